"""Prebuilt frames, held against a foreign WebSocket library."""

from __future__ import annotations

import pytest
from websockets.frames import Frame, Opcode

from gateway.server.frames import frame


@pytest.mark.parametrize("text", [True, False])
@pytest.mark.parametrize("size", [0, 1, 125, 126, 127, 65_535, 65_536, 200_000])
def test_a_frame_is_what_another_library_makes_of_it(size: int, *, text: bool) -> None:
    message = b"x" * size
    expected = Frame(Opcode.TEXT if text else Opcode.BINARY, message).serialize(mask=False)
    assert frame(message, text=text) == expected
