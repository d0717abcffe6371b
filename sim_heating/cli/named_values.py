"""Values of repeatable options of the form NAME=VALUE."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import click

from sim_heating.base.errors import InputError


def named_values(items: Sequence[str], option: str, example: str) -> dict[str, str]:
    """Texts by name of a repeatable option NAME=VALUE; a name may contain `=`, a value not.

    example : a value of the option, for messages
    raises : InputError, one line, for an item without `=`, an empty part, or a repeated name
    """
    values: dict[str, str] = {}
    for item in items:
        name, _equals, value = (text.strip() for text in item.rpartition("="))
        if not (name and value):
            raise InputError(f"{option} {item}: write {option} {example}")
        if name in values:
            raise InputError(f"{option}: {name} is given twice; leave one out")
        values[name] = value
    return values


def named_texts(example: str) -> Callable[[click.Context, click.Parameter, Sequence[str]], dict[str, str]]:
    """Callback of a repeatable option NAME=VALUE: its texts by name."""
    return lambda _, option, items: named_values(items, option.opts[0], example)
