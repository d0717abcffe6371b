"""The list of the paper's figures, what flights give of it, and the files of the command."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim_heating.base.errors import InputError, tell_left_out
from sim_heating.base.files import output_directory, read_toml_dict, write_json
from sim_heating.base.files.package import package_version
from sim_heating.base.progress import Progress, no_progress
from sim_heating.base.report.page import Page, Picture, Section, write_page
from sim_heating.base.report.table import Column, Table
from sim_heating.campaign.figures import (
    diagrams,
    filter_steps,
    histories,
    maps,
    pod,
    ratios,
    sections,
    segments,
    tunnel,
)
from sim_heating.campaign.figures.figure_file import PaperFigure, Statement
from sim_heating.campaign.figures.flown_data import FLAP, POPU, FlownData, LeftOut
from sim_heating.campaign.flights import SCENARIO_SUFFIX, CampaignFlight, flight_of_scenario, read_flights
from sim_heating.campaign.spec import Campaign, load_campaign
from sim_heating.simulation.run import fly_scenario

SUMMARY, PAGE, COMMAND = "figures.json", "report.html", "figures"
DRAWINGS: Mapping[int, Callable[[FlownData], PaperFigure]] = {
    1: diagrams.systems_approach,
    2: sections.sections,
    3: diagrams.estimator,
    4: filter_steps.steps,
    5: histories.lower_surface(5, 20.0),
    6: histories.lower_surface(6, 12.0),
    7: histories.lower_surface(7, 8.0),
    8: ratios.angle_of_attack,
    9: segments.reynolds_trend,
    10: histories.elevon(10, [(FLAP, 21.0), (POPU, 20.0)]),
    11: histories.elevon(11, [(FLAP, 12.0)]),
    12: ratios.elevon,
    13: histories.pod,
    14: pod.onset_of_impingement,
    15: maps.control_points,
    16: maps.wall_temperatures,
    17: pod.reynolds,
    18: tunnel.transient,
}
"""Number of a figure -> what draws it: 1 to 16 are the paper's, the others of what its text alone says. Speeds are the
paper's, in units of 1000 ft/s."""


@dataclass(frozen=True, eq=False)
class PaperFigures:
    """The figures that flights give, and the others with the reason.

    flights  : their names;  inputs : directories and files that they were read from
    drawn    : in order of number;  left_out : number -> reason
    """

    flights: tuple[str, ...]
    inputs: tuple[Path, ...]
    drawn: tuple[PaperFigure, ...]
    left_out: Mapping[int, str]

    def __repr__(self) -> str:
        numbers = ", ".join(str(f.number) for f in self.drawn) or "none"
        return f"<PaperFigures of {', '.join(self.flights)}: {numbers}>"

    def summary(self) -> dict[str, Any]:
        """Content of figures.json: files and findings of each figure, and reasons for those left out."""
        statements = self.statements
        return {
            "format": "figures/1",
            "program": f"sim-heating {package_version()}",
            "flights": list(self.flights),
            "figures": {
                str(f.number): {"title": f.title, "files": f.files, "found": list(f.notes)} for f in self.drawn
            },
            "statements": [
                {"figure": n, "statement": s.number, "paper": s.paper, "here": s.here, "verdict": s.verdict}
                for n, s in statements
            ],
            "observed": sum(s.observed for _, s in statements),
            "left_out": {str(number): reason for number, reason in self.left_out.items()},
        }

    @property
    def statements(self) -> list[tuple[int, Statement]]:
        """Number of the figure and statement of the paper, of all figures."""
        return [(f.number, s) for f in self.drawn for s in f.statements]

    @property
    def count(self) -> str:
        """How many statements these flights show, as text."""
        observed = sum(s.observed for _, s in self.statements)
        return f"{observed} of {len(self.statements)} statements of the paper observed"

    def page(self) -> Page:
        """Statements in a table, then every figure with what was found."""
        columns = [
            Column("figure"),
            Column("statement"),
            Column("the paper says", is_text=True),
            Column("these flights", is_text=True),
            Column("verdict", is_text=True),
        ]
        rows = [[n, s.number, s.paper, s.here, s.verdict] for n, s in self.statements]
        sections = [Section("Statements of the paper", tables=[Table("Statements", columns, rows)])]
        sections += [
            Section(f"Figure {f.number}", points=f.notes, pictures=[Picture(f.figure, f.title)]) for f in self.drawn
        ]
        return Page("The founding paper's figures", ", ".join(self.flights), sections, (self.count, ""))


