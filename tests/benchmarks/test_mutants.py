"""A sample of damaged files of every format that the program reads; ten thousand are `python -m benchmarks.mutants`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from benchmarks.mutants.judge import GOOD, Result, mutant, names_a_file, run_numbers
from benchmarks.mutants.subjects import command_text, make_inputs

SEED, COUNT = 771123, 200
COMPUTING = 5
"""One in so many of the commands that compute is run; all of those that only read."""
LONGEST_S = 120.0
"""Processor time of one, with the loading and perhaps the compiling of kernels [s]."""


@pytest.fixture(scope="module")
def whole_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("whole")
    make_inputs(home, closed=False)
    return home


@pytest.fixture(scope="module")
def results(whole_files: Path) -> list[Result]:
    numbers = [n for n in range(COUNT) if n % COMPUTING == 1 or not computes(whole_files, n)]
    return list(run_numbers(whole_files, SEED, numbers, longest_s=LONGEST_S))


def computes(home: Path, number: int) -> bool:
    subject, command, _, _ = mutant(home, SEED, number)
    return command in subject.computes and bool(subject.checks)


@pytest.mark.thorough
def test_a_damaged_file_is_accepted_with_finite_results_or_answered_in_a_line(results: list[Result]) -> None:
    faults = [r for r in results if r.outcome not in GOOD]
    lines = (f"{r.number}: {r.command}; {r.file}: {r.what} -> {r.outcome}: {r.message}" for r in faults)
    assert not faults, "\n\n".join(lines)


@pytest.mark.thorough
def test_the_sample_damages_every_format_and_sees_every_outcome(results: list[Result]) -> None:
    assert len({r.format for r in results}) > 15
    assert set(Counter(r.outcome for r in results)) == set(GOOD)


@pytest.mark.thorough
def test_a_mutant_is_known_by_its_seed_and_number(whole_files: Path) -> None:
    for number in range(40):
        one, other = (mutant(whole_files, SEED, number) for _ in range(2))
        assert (one[2], one[3]) == (other[2], other[3])
        assert command_text(one[1]) == command_text(other[1])
        assert one[3].content != (whole_files / one[2]).read_bytes()


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("record/record.toml: `title` is missing", True),
        ("record: holds both", True),
        ("effect `x` of SIM_HEATING_EFFECTS cannot be read", True),
        ("time_s: is not a record", False),
        ("altitude_m, row 3: 80 looks like km", False),
    ],
)
def test_a_line_names_a_file_by_its_name_and_a_folder_by_a_path(line: str, names: bool, tmp_path: Path) -> None:
    (tmp_path / "record").mkdir()
    (tmp_path / "record" / "record.toml").touch()
    assert names_a_file(line, tmp_path) == names
