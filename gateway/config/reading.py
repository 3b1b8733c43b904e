"""Reads a file that the operator has named; where that cannot be, the error says what to do."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from gateway.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path


def read_file(path: Path, largest: int, *, absent: str, kind: str) -> tuple[bytes, int]:
    """Read a file.

    Args:
        path: Where it is.
        largest: So many bytes it may have.
        absent: What to do where there is none.
        kind: What a larger one is not.

    Returns:
        What stands in it, and its mode.

    Raises:
        ConfigError: It cannot be read.
    """
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            data = file.read(largest + 1)
    except FileNotFoundError:
        raise ConfigError(f"{path}: does not exist; {absent}") from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: is a folder; name the file in it") from None
    except PermissionError:
        raise ConfigError(f"{path}: may not be read by this user; look at: ls -l {path}") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    if len(data) > largest:
        raise ConfigError(f"{path}: is larger than {largest} bytes; that is no {kind}")
    return data, mode
