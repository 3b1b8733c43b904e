from __future__ import annotations

import struct

from tests.faults.names import Answer, NameServer

QUESTION = struct.pack("!HHHHHH", 7, 0x0100, 1, 0, 0, 0) + b"\x05cell7\x04test\0" + struct.pack("!HH", 1, 1)


def test_the_name_service_answers_with_the_address_or_denies_it() -> None:
    server = NameServer()
    server.addresses["cell7.test"] = "127.0.0.9"
    found = server.answered(QUESTION)
    assert found[:2] == QUESTION[:2]
    assert struct.unpack_from("!HH", found, 4) == (1, 1)
    assert found.endswith(bytes([127, 0, 0, 9]))
    server.answer = Answer.NO_SUCH_NAME
    denied = server.answered(QUESTION)
    assert denied[3] & 0x0F == 3
    assert struct.unpack_from("!H", denied, 6) == (0,)
