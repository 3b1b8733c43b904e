"""The suite itself: each planted defect is found by the right check, with a message that helps."""

from __future__ import annotations

import dataclasses
import math
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec
import pytest

from gateway.api.decoder import Decoder, Event, Frame, Refused, Reject, Skipped
from gateway.api.framing import Checksum, FramedDecoder, Framing
from gateway.api.layout import Field, Flag, Layout
from gateway.api.polling import Polled
from gateway.api.signals import Signal
from gateway.api.vendor import Protocol
from gateway.core.registry import Registry
from gateway.testing.conformance import CHECKS, Result, perform, subjects
from gateway.testing.subject import Subject

KILO = Path(__file__).parent / "kilo"
BY_NAME = {check.name: check for check in CHECKS}
# What has nothing to look at in pushed frames with a checksum.
FOR_OTHERS = (
    "damaged_values_move_nothing",
    "skipped_frames_answer_nothing",
    "unrequested_frames_end_the_session",
    "requests_never_outrun_answers",
)
FOR_TEXT = tuple(check.name for check in CHECKS if "text" in check.of)


@pytest.fixture
def rainbow() -> Subject:
    return subjects(Registry(), "rainbow")[0]


@pytest.fixture
def kilo(tmp_path: Path) -> Subject:
    shutil.copytree(KILO, tmp_path / "kilo", ignore=shutil.ignore_patterns("__pycache__"))
    for path in (tmp_path, *tmp_path.rglob("*")):
        path.chmod(0o700)
    return subjects(Registry((tmp_path,)), "kilo")[0]


def with_protocol(subject: Subject, **changes: object) -> Subject:
    """A copy whose protocol differs."""
    protocol = dataclasses.replace(subject.protocol, **changes)  # type: ignore[arg-type] # names of its fields
    return dataclasses.replace(subject, protocol=protocol, _normalisers={})


def with_framing(subject: Subject, **changes: object) -> Subject:
    """A copy whose framing differs."""
    framing = dataclasses.replace(subject.framing, **changes)  # type: ignore[arg-type] # the same
    return with_protocol(subject, framing=framing)


def with_layouts(subject: Subject, change: Callable[[Layout], Layout]) -> Subject:
    """A copy whose tables differ."""
    kinds = [dataclasses.replace(kind, layouts=tuple(map(change, kind.layouts))) for kind in subject.framing.kinds]
    return with_framing(subject, kinds=tuple(kinds))


def with_field(subject: Subject, name: str, change: Callable[[Field], Field]) -> Subject:
    """A copy in whose tables one field differs."""

    def changed(layout: Layout) -> Layout:
        fields = tuple(change(field) if field.name == name else field for field in layout.fields)
        return dataclasses.replace(layout, fields=fields)

    return with_layouts(subject, changed)


def with_flag(subject: Subject, field: str, name: str, **changes: object) -> Subject:
    """A copy in whose tables one flag differs."""

    def differing(flag: Flag) -> Flag:
        return dataclasses.replace(flag, **changes) if flag.name == name else flag  # type: ignore[arg-type] # the same

    def changed(field: Field) -> Field:
        return dataclasses.replace(field, flags=tuple(map(differing, field.flags)))

    return with_field(subject, field, changed)


def with_signal(subject: Subject, at: str, /, **changes: object) -> Subject:
    """A copy in which one signal row differs."""

    def differing(row: Signal) -> Signal:
        return dataclasses.replace(row, **changes) if row.key == at else row  # type: ignore[arg-type] # the same

    return with_protocol(subject, signals=tuple(map(differing, subject.protocol.signals)))


def with_reader(subject: Subject, decoder: type[FramedDecoder]) -> Subject:
    """A copy whose decoder is another one."""

    class Changed(Protocol):
        def reader(self) -> FramedDecoder:
            """Make the other decoder."""
            assert self.framing is not None
            return decoder(self.framing)

    return dataclasses.replace(subject, protocol=_as(Changed, subject.protocol))


def with_session(subject: Subject, session: Callable[[FramedDecoder, bytes], Decoder]) -> Subject:
    """A copy that speaks to the controller in another way."""

    class Changed(Protocol):
        def decoder(self, options: msgspec.Struct) -> Decoder:
            """Make the other session."""
            assert self.request is not None
            assert self.framing is not None
            return session(FramedDecoder(self.framing), self.request(options))

    return dataclasses.replace(subject, protocol=_as(Changed, subject.protocol))


