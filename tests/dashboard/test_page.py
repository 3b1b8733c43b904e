"""The dashboard in Chromium: what it shows is what the bus says, and it never looks more certain than it is."""

from __future__ import annotations

import itertools
import math
from typing import cast

import anyio
import anyio.lowlevel
import pytest

from gateway.api.model import (
    EventKind,
    Joints,
    LinkState,
    Quality,
    Safety,
    SafetyState,
    Status,
    Tcp,
)
from gateway.testing.cell import virtual_cell
from tests.dashboard.browser import (
    NARROW,
    WIDE,
    Theme,
    Watched,
    browsing,
    dashboard,
    needs_chromium,
    open_page,
    page_url,
)
from tests.dashboard.kit import HandMade, doors

pytestmark = [needs_chromium, pytest.mark.limit(60)]
SEEN_WITHIN_S = 2.0
# What Chromium itself says of a gateway that is not there: to the socket, and to the page that asks why it failed.
GONE = ("WebSocket connection to", "net::ERR_CONNECTION_REFUSED", "/api/v1/robots")


def card(robot: str) -> str:
    return f'.card[data-robot="{robot}"]'


def part(robot: str, name: str) -> str:
    return f'{card(robot)} [data-part="{name}"]'


async def numbers(watched: Watched, selector: str) -> list[str]:
    found = await watched.page.locator(selector).all_inner_texts()
    return [text.strip() for text in found]


async def shows(watched: Watched, selector: str, text: str) -> None:
    """Wait until an element shows a text."""
    await watched.page.locator(selector, has_text=text).first.wait_for()


async def test_the_cards_show_what_the_bus_says() -> None:
    cell = HandMade("r1", "r2")
    cell.work("r1", turn=0.5)
    cell.work("r2", turn=-1.25)
    cell.say("r2", Safety(state=SafetyState.EMERGENCY_STOP), "safety")
    cell.say("r2", Status(e_stopped=True), "status")
    async with doors(cell) as url, dashboard(url) as watched:
        await shows(watched, part("r1", "mode"), "Automatic")
        told = [
            await watched.text(part("r1", name)) for name in ("link", "power", "motion", "safety", "estop", "speed")
        ]
        assert told == ["Online", "Enabled", "Moving", "Normal", "Released", "50 %"]
        assert await watched.text(part("r1", "program")) == "Running · weld.lua · line 42 of 99"
        for robot, turn in (("r1", 0.5), ("r2", -1.25)):
            degrees = [f"{math.degrees(sign * turn):.1f}".replace("-", "−") for sign in (1, -1)]  # noqa: RUF001
            await shows(watched, f"{card(robot)} .joints", degrees[0])
            assert await numbers(watched, f"{card(robot)} .joints .number") == [*degrees, "–"]  # noqa: RUF001
        await shows(watched, f"{card('r1')} .pose", "123.4")
        pose = await numbers(watched, f"{card('r1')} .pose td:not(.unit)")
        assert pose == ["123.4", "0.0", "−500.0", "0.0", "1000.0", "90.0"]  # noqa: RUF001
        assert await watched.text(part("r2", "safety")) == "Emergency stop"
        assert await watched.text(part("r2", "estop")) == "Pressed"
        assert "r2: emergency stop" in await watched.text("#summary")
        cell.work("r1", turn=1.0)
        await shows(watched, f"{card('r1')} .joints", "57.3")
        assert watched.complaints == []


async def test_what_nobody_knows_is_a_dash_and_never_zero() -> None:
    cell = HandMade("r1")
    cell.say("r1", Status(), "status")
    cell.say("r1", Joints(position=[0.0, None]))
    cell.say("r1", Tcp(), "tcp", Quality.UNCERTAIN)
    async with doors(cell) as url, dashboard(url) as watched:
        await shows(watched, part("r1", "mode"), "not told")  # no signal of toy fills it
        await shows(watched, part("r1", "motion"), "unknown")
        assert await watched.page.locator(part("r1", "motion")).get_attribute("data-tone") == "unknown"
        await shows(watched, f"{card('r1')} .joints", "0.0")
        assert await numbers(watched, f"{card('r1')} .joints .number") == ["0.0", "–"]  # noqa: RUF001
        assert set(await numbers(watched, f"{card('r1')} .pose td:not(.unit)")) == {"–"}  # noqa: RUF001
        assert "uncertain" in await watched.text(f"{card('r1')} h4:nth-of-type(2)")
        assert watched.complaints == []


