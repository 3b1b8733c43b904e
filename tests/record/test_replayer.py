"""What a robot's ring holds, replayed, gives the very samples that a subscriber of the live gateway got."""

from __future__ import annotations
