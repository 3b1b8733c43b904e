"""What a robot's ring holds, replayed, gives the very samples that a subscriber of the live gateway got."""

from __future__ import annotations

from collections.abc import Mapping

import anyio
import pytest

from gateway.api.model import Sample
from gateway.client import connect
from gateway.core.bus import Bus
from gateway.core.events import EventRing
from gateway.core.settings import RobotSettings
from gateway.record.replayer import Replayer
from gateway.testing.cell import virtual_cell
