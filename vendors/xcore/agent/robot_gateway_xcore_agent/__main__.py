"""`python -m robot_gateway_xcore_agent` is the command `robot-gateway-xcore-agent`."""

import sys

from robot_gateway_xcore_agent.cli import main

sys.exit(main())
