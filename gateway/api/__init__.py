"""The vendor kit: everything that a plugin in `vendors/` stands on. Pure: no I/O, no clock, no log.

Import from the modules: `layout` (tables), `framing` and `decoder` (bytes to frames), `signals` (frames to the
canonical `model`), `vendor` (what a plugin exports) and `messages` (the native protocol's structs).
"""
