"""Debian's Chromium for the tests of the dashboard: a page on which any error or warning is kept."""

from __future__ import annotations

import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Literal

import anyio
import pytest
from playwright.async_api import BrowserContext, ConsoleMessage, Page, Request, async_playwright

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="Chromium is missing: apt-get install chromium, and these tests run"
)
WIDE = 1280
NARROW = 390
_HEIGHTS = {WIDE: 900, NARROW: 844}
_PATIENCE_MS = 8000
_LOOK_AGAIN_S = 0.03
Theme = Literal["light", "dark"]


@dataclass
class Watched:
    """A page and what went wrong on it.

    Attributes:
        page: Playwright's page.
        complaints: Console errors and warnings, exceptions, and requests that failed.
    """

    page: Page
    complaints: list[str] = field(default_factory=list)

    def heed_console(self, message: ConsoleMessage) -> None:
        """Keep an error or a warning of the console."""
        if message.type in {"error", "warning"}:
            self.complaints.append(f"{message.type}: {message.text}")

    def heed_failure(self, request: Request) -> None:
        """Keep a request that failed."""
        self.complaints.append(f"failed: {request.url}")

    async def text(self, selector: str) -> str:
        """The text of an element as it is shown."""
        return (await self.page.locator(selector).first.inner_text()).strip()

    async def until(self, expression: str, within_s: float = _PATIENCE_MS / 1000) -> None:
        """Wait until an expression of JavaScript is true: asked from outside, for the page's policy allows no eval."""
        with anyio.fail_after(within_s):
            while not await self.page.evaluate(expression):  # noqa: ASYNC110 - it is another process
                await anyio.sleep(_LOOK_AGAIN_S)


@asynccontextmanager
async def browsing(
    width: int = WIDE, theme: Theme = "light", *, reduced: bool = False
) -> AsyncIterator[BrowserContext]:
    """Run a browser.

    Args:
        width: Of the window, px: `WIDE` or `NARROW`.
        theme: What the system prefers.
        reduced: Whether the system asks for less motion.
    """
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        try:
            context = await browser.new_context(
                viewport={"width": width, "height": _HEIGHTS[width]},
                color_scheme=theme,
                reduced_motion="reduce" if reduced else "no-preference",
                is_mobile=width == NARROW,
                has_touch=width == NARROW,
            )
            context.set_default_timeout(_PATIENCE_MS)
            yield context
        finally:
            await browser.close()


@asynccontextmanager
async def dashboard(
    url: str, width: int = WIDE, theme: Theme = "light", *, reduced: bool = False
) -> AsyncIterator[Watched]:
    """Open the dashboard of a gateway.

    Args:
        url: Its native door, such as `ws://127.0.0.1:8765/ws`.
        width: Of the window, px.
        theme: What the system prefers.
        reduced: Whether the system asks for less motion.
    """
    async with browsing(width, theme, reduced=reduced) as context:
        watched = await open_page(context, page_url(url))
        await watched.until("document.querySelector('#connection').textContent === 'Live'")
        yield watched


async def open_page(context: BrowserContext, address: str) -> Watched:
    """Open a page whose complaints are kept."""
    watched = Watched(await context.new_page())
    watched.page.on("console", watched.heed_console)
    watched.page.on("pageerror", lambda error: watched.complaints.append(f"exception: {error}"))
    watched.page.on("requestfailed", watched.heed_failure)
    await watched.page.goto(address)
    return watched


def page_url(url: str) -> str:
    """The address of the page beside a native door."""
    return url.replace("ws://", "http://", 1).removesuffix("ws")