async def test_a_cut_link_is_seen_within_two_seconds() -> None:
    async with virtual_cell("rainbow", count=2) as cell, dashboard(cell.url) as watched:
        await shows(watched, part("r2", "link"), "Online")
        await watched.until("document.querySelector('[data-robot=r2] .joints .number') !== null")
        with anyio.fail_after(SEEN_WITHIN_S):
            await cell.controllers[1].stop()
            await watched.until(
                "document.querySelector('[data-robot=r2] [data-part=link]').textContent !== 'Online' && "
                "document.querySelector('[data-robot=r2] .joints .number').textContent === '–'"  # noqa: RUF001
            )
        assert await watched.page.locator(card("r2")).get_attribute("data-old") == "true"
        assert "no link since" in await watched.text(f"{card('r2')} h4")
        assert await watched.text(part("r1", "link")) == "Online"
        await shows(watched, "#event-rows", "link.lost")
        await cell.controllers[1].start()
        await shows(watched, part("r2", "link"), "Online")
        assert watched.complaints == []


async def test_without_the_gateway_everything_is_old_and_it_comes_back_by_itself() -> None:
    cell = HandMade("r1")
    cell.work("r1")
    async with browsing() as context:
        async with doors(cell) as url:
            port = int(url.rsplit(":", 1)[1].split("/")[0])
            watched = await open_page(context, page_url(url))
            await shows(watched, part("r1", "link"), "Online")
            cell.raise_event("r1", EventKind.MOTION_STARTED, "STANDSTILL", "MOVING")
            await shows(watched, "#event-rows", "motion.started")
        await watched.page.locator("#banner").wait_for()
        assert "Everything below is old" in await watched.text("#banner")
        assert await watched.text("#connection") == "Disconnected"
        await shows(watched, part("r1", "link"), "Was online")
        assert await watched.page.locator(part("r1", "link")).get_attribute("data-tone") == "unknown"
        assert "When last seen" in await watched.text("#summary")
        for _ in range(3):
            cell.raise_event("r1", EventKind.MOTION_STOPPED, "MOVING", "STANDSTILL")
        cell.work("r1", turn=1.0)
        async with doors(cell, port):
            await shows(watched, "#connection", "Live")
            assert not await watched.page.locator("#banner").is_visible()
            await shows(watched, f"{card('r1')} .joints", "57.3")
            assert await watched.text(part("r1", "link")) == "Online"
            await watched.until("document.querySelectorAll('#event-rows tr').length === 4")  # each once, none is lost
            await anyio.sleep(0.3)
            assert await watched.page.locator("#event-rows tr").count() == 4
            await watched.page.close()
        assert [one for one in watched.complaints if not any(gone in one for gone in GONE)] == []


async def test_another_gateway_with_other_robots_is_shown_as_it_is() -> None:
    async with browsing() as context:
        first, second = HandMade("r1"), HandMade("r7", "r8", boot="other")
        first.work("r1")
        second.work("r8")
        async with doors(first) as url:
            port = int(url.rsplit(":", 1)[1].split("/")[0])
            watched = await open_page(context, page_url(url))
            await shows(watched, part("r1", "link"), "Online")
        second.raise_event("r8", EventKind.MODE_CHANGED, "MANUAL", "AUTOMATIC")
        async with doors(second, port):
            await shows(watched, part("r8", "mode"), "Automatic")
            assert await watched.page.locator(".card").count() == 2
            await shows(watched, "#event-rows", "Manual → Automatic")
            await watched.page.close()


HOSTILE = '<img src=x onerror="document.title=`taken`"><script>document.title="taken"</script>&amp;'


