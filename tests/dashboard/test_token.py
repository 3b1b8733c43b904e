"""The page before a gateway that asks for a token; and robots that come and go while it is open."""

from __future__ import annotations

import dataclasses
from typing import cast

import pytest

from gateway.config import Config
from gateway.testing.cell import virtual_cell
from tests.client.secured import ALL, ONLY_R1, WRONG, asking
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
from tests.dashboard.test_page import HEADINGS, NAMELESS, TOO_PALE, card, part, shows

pytestmark = [needs_chromium, pytest.mark.limit(60)]
REFUSED = "401"  # what Chromium itself says of the page's question
STORED = "Object.values(sessionStorage).concat(Object.values(localStorage))"


def cell() -> HandMade:
    """Two robots at work."""
    made = HandMade("r1", "r2")
    for name in ("r1", "r2"):
        made.work(name)
    return made


async def enter(watched: Watched, token: str) -> None:
    """Say a token."""
    await watched.page.get_by_label("Token", exact=True).fill(token)
    await watched.page.get_by_role("button", name="Show the robots").click()


async def test_the_page_asks_for_a_token_and_shows_nothing_before() -> None:
    async with doors(cell(), settings=asking()) as url, browsing() as context:
        said: list[str] = []
        context.on("request", lambda request: said.append(request.url))
        watched = await open_page(context, page_url(url))
        await shows(watched, "#entrance", "This gateway asks for a token")
        assert await watched.page.locator(".card, nav:visible, #charts:visible").count() == 0
        assert await watched.page.evaluate("document.activeElement.id") == "token"
        assert await watched.page.get_by_label("Token", exact=True).get_attribute("type") == "password"
        await enter(watched, ALL)
        await shows(watched, part("r2", "link"), "Online")
        assert not await watched.page.locator("#entrance").is_visible()
        await watched.page.reload()
        await shows(watched, part("r2", "link"), "Online")  # remembered for this tab
        await watched.page.close()
        assert all(REFUSED in complaint for complaint in watched.complaints)
        assert not any(ALL in one for one in [*said, *watched.complaints])  # never in an address or on the console


@pytest.mark.parametrize(
    ("token", "says"),
    [("", "Enter the token."), ("no token", "one word without blanks"), (WRONG, "does not know this token")],
)
async def test_a_wrong_token_is_told_in_words(token: str, says: str) -> None:
    async with doors(cell(), settings=asking()) as url, browsing() as context:
        watched = await open_page(context, page_url(url))
        await enter(watched, token)
        await shows(watched, "#token-error", says)
        assert await watched.page.locator("#token-error").get_attribute("role") == "alert"
        assert await watched.page.locator("#token").get_attribute("aria-invalid") == "true"
        assert await watched.page.evaluate(STORED) == []
        assert not await watched.page.locator("#forget").is_visible()
        await enter(watched, ALL)
        await shows(watched, part("r1", "link"), "Online")


async def test_a_token_is_forgotten_by_the_button_and_where_it_is_not_to_be_remembered() -> None:
    async with doors(cell(), settings=asking()) as url, browsing() as context:
        watched = await open_page(context, page_url(url))
        await watched.page.get_by_label("Remember it").uncheck()
        await enter(watched, ALL)
        await shows(watched, part("r1", "link"), "Online")
        assert await watched.page.evaluate(STORED) == []
        await watched.page.reload()
        await watched.page.locator("#token").wait_for()
        await enter(watched, ALL)
        await shows(watched, part("r1", "link"), "Online")
        assert await watched.page.evaluate(STORED) == [ALL]
        await watched.page.get_by_role("button", name="Forget token").click()
        await watched.page.locator("#token").wait_for()
        assert await watched.page.evaluate(STORED) == []
        assert await watched.page.locator(".card").count() == 0
        assert await watched.page.locator("#token-error").is_hidden()


