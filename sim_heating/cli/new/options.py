"""Options that the commands below `sim-heating new` have in common."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import click

from sim_heating.base.errors import InputError

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def quantity_option(
    name: str, unit: str, key: str, example: str, metavar: str, help: str, *, required: bool = False
) -> Decorator:
    """Option for a number with a unit: its value in the SI unit, None where not given.

    unit : SI unit of the value
    key  : of a declared file, whose range holds for the number
    example : a value, for messages
    """

    def read(_: click.Context, option: click.Parameter, value: str | None) -> float | None:
        if value is None:
            return None
        from sim_heating.templates.quantities import quantity

        return quantity(value, unit, option.opts[0], f"{option.opts[0]} {example}", key)

    return click.option(name, callback=read, metavar=metavar, help=help, required=required)


def fraction_option(name: str, help: str) -> Decorator:
    """Option for an emittance or absorptance [-], in the range of an emittance; None where not given."""

    def read(_: click.Context, option: click.Parameter, value: float | None) -> float | None:
        from sim_heating.base.limits import QUANTITIES

        quantity = QUANTITIES["emissivity"]
        if value is not None and not quantity.lowest <= value <= quantity.highest:
            rule = f"must be from {quantity.lowest:g} to {quantity.highest:g}{quantity.suggestion(value)}"
            raise InputError(f"{option.opts[0]} {value:g}: {rule}")
        return value

    return click.option(name, type=float, callback=read, help=help)


def title_option(product: str) -> Decorator:
    """Option for the title of a product, such as a record."""
    return click.option("--title", default="", help=f"title of the {product}")


def points_option(default: str) -> Decorator:
    """Option for names of control points; the default in words."""
    text = f"a control point; repeat; default: {default}"
    return click.option("--point", "points", multiple=True, metavar="NAME", help=text)


def two_times(_: click.Context, option: click.Parameter, value: str | None) -> tuple[float, float] | None:
    """Value of an option for two times `10,130` [s]."""
    if value is None:
        return None
    from sim_heating.base.files import plain_number

    try:
        first, second = (plain_number(text) for text in value.split(","))
    except ValueError:
        raise InputError(f"{option.opts[0]} {value}: write two times in s, such as {option.opts[0]} 10,130") from None
    return first, second


def interactive() -> bool:
    """Whether a person at a terminal can be asked."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def flight_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options for what a file of a flight does not state: fields of columns, and the air of the day."""
    from sim_heating.cli.console import PATH
    from sim_heating.cli.named_values import named_texts

    field = click.option(
        "--field",
        "fields",
        multiple=True,
        callback=named_texts("altitude_m=ALT:ft"),
        metavar="COLUMN=NAME:UNIT",
        help="field of the flight's file that is a column of conditions, with its unit: altitude_m=ALT:ft; or a "
        "constant: alpha_deg=0deg; repeat; default: by names and units in the file",
    )
    air = click.option(
        "--atmosphere",
        type=PATH,
        metavar="FILE",
        help="the air of the day: altitude, temperature, pressure of a radiosonde or an atmosphere model; default: the "
        "standard atmosphere where the flight has none",
    )
    return field(air(command))