def _as(kind: type[Protocol], protocol: Protocol) -> Protocol:
    return kind(**{field.name: getattr(protocol, field.name) for field in dataclasses.fields(protocol)})


class LosesRejects(FramedDecoder):
    """Forgets the bytes that are no frame."""

    def feed(self, data: bytes) -> list[Event]:
        """Take bytes."""
        return [event for event in super().feed(data) if not isinstance(event, Reject)]


class LosesCutFrames(FramedDecoder):
    """Takes one read for one frame, like many clients."""

    def feed(self, data: bytes) -> list[Event]:
        """Take bytes."""
        events = super().feed(data)
        return [*events, *self.end()]


class GivesUp(FramedDecoder):
    """Stops for good at the first wrong byte."""

    broken = False

    def feed(self, data: bytes) -> list[Event]:
        """Take bytes."""
        if self.broken:
            return [Reject(data, "broken")]
        events = super().feed(data)
        self.broken = any(isinstance(event, Reject) for event in events)
        return events


class Raises(FramedDecoder):
    """Raises at what it does not know."""

    def feed(self, data: bytes) -> list[Event]:
        """Take bytes."""
        events = super().feed(data)
        if any(isinstance(event, Reject) for event in events):
            raise ValueError("unknown frame")
        return events


class Hoards(FramedDecoder):
    """Keeps every byte that is no frame in its buffer."""

    hoard = 0

    @property
    def pending(self) -> int:
        """What the buffer seems to hold."""
        return self.hoard

    def feed(self, data: bytes) -> list[Event]:
        """Take bytes."""
        events = super().feed(data)
        self.hoard += sum(len(event.raw) for event in events if isinstance(event, Reject))
        return events


class IgnoresMagic(FramedDecoder):
    """Looks at length and type only."""

    def __init__(self, framing: Framing) -> None:
        super().__init__(dataclasses.replace(framing, magic=b""))


class Impatient(Polled):
    """Asks in every period, answered or not."""

    def tick(self) -> bytes | Refused:
        """Ask."""
        return self._request


class Trusting(Polled):
    """Takes frames that nobody asked for."""

    def feed(self, data: bytes) -> list[Event]:
        """Take bytes."""
        self._turn.answered()
        return self._decoder.feed(data)


class EasilyAnswered(Polled):
    """Takes a frame that carries no state for the answer."""

    def feed(self, data: bytes) -> list[Event]:
        """Take bytes."""
        events = super().feed(data)
        if any(isinstance(event, Skipped) for event in events):
            self._turn.answered()
        return events


def swap(first: str, second: str) -> Callable[[Subject], Subject]:
    """Exchange the places of two fields of one size."""

    def changed(layout: Layout) -> Layout:
        one, other = layout.by_name[first], layout.by_name[second]
        moved = {first: other.offset, second: one.offset}
        return dataclasses.replace(
            layout,
            fields=tuple(
                dataclasses.replace(field, offset=moved.get(field.name, field.offset)) for field in layout.fields
            ),
        )

    return lambda subject: with_layouts(subject, changed)


def slowly(*_: object) -> bool:
    """Take a very long time, for a function of a signal row."""
    return sum(range(3000)) > 0


Plant = Callable[[Subject], Subject]

