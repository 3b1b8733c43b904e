"""The virtual-controller kit: motion, scenario, chaos and sockets, for `simulate`, `demo` and the tests.

The daemon never imports it. A vendor's module or package `simulator` exports `SIMULATOR`, a `Simulator` record; the
sessions that it makes do no I/O, like the decoders at the other end.
"""
