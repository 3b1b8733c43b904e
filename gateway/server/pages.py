"""The dashboard's files: read once at the start, served from memory, and nothing else of the disk is."""

from __future__ import annotations

import hashlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path

from aiohttp import hdrs, web

FOLDER = Path(__file__).parent / "dashboard"
INDEX = "index.html"
CONTENT_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".ico": "image/x-icon",
    ".webmanifest": "application/manifest+json",
    ".woff2": "font/woff2",
}
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; font-src 'self'; "
    "manifest-src 'self'; connect-src 'self' ws://{host} wss://{host}; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


@dataclass(frozen=True, slots=True)
class File:
    """One file of the page.

    Args:
        body: Its bytes.
        content_type: What they are.
        etag: Changes with the bytes.
    """

    body: bytes
    content_type: str
    etag: str

    async def serve(self, request: web.Request) -> web.StreamResponse:
        """Answer with the file, or that the browser has it."""
        headers = {
            hdrs.CACHE_CONTROL: "no-cache",
            hdrs.ETAG: f'"{self.etag}"',
            "Content-Security-Policy": _POLICY.format(host=request.host),
            "Cross-Origin-Opener-Policy": "same-origin",
        }
        if any(known.value in {self.etag, "*"} for known in request.if_none_match or ()):
            return web.Response(status=HTTPStatus.NOT_MODIFIED, headers=headers)
        return web.Response(body=self.body, headers={**headers, hdrs.CONTENT_TYPE: self.content_type})


def load(folder: Path = FOLDER) -> dict[str, File]:
    """The files of the page by their address under `/`: those of a known kind, hidden ones left out."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        kind = CONTENT_TYPES.get(path.suffix)
        if kind is None or not path.is_file() or any(part.startswith(".") for part in name.split("/")):
            continue
        body = path.read_bytes()
        found[name] = File(body, kind, hashlib.sha256(body).hexdigest()[:16])
    return found


Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def routes(files: dict[str, File]) -> dict[str, Handler]:
    """A handler for each address of the page; `/` is the index."""
    found: dict[str, Handler] = {f"/{name}": file.serve for name, file in files.items()}
    if INDEX in files:
        found["/"] = files[INDEX].serve
    return found
