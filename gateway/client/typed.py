"""Samples whose data is the model's own struct of its group, instead of plain objects."""

from __future__ import annotations

import msgspec

from gateway.api.model import GROUPS, Sample

_KEYS = {name: frozenset(group.struct.__struct_encode_fields__) for name, group in GROUPS.items() if group.struct}


def typed(sample: Sample) -> Sample:
    """The sample with its data as the struct of its group: `Joints`, `Status` ….

    Data that is not whole stays as it came: a vendor's own, a choice of `fields`, or a value that only a later gateway
    knows.
    """
    group = GROUPS.get(sample.topic.rpartition("/")[2])
    data = sample.data
    if group is None or group.struct is None or not isinstance(data, dict):
        return sample
    if not _KEYS[group.name] <= data.keys():
        return sample
    try:
        return msgspec.structs.replace(sample, data=msgspec.convert(data, group.struct))
    except msgspec.ValidationError:
        return sample
