"""Answers over HTTP: JSON bodies, errors as `{code, message}`, and URL parameters of which none is passed over."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from http import HTTPStatus
from typing import TypeVar

import msgspec
import structlog
from aiohttp import hdrs, web

from gateway.server.requests import BadRequest

_LOG = structlog.get_logger()
_ENCODER = msgspec.json.Encoder()
_JSON = "application/json"
_Request = TypeVar("_Request")
# Any other refusal of a request is a 400.
_STATUSES = {
    "UNKNOWN_ROBOT": HTTPStatus.NOT_FOUND,
    "UNKNOWN_TOPIC": HTTPStatus.NOT_FOUND,
    "NOT_YET": HTTPStatus.SERVICE_UNAVAILABLE,
}
_WORDS = {
    HTTPStatus.NOT_FOUND: "there is nothing at this address: /api/v1/openapi.json lists what there is",
    HTTPStatus.METHOD_NOT_ALLOWED: "the doors only read: use GET",
}
# What a refusal may say besides its body.
_KEPT_HEADERS = (hdrs.WWW_AUTHENTICATE, hdrs.RETRY_AFTER)
# Sent with everything: what is read here is for programs and for our own page alone.
SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
}


class Failure(msgspec.Struct, frozen=True, kw_only=True):
    """Why a request was not answered."""

    code: str
    message: str


def encoded(body: bytes, *, status: int = HTTPStatus.OK, headers: Mapping[str, str] = {}) -> web.Response:
    """An answer whose JSON is at hand."""
    return web.Response(
        body=body, status=status, content_type=_JSON, charset="utf-8", headers={"Cache-Control": "no-store", **headers}
    )


def answer(value: object, *, status: int = HTTPStatus.OK, headers: Mapping[str, str] = {}) -> web.Response:
    """An answer in JSON."""
    return encoded(_ENCODER.encode(value), status=status, headers=headers)


def failure(status: int, code: str, message: str, headers: Mapping[str, str] = {}) -> web.Response:
    """An error in JSON."""
    return answer(Failure(code=code, message=_printable(message)), status=status, headers=headers)


def parameters(request: web.Request, *known: str) -> dict[str, str]:
    """The URL's parameters.

    Raises:
        BadRequest: One is not known, or stands there twice.
    """
    names = [name for name, _ in request.query.items()]
    unknown = [name for name in dict.fromkeys(names) if name not in known]
    if unknown:
        allowed = f"allowed are {', '.join(known)}" if known else "this address takes none"
        raise BadRequest("BAD_REQUEST", f"URL parameters: unknown: {_listed(unknown)}; {allowed}")
    twice = [name for name in dict.fromkeys(names) if names.count(name) > 1]
    if twice:
        why = "more than once: " + ", ".join(twice)
        raise BadRequest("BAD_REQUEST", f"URL parameters: {why}; several values stand in one, with commas")
    return dict(request.query)


def converted(values: Mapping[str, object], kind: type[_Request]) -> _Request:
    """URL parameters as a request of the native protocol.

    Raises:
        BadRequest: A value is not what it should be.
    """
    try:
        return msgspec.convert(values, kind, strict=False)
    except msgspec.ValidationError as error:
        raise BadRequest("BAD_REQUEST", f"URL parameters: {error}") from None


def splitted(found: Mapping[str, str], *names: str) -> dict[str, object]:
    """Of some parameters those that are lists, taken apart at the commas; the others as they are."""
    return {key: value.split(",") if key in names else value for key, value in found.items()}


@web.middleware
async def in_json(
    request: web.Request,
    handler: Callable[[web.Request], Awaitable[web.StreamResponse]],
) -> web.StreamResponse:
    """Make every error an answer of `{code, message}`, and answer OPTIONS."""
    try:
        return await handler(request)
    except BadRequest as error:
        return failure(_STATUSES.get(error.code, HTTPStatus.BAD_REQUEST), error.code, str(error))
    except web.HTTPMethodNotAllowed as error:
        allow = {"Allow": ", ".join(sorted({*error.allowed_methods, hdrs.METH_OPTIONS}))}
        if request.method == hdrs.METH_OPTIONS:
            return web.Response(status=HTTPStatus.NO_CONTENT, headers=allow)
        return _explained(error, allow)
    except web.HTTPException as error:
        if error.status < HTTPStatus.BAD_REQUEST:
            raise
        return _explained(error, {name: error.headers[name] for name in _KEPT_HEADERS if name in error.headers})
    except ConnectionError:
        raise  # the client is gone: nobody is left to be told
    except Exception:  # noqa: BLE001 - an internal error is logged, and costs its request
        _LOG.exception("request.failed", peer=request.remote, reason=request.path)
        words = "internal error, see the gateway's log"
        return failure(HTTPStatus.INTERNAL_SERVER_ERROR, "INTERNAL_SERVER_ERROR", words)


async def secure(request: web.Request, response: web.StreamResponse) -> None:  # noqa: ARG001 - a signal's signature
    """Put the security headers on an answer that has none of its own."""
    for name, value in SECURITY_HEADERS.items():
        response.headers.setdefault(name, value)


def _explained(error: web.HTTPException, headers: Mapping[str, str]) -> web.Response:
    status = HTTPStatus(error.status)
    own_words = error.text if error.text and not error.text.startswith(f"{error.status}:") else ""
    return failure(status, status.name, own_words.strip() or _WORDS.get(status, status.phrase), headers)


def _listed(names: Sequence[str], most: int = 8) -> str:
    return ", ".join(name[:80] for name in names[:most])


def _printable(text: str) -> str:
    """A text without the lone surrogates that an address may hold and JSON may not."""
    return text.encode("utf-8", "replace").decode()