# defect -> how it is planted, the check that must find it, and words that its message must have
DEFECTS: Mapping[str, tuple[Plant, str, str]] = {
    "two fields exchanged": (swap("jnt_ref", "jnt_ang"), "vectors_decode", "vendor.jnt_ref[0] should be"),
    "a field four bytes off": (
        lambda s: with_field(s, "jnt_cur", lambda f: dataclasses.replace(f, offset=f.offset + 4)),
        "tables_hold",
        "overlaps jnt_cur",
    ),
    "a signed word read as unsigned": (
        lambda s: with_field(s, "is_freedrive_mode", lambda f: dataclasses.replace(f, type="u32")),
        "vectors_decode",
        "is_freedrive_mode.raw should be",
    ),
    "a unit of the same quantity": (
        lambda s: with_field(s, "jnt_ang", lambda f: dataclasses.replace(f, unit="rad")),
        "vectors_decode",
        "canonical.joints.position[0] should be",
    ),
    "a unit of another quantity": (
        lambda s: with_field(s, "jnt_ang", lambda f: dataclasses.replace(f, unit="N")),
        "signals_compile",
        "'N' converts to 'N', not to 'rad'",
    ),
    "a unit that does not exist": (
        lambda s: with_field(s, "jnt_ang", lambda f: dataclasses.replace(f, unit="furlong")),
        "tables_hold",
        "unit 'furlong' is unknown",
    ),
    "a table without a source": (
        lambda s: with_layouts(s, lambda layout: dataclasses.replace(layout, source="")),
        "tables_hold",
        "name manual, version and section",
    ),
    "a flag one bit off": (
        lambda s: with_flag(s, "information_chunk_3", "safety_sss_pressed", bit=24),
        "tables_hold",
        "overlaps another flag",
    ),
    "a flag that is too wide": (
        lambda s: with_flag(s, "is_freedrive_mode", "freedrive", width=3),
        "vectors_decode",
        "is_freedrive_mode.freedrive should be 0",
    ),
    "a word compared without its mask": (
        lambda s: with_signal(s, "safety.self_collision", field="op_stat_self_collision"),
        "vectors_decode",
        "canonical.safety.self_collision should be False",
    ),
    "a row of a field that does not exist": (
        lambda s: with_signal(s, "joints.current", field="jnt_curr"),
        "signals_compile",
        "no field or flag 'jnt_curr'",
    ),
    "a row of a key that does not exist": (
        lambda s: with_signal(s, "joints.current", key="joints.currents"),
        "signals_compile",
        "the model has no key 'joints.currents'",
    ),
    "a rotation left out": (
        lambda s: with_signal(s, "tcp.pose", rotation=None),
        "vectors_decode",
        "canonical.tcp.pose.orientation should be",
    ),
    "a commanded value shown as measured": (
        lambda s: with_signal(s, "tcp.pose", quality=s.protocol.signals[0].quality),
        "vectors_decode",
        "canonical.tcp.q should be SUBSTITUTED",
    ),
    "zero where nothing is known": (
        lambda s: with_signal(s, "status.program.run_time", via=lambda v: v or 0.0, partial=True),
        "vectors_decode",
        "run_time should be None, not 0.0",
    ),
    "an enumeration with a word of its own": (
        lambda s: with_signal(s, "status.motion", via=lambda *_: "DANCING"),
        "canonical_groups_fit_the_model",
        "does not fit the model: Invalid enum value 'DANCING'",
    ),
    "a quaternion that is none": (
        lambda s: with_signal(s, "tcp.target_pose", via=lambda six: {"position": six[:3], "orientation": six[:4]}),
        "canonical_groups_fit_the_model",
        "give a unit quaternion",
    ),
    "NaN that is told": (
        lambda s: with_signal(s, "controller.tool_voltage", via=lambda v: math.nan if v is None else v, partial=True),
        "nothing_is_told_that_is_not_finite",
        "tool_voltage is nan: make it null",
    ),
    "a slow function": (
        lambda s: with_signal(s, "status.drives_powered", via=slowly),
        "decoding_is_fast",
        "times struct.unpack of the same bytes",
    ),
    "no magic": (lambda s: with_framing(s, magic=b""), "framing_holds", "the framing has no magic"),
    "half a magic": (lambda s: with_framing(s, magic=b"", header=4), "garbage_gives_nothing", "bytes give Frame"),
    "a magic that is not checked": (
        lambda s: with_reader(s, IgnoresMagic),
        "damaged_headers_cost_little",
        "is still taken for a frame: check the magic",
    ),
    "a length that may change within a session": (
        lambda s: with_framing(s, one_length=False),
        "damaged_headers_cost_little",
        "mixes two frames",
    ),
    "a length that counts itself wrongly": (
        lambda s: with_framing(s, length_adds=0),
        "vectors_decode",
        "should give one frame of layout 580",
    ),
    "a kind that its table does not fit": (
        lambda s: with_framing(s, kinds=tuple(dataclasses.replace(kind, smallest=500) for kind in s.framing.kinds)),
        "framing_holds",
        "a frame of layout 488 has 488 bytes",
    ),
    "rejects that are lost": (
        lambda s: with_reader(s, LosesRejects),
        "junk_is_rejected",
        "put every byte into the `raw` of exactly one event",
    ),
    "one read taken for one frame": (
        lambda s: with_reader(s, LosesCutFrames),
        "cuts_change_nothing",
        "a decoder must not depend on how bytes arrive",
    ),
    "a decoder that gives up": (lambda s: with_reader(s, GivesUp), "damaged_headers_cost_little", "search on"),
    "a decoder that raises": (lambda s: with_reader(s, Raises), "garbage_gives_nothing", "ValueError: unknown frame"),
    "a buffer without bounds": (lambda s: with_reader(s, Hoards), "garbage_gives_nothing", "wait in the buffer"),
    "a second request before the answer": (
        lambda s: with_session(s, Impatient),
        "one_request_is_outstanding",
        "a second request leaves while 0 bytes",
    ),
    "requests that run ahead": (
        lambda s: with_session(s, Impatient),
        "requests_never_outrun_answers",
        "wait for each answer",
    ),
    "frames that nobody asked for": (
        lambda s: with_session(s, Trusting),
        "unrequested_frames_end_the_session",
        "refuse the session as out_of_step",
    ),
    "a skipped frame taken for the answer": (
        lambda s: with_session(s, EasilyAnswered),
        "skipped_frames_answer_nothing",
        "which carries no state",
    ),
    "a request outside the allow-list": (
        lambda s: with_protocol(s, request=lambda _: b"jointall"),
        "only_allowed_bytes_are_sent",
        "b'jointall' are not in Protocol.outgoing",
    ),
    "an option that changes the request": (
        lambda s: with_protocol(s, outgoing=(b"reqdata",)),
        "only_allowed_bytes_are_sent",
        r"b'reqdata\n' are not in Protocol.outgoing",
    ),
    "a rate above the highest": (
        lambda s: with_protocol(s, max_rate_hz=10.0),
        "record_is_valid",
        "max_rate_hz 10.0 must be there",
    ),
    "a folder of another name": (
        lambda s: dataclasses.replace(s, folder=s.folder.parent / "rainbows"),
        "record_is_valid",
        "give both one name",
    ),
    "no vectors": (
        lambda s: dataclasses.replace(s, folder=s.folder.parent),
        "vectors_decode",
        "cannot be read: No such file or directory",
    ),
    "no virtual controller": (
        lambda s: dataclasses.replace(s, simulator=None),
        "simulator_answers",
        "exports no SIMULATOR",
    ),
}