async def test_a_token_shows_no_more_than_it_may_read() -> None:
    async with doors(cell(), settings=asking()) as url, browsing() as context:
        watched = await open_page(context, page_url(url))
        await enter(watched, ONLY_R1)
        await shows(watched, part("r1", "link"), "Online")
        await shows(watched, card("r1"), "28.6")
        assert await watched.page.locator(".card").count() == 1
        assert await watched.page.locator("#banner").is_hidden()
        assert "r2" not in await watched.page.inner_text("body")
        assert await watched.text(part("r1", "power")) in {"– unknown", "– not told"}  # noqa: RUF001 - a dash


async def test_a_token_that_is_withdrawn_empties_the_page_and_asks_for_another() -> None:
    async with browsing() as context:
        async with doors(cell(), settings=asking()) as url:
            port = int(url.rsplit(":", 1)[1].split("/")[0])
            watched = await open_page(context, page_url(url))
            await enter(watched, ALL)
            await shows(watched, part("r1", "link"), "Online")
        async with doors(cell(), port, asking(without=ALL)):
            await shows(watched, "#token-error", "does not take the token of this tab any more")
            assert await watched.page.locator(".card").count() == 0
            assert ALL not in cast("list[str]", await watched.page.evaluate(STORED))
            await watched.page.close()


async def test_a_gateway_that_begins_to_ask_is_noticed() -> None:
    async with browsing() as context:
        async with doors(cell()) as url:
            port = int(url.rsplit(":", 1)[1].split("/")[0])
            watched = await open_page(context, page_url(url))
            await shows(watched, part("r1", "link"), "Online")
            assert not await watched.page.locator("#forget").is_visible()
        async with doors(cell(), port, asking()):
            await watched.page.locator("#token").wait_for()
            assert await watched.page.locator("#token-error").is_hidden()
            await watched.page.close()


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("width", [NARROW, WIDE])
async def test_the_form_can_be_read_and_reached_and_fits(width: int, theme: Theme) -> None:
    async with doors(cell(), settings=asking()) as url, browsing(width, theme, reduced=True) as context:
        watched = await open_page(context, page_url(url))
        await enter(watched, WRONG)
        await shows(watched, "#token-error", "does not know")
        assert await watched.page.evaluate("document.documentElement.scrollWidth") == width
        assert cast("list[str]", await watched.page.evaluate(TOO_PALE)) == []
        assert cast("list[str]", await watched.page.evaluate(NAMELESS)) == []
        assert cast("list[int]", await watched.page.evaluate(HEADINGS))[0] == 1
        await watched.page.locator("#token").focus()
        for reached in ("token-keep", ""):
            await watched.page.keyboard.press("Tab")
            assert await watched.page.evaluate("document.activeElement.id") == reached


async def test_robots_that_a_reload_adds_and_removes_come_and_go_and_the_others_stay() -> None:
    async with virtual_cell("rainbow", count=3) as running, dashboard(running.url) as watched:
        gateway = running.gateway
        await shows(watched, part("r3", "link"), "Online")
        await watched.page.evaluate("document.querySelector('.card[data-robot=r1]').mine = true")
        whole = gateway.config
        fewer = _without(whole, "r2")
        await gateway.reload(fewer)
        await watched.page.locator(card("r2")).wait_for(state="detached", timeout=3000)
        await shows(watched, "#summary", "2 robots")
        await gateway.reload(whole)
        await shows(watched, part("r2", "link"), "Online")
        await shows(watched, f"{card('r2')} .joints", "°")
        names = "[...document.querySelectorAll('.card')].map((one) => one.dataset.robot)"
        assert await watched.page.evaluate(names) == ["r1", "r2", "r3"]
        assert await watched.page.evaluate("document.querySelector('.card[data-robot=r1]').mine")
        await shows(watched, "#event-rows", "robot.removed")
        await shows(watched, "#event-rows", "robot.added")
        assert await watched.page.locator("#banner").is_hidden()
        assert watched.complaints == []


def _without(config: Config, name: str) -> Config:
    return dataclasses.replace(config, robots=tuple(robot for robot in config.robots if robot.name != name))
