"""An invented vendor that cannot be imported."""

raise RuntimeError("early: no import")
