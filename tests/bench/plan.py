"""How large and how long the benchmarks are: the full run, a quick one, and the smallest that still runs every line."""

from __future__ import annotations

import msgspec


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """Sizes and times.

    Args:
        rounds: How often each figure is taken, in turns with its baseline.
        window_s: How long a running server is measured.
        warm_s: How long it runs before that.
        call_s: How long a function is called in one round.
        robots: How many robots the loads have.
        rate_hz: Their rate.
        clients: Numbers of clients that the cost of a sample is measured with.
        many: How many robots the largest load has.
        readers: Clients that check every number there.
        visitors: Clients that come and go.
        encodings: How the samples are encoded whose cost is compared.
        points: How many points of each axis are measured that cost grows along.
        churn_s: For how long; memory is compared with that after a tenth of it.
        fill_s: How long the recorder's rings take to fill in the largest load.
    """

    rounds: int = 5
    window_s: float = 2.0
    warm_s: float = 1.0
    call_s: float = 0.02
    robots: int = 16
    rate_hz: float = 125.0
    clients: tuple[int, ...] = (1, 10, 50, 200)
    many: int = 64
    readers: int = 20
    visitors: int = 200
    encodings: tuple[str, ...] = ("json", "msgpack")
    points: int = 9
    churn_s: float = 60.0
    fill_s: float = 25.0


FULL = Plan()
LONG = Plan(churn_s=600.0)
QUICK = Plan(rounds=3, window_s=1.0, warm_s=0.5, call_s=0.005, clients=(10, 50), churn_s=20.0)
TINY = Plan(
    rounds=1,
    window_s=0.2,
    warm_s=0.1,
    call_s=0.0005,
    robots=2,
    clients=(2,),
    many=3,
    readers=2,
    visitors=3,
    encodings=("json",),
    points=1,
    churn_s=1.0,
    fill_s=0.1,
)
