"""What the virtual agent reads of its robot: the members of a state, and the objects that commands ask for too."""

from __future__ import annotations

from math import sin

from gateway.api.model import Power
from gateway.sim.scenario import RobotState
from vendors.xcore.encoding import Json, to_builtins
from vendors.xcore.objects import CartesianPosition, KeyPadState
from vendors.xcore.simulator import telling
from vendors.xcore.simulator.options import XcoreOptions

_NOT_READY = {"ec": -1, "message": "the virtual drives are being powered up"}


def state_members(state: RobotState, options: XcoreOptions) -> Json:
    """The members of a state, as JSON data."""
    pose = telling.pose(state)
    external = telling.extras(options)
    members: Json = {
        "jointPos": telling.joints(state, options),
        "jointVel": telling.velocities(state, options),
        "jointTorque": telling.torques(state, options),
        "posture": {"flangeInBase": pose, "endInRef": pose},
        "cartPosture": to_builtins(cart_posture(state, options)),
        "powerState": telling.power_state(state).value,
        "operateMode": telling.operate_mode(state).value,
        "operationState": telling.operation_state(state).value,
        "keypad": to_builtins(keypad(state)),
        "di": dict(zip(("part_present", "door_closed"), inputs(state), strict=True)),
        "do": dict(zip(("gripper", "lamp"), outputs(state), strict=True)),
        "ai": {"pressure": pressure(state)},
    }
    if external:
        members["external"] = external
    if state.phase.power is Power.BOOTING:
        members["jointTorque"] = None
        members["errors"] = {"jointTorque": _NOT_READY}
    return members


def cart_posture(state: RobotState, options: XcoreOptions) -> CartesianPosition:
    """Where the robot's end is."""
    return CartesianPosition(
        trans=state.tcp.position,
        rpy=state.tcp.rpy,
        hasElbow=options.axes > len(state.position),
        external=tuple(telling.extras(options)),
    )


def keypad(state: RobotState) -> KeyPadState:
    """The keys at the robot's end: who guides it by hand holds the first."""
    return KeyPadState(key1_state=state.phase.freedrive)


def inputs(state: RobotState) -> tuple[bool, bool]:
    """The digital inputs: there is a part in the gripper; the door is closed."""
    return state.gripper_closed, not state.phase.freedrive


def outputs(state: RobotState) -> tuple[bool, bool]:
    """The digital outputs: the gripper closes; the lamp is lit, as long as the program runs."""
    return state.gripper_closed, telling.running(state)


def pressure(state: RobotState) -> float:
    """The analog input: pressure of the gripper's air, in V."""
    return 4.2 + 0.3 * sin(state.time_s)
