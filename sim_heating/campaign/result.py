"""What a campaign found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from sim_heating.base.files.package import package_version
from sim_heating.campaign.ageing import Walk, walks_of_fits
from sim_heating.campaign.flights import CampaignFlight
from sim_heating.campaign.joint import Group
from sim_heating.campaign.manoeuvre_fits import usable
from sim_heating.campaign.spec import Campaign
from sim_heating.credibility.facts.of_records import MODEL_ERROR_RATIO, facts_of_readings, of_several
from sim_heating.credibility.reviews import digest_of
from sim_heating.credibility.statement import Answer, Statement, assess

FORMAT = "campaign-report/1"
IMPROBABLE = 1e-3
"""p-value of the agreement of flights below which they are said to disagree."""


Row = dict[str, Any]
"""What is written of a fit, of a joint fit, or of the errors of a manoeuvre."""


def _answer(rows: Sequence[Row], fails: Callable[[Row], bool], text: str) -> Answer:
    """Whether there are rows and none fails; text : of how many fail, after the number."""
    failing = list(filter(fails, rows))
    return Answer(bool(rows) and not failing, f"{len(failing)} of {len(rows)} {text}")


def _is_noisy(fit: Row) -> bool:
    return not (fit["converged"] and fit["residual_over_noise"] <= MODEL_ERROR_RATIO)


def _disagrees(joint: Row) -> bool:
    return bool(joint["agreement"]["p_value"] < IMPROBABLE)


def _is_beyond(error: Row) -> bool:
    return bool(error["after_K"] > MODEL_ERROR_RATIO * error["noise_floor_K"])


@dataclass(frozen=True, eq=False)
class CampaignResult:
    """A campaign with its results.

    out     : directory of the results
    flights : with their records;  checks : names of those that revise no table
    groups  : manoeuvres that flights have in common
    closed  : rows of close-loop, one a record
    fits    : rows of the fits of single flights;  joint : of several flights
    omitted : manoeuvres that were not fitted, with the reason
    updates : rows of the revisions of the tables, in their order;  refused : fits that revised none, with the reason
    errors  : rows of RMSE [K] of each manoeuvre by the tables before and after, and by its fit
    """

    campaign: Campaign
    out: Path
    flights: tuple[CampaignFlight, ...]
    checks: frozenset[str]
    groups: tuple[Group, ...]
    closed: list[dict[str, Any]] = field(default_factory=list)
    fits: list[dict[str, Any]] = field(default_factory=list)
    joint: list[dict[str, Any]] = field(default_factory=list)
    omitted: list[str] = field(default_factory=list)
    updates: list[dict[str, Any]] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    errors: list[dict[str, Any]] = field(default_factory=list)

    def __repr__(self) -> str:
        fits = f"{len(self.fits)} fits, {len(self.joint)} of several flights"
        return f"<CampaignResult {self.campaign.title!r}: {len(self.flights)} flights, {fits}>"

    @cached_property
    def walks(self) -> list[Walk]:
        """Parameters that age, along the flights, by the fits of single flights that are usable."""
        rows = [row for row in self.fits if not usable(row)]
        return walks_of_fits(rows, self.campaign.declared.ageing, [f.name for f in self.flights])

    @cached_property
    def credibility(self) -> Statement:
        """What supports the revised tables, factor by factor."""
        records = [f.records[p] for f in self.fitted_flights for p in self.points if p in f.records]
        facts = of_several(list(map(partial(facts_of_readings, "campaign"), records)))
        done = [r for r in (*self.fits, *self.joint) if "failed" not in r]
        compared = [r for r in self.joint if r.get("agreement")]
        checked = [e for e in self.errors if e["check"]]
        facts_of_campaign = replace(
            facts,
            topics=facts.topics | {"estimates", "sensitivities"},
            consistent=_answer(done, _is_noisy, "fits are not within their noise"),
            holds=_answer(compared, _disagrees, "groups of flights do not agree"),
            varied=_answer(checked, _is_beyond, "manoeuvres that only check are not predicted within their noise"),
            folder=self.campaign.vehicle.directory,
            reviewed=digest_of(self.campaign.vehicle),
        )
        return assess(facts_of_campaign)

    @property
    def fitted_flights(self) -> list[CampaignFlight]:
        """Flights that are fitted, which are all but those that check."""
        return [f for f in self.flights if f.name not in self.checks]

    @property
    def points(self) -> list[str]:
        """Control points of all flights, in the order of the campaign or of the records."""
        flown = dict.fromkeys(p for f in self.flights for p in f.records)
        named = self.campaign.declared.control_points
        return list(flown) if named is None else [p for p in named if p in flown]

    def as_json(self) -> dict[str, Any]:
        """Contents of campaign.json."""
        return {
            "format": FORMAT,
            "title": self.campaign.title,
            "vehicle": self.campaign.vehicle.name,
            "program": f"sim-heating {package_version()}",
            "flights": [
                {
                    "name": f.name,
                    "check": f.name in self.checks,
                    "records": {p: str(r.directory) for p, r in f.records.items()},
                    "manoeuvres": [vars(m) for m in f.manoeuvres],
                }
                for f in self.flights
            ],
            "closed": self.closed,
            "fits": self.fits,
            "joint": self.joint,
            "ageing": [vars(walk) for walk in self.walks],
            "omitted": self.omitted,
            "updates": self.updates,
            "refused": self.refused,
            "errors": self.errors,
            "credibility": self.credibility.as_json(),
        }
