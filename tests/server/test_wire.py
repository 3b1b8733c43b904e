"""Both encodings: what is joined by hand equals what the structs encode to, and nothing is encoded twice."""

from __future__ import annotations

import msgspec
import pytest

from gateway.api.messages import Data, EventMessage, Ping, Response
from gateway.api.model import Joints, Pose, Quality, Sample, Tcp
from gateway.core.bus import Bus
from gateway.server.inbox import Newest
from gateway.server.outbox import Outbox, Subscription, Wish
from gateway.server.wire import ENCODINGS, JSON, MSGPACK, Cut, Encoding, encode_events, project
from tests.server.kit import Now, cell, publish, raise_event, reading

both = pytest.mark.parametrize("encoding", ENCODINGS.values(), ids=["json", "msgpack"])


JSON_RESPONSES: msgspec.json.Decoder[Response] = msgspec.json.Decoder(Response)
MSGPACK_RESPONSES: msgspec.msgpack.Decoder[Response] = msgspec.msgpack.Decoder(Response)


def decoded(encoding: Encoding, message: bytes) -> Response:
    return JSON_RESPONSES.decode(message) if encoding.text else MSGPACK_RESPONSES.decode(message)


@both
@pytest.mark.parametrize("count", [0, 1, 2, 15, 16, 300])
def test_a_joined_message_says_what_the_struct_would_say(encoding: Encoding, count: int) -> None:
    samples = [
        Sample(topic="r1/joints", seq=seq, epoch="e", t=seq, q=Quality.GOOD, data=Joints(position=[1.5, None]))
        for seq in range(count)
    ]
    joined = encoding.list_message("data", "samples", [encoding.encode(sample) for sample in samples])
    assert decoded(encoding, joined) == decoded(encoding, encoding.encode(Data(samples=samples)))


def test_in_json_the_joined_message_is_the_same_to_the_byte() -> None:
    sample = Sample(topic="r1/joints", seq=1, epoch="e", t=1, q=Quality.GOOD, data=Joints())
    joined = JSON.list_message("data", "samples", [JSON.encode(sample), JSON.encode(sample)])
    assert joined == JSON.encode(Data(samples=[sample, sample]))


@both
def test_events_are_joined_the_same_way(encoding: Encoding) -> None:
    bus, _ = cell("r1")
    for _ in range(3):
        raise_event(bus, "r1")
    events, _ = bus.events.since(None, 10)
    assert decoded(encoding, encode_events(encoding, events)) == EventMessage(events=events)


def test_a_request_is_read_from_either_encoding() -> None:
    assert JSON.decode(b'{"op":"ping","id":1}') == Ping(id=1)
    assert MSGPACK.decode(msgspec.msgpack.encode({"op": "ping", "id": "a"})) == Ping(id="a")


def test_projection_keeps_the_named_paths_and_nothing_else() -> None:
    pose = Pose(position=[1.0, 2.0, 3.0])
    tcp = Tcp(pose=pose, speed=0.5)
    assert project(tcp, (("speed",),)) == {"speed": 0.5}
    assert project(tcp, (("pose", "position"), ("speed",))) == {"pose": {"position": [1.0, 2.0, 3.0]}, "speed": 0.5}
    assert project(tcp, (("pose",),)) == {"pose": pose}
    assert project(tcp, (("pose",), ("pose", "position"))) == {"pose": pose}
    assert project(tcp, (("target_pose", "position"),)) == {"target_pose": {"position": None}}
    assert project(tcp, (("zzz",), ("speed", "zzz"), ("pose", "zzz"))) == {}


def test_projection_reads_the_mapping_of_a_vendor_group() -> None:
    data = {"word": {"raw": 3, "bit": 1}, "none": None}
    assert project(data, (("word", "bit"),)) == {"word": {"bit": 1}}
    assert project(data, (("none", "bit"),)) == {"none": {"bit": None}}
    assert project(data, (("zzz", "bit"),)) == {}


@both
def test_a_cut_changes_the_data_and_leaves_the_envelope(encoding: Encoding) -> None:
    bus, _ = cell("r1")
    made = reading("r1/joints", 5)
    whole = Cut(encoding, None).encoded(bus.topics["r1/joints"], made)
    part = Cut(encoding, (("position",),)).encoded(bus.topics["r1/joints"], made)
    full, cut = (decoded(encoding, encoding.list_message("data", "samples", [one])) for one in (whole, part))
    assert isinstance(full, Data)
    assert isinstance(cut, Data)
    assert cut.samples[0].data == {"position": [5.0, None]}
    assert msgspec.structs.replace(full.samples[0], data=None) == msgspec.structs.replace(cut.samples[0], data=None)


class CountingEncoding:
    """An encoding that counts what it encodes."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.text = True
        self.count = 0
        self.decode = JSON.decode
        self.decode_id = JSON.decode_id
        self.list_message = JSON.list_message

    def encode(self, message: object) -> bytes:
        """Encode one message."""
        self.count += 1
        return JSON.encode(message)


def subscribed(bus: Bus, encoding: Encoding, fields: tuple[tuple[str, ...], ...] | None) -> Outbox:
    outbox = Outbox(encoding, 0.0, Now())
    wish = Wish(period_s=None, every=False, cut=Cut(encoding, fields))
    outbox.add(1, Subscription(wish, bus.match(["r1/joints"]), outbox))
    return outbox


def test_a_sample_is_encoded_once_for_each_topic_fields_and_encoding_whatever_the_number_of_clients() -> None:
    bus, _ = cell("r1")
    one, two = CountingEncoding("one"), CountingEncoding("two")
    outboxes = [
        subscribed(bus, encoding, fields)
        for encoding in (one, two)
        for fields in (None, (("position",),))
        for _ in range(50)
    ]
    made = publish(bus, "r1/joints", 1)
    assert made.asked == 0
    messages = [message for outbox in outboxes for message in outbox.collect()]
    assert len(messages) == 200
    assert (one.count, two.count) == (2, 2)
    assert made.asked == 4


def test_nothing_is_normalised_while_nobody_is_subscribed() -> None:
    bus, _ = cell("r1")
    assert publish(bus, "r1/joints", 1).asked == 0


def test_an_inbox_that_is_not_due_gives_nothing() -> None:
    assert Newest(1.0, None).take(5.0) == []
