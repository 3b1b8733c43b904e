"""Commands that only the running program knows: a subcommand for a vendor, its options the fields of a struct."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, TypeVar, Union, cast, get_args, get_origin

import msgspec
import typer
from typer.core import TyperCommand

from gateway.config.problems import fault_of
from gateway.core.registry import Registry
from gateway.errors import ConfigError

OWN = "the vendor's own options"
_WIDEST_CHOICES = 60

T = TypeVar("T")

VendorDirs = Annotated[
    list[Path] | None,
    typer.Option("--vendor-dir", metavar="DIR", is_eager=True, help="A folder of further vendors; may be repeated."),
]


def parameters(options: type[msgspec.Struct]) -> Iterator[inspect.Parameter]:
    """The fields of a struct as parameters of a command: typer shows and reads them, the struct checks them."""
    for field in msgspec.structs.fields(options):
        _, *meta = get_args(field.type) if hasattr(field.type, "__metadata__") else (field.type,)
        value_type = _bare(field.type)
        text = next((item.description for item in meta if isinstance(item, msgspec.Meta)), None)
        # Choices too many for a line are left to the description.
        wide = len("|".join(map(str, get_args(value_type)))) > _WIDEST_CHOICES
        metavar = field.name.upper() if wide else None
        option = typer.Option(flag(field.name), help=text, metavar=metavar, rich_help_panel=OWN.capitalize())
        yield inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=field.default,
            annotation=Annotated[value_type, option],
        )


def _bare(kind: object) -> object:
    """A type without its limits, which are the struct's to check; typer cannot look into a union with them."""
    if hasattr(kind, "__metadata__"):
        return _bare(get_args(kind)[0])
    if isinstance(kind, UnionType) or get_origin(kind) is Union:
        return Union[tuple(map(_bare, get_args(kind)))]  # noqa: UP007 - of types that only the running program knows
    return kind


def read(options: type[msgspec.Struct], values: Mapping[str, object]) -> msgspec.Struct:
    """Make the struct of what typer has read; what is wrong is a usage error that names its option."""
    for field in msgspec.structs.fields(options):
        fault = fault_of(values[field.name], field.type)
        if fault:
            raise typer.BadParameter(fault, param_hint=flag(field.name))
    return checked(OWN, lambda: msgspec.convert(values, options))


def flag(name: str) -> str:
    """How a field is spelt on the command line."""
    return f"--{name.replace('_', '-')}"


def command(
    name: str,
    text: str,
    parameters: Sequence[inspect.Parameter],
    run: Callable[..., None],
) -> TyperCommand:
    """Make a command of parameters that only the running program knows.

    Args:
        name: Of the command.
        text: Its help.
        parameters: What `run` is called with, by name; the annotations are typer's.
        run: What it does.
    """
    vars(run)["__signature__"] = inspect.Signature(parameters)
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    one = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    one.command(name, help=text, short_help=text.partition("\n")[0])(run)
    return cast("TyperCommand", typer.main.get_command(one))


def registry_of(ctx: object) -> Registry:
    """The vendors that a group of commands knows, those of its `--vendor-dir` among them."""
    dirs = cast("typer.Context", ctx).params.get("vendor_dir") or []
    try:
        return Registry([Path(folder) for folder in dirs])
    except ConfigError as error:
        raise typer.BadParameter(str(error), param_hint="--vendor-dir") from None


def checked(option: str, make: Callable[[], T]) -> T:
    """Turn a wrong value into a usage error that names its option."""
    try:
        return make()
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint=option) from None
