"""`/metrics` for Prometheus: everything is read from the bus and the doors when it is asked for, nothing per frame."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from dataclasses import field as made
from itertools import accumulate

from aiohttp import hdrs, web
from prometheus_client import CollectorRegistry, Metric
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from gateway import __version__
from gateway.api.messages import ExportInfo, RobotInfo
from gateway.api.model import LinkState, LinkStats
from gateway.core.bus import Listener
from gateway.server.access import cell_of
from gateway.server.answers import parameters
from gateway.server.cell import Cell
from gateway.server.health import LAG_BOUNDS_S, Pulse
from gateway.server.traffic import Traffic

Delivered = Callable[[], Mapping[str, Traffic]]

# Reasons of rejects come from plugins: so many of a robot have a series of their own, the rest share one.
MOST_REASONS = 24
OTHER_REASONS = "other"
_LONGEST_REASON = 64
_PREFIX = "robot_gateway_"
_ROBOT = ("robot", "vendor", "protocol")

# name, what it counts, field of link_stats
_COUNTERS = (
    ("frames", "Good frames received.", "frames"),
    ("skipped_frames", "Known frames received that carry no state.", "skipped"),
    ("bad_values", "Groups that held NaN or infinite values.", "bad_values"),
    ("gaps", "Frames that the controller numbered and that did not come; absent where it gives no number.", "gaps"),
    ("sessions", "Connections opened to the controller.", "sessions"),
    ("received_bytes", "Bytes received from the controller.", "n_bytes"),
)
_GAUGES = (
    ("last_frame_age_seconds", "Age of the last good frame, as of the last second.", "age"),
    ("decode_time_seconds", "Mean time to decode one read, over the last second.", "decode_time"),
    ("clock_offset_seconds", "The controller's clock minus the gateway's; absent where it has none.", "clock_offset"),
)
_TRAFFIC = (
    ("sent_bytes", "Bytes sent to clients.", "n_bytes"),
    ("missed_samples", "Samples that clients asked for and did not get.", "missed_samples"),
    ("missed_events", "Events that clients asked for and that were gone.", "missed_events"),
    ("clients_sent_away", "Clients cut off because they did not read.", "sent_away"),
)
_OF = ("export",)
_SENT = ("export", "kind")
_EXPORTS: tuple[tuple[str, str, Callable[[ExportInfo], float]], ...] = (
    ("export_connected", "1: the exporter has its server; 0: it has not.", lambda info: float(info.connected)),
    ("export_waiting_events", "Events in its outbox.", lambda info: info.waiting_events),
    ("export_waiting_bytes", "What they take.", lambda info: info.waiting_bytes),
    ("export_lag_seconds", "Age of the oldest of them; 0: none waits.", lambda info: info.oldest or 0.0),
)
# What a door does not count: no series is better than one that stays 0.
_UNCOUNTED = {("native", "missed_events"), ("native", "sent_away")}


class CellCollector(Collector):
    """Reads the cell anew for each scrape.

    Args:
        cell: The robots and the bus.
        delivered: Reads what each door has delivered, by its name.
        pulse: The loop's lag.
        refused: How often something was refused, by reason.
        reasons: By robot, those of its rejects that have a series of their own; kept from scrape to scrape.
    """

    def __init__(
        self,
        cell: Cell,
        delivered: Delivered,
        pulse: Pulse,
        refused: Mapping[str, int],
        reasons: dict[str, set[str]],
    ) -> None:
        self._cell = cell
        self._delivered = delivered
        self._pulse = pulse
        self._refused = refused
        self._reasons = reasons

    def collect(self) -> Iterator[Metric]:
        """Every metric."""
        info = GaugeMetricFamily(f"{_PREFIX}info", "The running gateway; always 1.", labels=["version"])
        info.add_metric([__version__], 1)
        yield info
        infos = [(info, [info.name, info.vendor, info.protocol]) for info in self._cell.infos()]
        yield self._link_states(infos)
        yield from self._link_numbers(infos)
        yield from self._deliveries()
        yield from self._exports()
        yield from self._recorder()
        tasks = GaugeMetricFamily(f"{_PREFIX}tasks", "Tasks of the event loop.")
        tasks.add_metric([], _n_tasks())
        yield tasks
        refused = CounterMetricFamily(f"{_PREFIX}refused", "Requests and connections refused.", labels=["reason"])
        for reason, count in self._refused.items():
            refused.add_metric([reason], count)
        yield refused
        yield self._lag()

    def _link_states(self, infos: list[tuple[RobotInfo, list[str]]]) -> Metric:
        text = "State of the link: 1 for the one that it is in, 0 for the others."
        family = GaugeMetricFamily(f"{_PREFIX}link_state", text, labels=[*_ROBOT, "state"])
        for info, labels in infos:
            for state in LinkState:
                family.add_metric([*labels, state.value], float(info.link.state is state))
        return family

    def _link_numbers(self, infos: list[tuple[RobotInfo, list[str]]]) -> Iterator[Metric]:
        told = [(labels, self._stats(info.name)) for info, labels in infos]
        for kind, rows in ((CounterMetricFamily, _COUNTERS), (GaugeMetricFamily, _GAUGES)):
            for name, text, field in rows:
                family = kind(_PREFIX + name, text, labels=_ROBOT)
                for labels, stats in told:
                    value = getattr(stats, field)
                    if value is not None:
                        family.add_metric(labels, value)
                yield family
        text = "How often bytes were discarded, by reason."
        rejects = CounterMetricFamily(f"{_PREFIX}rejects", text, labels=[*_ROBOT, "reason"])
        for labels, stats in told:
            for reason, count in self._bounded(labels[0], stats.rejects).items():
                rejects.add_metric([*labels, reason], count)
        yield rejects

    def _deliveries(self) -> Iterator[Metric]:
        raised = CounterMetricFamily(f"{_PREFIX}events", "Events raised, of all robots.")
        raised.add_metric([], self._cell.bus.events.last_seq)
        yield raised
        doors = self._delivered()
        readers = GaugeMetricFamily(f"{_PREFIX}subscribers", "Clients that are connected.", labels=["door"])
        for door, traffic in doors.items():
            readers.add_metric([door], traffic.clients)
        yield readers
        listeners = GaugeMetricFamily(f"{_PREFIX}subscribed_topics", "Topics that somebody reads.", labels=["robot"])
        for name in self._cell.robots:
            topics = (topic for topic in self._cell.topics.values() if topic.robot == name)
            listeners.add_metric([name], sum(any(map(_subscribes, topic.listeners)) for topic in topics))
        yield listeners
        for name, text, field in _TRAFFIC:
            family = CounterMetricFamily(_PREFIX + name, text, labels=["door"])
            for door, traffic in doors.items():
                if (door, field) not in _UNCOUNTED:
                    family.add_metric([door], getattr(traffic, field))
            yield family

    def _exports(self) -> Iterator[Metric]:
        """What the exporters have sent and still owe; nothing where there is none."""
        infos = self._cell.exports()
        if not infos:
            return
        for name, text, value in _EXPORTS:
            gauge = GaugeMetricFamily(_PREFIX + name, text, labels=["export"])
            for info in infos:
                gauge.add_metric([info.name], value(info))
            yield gauge
        sent = CounterMetricFamily(f"{_PREFIX}export_sent", "What was sent; of events: acknowledged.", labels=_SENT)
        dropped = CounterMetricFamily(
            f"{_PREFIX}export_dropped_events", "Events that will never arrive, since the outbox was made.", labels=_OF
        )
        for info in infos:
            dropped.add_metric([info.name], info.dropped_events)
            for kind, count in info.sent.items():
                sent.add_metric([info.name, kind], count)
        yield sent
        yield dropped

    def _recorder(self) -> Iterator[Metric]:
        """How the recorder does; nothing where there is none."""
        info = self._cell.recorder
        if info is None:
            return
        for name, text, count in (
            ("recordings", "Recordings written.", info.recordings),
            ("recordings_failed", "Recordings that could not be written.", info.failed),
        ):
            family = CounterMetricFamily(_PREFIX + name, text)
            family.add_metric([], count)
            yield family
        for name, text, value in (
            ("recording", "Whether a recording is being written.", float(info.recording is not None)),
            ("recorder_ring_bytes", "Memory that the last seconds of all robots take.", info.ring_bytes),
        ):
            gauge = GaugeMetricFamily(_PREFIX + name, text)
            gauge.add_metric([], value)
            yield gauge

    def _lag(self) -> Metric:
        bounds = [*(str(bound) for bound in LAG_BOUNDS_S), "+Inf"]
        buckets = list(zip(bounds, map(float, accumulate(self._pulse.counts)), strict=True))
        text = "How late the event loop was at each of its beats."
        return HistogramMetricFamily(f"{_PREFIX}loop_lag_seconds", text, buckets=buckets, sum_value=self._pulse.lag_sum)

    def _stats(self, robot: str) -> LinkStats:
        topic = self._cell.topics.get(f"{robot}/link_stats")
        data = None if topic is None or topic.latest is None else topic.latest.sample(topic).data
        return data if isinstance(data, LinkStats) else LinkStats()

    def _bounded(self, robot: str, rejects: dict[str, int]) -> dict[str, int]:
        """Counts by reason, of a bounded number of reasons; one that has its own series keeps it."""
        known = self._reasons.setdefault(robot, set())
        counts: dict[str, int] = {}
        for reason, count in rejects.items():
            if reason not in known and len(known) < MOST_REASONS:
                known.add(reason)
            shown = reason[:_LONGEST_REASON] if reason in known else OTHER_REASONS
            counts[shown] = counts.get(shown, 0) + count
        return counts


def _subscribes(listener: Listener) -> bool:
    """Whether a listener is somebody's subscription, and not a part of the gateway."""
    return bool(getattr(listener, "is_subscriber", True))


