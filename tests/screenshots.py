"""Makes the pictures of the dashboard in docs/images: `make screenshots`."""

from __future__ import annotations

import sys
from pathlib import Path

import anyio
from playwright.async_api import Page

from gateway import logs
from tests.dashboard.browser import CHROMIUM, NARROW, WIDE, Theme, browsing, open_page, page_url
from tests.dashboard.cell import LOST, eight_robots

FOLDER = Path(__file__).parents[1] / "docs" / "images"
_SETTLE_S = 8.0
_CHART_S = 60.0
_PICTURES: tuple[tuple[int, Theme], ...] = ((WIDE, "light"), (WIDE, "dark"), (NARROW, "light"), (NARROW, "dark"))


async def _take(folder: Path, chart_s: float) -> None:
    async with eight_robots() as cell:
        for number, (width, theme) in enumerate(_PICTURES):
            async with browsing(width, theme) as context:
                watched = await open_page(context, page_url(cell.gateway.url))
                page = watched.page
                await watched.until("document.querySelectorAll('.card').length === 8")
                if number == 0:
                    await anyio.sleep(_SETTLE_S / 2)
                    await cell.controllers[LOST].stop()
                await page.locator("#charts").scroll_into_view_if_needed()
                await page.locator("#add-chart").click()
                second = page.locator(".chart").nth(1)
                await second.get_by_label("Topic").select_option("tcp")
                await anyio.sleep(chart_s if theme == "light" and width == WIDE else _SETTLE_S)
                await page.locator("#field-text").fill("pos")
                await page.locator("#fields").scroll_into_view_if_needed()
                await anyio.sleep(1.0)
                await page.evaluate("window.scrollTo({ top: 0, behavior: 'instant' })")
                await anyio.sleep(1.0)
                name = f"dashboard-{width}-{theme}"
                await page.screenshot(path=folder / f"{name}.png", full_page=width == WIDE)
                if width == NARROW:
                    await _take_parts(page, folder / name)
                print(f"{folder / name}.png", *watched.complaints)


async def _take_parts(page: Page, path: Path) -> None:
    """The narrow page is long: pictures of what lies further down."""
    for part, selector in (("lost", f'.card[data-robot="{LOST}"]'), ("charts", "#charts"), ("events", "#events")):
        show = "(node) => node.scrollIntoView({ block: 'start', behavior: 'instant' })"
        await page.locator(selector).evaluate(show)
        await anyio.sleep(1.0)
        await page.screenshot(path=path.with_name(f"{path.name}-{part}.png"))


if __name__ == "__main__":
    if CHROMIUM is None:
        sys.exit("Chromium is missing: apt-get install chromium")
    logs.configure("error")
    FOLDER.mkdir(parents=True, exist_ok=True)
    anyio.run(_take, FOLDER, float(sys.argv[1]) if len(sys.argv) > 1 else _CHART_S)
