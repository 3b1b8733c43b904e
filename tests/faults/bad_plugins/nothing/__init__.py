"""An invented vendor whose `VENDOR` is none."""

VENDOR = 3
