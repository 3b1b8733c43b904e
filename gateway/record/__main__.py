"""The process that writes one recording: a spool on standard input, the outcome as one line of JSON on standard output.

It is a process of its own so that neither its work nor a full disk can hold up the gateway.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from gateway.record.making import Making
from gateway.record.mcapfile import Writer
from gateway.record.retention import hold
from gateway.record.settings import PART
from gateway.record.spool import Outcome, SpoolError, SpoolReader

_READ = 1 << 16
_NICE = 10  # a recording may take its time: robots may not
_UMASK = 0o027  # what a plant does is not for everybody on the machine
# Where memory runs out, the recording goes before the gateway does.
_OOM, _FIRST_TO_GO = Path("/proc/self/oom_score_adj"), "900"


def write(path: Path) -> Outcome:
    """Write what comes on standard input."""
    try:
        with Writer(path) as writer, _held(path):
            making, reader = Making(writer), SpoolReader()
            while data := os.read(sys.stdin.fileno(), _READ):
                for message in reader.feed(data):
                    making.take(message)
            if not making.finished:
                return Outcome(error="the gateway has ended before the recording did")
    except SpoolError as error:
        return Outcome(error=str(error))
    except OSError as error:
        return Outcome(error=f"{path}: {error.strerror or error}")
    return Outcome(n_bytes=path.stat().st_size, n_messages=writer.n_messages, notes=making.notes)


@contextmanager
def _held(path: Path) -> Iterator[None]:
    """Keep the unfinished file from being swept by a gateway that starts meanwhile."""
    descriptor = hold(path.with_name(path.name + PART))
    try:
        yield
    finally:
        os.close(descriptor)


def main() -> None:
    """Write the file that the first argument names."""
    os.umask(_UMASK)
    with suppress(OSError):  # a service manager may forbid it
        os.nice(_NICE)
    with suppress(OSError):
        _OOM.write_text(_FIRST_TO_GO)
    outcome = write(Path(sys.argv[1]))
    with suppress(BrokenPipeError):  # the gateway has gone: nobody asks any more
        os.write(sys.stdout.fileno(), msgspec.json.encode(outcome) + b"\n")
    sys.exit(1 if outcome.error else 0)


if __name__ == "__main__":
    main()
