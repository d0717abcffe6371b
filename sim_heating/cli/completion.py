"""The command `sim-heating completion`, and the names that tab completion offers."""

from __future__ import annotations

import os
from collections.abc import Iterator
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
    of_files, waiting = kinds not in ("record", "vehicle"), [(start, 0)]
    for _ in range(LARGEST):
        if not waiting:
            return
        folder, depth = waiting.pop(0)
        entries = _entries(folder)
        names = {entry.name for entry in entries}
        if begins is None and not names.isdisjoint({"record.toml", "vehicle.toml"}):
            if kinds == "path" or (kinds == "vehicle") is ("vehicle.toml" in names):
                yield folder.as_posix()
            continue
        visible = [entry for entry in entries if not entry.name.startswith(".")]
        is_folder = {folder / entry.name: entry.is_dir(follow_symlinks=False) for entry in visible}
        waiting += [(path, depth + 1) for path, inner in is_folder.items() if inner and depth < DEPTH]
        if of_files:
            files = [path for path, inner in is_folder.items() if path.suffix == ".toml" and not inner]
            yield from (path.as_posix() for path in files if _is_of_format(path, begins))


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    """Entries of a folder in the order of their names; none where it cannot be read."""
    try:
        return sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError:
        return []


def _is_of_format(path: Path, begins: str | None) -> bool:
    """Whether a TOML file states a format that begins so in its first lines; any stated format where None."""
    try:
        with path.open(encoding="utf-8") as file:
            head = file.read(4096)
    except (OSError, UnicodeDecodeError):
        return False
    return f'format = "{begins or ""}' in head