@pytest.mark.limit(60)
@pytest.mark.parametrize("defect", DEFECTS)
async def test_a_planted_defect_is_found(rainbow: Subject, defect: str) -> None:
    plant, check, words = DEFECTS[defect]
    outcome = await perform(BY_NAME[check], plant(rainbow))
    assert outcome.result == "failed"
    assert words in outcome.message
    assert len(outcome.message) < 1500


@pytest.mark.parametrize("check", BY_NAME)
async def test_an_invented_vendor_of_another_kind_passes(kilo: Subject, check: str) -> None:
    outcome = await perform(BY_NAME[check], kilo)
    assert outcome.result == expected(check, kilo), outcome.message


def expected(check: str, kilo: Subject) -> Result:
    """What a check says of the invented vendor: pushed frames with a checksum."""
    if check in kilo.vendor.exempt:
        return "exempt"
    return "does not apply" if check in {*FOR_OTHERS, *FOR_TEXT} else "passed"


async def test_what_does_not_apply_says_why(kilo: Subject, rainbow: Subject) -> None:
    outcomes = [await perform(BY_NAME[check], kilo) for check in (*FOR_OTHERS, FOR_TEXT[0])]
    outcomes.append(await perform(BY_NAME["damage_never_passes"], rainbow))
    assert [outcome.message for outcome in outcomes] == [
        "the frames have a checksum: damage_never_passes looks at them",
        *["the controller pushes its frames and answers no requests"] * 3,
        "its frames are binary: the checks of bytes and tables look at them",
        "the frames have no checksum: damaged_values_move_nothing looks at them",
    ]


