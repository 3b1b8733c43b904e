"""Which entries of the controller's log stand as faults, and until when."""

from __future__ import annotations

import pytest

from gateway.api.decoder import Frame, Reject
from gateway.api.model import Fault, Severity
from tests.vendors.xcore.stream_kit import Json, Stream
from vendors.xcore.log_faults import MOST, LogFaults
from vendors.xcore.objects import LogInfo
from vendors.xcore.stream_record import Entry

ENTRY: Json = {"id": 50002, "timestamp": "2024-05-01", "content": "Axis 3 is overloaded", "repair": "Reduce the load"}
FAULT = Fault("50002", main=50002, severity=Severity.ERROR, text="Axis 3 is overloaded", remedy="Reduce the load")


def test_an_entry_is_a_fault_with_the_vendors_text_and_remedy() -> None:
    found = Stream()
    assert found.values("log", level="error", log=ENTRY)["faults"] == [FAULT]
    assert found.values("state", powerState="off")["faults"] == [FAULT]


@pytest.mark.parametrize(
    ("level", "severity"), [("error", Severity.ERROR), ("warning", Severity.WARNING), (None, None), ("alert", None)]
)
def test_an_entry_of_any_level_but_info_is_a_fault(level: str | None, severity: Severity | None) -> None:
    values = Stream().values("log", level=level, log={"id": 7})
    assert values["faults"] == [Fault("7", main=7, severity=severity)]


def test_information_is_no_fault() -> None:
    found = Stream()
    values = found.values("log", level="info", log=ENTRY)
    assert "faults" not in values
    assert values["log"] == Entry(
        "info", LogInfo(id=50002, timestamp="2024-05-01", content="Axis 3 is overloaded", repair="Reduce the load")
    )


@pytest.mark.parametrize(
    "members",
    [
        {"level": 2, "log": ENTRY},
        {"level": "error", "log": None},
        {"level": "error", "log": {"id": "x"}},
        {"level": "error"},
    ],
)
def test_a_log_that_is_none_is_rejected(members: Json) -> None:
    assert isinstance(Stream().tell("log", **members)[0], Reject)


def test_before_the_first_evidence_nothing_is_known() -> None:
    found = Stream()
    assert "faults" not in found.values("state", operationState="idle")
    assert found.values("state", operationState="moving")["faults"] == []


def test_a_fault_stands_until_the_robot_works_again_after_it_has_stood_still() -> None:
    found = Stream()
    found.values("state", operationState="moving")
    found.tell("log", level="error", log=ENTRY)
    for running in ("moving", "rlProgram", "idle", "unknown", "drag", "jog"):  # it runs out, stops, and is looked at
        assert found.values("state", operationState=running)["faults"] == [FAULT]
    assert found.values("state", operationState="moving")["faults"] == []
    assert found.values("state", operationState="idle")["faults"] == []


def test_a_repeated_entry_is_one_fault_and_stands_from_its_last_repetition() -> None:
    found = Stream()
    found.tell("log", level="error", log=ENTRY)
    found.values("state", operationState="idle")
    (event,) = found.tell("log", level="error", log=ENTRY)
    assert isinstance(event, Frame)
    assert "faults" not in event.values  # nothing new
    assert found.values("state", operationState="moving")["faults"] == [FAULT]
    found.values("state", operationState="idle")
    assert found.values("state", operationState="moving")["faults"] == []
    assert found.values("log", level="error", log=ENTRY)["faults"] == [FAULT]


def test_a_text_that_comes_later_completes_the_fault() -> None:
    found = Stream()
    found.tell("log", level=None, log={"id": 50002})
    assert found.values("log", level="error", log=ENTRY)["faults"] == [FAULT]
    (event,) = found.tell("log", level=None, log={"id": 50002})
    assert isinstance(event, Frame)
    assert "faults" not in event.values


def test_the_number_of_faults_is_bounded() -> None:
    faults = LogFaults()
    for number in range(100):
        faults.take(Entry("error", LogInfo(id=number)))
    assert faults.standing is not None
    assert [fault.main for fault in faults.standing] == list(range(MOST))  # those that stand do not give way
    assert faults.left_out == 100 - MOST
