"""A plant as config/nats has it: a hub, and servers of cells that are leaf nodes of it, on free ports."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import nats

from tests.export.kit import Server, free_port

SHIPPED = Path(__file__).parents[2] / "config" / "nats"
WORDS = {"HUB_ADMIN": "a", "HUB_READER": "b", "HUB_CELL1": "c1", "HUB_CELL2": "c2"}


@dataclass(frozen=True, slots=True)
class Layout:
    """The servers of a plant.

    Attributes:
        hub: Of the plant.
        leaves: Of the cells, by name.
    """

    hub: Server
    leaves: dict[str, Server]


@contextmanager
def plant_servers(folder: Path) -> Iterator[Layout]:
    """The shipped files, with ports and folders of the test."""
    leaf_port = free_port()
    hub = Server(folder / "hub")
    (hub.folder / "cells").mkdir()
    for name in ("accounts.conf", "imports.conf"):
        (hub.folder / "cells" / name).write_text(_filled((SHIPPED / "cells" / name).read_text()))
    text = (SHIPPED / "hub.conf").read_text()
    text = text.replace('"0.0.0.0:4222"', f'"127.0.0.1:{hub.port}"').replace("0.0.0.0:7422", f"127.0.0.1:{leaf_port}")
    text = text.replace('http: "127.0.0.1:8222"', "").replace("/var/lib/nats/hub", str(hub.folder / "js"))
    hub.write(_filled(text))
    leaves = {}
    for name in ("cell1", "cell2"):
        leaf = leaves[name] = Server(folder / name)
        text = (SHIPPED / "cell.conf").read_text().replace("cell1", name)
        text = text.replace("127.0.0.1:4222", f"127.0.0.1:{leaf.port}").replace("/var/lib/nats", str(leaf.folder))
        url = f'"nats://{name}:{WORDS[f"HUB_{name.upper()}"]}@127.0.0.1:{leaf_port}"'
        leaf.write(text.replace("$HUB_LEAF_URL", url))
    with ExitStack() as stack:
        for server in (hub, *leaves.values()):
            stack.callback(server.kill)
            server.start()
        yield Layout(hub, leaves)


async def make_streams(hub: Server, *cells: str) -> None:
    """What the shipped script does."""
    client = await nats.connect(hub.url, user="admin", password=WORDS["HUB_ADMIN"])
    await _script().make(client.jetstream(), "plant1", list(cells))
    await client.close()


def _script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("streams", SHIPPED / "streams.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _filled(text: str) -> str:
    for word, value in WORDS.items():
        text = text.replace(f"${word}", value)
    return text
