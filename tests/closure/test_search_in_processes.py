"""What the search finds does not depend on how its candidates are shared out to processes, to the last bit.

The search runs in a process of its own: that of a test has threads, beside which no process is copied.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from sim_heating.base.parallel.processes import in_shares
from sim_heating.base.parallel.threads import march_threads
from sim_heating.closure.search.search import search_effects
from sim_heating.inputs.record import load_record
from tests.support.few_candidates import search_among

ROOT = Path(__file__).parents[2]


def print_findings(processes: int) -> None:
    """Search p08 among four effects and print every number of the trials and hypotheses."""
    with pytest.MonkeyPatch.context() as patch, march_threads(processes):
        search_among(patch, "impingement-onset", "transition", "interaction", "coating-thickness")
        found = search_effects(load_record(ROOT / "scenarios" / "records" / "practice" / "p08"))
        shared = in_shares(lambda chosen: [len(chosen)] * len(chosen), 2)
    assert shared == ([1, 1] if processes > 1 and sys.platform == "linux" else [2, 2])
    print(found.names)
    print([repr(float(gain)) for gain in found.first.predicted])
    for t in found.first.trials:
        print(t.name, repr(float(t.delta_bic)), t.fit.values.tolist(), t.fit.sigma.tolist())
    for h in found.hypotheses:
        print(h.names, repr(float(h.last.delta_bic)), h.last.fit.values.tolist(), repr(h.adequacy))


@pytest.mark.thorough
def test_findings_are_the_same_from_one_process_and_from_two():
    outputs = [
        subprocess.run(
            [sys.executable, "-c", f"from {__name__} import print_findings; print_findings({processes})"],
            cwd=ROOT, capture_output=True, text=True, check=True,
        ).stdout
        for processes in (1, 2)
    ]  # fmt: skip
    assert outputs[0].startswith("('impingement-onset',)")
    assert len(outputs[0].splitlines()) > 4
    assert outputs[0] == outputs[1]
