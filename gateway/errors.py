"""The error tree: everything that the gateway raises on purpose.

    GatewayError
    ├── ConfigError          the configuration cannot be used: exit code 78
    ├── VendorError          a plugin is broken: its robots are off, the others run
    │   └── UnknownVendor    there is no plugin of that name: in a configuration that is an error
    └── LinkError            a link failed: it is retried
        ├── LinkClosed       the connection could not be opened, or has ended
        ├── LinkStale        no good frame within `stale_s`
        └── LinkRefused      the controller or the stream was refused, by a decoder or by the controller itself

Errors carry attributes, not prose to parse. Misuse of a function raises `ValueError` or `TypeError`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


class GatewayError(Exception):
    """Base of all errors raised on purpose."""


class ConfigError(GatewayError):
    """The configuration cannot be used.

    Attributes:
        problems: One line for each thing that is wrong: file, line, key and what to do.
    """

    def __init__(self, *problems: str) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


class VendorError(GatewayError):
    """A plugin is broken or missing.

    Attributes:
        vendor: Name of the plugin.
        reason: What is wrong with it.
    """

    def __init__(self, vendor: str, reason: str) -> None:
        super().__init__(f"vendor {vendor}: {reason}")
        self.vendor = vendor
        self.reason = reason


class UnknownVendor(VendorError):
    """There is no plugin of that name.

    Attributes:
        nearest: The names most like it, best first.
    """

    def __init__(self, vendor: str, reason: str, nearest: Sequence[str] = ()) -> None:
        super().__init__(vendor, reason)
        self.nearest = tuple(nearest)


class LinkError(GatewayError):
    """A link failed and is retried.

    Attributes:
        reason: What happened, in words for the operator.
    """

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class LinkClosed(LinkError):
    """The connection could not be opened, or has ended.

    Attributes:
        refused: The controller is there, but nothing listens on the port; or, where it calls, it has not called.
    """

    def __init__(self, reason: str, *, refused: bool = False) -> None:
        super().__init__(reason)
        self.refused = refused


class LinkStale(LinkError):
    """No good frame came within `stale_s`."""


class LinkRefused(LinkError):
    """The stream or the login was refused.

    Attributes:
        kind: `out_of_step` is retried at once; `incompatible` and `refused` slowly.
    """

    def __init__(self, reason: str, kind: str) -> None:
        super().__init__(reason)
        self.kind = kind
