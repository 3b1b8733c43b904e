"""The model: its schemas, its defaults, and what it promises of null."""

from __future__ import annotations

import jsonschema
import msgspec
import pytest

from gateway.api.model import (
    FRAME_GROUPS,
    GROUPS,
    QUALITY_RANK,
    SAFETY_NOTICE,
    Fault,
    Joints,
    Pose,
    Quality,
    Safety,
    SafetyState,
    Tcp,
    worst,
)

STRUCTS = {name: group.struct for name, group in GROUPS.items() if group.struct is not None}


@pytest.mark.parametrize("name", STRUCTS)
def test_every_group_has_a_valid_schema_that_describes_every_key(name: str) -> None:
    schema = msgspec.json.schema(STRUCTS[name])
    jsonschema.Draft202012Validator.check_schema(schema)
    for struct in schema["$defs"].values():
        assert struct.get("description")
        for key, value in struct.get("properties", {}).items():
            assert value.get("description"), f"{name}: {key}"


@pytest.mark.parametrize("name", FRAME_GROUPS)
def test_every_leaf_of_a_frame_group_may_be_null(name: str) -> None:
    empty = STRUCTS[name]()
    told = {key: value for key, value in msgspec.to_builtins(empty).items() if value is not None}
    assert told in ({}, {"substituted": []})
    jsonschema.validate(msgspec.to_builtins(empty), msgspec.json.schema(STRUCTS[name]))


def test_units_stand_in_the_schema() -> None:
    schema = msgspec.json.schema(Joints)
    assert schema["$defs"]["Joints"]["properties"]["temperature"]["unit"] == "K"


def test_the_safety_schema_says_what_it_is_not_for() -> None:
    assert SAFETY_NOTICE in msgspec.json.schema(Safety)["$defs"]["Safety"]["description"]


def test_the_worst_quality_wins() -> None:
    assert worst(Quality.GOOD, Quality.SUBSTITUTED, Quality.UNCERTAIN) is Quality.UNCERTAIN
    assert worst(Quality.DISCONNECTED, Quality.BAD) is Quality.DISCONNECTED
    ranked = sorted(Quality, key=QUALITY_RANK.__getitem__, reverse=True)
    assert ranked == ["DISCONNECTED", "STALE", "BAD", "UNCERTAIN", "SUBSTITUTED", "GOOD"]


def test_structs_survive_json_and_messagepack() -> None:
    tcp = Tcp(pose=Pose([1.0, None, 2.0], [0.0, 0.0, 0.0, 1.0]), substituted=["pose"])
    assert msgspec.json.decode(msgspec.json.encode(tcp), type=Tcp) == tcp
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(tcp), type=Tcp) == tcp


def test_an_enumeration_takes_no_other_word() -> None:
    assert msgspec.convert({"state": "NORMAL"}, Safety).state is SafetyState.NORMAL
    with pytest.raises(msgspec.ValidationError, match="Invalid enum value 'CALM'"):
        msgspec.convert({"state": "CALM"}, Safety)


def test_a_fault_is_the_same_while_code_and_joint_are() -> None:
    assert Fault("err_jam", joint=1, since=5).key == Fault("err_jam", joint=1, text="JAM").key
    assert Fault("err_jam", joint=1).key != Fault("err_jam", joint=2).key