async def test_hostile_words_of_a_vendor_are_shown_as_text() -> None:
    name = '<b onmouseover=alert(1)>*?[x]"'
    cell = HandMade(name, "r2")
    cell.work(name, turn=0.25)
    cell.fail(name, HOSTILE, HOSTILE)
    cell.link("r2", LinkState.REFUSED, HOSTILE)
    async with doors(cell) as url, dashboard(url) as watched:
        await shows(watched, ".faults", "Remedy")
        assert HOSTILE in await watched.text(".faults li strong")
        assert HOSTILE in await watched.text(".faults .remedy")
        assert await watched.text(".card h3") == name
        await shows(watched, f"{card('r2')} .link-line", HOSTILE)
        await shows(watched, "#event-rows .change", HOSTILE)
        await watched.page.locator(".card:first-child .joints .number").first.wait_for()  # its topics are found
        assert await watched.page.locator("main img, main script, main b").count() == 0
        assert await watched.page.title() == "Robot gateway"
        assert watched.complaints == []


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("width", [NARROW, WIDE])
async def test_no_page_is_wider_than_its_window_and_every_text_can_be_read(width: int, theme: Theme) -> None:
    names = ["r1", "r2", "a-rather-long-name-of-one-robot-x", "r4"]
    cell = HandMade(*names)
    for name in names:
        cell.work(name)
    cell.fail("r2", "Overcurrent " * 12, "Unplug" * 40)
    cell.lose("r4")
    async with doors(cell) as url, dashboard(url, width, theme, reduced=True) as watched:
        await shows(watched, part("r4", "link"), "Lost")
        await watched.page.locator(card("r4")).scroll_into_view_if_needed()
        await shows(watched, card("r4"), "no link")
        await shows(watched, "#event-rows", "fault.raised")
        await watched.page.locator("#fields").scroll_into_view_if_needed()
        await shows(watched, "#field-rows", "angle")
        assert await watched.page.evaluate("document.documentElement.scrollWidth") == width
        assert cast("list[str]", await watched.page.evaluate(TOO_PALE)) == []
        assert watched.complaints == []


async def test_the_theme_can_be_chosen_and_stays() -> None:
    async with doors(HandMade("r1")) as url, dashboard(url) as watched:
        button = watched.page.locator("#theme")
        ground = "getComputedStyle(document.body).backgroundColor"
        light = await watched.page.evaluate(ground)
        await button.click()
        await button.click()
        assert await button.inner_text() == "Theme: dark"
        dark = await watched.page.evaluate(ground)
        assert dark != light
        await watched.page.reload()
        assert await watched.page.evaluate(ground) == dark


async def test_every_control_has_a_name_and_the_keyboard_reaches_all() -> None:
    cell = HandMade("r1")
    cell.work("r1")
    cell.raise_event("r1", EventKind.MOTION_STARTED, "STANDSTILL", "MOVING")
    async with doors(cell) as url, dashboard(url) as watched:
        page = watched.page
        await shows(watched, ".legend", "J1")
        assert cast("list[str]", await page.evaluate(NAMELESS)) == []
        headings = cast("list[int]", await page.evaluate(HEADINGS))
        assert headings[0] == 1
        assert headings.count(1) == 1
        assert all(after - before <= 1 for before, after in itertools.pairwise(headings))
        for landmark in ("banner", "navigation", "main"):
            assert await page.get_by_role(landmark).count() == 1
        wanted = cast("int", await page.evaluate(f"{TABBABLE}.length"))
        reached: set[int] = set()
        for _ in range(wanted + 2):
            await page.keyboard.press("Tab")
            at = cast("int", await page.evaluate(f"{TABBABLE}.indexOf(document.activeElement)"))
            if at < 0:
                break
            assert await page.evaluate("getComputedStyle(document.activeElement).outlineStyle") != "none"
            reached.add(at)
        assert reached == set(range(wanted))


async def test_events_are_found_by_robot_kind_and_text_and_the_bad_ones_are_said_aloud() -> None:
    cell = HandMade("r1", "r2")
    cell.raise_event("r1", EventKind.MODE_CHANGED, "MANUAL", "AUTOMATIC")  # before the page was opened
    async with doors(cell) as url, dashboard(url) as watched:
        await shows(watched, "#event-rows", "Manual → Automatic")
        cell.raise_event("r2", EventKind.MOTION_STARTED, "STANDSTILL", "MOVING")
        cell.raise_event("r2", EventKind.ESTOP_PRESSED, before=False, after=True)
        rows = watched.page.locator("#event-rows tr")
        await shows(watched, "#event-rows", "estop.pressed")
        assert "estop.pressed" in await rows.first.inner_text()
        await watched.page.locator("#event-robot").select_option("r2")
        await watched.until("document.querySelectorAll('#event-rows tr').length === 2")
        await watched.page.locator("#event-kind").select_option("motion.started")
        await watched.until("document.querySelectorAll('#event-rows tr').length === 1")
        await watched.page.locator("#event-kind").select_option("")
        await watched.page.locator("#event-robot").select_option("")
        await watched.page.locator("#event-text").fill("automatic")
        await watched.until("document.querySelectorAll('#event-rows tr').length === 1")
        await watched.page.locator("#event-text").fill("nothing like it")
        await shows(watched, "#event-empty", "No event matches")
        await watched.until("document.querySelector('#said').textContent.includes('r2 estop pressed')")
        assert watched.complaints == []


