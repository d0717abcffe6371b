"""The command `sim-heating credibility`: what supports a result, and the user's own evidence."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import sim_heating as sh
from sim_heating.base.errors import InputError
from sim_heating.cli.console import CONSOLE, PATH, ROOT, HelpfulGroup, print_table, progress_line
from sim_heating.cli.output import report_files, report_results

if TYPE_CHECKING:
    from sim_heating.credibility.validation.region import ValidationCase

RESULTS = ("summary.json", "estimate.json", "closure.json", "study.json", "campaign.json", "design.json", "live.json")
"""Files that hold a credibility statement."""
SHOW = "show"


class GroupWithDefault(HelpfulGroup):
    """A group whose arguments are those of `show` where they begin with no command."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put `show` before arguments that name no command; the options of the group itself come first."""
        options = {name for p in self.get_params(ctx) for name in p.opts}
        if not args or (args[0] not in self.commands and args[0] not in options):
            args = [SHOW, *args]
        return super().parse_args(ctx, args)


@click.group(cls=GroupWithDefault)
def credibility() -> None:
    """What supports a result: `credibility RESULT_DIR` shows its statement, `credibility show --help` the options.

    A self-assessment after the factors of NASA-STD-7009B; no statement of compliance.
    """


@credibility.command(SHOW)
@click.argument("results", type=PATH, default=".")
@click.option(
    "--reviews",
    type=PATH,
    help="signed reviews of a file elsewhere; the credibility.toml beside the record or vehicle counts anyhow",
)
def show(results: Path, reviews: Path | None) -> None:
    """Show the credibility statement of RESULTS, a directory that a command wrote (default: the current one)."""
    from sim_heating.credibility.reviews import reviews_of_file
    from sim_heating.credibility.section import contributions_table, factors_table, points_of
    from sim_heating.credibility.statement import with_reviews

    path, block = _statement_in(results)
    if reviews is not None:
        block = with_reviews(block, reviews_of_file(reviews, block["reviewable"]))
    CONSOLE.print(f"{path}: {block['basis']}", soft_wrap=True)
    print_table(factors_table(block))
    for table in contributions_table(block):
        print_table(table)
    for line in points_of(block):
        CONSOLE.print(line, soft_wrap=True)
    report_results(block)


def _statement_in(results: Path) -> tuple[Path, dict[str, Any]]:
    """The file of a directory that holds a statement, and the statement.

    raises : InputError where there is none
    """
    from sim_heating.base.files import display_path, read_json

    paths = [results] if results.is_file() else [results / name for name in RESULTS]
    for path in paths:
        block = read_json(path).get("credibility") if path.is_file() else None
        if isinstance(block, dict):
            return path, block
    if not results.exists():
        raise InputError(
            f"{results}: there is no such directory; name one with results, or a command: {', '.join(_commands())}"
        )
    raise InputError(f"{display_path(results)}: {_what_it_is(results)}")


def _what_it_is(results: Path) -> str:
    """What a directory without a statement is, and which one to name."""
    from sim_heating.base.files import display_path

    if (results / "record.toml").is_file():
        return "is a flight record; name the directory of results that predict, estimate or close-loop wrote from it"
    below = sorted(p.parent for name in RESULTS for p in results.glob(f"*/{name}"))
    hint = f"; its folders have some, such as {display_path(below[0])}" if below else "; run the command again"
    if (results / "vehicle.toml").is_file():
        hint = ": it is a vehicle; name the directory that a command wrote with --out"
    return f"holds no result with a credibility statement{hint}"


def _commands() -> list[str]:
    return [name for name in credibility.commands if name != SHOW]


@credibility.command("rules")
def show_rules() -> None:
    """Show the factors and the rule of each level."""
    from sim_heating.credibility.section import rules_table

    table = rules_table()
    print_table(table)
    report_results({"rules": table.rows})


@credibility.command("add")
@click.argument("record", type=PATH)
@click.option("--force", is_flag=True, help="replace a validation case of this name")
@ROOT
def add(record: Path, force: bool, root: Path | None) -> None:
    """Predict a measured RECORD with its declared model, and add its conditions and errors to the validated region.

    The case is written into the folder `validation` of the current directory, or into the one that
    SIM_HEATING_VALIDATION names; commands that are run there take it into account.
    """
    from dataclasses import replace

    from sim_heating.base.files.package import package_version
    from sim_heating.credibility.validation.own_cases import case_of_record, write_case

    loaded = sh.load_record(record, root=root)
    with progress_line(f"predicting {loaded.name}"):
        case = replace(case_of_record(loaded, sh.predict(loaded).residual_K), of_user=True)
    path = write_case(case, f"sim-heating {package_version()}", replace=force)
    _print_cases([case])
    CONSOLE.print(f"Wrote {path}", soft_wrap=True)
    report_files(None, [path])
    report_results(_case_results(case))


@credibility.command("list")
def list_cases() -> None:
    """List the measured data sets: those of the project and your own."""
    from sim_heating.credibility.validation.own_cases import all_cases

    cases = all_cases()
    _print_cases(cases)
    report_results({"cases": [_case_results(c) for c in cases]})


@credibility.command("remove")
@click.argument("name")
def remove(name: str) -> None:
    """Remove your validation case NAME; data sets of the project stay."""
    from sim_heating.credibility.validation.own_cases import remove_case

    path = remove_case(name)
    CONSOLE.print(f"Removed {path}", soft_wrap=True)
    report_results({"removed": path})


@credibility.command("review")
@click.argument("path", type=PATH)
@click.option("--factor", required=True, help="what was reviewed; `credibility rules` lists the factors")
@click.option("--level", required=True, type=click.IntRange(0, 4), help="level that the reviewer finds reached")
@click.option("--person", required=True, help="name, and on whose behalf")
@click.option("--statement", required=True, help="what was found, in a sentence")
@click.option("--date", type=click.DateTime(["%Y-%m-%d"]), help="of the review; default: today")
@ROOT
def review(path: Path, factor: str, level: int, person: str, statement: str, date: Any, root: Path | None) -> None:
    """Add a signed review to the credibility.toml of PATH, a record or a vehicle.

    It counts as long as the reviewed files stay as they are.
    """
    import datetime

    from pydantic import ValidationError

    from sim_heating.credibility.reviews import Review, add_review, digest_of

    is_vehicle = (path / "vehicle.toml").is_file()
    subject = sh.load_vehicle(path, root=root) if is_vehicle else sh.load_record(path, root=root)
    day = datetime.date.today() if date is None else date.date()
    try:
        signed = Review(
            factor=factor, level=level, person=person, date=day, statement=statement, reviewed=digest_of(subject)
        )
    except ValidationError as error:
        problem = error.errors()[0]
        name = problem["loc"][0] if problem["loc"] else ""
        raise InputError(f"--{name}: {problem['msg'].removeprefix('Value error, ')}") from None
    file = add_review(path, signed)
    CONSOLE.print(f"Wrote {file}: {factor} {level}, {person}; it counts while the files of {path} stay as they are")
    report_files(None, [file])
    report_results(signed.model_dump(mode="json"))


def _print_cases(cases: Any) -> None:
    from sim_heating.credibility.section import cases_table

    print_table(cases_table(cases))


def _case_results(case: ValidationCase) -> dict[str, Any]:
    from sim_heating.credibility.evidence import case_as_json

    return {**case_as_json(case), "own": case.of_user}
