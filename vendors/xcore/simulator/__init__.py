"""The virtual xCore controller: External Communication and an agent of `xcore-objects/1`, from one motion and scenario.

Port 4320 answers the words of the vendor's manual, or calls a gateway instead; port 5920 pushes objects. The vendor has
no port for either: both numbers are ours.
"""

from __future__ import annotations

from typing import cast

import msgspec

from gateway.sim.simulator import Demo, Port, Simulator
from vendors.xcore.simulator.external import ExternalSession
from vendors.xcore.simulator.objects import FILLERS, ObjectsSession
from vendors.xcore.simulator.options import XcoreOptions

EXTERNAL_PORT = 4320
OBJECTS_PORT = 5920
# What a gateway must be told of a virtual controller with the usual options.
_ROBOT = {"port": EXTERNAL_PORT, "estop_polarity": "active_high"}
_SETTINGS = {"torque_unit": "Nm"}


def _calls(options: msgspec.Struct) -> tuple[str, int] | None:
    return cast("XcoreOptions", options).gateway


SIMULATOR = Simulator(
    ports=(
        Port(protocol="external", port=EXTERNAL_PORT, session=ExternalSession, header=1, calls=_calls),
        Port(protocol="objects", port=OBJECTS_PORT, session=ObjectsSession, header=1, fillers=FILLERS),
    ),
    options=XcoreOptions,
    demos=(
        Demo(protocol="external", robot={**_ROBOT, "external": _SETTINGS}),
        Demo(protocol="objects"),
        Demo(protocol="external", robot={**_ROBOT, "external": {**_SETTINGS, "role": "server"}}),
    ),
)