async def test_a_protocol_without_vectors_passes_no_check_of_vectors(kilo: Subject) -> None:
    other = with_protocol(kilo, name="other")
    for check in ("vectors_decode", "cuts_change_nothing", "damage_never_passes", "keys_follow_values"):
        outcome = await perform(BY_NAME[check], other)
        assert "vectors.toml has no vector of protocol other" in outcome.message
        assert outcome.result == "failed"


async def test_a_checksum_that_leaves_a_byte_out_is_found(kilo: Subject) -> None:
    leaves_out = Checksum(type="u16", of=lambda covered: sum(covered[:5]) & 0xFFFF)
    honest = kilo.framing.checksum
    assert honest is not None
    either = Checksum(type="u16", of=lambda covered: honest.of(covered[:9] + kilo.states[0].raw[9:10] + covered[10:]))
    assert (await perform(BY_NAME["vectors_decode"], with_framing(kilo, checksum=leaves_out))).result == "failed"
    outcome = await perform(BY_NAME["damage_never_passes"], with_framing(kilo, checksum=either))
    assert "let the checksum cover every byte before it" in outcome.message


async def test_a_tail_that_is_not_checked_is_found(kilo: Subject) -> None:
    outcome = await perform(BY_NAME["vectors_decode"], with_framing(kilo, tail=b""))
    assert "should give one frame of layout state" in outcome.message


async def test_a_pushed_protocol_that_sends_is_found(kilo: Subject) -> None:
    class Talks(FramedDecoder):
        def tick(self) -> bytes | Refused:
            """Ask."""
            return b"more"

    for check in ("only_allowed_bytes_are_sent", "one_request_is_outstanding"):
        assert (await perform(BY_NAME[check], with_reader(kilo, Talks))).result == "failed"


async def test_a_field_that_no_vector_reaches_is_found(kilo: Subject) -> None:
    text = (kilo.folder / "vectors.toml").read_text().replace("counts = [", "volts_too = [")
    (kilo.folder / "vectors.toml").write_text(text)
    outcome = await perform(BY_NAME["vectors_cover_everything"], kilo)
    assert "no vector expects a value of counts that is not 0" in outcome.message


async def test_an_expected_field_that_does_not_exist_is_found(kilo: Subject) -> None:
    text = (kilo.folder / "vectors.toml").read_text().replace("volts = 24", "vlots = 24")
    (kilo.folder / "vectors.toml").write_text(text)
    outcome = await perform(BY_NAME["vectors_decode"], kilo)
    assert "vendor.vlots should be 24; there is no such key" in outcome.message


async def test_a_readme_that_says_nothing_is_found(kilo: Subject) -> None:
    (kilo.folder / "README.md").write_text("# Kilo\n")
    outcome = await perform(BY_NAME["folder_is_documented"], kilo)
    assert "name manual, firmware, quirks and what is not established" in outcome.message


async def test_a_check_that_does_not_exist_cannot_be_exempt(kilo: Subject) -> None:
    vendor = dataclasses.replace(kilo.vendor, exempt={"vectors_decod": "a slip of the pen"})
    outcome = await perform(CHECKS[0], dataclasses.replace(kilo, vendor=vendor))
    assert "exempt names no check: vectors_decod" in outcome.message


async def test_an_exemption_needs_a_reason(kilo: Subject) -> None:
    vendor = dataclasses.replace(kilo.vendor, exempt={"vectors_decode": " "})
    outcome = await perform(CHECKS[0], dataclasses.replace(kilo, vendor=vendor))
    assert "write down why" in outcome.message


def test_every_check_says_what_it_checks_in_one_sentence() -> None:
    for check in CHECKS:
        assert check.text.endswith(".")
        assert "\n" not in check.text
    assert len(BY_NAME) == len(CHECKS)


@pytest.mark.limit(60)
def test_the_limit_marker_raises_the_time_out(request: pytest.FixtureRequest) -> None:
    marker = request.node.get_closest_marker("timeout")
    assert marker is not None
    assert marker.args == (60,)


def test_a_frame_knows_what_it_is(kilo: Subject) -> None:
    (event,) = kilo.protocol.reader().feed(kilo.states[0].raw)
    assert isinstance(event, Frame)
    assert str(event) == "Frame(state, 30 bytes)"
