"""FAIRINO FR series: CNDE (20005, UDP 20006), and the frames that older firmware pushes on 20004 and 8083."""

from __future__ import annotations

from gateway.api.vendor import Vendor
from vendors.fairino.cnde_protocol import CNDE
from vendors.fairino.pushed import LEGACY, STATUS

VENDOR = Vendor(name="fairino", title="FAIRINO FR", protocols=(CNDE, LEGACY, STATUS))
