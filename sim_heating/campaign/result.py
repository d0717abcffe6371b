"""What a campaign found."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sim_heating.base.files.package import package_version
from sim_heating.campaign.flights import CampaignFlight
from sim_heating.campaign.joint import Group
from sim_heating.campaign.spec import Campaign

FORMAT = "campaign-report/1"


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

    @property
    def fitted_flights(self) -> list[CampaignFlight]:
        """Flights that are fitted, which are all but those that check."""
        return [f for f in self.flights if f.name not in self.checks]

    @property
    def points(self) -> list[str]:
        """Control points of all flights, in the order of the campaign or of the records."""
        found = dict.fromkeys(p for f in self.flights for p in f.records)
        named = self.campaign.declared.control_points
        return list(found) if named is None else [p for p in named if p in found]

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
            "omitted": self.omitted,
            "updates": self.updates,
            "refused": self.refused,
            "errors": self.errors,
        }
