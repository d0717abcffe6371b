"""The command `sim-heating completion`, and the names that tab completion offers."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from itertools import repeat
from pathlib import Path

import click
from click.shell_completion import CompletionItem, get_completion_class

from sim_heating.cli.output import current_report, report_results

VARIABLE = "_SIM_HEATING_COMPLETE"
"""Environment variable by which a shell asks for completions."""
DEPTH = 4
"""Folders below the current one in which records and scenarios are looked for."""
LARGEST = 2000
"""Folders that are looked into at most: a completion that takes long is none."""
INSTALL = {
    "bash": 'eval "$(sim-heating completion bash)"    in ~/.bashrc',
    "zsh": 'eval "$(sim-heating completion zsh)"    in ~/.zshrc',
    "fish": "sim-heating completion fish > ~/.config/fish/completions/sim-heating.fish",
}
"""By shell, the line that installs completion."""


@click.command()
@click.argument("shell", type=click.Choice(tuple(INSTALL)))
def completion(shell: str) -> None:
    """Print the script that completes commands, options, records, scenarios and vehicles by the tab key.

    \b
    Install it by one line:
      bash: eval "$(sim-heating completion bash)"    in ~/.bashrc
      zsh:  eval "$(sim-heating completion zsh)"    in ~/.zshrc
      fish: sim-heating completion fish > ~/.config/fish/completions/sim-heating.fish
    """
    shell_class = get_completion_class(shell)
    assert shell_class is not None
    context = click.get_current_context().find_root()
    script = shell_class(context.command, {}, "sim-heating", VARIABLE).source()
    report_results({"shell": shell, "script": script, "install": INSTALL[shell]})
    if not current_report().is_json:
        click.echo(script)


def complete_paths(_: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Records, scenarios and vehicles below the current folder, and names of vehicles, as an argument takes them.

    Where none begins with what was typed, the shell completes names of files.
    """
    kinds = (parameter.name or "").rstrip("s")
    names = [*_vehicles()] if kinds in ("vehicle", "path") else []
    names += _below(Path(), kinds)
    chosen = sorted({name for name in names if name.startswith(incomplete)})
    return [CompletionItem(name) for name in chosen] or [CompletionItem(incomplete, type="file")]


def _vehicles() -> Iterator[str]:
    """Names of the vehicles that are found by name."""
    from sim_heating.base.files.package import data_folders

    named = os.environ.get("SIM_HEATING_AIRCRAFT_DATA", "")
    for folder in (Path(named), *data_folders("aircraft_data")) if named else data_folders("aircraft_data"):
        yield from (path.parent.name for path in folder.glob("*/vehicle.toml"))


def _below(start: Path, kinds: str) -> Iterator[str]:
    """Records, vehicles, and files that begin as the parameter takes them, below a folder."""
    begins = {"scenario": "scenario/", "study": "study/", "campaign_file": "campaign/"}.get(kinds)
    waiting = [(start, 0)]
    for _ in range(LARGEST):
        if not waiting:
            return
        folder, depth = waiting.pop(0)
        is_folder = _entries(folder)
        declared = {folder / "record.toml", folder / "vehicle.toml"} & is_folder.keys()
        if begins is None and declared:
            if kinds == "path" or (kinds == "vehicle") is (folder / "vehicle.toml" in declared):
                yield folder.as_posix()
            continue
        if depth < DEPTH:
            waiting += zip(filter(is_folder.get, is_folder), repeat(depth + 1))
        if kinds not in ("record", "vehicle"):
            yield from _files_of_format(is_folder, begins)


def _entries(folder: Path) -> dict[Path, bool]:
    """Entries of a folder but hidden ones, in the order of their names, and which are folders; none where it cannot be
    read."""
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError:
        return {}
    return {folder / e.name: e.is_dir(follow_symlinks=False) for e in entries if not e.name.startswith(".")}


def _files_of_format(is_folder: Mapping[Path, bool], begins: str | None) -> Iterator[str]:
    for path, inner in is_folder.items():
        if path.suffix == ".toml" and not inner and _is_of_format(path, begins):
            yield path.as_posix()


def _is_of_format(path: Path, begins: str | None) -> bool:
    """Whether a TOML file states a format that begins so in its first lines; any stated format where None."""
    try:
        with path.open(encoding="utf-8") as file:
            head = file.read(4096)
    except (OSError, UnicodeDecodeError):
        return False
    return f'format = "{begins or ""}' in head
