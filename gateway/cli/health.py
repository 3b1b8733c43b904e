"""`robot-gateway health`: does the gateway of this machine answer? For a container's HEALTHCHECK and the like."""

from __future__ import annotations

import http.client
import ipaddress
import json
import os
import ssl
import sys
import tomllib
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

import typer

from gateway.cli.common import USAGE, fail
from gateway.config import find_config
from gateway.config.keys import Server, split_listen
from gateway.errors import ConfigError

_LARGEST = 64 * 1024  # bytes of an answer that are read


def health(
    url: Annotated[
        str | None,
        typer.Option(
            "--url", metavar="URL", help="The gateway, such as http://127.0.0.1:8765. Default: as configured."
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", metavar="FILE", help="Where its address stands. Default: as for run."),
    ] = None,
    *,
    ready: Annotated[bool, typer.Option("--ready", help="Ask whether every robot has been tried as well.")] = False,
    timeout: Annotated[float, typer.Option(metavar="SECONDS", help="How long it may take to answer.", min=0.01)] = 3.0,
) -> None:
    """Ask whether a gateway lives: exit code 0 if it does, 1 if not. No token is needed.

    Whether the robots are online is another question: see `robot-gateway status`.

    \b
    Examples:
      robot-gateway health
      robot-gateway health --ready
      robot-gateway health --url https://10.0.2.1:8765
    """  # noqa: D301 - the \b keeps the lines apart
    door = url or _own_url(config)
    code, text = _ask(door, "/readyz" if ready else "/healthz", timeout)
    if code != http.HTTPStatus.OK:
        fail(f"{door}: {text}")
    sys.stdout.write(f"{door}: {text}\n")


def _own_url(explicit: Path | None) -> str:
    """Where the gateway of a configuration can be reached from this machine; read without loading any plugin."""
    try:
        file = find_config(explicit, os.environ, Path.cwd())
        server = tomllib.loads(file.read_text("utf-8-sig")).get("server", {})
        host, port = split_listen(server.get("listen", Server().listen))
    except (ConfigError, OSError, ValueError, AttributeError, TypeError) as error:
        fail(f"where the gateway listens is not known: {error}; correct that, or name it with --url")
    scheme = "https" if "tls" in server else "http"
    host = _reachable(host)
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"


def _reachable(host: str) -> str:
    """The address itself, or the loopback address where it means every address of the machine."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    if not address.is_unspecified:
        return host
    return "127.0.0.1" if address.version == 4 else "::1"  # noqa: PLR2004  IPv4


def _ask(url: str, path: str, timeout_s: float) -> tuple[int, str]:
    """The status and the text of an answer; status 0: there was none."""
    connection = _connection(url, timeout_s)
    try:
        connection.request("GET", path)
        response = connection.getresponse()
        return response.status, _words(response.status, response.read(_LARGEST))
    except (OSError, http.client.HTTPException) as error:
        return 0, f"no answer: {str(error) or type(error).__name__}"
    finally:
        connection.close()


def _connection(url: str, timeout_s: float) -> http.client.HTTPConnection:
    parts = urlsplit(url)
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if parts.scheme not in {"http", "https"} or not host:
        fail(f"{url!r} is not an address like http://127.0.0.1:8765", USAGE)
    if parts.scheme == "http":
        return http.client.HTTPConnection(host, port, timeout=timeout_s)
    # Nothing secret is sent and nothing but "it lives" is believed; the certificate is made for another name than this.
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return http.client.HTTPSConnection(host, port, timeout=timeout_s, context=context)


def _words(status: int, body: bytes) -> str:
    """What the body says, in one line: its `message`, or its `status`."""
    try:
        told = json.loads(body)
        return str(told.get("message") or told["status"])
    except (ValueError, AttributeError, KeyError):
        return f"HTTP status {status}, which is not a gateway's answer"
