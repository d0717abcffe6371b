"""Betts' optimal re-entry: published cross-range and time of flight."""

from __future__ import annotations

import numpy as np

from tests.support.betts import PUBLISHED, solve_betts
from tests.support.verification.row import Row


def rows() -> list[Row]:
    """All of this subject; without CasADi, nothing."""
    try:
        import casadi  # noqa: F401
    except ImportError:
        return []
    found = []
    for case, (latitude_deg, time_s) in PUBLISHED.items():
        last = solve_betts(case)[-1]
        name = "Betts' entry, heating limited" if case == "limited" else "Betts' entry"
        source = "Betts (2010), section 6.1"
        found += [
            Row(
                f"{name}: cross-range",
                latitude_deg,
                float(np.degrees(last.goal)),
                1e-3,
                "deg",
                source,
                "four decimals; mesh error 1e-6",
            ),
            Row(
                f"{name}: time of flight",
                time_s,
                last.duration_s,
                0.5,
                "s",
                source,
                "flat optimum: 1e-6 of the goal moves the time by 0.1 %",
            ),
        ]
    return found
