"""What `robot-gateway replay --diff` prints: how a replay differs from what was recorded."""

from __future__ import annotations

import msgspec
import typer

from gateway.cli.common import FAILURE, fail
from gateway.cli.recorded import Job, put, warn
from gateway.cli.view import clock_time
from gateway.record.comparing import Comparison, Differences
from gateway.record.replaying import Replay

_NOT_COMPARED = {"link", "link_stats", "events", "commands", "session"}
_SHOWN = 60  # characters of a value that has changed


def compare(job: Job, *, json: bool) -> None:
    """Compare, print what is different, and end with 1 if anything is."""
    recorded = {
        name: count
        for name, count in job.recording.topics.items()
        if name.partition("/")[0] in job.robots and "/raw/" not in name and name.rpartition("/")[2] not in _NOT_COMPARED
    }
    if not recorded:
        fail(f"{job.recording.path}: holds no samples to compare with")
    replay = Replay(job.robots, job.recording.begins_t)
    comparison = Comparison(recorded, job.from_t, job.to_t)
    for topic in replay.bus.topics.values():
        topic.listeners.append(comparison)
    for entry in job.entries():
        if entry.topic in recorded:
            comparison.recorded(entry)
        else:
            replay.take(entry)
    found = comparison.finish()
    if json:
        put(_differences_json(found))
    else:
        _print_differences(found, recorded)
    warn(replay)
    if found.counts or job.left_out or any(tally.problem for tally in replay.tallies.values()):
        raise typer.Exit(FAILURE)


def _print_differences(found: Differences, recorded: dict[str, int]) -> None:
    for topic in sorted(recorded):
        own = {what: count for (name, what), count in found.counts.items() if name == topic}
        told = [f"{found.same[topic]} the same"]
        told += [f"{found.changed[topic]} changed"] if found.changed[topic] else []
        told += [f"{own[what]} {what}" for what in ("missing", "added") if what in own]
        put(f"{topic}  {', '.join(told)}")
        for what, count in own.items():
            first = found.first[topic, what]
            change = "" if what in {"missing", "added"} else f": {_short(first.before)} → {_short(first.after)}"
            put(f"  {what}  {count} times, first at {clock_time(first.t)}{change}")
    n_same = found.same.total()
    n_other = sum(found.changed.values()) + sum(
        count for (_, what), count in found.counts.items() if what in {"missing", "added"}
    )
    put(f"{n_same} samples are the same, {n_other} are not")


def _differences_json(found: Differences) -> str:
    changes = [
        {
            "topic": topic,
            "what": what,
            "count": count,
            "t": found.first[topic, what].t,
            "from": found.first[topic, what].before,
            "to": found.first[topic, what].after,
        }
        for (topic, what), count in found.counts.items()
    ]
    return msgspec.json.encode({"same": dict(found.same), "changed": dict(found.changed), "changes": changes}).decode()


def _short(value: object) -> str:
    text = msgspec.json.encode(value).decode()
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"