def draw_figures(
    flights: Sequence[CampaignFlight | str | os.PathLike[str]],
    numbers: Sequence[int] | None = None,
    *,
    points: Mapping[str, str] | None = None,
    reference: str = "both",
    root: str | os.PathLike[str] | None = None,
    progress: Progress = no_progress,
) -> PaperFigures:
    """Draw the founding paper's figures over flights.

    flights   : flights, or their sources: campaign files, scenario files, directories of records
    numbers   : of the figures, 1 to 18, of which 17 and 18 are of its text alone; all by default
    points    : `lower`, `elevon`, `pod` or `tunnel` -> control point, where not the one of POINTS (flown.py)
    reference : of figure 9, `both`, `stagnation` or `eckert-turbulent`
    root      : folder that files may name others in; by default the nearest above each that holds `scenarios`
    progress  : called with the fraction done and a line of text
    returns   : the figures that these flights give, and the reason for each other one
    raises    : InputError where a number, a point or a source cannot be used

    A manoeuvre is found by its kind and its speed, the nearest to the paper's within 1500 ft/s; of flights that flew it
    alike the first is drawn.
    """
    chosen = sorted(dict.fromkeys(numbers or DRAWINGS))
    for number in chosen:
        if number not in DRAWINGS:
            raise InputError(f"figure {number}: there are figures 1 to {max(DRAWINGS)}")
    read, inputs = _flights(flights, root, lambda done, text: progress(0.3 * done, f"flights: {text}"))
    if not read:
        raise InputError("figures: no flight; name a campaign, scenarios or directories of records")
    data = FlownData(read, points, reference)
    drawn: list[PaperFigure] = []
    left_out: dict[int, str] = {}
    for k, number in enumerate(chosen):
        progress(0.3 + 0.7 * k / len(chosen), f"figure {number}")
        try:
            drawn.append(DRAWINGS[number](data))
        except LeftOut as reason:
            left_out[number] = str(reason)
        except InputError:
            raise
        except Exception as error:  # one figure does not cost the others
            left_out[number] = tell_left_out(f"figure {number}", error)
    return PaperFigures(tuple(f.name for f in read), tuple(inputs), tuple(drawn), left_out)


def _flights(
    sources: Sequence[CampaignFlight | str | os.PathLike[str]], root: str | os.PathLike[str] | None, progress: Progress
) -> tuple[list[CampaignFlight], list[Path]]:
    """Flights of all sources in their order, and the files and directories that they come from."""
    flights: list[CampaignFlight] = []
    inputs: list[Path] = []
    paths = [Path(source) for source in sources if not isinstance(source, CampaignFlight)]
    for source in sources:
        if isinstance(source, CampaignFlight):
            flights.append(source)
        elif _is_campaign(Path(source)):
            campaign = load_campaign(source, root=root)
            inputs += campaign.files
            paths.remove(Path(source))
            flights += _campaign_flights(campaign, root, progress)
    flights += read_flights(paths, root=root, progress=progress) if paths else []
    return flights, list(dict.fromkeys([*inputs, *_inputs_of(flights)]))


def _inputs_of(flights: Sequence[CampaignFlight]) -> list[Path]:
    """Files of the flights' scenarios, and directories of the records of those that have none."""
    files = [path for f in flights if f.scenario is not None for path in f.scenario.files]
    records = [r.directory for f in flights if f.scenario is None for r in f.records.values()]
    return [*files, *filter(Path.is_dir, records)]


def _campaign_flights(
    campaign: Campaign, root: str | os.PathLike[str] | None, progress: Progress
) -> Iterator[CampaignFlight]:
    """Flights of a campaign: its records are read, each of its scenarios is flown once for all seeds."""
    for source in campaign.flights:
        if source.records is not None:
            yield from read_flights([source.records], root=root, progress=progress)
            continue
        progress(0.0, f"flying {source.scenarios[0].title}")
        flown = fly_scenario(source.scenarios[0])
        yield from (flight_of_scenario(scenario, flown=flown) for scenario in source.scenarios)


def _is_campaign(path: Path) -> bool:
    """Whether a file says that it is a campaign."""
    return path.suffix == SCENARIO_SUFFIX and str(read_toml_dict(path).get("format", "")).startswith("campaign/")


def write_figures(figures: PaperFigures, out: str | os.PathLike[str]) -> list[str]:
    """Write every figure with its data, figures.json, and a page with the statements.

    returns : names of the files
    raises  : InputError where the directory contains files of these names that this program did not write
    """
    with output_directory(out, COMMAND, inputs=figures.inputs) as folder:
        for figure in figures.drawn:
            figure.write(folder)
        write_json(folder / SUMMARY, figures.summary())
        write_page(folder / PAGE, figures.page)
        return sorted(p.name for p in folder.iterdir() if p.is_file() and not p.name.startswith("."))
