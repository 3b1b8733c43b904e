"""The command `robot-gateway-xcore-agent`: its options, its exit codes, its signals."""

from __future__ import annotations

import argparse
import faulthandler
import logging
import os
import signal
import sys
from typing import List, NoReturn, Optional

from robot_gateway_xcore_agent import owner, sdk
from robot_gateway_xcore_agent.lines import AGENT_VERSION
from robot_gateway_xcore_agent.reader import Port, Ports
from robot_gateway_xcore_agent.tap import DEFAULT_PORT

log = logging.getLogger("robot_gateway_xcore_agent")

FLAG = "--connecting-may-stop-the-robot"
NOT_ACKNOWLEDGED = (
    "not started: connecting through the SDK resets the controller's motion buffer, and losing the connection later "
    "may stop the robot. Where an application already drives the robot through the SDK, use the tap in it instead. "
    f"If this robot may be disturbed now, say so with {FLAG}"
)
SLOWEST_HZ, FASTEST_HZ = 1.0, 50.0
LOOPBACK = ("127.0.0.1", "::1", "localhost")
MAX_PORT = 65_535
HIGHEST_INDEX = 65_535
EXIT_CODES = f"""\
exit codes:
  0   stopped by SIGTERM or SIGINT
  1   a mistake of the agent
  2   the options are wrong
  3   {FLAG} is missing
  69  the SDK is not installed for this Python
  70  the SDK does not import, or lacks the robot's class
  73  the address to listen on cannot be had; the robot was not touched
  75  the robot was not reached, or refused the SDK (only without --reconnect)
  -6  the SDK ended the process (SIGABRT); nothing in it can prevent that
"""


class _OneLine(logging.Formatter):
    """One line for each record, a trace included."""

    def format(self, record: logging.LogRecord) -> str:
        return super().format(record).replace("\n", " | ")


def _rate(text: str) -> float:
    value = float(text)
    if not SLOWEST_HZ <= value <= FASTEST_HZ:
        raise argparse.ArgumentTypeError(f"must be {SLOWEST_HZ:g} to {FASTEST_HZ:g}")
    return value


def _seconds(text: str) -> float:
    value = float(text)
    if not 0 < value <= 60:  # noqa: PLR2004 - a minute
        raise argparse.ArgumentTypeError("must be more than 0 and at most 60")
    return value


def _port(text: str) -> int:
    value = int(text)
    if not 0 <= value <= MAX_PORT:
        raise argparse.ArgumentTypeError("must be 0 to 65535")
    return value


def _board_port(text: str) -> Port:
    name, found, place = text.partition("=")
    board, comma, port = place.partition(",")
    if not (name and found and comma and board.isdecimal() and port.isdecimal()):
        raise argparse.ArgumentTypeError("must be NAME=BOARD,PORT")
    if max(int(board), int(port)) > HIGHEST_INDEX:
        raise argparse.ArgumentTypeError("board and port are 65535 at most")
    return Port(name, int(board), int(port))


def parser() -> argparse.ArgumentParser:
    """Make the parser of the command line."""
    made = argparse.ArgumentParser(
        prog="robot-gateway-xcore-agent",
        description="Reads one robot through ROKAE's xCore SDK and publishes it as xcore-objects/1. Read-only.",
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    classes = ", ".join(f"{name} ({text})" for name, text in sdk.ROBOT_CLASSES.items())
    made.add_argument("--version", action="version", version=AGENT_VERSION)
    made.add_argument("--robot", required=True, metavar="IP", help="address of the controller")
    made.add_argument("--class", required=True, dest="robot_class", choices=sdk.ROBOT_CLASSES, help=classes)
    made.add_argument(FLAG, dest="acknowledged", action="store_true", help="it may: without this nothing is connected")
    made.add_argument("--listen", default="127.0.0.1", metavar="HOST", help="address for the gateway (%(default)s)")
    made.add_argument("--port", type=_port, default=DEFAULT_PORT, help="port for the gateway (%(default)s)")
    made.add_argument("--local-ip", default="", metavar="IP", help="this computer's address, as the SDK wants it")
    made.add_argument("--rate", type=_rate, default=10.0, metavar="HZ", help="states a second, 1 to 50 (%(default)g)")
    made.add_argument("--call-timeout", type=_seconds, default=3.0, metavar="S", help="when a call hangs (%(default)g)")
    for kind, text in (("di", "a digital input"), ("do", "a digital output"), ("ai", "an analog input")):
        made.add_argument(
            "--" + kind,
            type=_board_port,
            action="append",
            default=[],
            metavar="NAME=BOARD,PORT",
            help="publish " + text + "; may be repeated",
        )
    made.add_argument("--reconnect", action="store_true", help="connect again after a loss: this may stop the robot")
    made.add_argument(
        "--disconnect-on-exit", action="store_true", help="call disconnectFromRobot at the end: this stops the robot"
    )
    return made


def main(argv: Optional[List[str]] = None) -> int:
    """Run the command; answers an exit code if the robot was never touched, and ends the process otherwise."""
    found = parser().parse_args(argv)
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_OneLine("%(asctime)s %(levelname)s %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    if not found.acknowledged:
        log.error(NOT_ACKNOWLEDGED)
        return owner.EXIT_NOT_ACKNOWLEDGED
    options = owner.Options(
        robot=found.robot,
        robot_class=found.robot_class,
        listen=found.listen,
        port=found.port,
        local_ip=found.local_ip,
        period_s=1.0 / found.rate,
        call_timeout_s=found.call_timeout,
        reconnect=found.reconnect,
        disconnect_on_exit=found.disconnect_on_exit,
        ports=Ports(tuple(found.di), tuple(found.do), tuple(found.ai)),
    )
    return _own(options)


def _own(options: owner.Options) -> int:
    try:
        owned = owner.Owner(options, sdk.load())
    except sdk.SdkMissingError as error:
        log.error("%s", error)  # noqa: TRY400 - a trace says nothing to the user
        return owner.EXIT_NO_SDK
    except Exception as error:  # noqa: BLE001 - whatever a broken SDK raises
        log.error("the SDK cannot be used: %s: %s", type(error).__name__, error)  # noqa: TRY400 - the same
        return owner.EXIT_BROKEN_SDK
    try:
        owned.service.stream.listen(options.listen, options.port)
    except OSError as error:
        log.error("cannot listen on %s port %d: %s", options.listen, options.port, error)  # noqa: TRY400 - the same
        return owner.EXIT_ADDRESS_TAKEN
    log.info("listener.opened peer=%s", owned.service.stream.address)
    if options.listen not in LOOPBACK:
        log.warning("listener.opened reason='not on loopback: whoever reaches the port reads, without a password'")
    faulthandler.enable()

    def stop(_number: int, _frame: object) -> None:
        owned.stopping = True

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    try:
        code = owned.run()
    except BaseException:
        log.exception("agent.failed")
        code = owner.EXIT_MISTAKE
    return _leave(code)


def _leave(code: int) -> NoReturn:
    """End the process without destructors: the SDK's may disconnect, and disconnecting stops the robot."""
    logging.shutdown()
    sys.stderr.flush()
    os._exit(code)
