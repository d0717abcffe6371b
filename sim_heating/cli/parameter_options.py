"""Options of `sim-heating estimate` about its parameters: --fix, --prior, --bound, --tie, and a file of settings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from sim_heating.base.errors import InputError
from sim_heating.cli.console import PATH
from sim_heating.cli.named_values import named_values

if TYPE_CHECKING:
    from sim_heating.inputs.fit_settings import FitSettings

F = TypeVar("F", bound=Callable[..., Any])


def _named_numbers(example: str, count: int) -> Callable[..., dict[str, Any]]:
    """Callback of a repeatable option `NAME=VALUE` or `NAME=VALUE,VALUE`: the numbers by name."""

    def read(_: click.Context, option: click.Parameter, values: tuple[str, ...]) -> dict[str, Any]:
        from sim_heating.base.files import plain_number
        from sim_heating.inputs.fit_settings import FLAT

        by_name: dict[str, Any] = {}
        for name, text in named_values(values, option.opts[0], example).items():
            try:
                numbers = [plain_number(number) for number in text.split(",")]
            except ValueError:
                numbers = []
            flat = text == FLAT and FLAT in example
            if len(numbers) != count and not flat:
                raise InputError(f"{option.opts[0]} {name}={text}: write {option.opts[0]} {example}")
            by_name[name] = FLAT if flat else numbers[0] if count == 1 else numbers
        return by_name

    return read


def _ties(_: click.Context, option: click.Parameter, values: tuple[str, ...]) -> list[list[str]]:
    """Values of --tie, `NAME=NAME=...` or a single NAME, as lists of names."""
    ties = [[name.strip() for name in item.split("=")] for item in values]
    for item, names in zip(values, ties, strict=True):
        if not all(names) or len(set(names)) < len(names):
            raise InputError(f"{option.opts[0]} {item}: write {option.opts[0]} NAME=OTHER, two names or more")
    return ties


_OPTIONS = (
    click.option(
        "--settings",
        "settings_file",
        type=PATH,
        metavar="FILE.toml",
        help="parameters, reference, start, fit, fix, prior, bound, tie; options given here prevail",
    ),
    click.option(
        "--fix",
        multiple=True,
        metavar="NAME=VALUE",
        callback=_named_numbers("NAME=0.0013", 1),
        help="a parameter that is not estimated, at this value; NAME may end in @POINT, for clocks and thermocouples "
        "in @RECORD or @FLIGHT; may be repeated, as the next three",
    ),
    click.option(
        "--prior",
        multiple=True,
        metavar="NAME=MEAN,SIGMA",
        callback=_named_numbers("NAME=MEAN,SIGMA or NAME=flat", 2),
        help="normal prior of a parameter; NAME=flat for none",
    ),
    click.option(
        "--bound",
        multiple=True,
        metavar="NAME=LOW,HIGH",
        callback=_named_numbers("NAME=LOW,HIGH", 2),
        help="least and greatest value of a parameter",
    ),
    click.option(
        "--tie",
        multiple=True,
        metavar="NAME=OTHER",
        callback=_ties,
        help="parameters that have one value; NAME alone: all that it covers, such as clock.skew@FLIGHT",
    ),
)


def parameter_options(command: F) -> F:
    """A command with these options."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def merged_settings(file: Path | None, **settings: Any) -> FitSettings:
    """Settings of a file with those of the command line, which prevail by key, and by name within a table.

    given  : keys of FitSettings; empty ones and None are not given
    raises : InputError for a file that cannot be read, or a value that is none
    """
    from sim_heating.base.files import check, read_toml
    from sim_heating.inputs.fit_settings import FitSettings

    stated = {key: value for key, value in settings.items() if value not in (None, [], {}, ())}
    declared = {} if file is None else read_toml(file, FitSettings).model_dump(exclude_unset=True)
    for key, value in stated.items():
        by_name = isinstance(value, dict) and isinstance(declared.get(key), dict)
        declared[key] = {**declared[key], **value} if by_name else value
    return check(declared, FitSettings, "estimate")
