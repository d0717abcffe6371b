"""Turns pages that are written for any reader of Markdown into pages of the site.

A page of `docs` reads well on a forge, and has nothing that only Sphinx understands. When the site is built

- the list of links of an `index.md` becomes its part of the table of contents;
- `<!-- autodoc: NAME ... -->` becomes the descriptions of these public names, `<!-- commands -->` that of the commands;
- links to files outside `docs` become downloads;
- the architecture's Mermaid diagram becomes a picture (Mermaid would be loaded from the network).

Docstrings are written as aligned `name : text`; they become fields of a function or a class.
"""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from types import ModuleType

import click
import flowchart
from docutils import nodes
from sphinx.application import Sphinx

from sim_heating.cli import COMMANDS, cli

LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s#]+)(#[^)\s]*)?\)")
FIELD = re.compile(r"^([a-z_]\w*(?:, [a-z_]\w*)*) +: +(?=\S)")
EQUATIONS = re.compile(r"docs/([\w/]+)\.md")


def written_for_the_site(app: Sphinx, docname: str, content: list[str]) -> None:
    """Replace what a forge shows otherwise; `source-read` of Sphinx."""
    text = content[0]
    if Path(app.env.doc2path(docname)).suffix != ".md":
        return
    folder = Path(app.env.doc2path(docname)).parent
    text = re.sub(r"<!-- autodoc: ([\w ]+) -->", lambda m: autodoc(m[1].split()), text)
    text = text.replace("<!-- commands -->", commands())
    text = re.sub(r"```mermaid\n(.*?)```", lambda m: flowchart.svg(m[1]), text, flags=re.DOTALL)
    text = LINK.sub(lambda m: download(m, folder, Path(app.srcdir)), text)
    if docname.rpartition("/")[2] in ("index", "README"):
        text += toctree(text)
    content[0] = text


def fenced(text: str) -> str:
    """A directive on lines of its own."""
    return f"\n{text}\n"


def autodoc(names: list[str]) -> str:
    """Descriptions of public names of the package."""
    import sim_heating as sh

    lines = []
    for name in names:
        found = getattr(sh, name)
        if isinstance(found, type):
            kind = "exception" if issubclass(found, Exception) else "class"
            lines += [f".. auto{kind}:: {name}", "   :members:", ""]
        elif isinstance(found, ModuleType):
            text = inspect.cleandoc(found.__doc__ or "").split("\n")
            docstring(None, "module", name, found, None, text)
            lines += [f".. py:data:: {name}", "", *(f"   {line}" for line in text), ""]
        else:
            lines += [f".. autofunction:: {name}", ""]
    return fenced("\n".join(["```{eval-rst}", ".. currentmodule:: sim_heating", "", *lines, "```"]))


def download(found: re.Match[str], folder: Path, docs: Path) -> str:
    """A link to a file outside `docs` as a download; any other as it is."""
    text, target = found[1], found[2]
    if re.match(r"[a-z]+:", target):
        return found[0]
    path = (folder / target).resolve()
    if path.is_relative_to(docs) or not path.exists():
        return found[0]
    if path.is_dir():
        return f"{text} (`{path.relative_to(docs.parent)}`)"
    return f"{{download}}`{text.replace('`', '')} <{target}>`"


def toctree(text: str) -> str:
    """Table of contents of a page that lists others: its links to pages, in their order."""
    pages = dict.fromkeys(m[2] for m in LINK.finditer(text) if not re.match(r"[a-z]+:|\.\./", m[2]))
    own = [p for p in pages if "/" not in p or re.search(r"/(index|README)\.md$", p)]
    entries = [re.sub(r"\.(md|ipynb)$", "", p) for p in own if p.endswith((".md", ".ipynb"))]
    return fenced("\n".join(["```{toctree}", ":hidden:", "", *entries, "```"])) if entries else ""


def docstring(app: Sphinx | None, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Aligned `name : text` as a field list; symbols of formulas as they are; `autodoc-process-docstring` of Sphinx."""
    made: list[str] = []
    fields = False
    example = False
    for line in lines:
        field = FIELD.match(line)
        example = bool(line.strip()) and (example or line.startswith(">>>"))
        if example:
            made.append(line)
        elif field:
            if not fields:
                made.append("")
            fields = True
            names = field[1].replace(", ", ",")
            kind = names if names in ("returns", "raises") else f"param {names}"
            made.append(f":{kind}: {plain(line[field.end() :])}")
        elif fields and line.startswith(" "):
            made.append("   " + plain(line.strip()))
        else:
            if fields and line.strip():
                made.append("")
            fields = fields and not line.strip()
            made.append(plain(line))
    lines[:] = made


def plain(text: str) -> str:
    """Text of a docstring as reStructuredText: what is not in backticks is meant as it is."""
    parts = re.split(r"(`[^`]+`)", text)
    for i in range(0, len(parts), 2):
        escaped = re.sub(r"([*|\\]|(?<=\w)_(?!\w))", r"\\\1", parts[i])
        parts[i] = EQUATIONS.sub(lambda m: f":doc:`/{m[1]}`", escaped)
    return "".join(parts)


def equations(app: Sphinx, doctree: nodes.document) -> None:
    """Displayed equations as one environment each, in which a number and line breaks may stand together."""
    for node in doctree.findall(nodes.math_block):
        node["no-wrap"] = True
        node["nowrap"] = True
        body = node.astext().strip()
        if not body.startswith(r"\begin{align"):
            node.children = [nodes.Text(f"\\begin{{equation*}}\n{body}\n\\end{{equation*}}")]


def commands() -> str:
    """All commands with their arguments and options, as their help states them."""
    top = click.Context(cli, info_name="sim-heating")
    known = {name: cli.get_command(top, name) for name in COMMANDS}
    return "\n".join(section(command, click.Context(command, top, name)) for name, command in known.items() if command)


def section(command: click.Command, context: click.Context) -> str:
    """Heading, usage, help and a table of the options of a command, and those of its own commands."""
    paragraphs = inspect.cleandoc(command.help or "").split("\n\n")
    text = "\n\n".join(
        "\n".join(f"    {line}" for line in p.splitlines()[1:]) if p.startswith("\b") else escaped(" ".join(p.split()))
        for p in paragraphs
    )
    usage = "    " + " ".join([context.command_path, *command.collect_usage_pieces(context)])
    records = [p.get_help_record(context) for p in command.params]
    rows = [f"| `{option}` | {escaped(about)} |".replace("\n", " ") for option, about in filter(None, records)]
    parts = [f"## {context.command_path}", text, usage, "\n".join(["| option | |", "|---|---|", *rows])]
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            if below:
                parts.append(section(below, click.Context(below, context, name)))
    return "\n\n".join(parts) + "\n"


def escaped(text: str) -> str:
    """Text of a help page as Markdown: symbols as they are, what is in backticks as code."""
    parts = re.split(r"(`[^`]+`)", text)
    return "".join(p if p.startswith("`") else re.sub(r"([|*_<\[$])", r"\\\1", p) for p in parts)


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to the build."""
    app.connect("source-read", written_for_the_site)
    app.connect("autodoc-process-docstring", docstring)
    app.connect("doctree-read", equations)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
