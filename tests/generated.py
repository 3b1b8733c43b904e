"""Writes the generated files of the repository anew: `make generated`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from gateway.cli.demo import demo_toml
from gateway.config.printing import json_schema
from gateway.core.registry import Registry
from gateway.server.openapi import openapi_text
from tests.asyncapi import asyncapi
from tests.coverage_page import coverage_page
from tests.documents import model_page
from tests.man_page import man_page

ROOT = Path(__file__).parents[1]


def generated() -> dict[Path, str]:
    """What each generated file must say."""
    registry = Registry()
    schema = json.dumps(json_schema(registry), indent=2, ensure_ascii=False) + "\n"
    return {
        ROOT / "config" / "demo.toml": demo_toml(registry),
        ROOT / "config" / "gateway.schema.json": schema,
        ROOT / "docs" / "asyncapi.json": json.dumps(asyncapi(), indent=2, ensure_ascii=False) + "\n",
        ROOT / "docs" / "coverage.md": coverage_page(registry),
        ROOT / "docs" / "model.md": model_page(),
        ROOT / "docs" / "openapi.json": openapi_text(),
        ROOT / "packaging" / "robot-gateway.1": man_page(),
    }


def main() -> None:
    """Write every file."""
    for path, text in generated().items():
        path.write_text(text, "utf-8")
        sys.stdout.write(f"{path.relative_to(ROOT)}\n")


if __name__ == "__main__":
    main()
