"""Text of the templates in this folder, with values written as TOML."""

from __future__ import annotations

from functools import cache
from typing import Any

import jinja2
import tomlkit

from sim_heating.base.files import toml_text
from sim_heating.base.files.schema import schema_line


@cache
def _environment() -> jinja2.Environment:
    loader = jinja2.PackageLoader("sim_heating.templates", ".")
    environment = jinja2.Environment(
        loader=loader,
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"toml": _toml_value, "tables": toml_text}
    return environment


def _toml_value(value: Any) -> str:
    """A value as TOML on one line, a dict as an inline table."""
    item = tomlkit.inline_table() if isinstance(value, dict) else tomlkit.item(value)
    if isinstance(value, dict):
        item.update(value)
    return item.as_string()


def render_toml(template: str, schema: str, /, **values: Any) -> str:
    """The text of a template of a TOML file, after the line by which editors find its schema.

    schema : name of the format, as `record`
    """
    return f"{schema_line(schema)}\n{render(template, **values)}"


def render(template: str, **values: Any) -> str:
    """The text of a template.

    template : name of its file in this folder
    values   : of its variables; one that is missing is an error of the program
    """
    return _environment().get_template(template).render(**values)
