"""An agent beside ROKAE's xCore SDK: it publishes what the SDK knows as the stream `xcore-objects/1`, and reads only.

It is ours, not ROKAE's, and brings nothing of the SDK. `tap` is for an application that already drives the robot;
the command `robot-gateway-xcore-agent` is for a robot that nobody else drives through the SDK.
"""

from robot_gateway_xcore_agent.lines import AGENT_VERSION
from robot_gateway_xcore_agent.proxy import untap
from robot_gateway_xcore_agent.tap import Tap, tap, tap_of

__version__ = AGENT_VERSION
__all__ = ["Tap", "__version__", "tap", "tap_of", "untap"]
