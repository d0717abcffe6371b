"""How often an effect is named where there is none: counted over records made without one, and said in every report."""

from __future__ import annotations

import json
from importlib.resources import files

from scipy.stats import beta

LEVEL = 0.95


def false_alarm() -> str:
    """The chance of a false alarm, and what it rests on, in a line."""
    counted = json.loads(files("sim_heating").joinpath("data", "closure_calibration.json").read_text(encoding="utf-8"))
    named, records = int(counted["named"]), int(counted["records"])
    limit = float(beta.ppf(LEVEL, named + 1, records - named))
    return (
        f"An effect was named in {named} of {records} synthetic records that had none: chance of a false alarm below "
        f"{limit:.1%} with {LEVEL:.0%} confidence on such records"
    )
