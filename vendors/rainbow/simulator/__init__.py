"""The virtual Rainbow controller: its ports.

It answers each `reqdata` on port 5001 with one frame in one send, as clients expect. Port 5000 acknowledges every
command and executes none: some clients insist on connecting to it.
"""

from __future__ import annotations

from gateway.sim.simulator import Demo, Port, Simulator
from vendors.rainbow.simulator.encoding import FILLERS, HEADER, RainbowOptions
from vendors.rainbow.simulator.sessions import CommandSession, StateSession

SIMULATOR = Simulator(
    ports=(
        Port(protocol="reqdata", port=5001, session=StateSession, header=HEADER, fillers=FILLERS),
        Port(protocol=None, port=5000, session=CommandSession),
    ),
    options=RainbowOptions,
    demos=(Demo(protocol="reqdata", robot={"estop_polarity": "active_low"}),),
)