async def test_a_storm_of_events_is_all_taken_and_the_newest_are_shown() -> None:
    cell = HandMade("r1")
    async with doors(cell) as url, dashboard(url) as watched:
        await watched.until("document.querySelector('#event-empty').offsetParent !== null")
        await shows(watched, part("r1", "link"), "Online")
        for number in range(900):
            cell.raise_event("r1", EventKind.MODE_CHANGED, number, number + 1)
            if number % 100 == 0:
                await anyio.lowlevel.checkpoint()
        await shows(watched, "#event-rows tr:first-child", "899 → 900")
        await shows(watched, "#event-count", "200 of 900 shown")
        assert watched.complaints == []


async def test_raw_fields_are_found_by_name_and_unit_and_show_the_frame() -> None:
    cell = HandMade("r1", "r2")
    cell.work("r1", turn=0.5)
    cell.work("r2", turn=-0.25)
    async with doors(cell) as url, dashboard(url) as watched:
        await watched.page.locator("#fields").scroll_into_view_if_needed()
        await shows(watched, "#field-rows", "0.50000  2")
        await watched.page.locator("#field-text").fill("deg")
        visible = watched.page.locator("#field-rows tr:visible")
        assert await visible.count() == 1
        assert (await visible.first.inner_text()).split() == ["angle", "0.50000", "2", "deg"]
        await watched.page.locator("#field-text").fill("moving")
        await shows(watched, "#field-rows tr:visible", "word.moving")
        await watched.page.locator("#field-text").fill("")
        await watched.page.locator("#field-robot").select_option("r2")
        await shows(watched, "#field-rows", "−0.25000")  # noqa: RUF001
        cell.say("r2", {"angle": None, "word": None, "run_time": None}, "vendor", Quality.STALE)
        await shows(watched, "#field-count", "stale")
        assert "0" not in await watched.text("#field-rows .value")
        assert watched.complaints == []


async def test_a_chart_shows_the_chosen_field_holds_still_and_reads_out_values() -> None:
    cell = HandMade("r1", "r2")
    async with doors(cell) as url, dashboard(url) as watched:
        page = watched.page
        await page.locator("#charts").scroll_into_view_if_needed()
        chart = page.locator(".chart").first
        await chart.get_by_label("Robot").select_option("r2")
        for number in range(20):
            cell.work("r2", turn=math.radians(number))
            await anyio.sleep(0.04)
        await shows(watched, ".legend", "19.00")
        await chart.get_by_role("button", name="Pause").click()
        for _ in range(5):
            cell.work("r2", turn=math.radians(77.0))
            await anyio.sleep(0.04)
        assert "19.00" in await watched.text(".legend")
        assert "Paused" in await watched.text(".readout")
        box = await chart.locator("canvas").bounding_box()
        assert box is not None
        await page.mouse.move(box["x"] + 100, box["y"] + 60)  # long before the page was opened
        await shows(watched, ".readout", "At the cursor")
        await shows(watched, ".readout", "no value")
        await chart.locator("canvas").focus()
        await page.keyboard.press("ArrowLeft")
        await watched.until("document.querySelector('.chart canvas').getAttribute('aria-valuetext').includes('J1 ')")
        await chart.get_by_role("button", name="Resume").click()
        await page.mouse.move(0, 0)
        await shows(watched, ".legend", "77.00")
        await chart.get_by_role("button", name="J2").click()
        assert await chart.get_by_role("button", name="J2").get_attribute("aria-pressed") == "false"
        await chart.get_by_label("Topic").select_option("tcp")
        await chart.get_by_label("Field").select_option("pose.position")
        cell.work("r2")
        await shows(watched, ".legend", "123.40")
        await chart.get_by_label("Field").select_option("pose.orientation")
        cell.work("r2")
        await shows(watched, ".legend", "90.00")
        cell.lose("r2")
        await shows(watched, ".readout", "no value now")
        assert watched.complaints == []


