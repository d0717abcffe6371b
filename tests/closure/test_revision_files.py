"""Revision files that were damaged or edited: refused in one line, whatever is wrong with them."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import chdir
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_heating.base.errors import InputError
from sim_heating.base.files import read_json, text_digest, with_digest
from sim_heating.cli import main
from sim_heating.closure.revise.revisions import read_history
from sim_heating.inputs.vehicle import Vehicle, load_vehicle
from tests.closure.test_update_tables import POINT, edit, flown_records, table_of, update_and_write

__all__ = ["flown_records"]

REVISIONS = Path(f"orbiter/ratio_revisions/{POINT}")


@pytest.fixture(scope="module")
def twice_revised(flown_records: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the vehicle after two revisions from two flights."""
    home = shutil.copytree(flown_records, tmp_path_factory.mktemp("revised"), dirs_exist_ok=True)
    with chdir(home):
        for fit in ("first.json", "second.json"):
            update_and_write(fit)
    return home


@pytest.fixture
def revised(twice_revised: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the vehicle with two revisions in the working directory; the directory of their files."""
    shutil.copytree(twice_revised, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path / REVISIONS


def rewritten(file: Path, change: Callable[[dict[str, Any]], object], sealed: bool = True) -> None:
    """A revision's file with other contents, with a digest that fits them or without one."""
    data = read_json(file)
    change(data)
    content = {k: v for k, v in data.items() if k != "digest"}
    file.write_text(json.dumps(with_digest(content) if sealed else content))


def put(*where: str | int, value: Any) -> Callable[[dict[str, Any]], object]:
    """Another value at a place of the file."""

    def change(data: Any) -> None:
        for key in where[:-1]:
            data = data[key]
        data[where[-1]] = value

    return change


def indefinite(data: dict[str, Any]) -> None:
    C = np.array(data["evidence"]["covariance"])
    C[0, 1] = C[1, 0] = 1.5 * np.sqrt(C[0, 0] * C[1, 1])
    data["evidence"]["covariance"] = C.tolist()


DAMAGED: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "its own parent": (put("parent", value=3), "`parent`: 3 is not the revision before 3, which is 2"),
    "a later parent": (put("parent", value=7), "`parent`: 7 is not the revision before 3"),
    "another revision": (lambda d: d.update(revision=2, parent=1), f"is revision 2 of \"{POINT}\"; this must be"),
    "another point": (put("control_point", value="V07T9999"), "is revision 3 of \"V07T9999\"; this must be"),
    "two forms": (put("evidence", "H", value=[]), "`H`"),
    "no sample": (put("evidence", "x", value=[]), "`x`: holds no sample"),
    "a lost variable": (lambda d: d["evidence"]["x"][1].pop(), "`x`, row 2: has 4 values where there must be 5"),
    "a lost derivative": (lambda d: d["evidence"]["basis"][1].pop(), "`basis`, row 2: has 1 values"),
    "a lost ratio": (lambda d: d["evidence"]["ratio"].pop(), "`ratio`: has "),
    "no ratios": (lambda d: d["evidence"].pop("ratio"), "`ratio` is missing"),
    "no weight": (put("evidence", "weight", 0, value=0.0), "`weight`: must be above 0"),
    "an exact form": (put("evidence", "shape_sigma", value=0.0), "`shape_sigma`"),
    "unknown parameter": (put("evidence", "names", 0, value="ratio.scael"), "did you mean `ratio.scale`"),
    "one parameter twice": (put("evidence", "names", 0, value="ratio.d_alpha"), "`ratio.d_alpha` occurs twice"),
    "asymmetric covariance": (put("evidence", "covariance", 0, 1, value=1e-7), "`covariance`: is not symmetric"),
    "negative variance": (put("evidence", "covariance", 0, 0, value=-1.0), "`covariance`: is not positive definite"),
    "indefinite covariance": (indefinite, "`covariance`: is not positive definite"),
    "covariance of one": (put("evidence", "covariance", value=[[1e-6]]), "`covariance`: has 1 rows for 2 names"),
    "no reach": (lambda d: d["reach"].pop("beta_deg"), "[reach]: must hold a distance from 1e-09"),
    "half a segment": (put("records", 0, "segments", value=[[3.0]]), "[3.0] is not [start_s, end_s]"),
    "no records": (put("records", value="first"), "`records`: \"first\" is not a list"),
    "infinite": (put("chi_square", value=1e400), "contains Infinity"),
}  # fmt: skip


