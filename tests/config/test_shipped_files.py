"""The files in `config/`: the schema is current, and what is shipped is valid.

To write the schema anew: `robot-gateway check --schema > config/gateway.schema.json`.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import jsonschema
import pytest

from gateway.config import load
from gateway.config.printing import as_toml, json_schema
from gateway.core.registry import Registry
from gateway.core.settings import RobotSettings

FOLDER = Path(__file__).parents[2] / "config"
ROBOT = {"name": "r", "vendor": "rainbow", "host": "h"}


def validator() -> jsonschema.Draft202012Validator:
    schema = json.loads((FOLDER / "gateway.schema.json").read_text("utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def test_the_schema_is_the_one_that_the_code_would_write() -> None:
    written = (FOLDER / "gateway.schema.json").read_text("utf-8")
    current = json.dumps(json_schema(Registry()), indent=2, ensure_ascii=False) + "\n"
    assert written == current, "run: robot-gateway check --schema > config/gateway.schema.json"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: str(path.name))
def test_every_configuration_that_is_shipped_loads_and_fits_the_schema(path: Path) -> None:
    config = load(path)
    assert config.robots
    assert not config.warnings
    assert all(isinstance(robot, RobotSettings) for robot in config.robots)
    validator().validate(tomllib.loads(path.read_text("utf-8")))
    validator().validate(tomllib.loads(as_toml(config)))


def test_every_default_in_the_example_is_the_true_one() -> None:
    text = (FOLDER / "gateway.toml").read_text("utf-8")
    head, _, _ = text.partition("# ---- The next robot")
    shown = {line.removeprefix("# ") for line in head.splitlines() if line.startswith("# ") and " = " in line}
    examples = ("vendor_dirs", "estop_polarity", "tokens", "allowed_", "certificate", "key =", "directory")
    shown = {line for line in shown if not line.startswith(examples) and "5 times" not in line}
    printed = set(as_toml(load(FOLDER / "gateway.toml")).splitlines())
    assert shown
    assert shown <= printed


@pytest.mark.parametrize(
    "wrong",
    [
        {"zzz": 1},
        {"server": {"zzz": 1}},
        {"server": {"flush_ms": -1}},
        {"server": {"event_ring": "x"}},
        {"vendor_dirs": [1]},
        {"robots": {}},
        {"robots": [{"name": "r", "vendor": "rainbow"}]},
        {"robots": [ROBOT | {"zzz": 1}]},
        {"robots": [ROBOT | {"name": "R 1"}]},
        {"robots": [ROBOT | {"vendor": "rainbw"}]},
        {"robots": [ROBOT | {"protocol": "reqdat"}]},
        {"robots": [ROBOT | {"port": 0}]},
        {"robots": [ROBOT | {"rate_hz": 501}]},
        {"robots": [ROBOT | {"estop_polarity": "low"}]},
        {"robots": [ROBOT | {"reqdata": {"terminator": "x"}}]},
        {"robots": [ROBOT | {"protocol": "reqdata", "reqdata": {"zzz": 1}}]},
    ],
)
def test_an_editor_sees_what_is_wrong_by_the_schema(wrong: dict[str, object]) -> None:
    with pytest.raises(jsonschema.ValidationError):
        validator().validate(wrong)


def test_the_schema_takes_what_is_right() -> None:
    validator().validate({})
    validator().validate({"robots": [ROBOT | {"protocol": "reqdata", "reqdata": {"terminator": "\n"}}]})
