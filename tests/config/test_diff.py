"""What a new configuration would change in a gateway that runs, and what has to wait."""

from __future__ import annotations

from gateway.config import parse
from gateway.config.diff import Plan, diff, effective, understand
from gateway.core.registry import Registry

REGISTRY = Registry()


def entry(place: tuple[str, str]) -> str:
    """The entry of a robot at an address."""
    name, host = place
    return f'[[robots]]\nname = "{name}"\nvendor = "fairino"\nhost = "{host}"\n'


def plan_of(before: dict[str, str], after: dict[str, str], *holding: str) -> tuple[Plan, dict[str, str]]:
    """The plan for robots at some addresses, and where the robots are by it."""
    configs = [parse("\n".join(map(entry, one.items())), "test", REGISTRY) for one in (before, after)]
    plan = diff(understand(configs[0]), understand(configs[1]), holding)
    running = {robot.name: robot for robot in configs[0].robots}
    return plan, {robot.name: robot.host for robot in effective(plan, running, configs[1].robots)}


def test_robots_that_exchange_their_controllers_are_both_changed() -> None:
    plan, hosts = plan_of({"a": "10.0.0.1", "b": "10.0.0.2"}, {"a": "10.0.0.2", "b": "10.0.0.1"})
    assert [robot.name for robot in plan.changed] == ["a", "b"]
    assert hosts == {"a": "10.0.0.2", "b": "10.0.0.1"}


def test_who_would_take_the_place_of_one_that_waits_waits_too_and_so_on() -> None:
    before = {"a": "10.0.0.1", "b": "10.0.0.2", "c": "10.0.0.3"}
    after = {"new": "10.0.0.2", "other": "10.0.0.3", "c": "10.0.0.4", "b": "10.0.0.1", "a": "10.0.0.9"}
    plan, hosts = plan_of(before, after, "a")
    assert [(held.name, held.what) for held in plan.held] == [("a", "changed"), ("b", "changed"), ("new", "added")]
    assert "waits for b" in plan.held[-1].reason
    assert hosts == {"a": "10.0.0.1", "b": "10.0.0.2", "c": "10.0.0.4", "other": "10.0.0.3"}


def test_who_waits_in_a_ring_waits_for_the_one_that_holds_a_session() -> None:
    before = {"a": "10.0.0.1", "b": "10.0.0.2", "c": "10.0.0.3"}
    plan, hosts = plan_of(before, {"a": "10.0.0.2", "b": "10.0.0.3", "c": "10.0.0.1"}, "b")
    assert {held.name for held in plan.held} == {"a", "b", "c"}
    assert hosts == before
