"""An agent of `xcore-objects/1` for tests: its examples, and a decoder that has read a hello."""

from __future__ import annotations

import json

from gateway.api.decoder import Event, Frame, Reject
from vendors.xcore.stream import ObjectsDecoder, ObjectsOptions

UNITS = {
    "length": "m", "angle": "rad", "speed": "mm/s", "zone": "mm", "rotSpeed": "rad/s", "torque": "Nm", "mass": "kg",
    "time": "s",
}  # fmt: skip
INFO = {"id": "demo", "mac": "", "version": "3.2.1", "type": "demo-6", "joint_num": 6}
HELLO = {
    "type": "hello", "schema": "xcore-objects/1", "agent": "0.1.0", "sdkVersion": "0.7.1", "readOnly": True,
    "units": UNITS, "info": INFO,
}  # fmt: skip
TS = 1_700_000_000_000_000
# The second example of docs/xcore-objects.md, 8.6, byte by byte.
STATE = (
    b'{"type":"state","seq":1,"ts":1700000000000000,"jointPos":[0,0.5,-0.5,0,1.5,0],"powerState":"on",'
    b'"operateMode":"automatic","operationState":"idle"}\n'
)
Json = dict[str, object]


def line(message: object) -> bytes:
    return json.dumps(message, ensure_ascii=False, separators=(",", ":")).encode() + b"\n"


class Stream:
    """A decoder that has read a hello, and an agent that numbers its messages."""

    def __init__(self, hello: Json | None = None, ask: dict[str, float] | None = None) -> None:
        self.decoder = ObjectsDecoder(ObjectsOptions(ask=ask or {}))
        self.seq = 0
        self.hello = self.decoder.feed(line(HELLO if hello is None else hello))

    def tell(self, kind: str, **members: object) -> list[Event]:
        self.seq += 1
        return self.decoder.feed(line({"type": kind, "seq": self.seq, "ts": TS + self.seq, **members}))

    def values(self, kind: str, **members: object) -> Json:
        (event,) = self.tell(kind, **members)
        assert isinstance(event, Frame)
        return dict(event.values)

    def event(self, name: str, **data: object) -> Json:
        return self.values("event", event=name, data=data)

    def reject(self, kind: str, **members: object) -> Reject:
        event = self.tell(kind, **members)[0]
        assert isinstance(event, Reject)
        return event