async def test_only_what_can_be_seen_is_subscribed() -> None:
    names = [f"r{number}" for number in range(1, 9)]
    cell = HandMade(*names)
    for name in names:
        cell.work(name)

    def listeners(topic: str) -> int:
        return len(cell.bus.topics[topic].listeners)

    async with doors(cell) as url, dashboard(url, NARROW) as watched:
        await shows(watched, f"{card('r1')} .joints", "28.6")
        assert listeners("r1/joints") == 1
        assert listeners("r8/joints") == 0
        assert listeners("r1/vendor") == 0
        await watched.page.locator("#fields").scroll_into_view_if_needed()
        await shows(watched, "#field-rows", "0.50000  2")
        with anyio.fail_after(5):
            while listeners("r2/joints") or not listeners("r1/vendor"):  # noqa: ASYNC110 - the bus has no event for it
                await anyio.sleep(0.02)
    assert not any(topic.listeners for topic in cell.bus.topics.values())


async def test_eight_robots_at_30_hz_leave_the_page_smooth() -> None:
    names = [f"r{number}" for number in range(1, 9)]
    cell = HandMade(*names)
    async with doors(cell) as url, dashboard(url) as watched:
        calm = cast("int", await watched.page.evaluate(FRAMES_IN_2_S))
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(_move, cell, names)
            await shows(watched, f"{card('r8')} .joints", ".")
            busy = cast("int", await watched.page.evaluate(FRAMES_IN_2_S))
            tasks.cancel_scope.cancel()
        print(f"\npictures in 2 s: {calm} without data, {busy} with 8 robots at 30 Hz")
        assert busy > calm / 2
        assert watched.complaints == []


async def _move(cell: HandMade, names: list[str]) -> None:
    number = 0
    while True:
        number += 1
        for name in names:
            cell.work(name, turn=math.sin(number / 30))
        await anyio.sleep(1 / 30)


FRAMES_IN_2_S = """() => new Promise((resolve) => {
  const begin = performance.now();
  let count = 0;
  const step = (now) => { count++; if (now - begin < 2000) requestAnimationFrame(step); else resolve(count); };
  requestAnimationFrame(step);
})"""
TABBABLE = """[...document.querySelectorAll('a[href], button, select, input, [tabindex="0"]')]
  .filter((one) => !one.disabled && one.offsetParent !== null || one.classList.contains('skip'))"""
HEADINGS = "[...document.querySelectorAll('h1, h2, h3, h4')].map((one) => Number(one.tagName[1]))"
NAMELESS = """[...document.querySelectorAll('a, button, select, input, canvas, section, article, table, [role=region]')]
  .filter((one) => {
    const labels = (one.getAttribute('aria-labelledby') ?? '').split(' ').filter(Boolean);
    const named = labels.map((id) => document.getElementById(id)?.textContent ?? '').join('');
    const own = ['A', 'BUTTON'].includes(one.tagName) ? one.textContent : '';
    const text = [named, own, one.getAttribute('aria-label'), one.labels?.[0]?.textContent, one.caption?.textContent];
    return !text.some((found) => found && found.trim());
  })
  .map((one) => one.outerHTML.slice(0, 120))"""
TOO_PALE = """(() => {
  const parse = (text) => (text.match(/[\\d.]+/g) ?? []).map(Number);
  const light = ([r, g, b]) => {
    const [x, y, z] = [r, g, b].map((c) => (c /= 255) <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
    return 0.2126 * x + 0.7152 * y + 0.0722 * z;
  };
  const ground = (node) => {
    for (; node; node = node.parentElement) {
      const colour = parse(getComputedStyle(node).backgroundColor);
      if (colour.length === 3 || colour[3] === 1) return colour;
    }
    return [255, 255, 255];
  };
  const found = new Set();
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode.parentElement;
    if (!walker.currentNode.data.trim() || !node.offsetParent || node.closest('[disabled], .sr, option')) continue;
    const [a, b] = [light(parse(getComputedStyle(node).color)), light(ground(node))].sort((p, q) => q - p);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < 4.5) found.add(`${node.className || node.tagName}: ${ratio.toFixed(2)}`);
  }
  return [...found];
})()"""