@pytest.mark.sample(8)
@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_revision_is_refused_in_one_line(
    name: str, revised: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, hint = DAMAGED[name]
    rewritten(revised / "revision_3.json", change, sealed=name != "infinite")  # which has no digest
    assert main(["update-tables", "--vehicle", "./orbiter", "--revert", POINT]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
    assert hint in lines[0]
    assert f"{REVISIONS}/revision_3.json" in lines[0]
    assert len(lines) <= 2, lines


OTHER_EVIDENCE: dict[str, Callable[[dict[str, Any]], object]] = {
    "another value": put("evidence", "ratio", 0, value=0.5),
    "wider bounds": lambda d: put(
        "evidence", "covariance", value=(9.0 * np.array(d["evidence"]["covariance"])).tolist()
    )(d),
}


@pytest.mark.parametrize("name", OTHER_EVIDENCE)
def test_a_revision_with_other_evidence_is_refused_and_can_be_undone(name: str, revised: Path) -> None:
    before = (revised / "revision_2.csv").read_bytes()
    rewritten(revised / "revision_3.json", OTHER_EVIDENCE[name])
    with pytest.raises(InputError, match=r"revision_3\.json: its evidence does not make the table"):
        read_history(load_vehicle("./orbiter"), POINT)
    assert main(["update-tables", "--vehicle", "./orbiter", "--revert", POINT]) == 0
    assert table_of(Path("orbiter")).read_bytes() == before


def test_a_table_that_was_revised_below_zero_is_reverted(revised: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As a version without the check wrote it: no command reads the vehicle, and the revert says what was wrong."""
    table, before = table_of(Path("orbiter")), (revised / "revision_2.csv").read_bytes()
    lines = table.read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("alpha_deg"))
    cells = lines[at + 1].split(",")
    cells[lines[at].split(",").index("ratio")] = "-0.4"
    table.write_text("\n".join([*lines[: at + 1], ",".join(cells), *lines[at + 2 :]]) + "\n")
    rewritten(revised / "revision_3.json", put("table_hash", value=text_digest(table.read_text())))
    assert main(["validate", "./orbiter"]) == 2
    capsys.readouterr()
    assert main(["update-tables", "--vehicle", "./orbiter", "--revert", POINT]) == 0
    printed = capsys.readouterr()
    assert f"{POINT}: revision 3 undone; revision 2 is in force" in printed.out
    assert f"row {at + 2}, column ratio: -0.4 is not a ratio of film coefficients" in printed.err
    assert "revision 3, which is undone, had it" in printed.err
    assert table.read_bytes() == before
    assert main(["validate", "./orbiter"]) == 0


@pytest.mark.parametrize("revision", ["2", "3"])
def test_a_revision_edited_by_hand_is_refused(revised: Path, revision: str) -> None:
    edit(revised / f"revision_{revision}.json", lambda text: text.replace('"chi_square": ', '"chi_square": 1'))
    with pytest.raises(InputError, match=rf"revision_{revision}\.json: was changed after it was written"):
        read_history(load_vehicle("./orbiter"), POINT)


def test_a_revision_without_its_digest_is_refused(revised: Path) -> None:
    rewritten(revised / "revision_3.json", lambda _: None, sealed=False)
    with pytest.raises(InputError, match=r"revision_3\.json: was changed after it was written"):
        read_history(load_vehicle("./orbiter"), POINT)


NUMBERS = {"wide": "\uff12", "negative": "-1", "long": "9" * 5000, "real": "1.0", "none": ""}


@pytest.mark.parametrize("number", NUMBERS.values(), ids=NUMBERS)
def test_a_table_needs_a_whole_number_in_plain_digits(number: str, workdir: Path) -> None:
    edit(table_of(workdir / "orbiter"), lambda text: text.replace("# revision: 1\n", f"# revision: {number}\n"))
    with pytest.raises(InputError, match=r"header `revision`: .* is not a whole number"):
        read_history(load_vehicle("./orbiter"), POINT)


# Whatever is changed --------------------------------------------------------------------------------------------------


def places(value: Any, here: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """All places of a JSON value, those in long lists by their ends."""
    if here:
        yield here
    if isinstance(value, dict):
        for key, v in value.items():
            yield from places(v, (*here, key))
    if isinstance(value, list):
        for i in sorted({0, 1, len(value) - 1} & set(range(len(value)))):
            yield from places(value[i], (*here, i))


OTHERS = st.sampled_from(
    [None, True, 0, 1, -1, 2, 3, 10**30, 0.5, -1e300, 5e-324, "", "x", POINT, "../..", "\x1b[2J\n", [], [[]], [[], []],
     [0], [1, 1], {}, {"a": 1}, {"": []}]
)  # fmt: skip


@pytest.fixture(scope="module")
def vehicle(twice_revised: Path, tmp_path_factory: pytest.TempPathFactory) -> Vehicle:
    """A vehicle with two revisions, for many readings."""
    home = shutil.copytree(twice_revised, tmp_path_factory.mktemp("read"), dirs_exist_ok=True)
    return load_vehicle(home / "orbiter")


@pytest.mark.thorough
@settings(max_examples=100)
@given(data=st.data())
def test_any_change_of_a_revision_is_refused_or_does_not_matter(data: st.DataObject, vehicle: Vehicle) -> None:
    """With the digest of the file as it was, or with none: refused. With a fitting one: refused, or of no weight in
    what follows from the evidence."""
    number, kind = data.draw(st.sampled_from([2, 3])), data.draw(st.sampled_from(["as it was", "none", "fitting"]))
    how, other = data.draw(st.sampled_from(["replace", "remove", "repeat", "scale"])), data.draw(OTHERS)
    file = vehicle.directory / "ratio_revisions" / POINT / f"revision_{number}.json"
    whole, known = file.read_text(), read_history(vehicle, POINT)
    content = json.loads(whole)
    changed = copy.deepcopy(content)
    place = data.draw(st.sampled_from([p for p in places(content) if p != ("digest",)]))
    parent: Any = changed
    for key in place[:-1]:
        parent = parent[key]
    if how == "remove":
        del parent[place[-1]]
    elif how == "repeat" and isinstance(parent, list):
        parent.insert(int(place[-1]), copy.deepcopy(parent[int(place[-1])]))
    elif how == "scale" and isinstance(parent[place[-1]], float):
        parent[place[-1]] *= 1.01
    else:
        parent[place[-1]] = other
    plain = {k: v for k, v in changed.items() if k != "digest"}
    refused: tuple[str, ...] = ()
    try:
        file.write_text(json.dumps({"as it was": changed, "none": plain, "fitting": with_digest(plain)}[kind]))
        found = read_history(vehicle, POINT)
    except InputError as error:
        refused = error.problems
    finally:
        file.write_text(whole)
    assert all(line.isprintable() and file.name in line for line in refused)
    if not refused:
        assert kind == "fitting" or (kind == "as it was" and changed == content)
        for one, other in zip(found.revisions, known.revisions, strict=True):
            np.testing.assert_allclose(one.evidence.ratio, other.evidence.ratio, rtol=0.02, atol=1e-9)