def _n_tasks() -> int:
    """How many tasks the running loop has; 0 where none runs."""
    try:
        return len(asyncio.all_tasks())
    except RuntimeError:
        return 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Scrapes:
    """What is told to whoever scrapes.

    Attributes:
        delivered: Reads what each door has delivered, by its name.
        pulse: The loop's lag.
        refused: How often something was refused, by reason.
        reasons: By robot, those of its rejects that have a series of their own.
    """

    delivered: Delivered
    pulse: Pulse
    refused: Mapping[str, int]
    reasons: dict[str, set[str]] = made(default_factory=dict)

    def registry(self, cell: Cell) -> CollectorRegistry:
        """A registry of what a cell, or what may be seen of it, tells now: nothing is global."""
        registry = CollectorRegistry()
        registry.register(CellCollector(cell, self.delivered, self.pulse, self.refused, self.reasons))
        return registry


SCRAPES = web.AppKey("scrapes", Scrapes)


async def metrics(request: web.Request) -> web.Response:
    """The metrics, in the text format of Prometheus or in OpenMetrics; of robots those that the caller may see."""
    parameters(request)
    encode, content_type = choose_encoder(request.headers.get(hdrs.ACCEPT, ""))
    registry = request.app[SCRAPES].registry(cell_of(request))
    return web.Response(body=encode(registry), headers={hdrs.CONTENT_TYPE: content_type})
