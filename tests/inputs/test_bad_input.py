"""Every file kind, damaged in every way: one line that names file, place and value and what to do."""

# ruff: noqa: E501 - the tables of damage hold one case a line

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sim_heating.base.errors import InputError
from sim_heating.base.files import check, toml_text
from sim_heating.cli.path_check import check_path
from sim_heating.inputs.record import load_record
from sim_heating.thermal.stack import construct
from sim_heating.trajectory.spec import FmuSource
from tests.support.paths import TILE

Damage = Callable[[str], str]


@pytest.fixture
def tile(tmp_path: Path) -> Path:
    return Path(shutil.copytree(TILE, tmp_path / "tile"))


def swap(old: str, new: str) -> Damage:
    """Replace the first occurrence of a text that must be there."""

    def damage(text: str) -> str:
        assert old in text
        return text.replace(old, new, 1)

    return damage


def cell(row: int, column: str, value: str) -> Damage:
    """Replace one cell; the row counts lines of the file."""

    def damage(text: str) -> str:
        lines = text.splitlines()
        names = next(line for line in lines if not line.startswith("#")).split(",")
        cells = lines[row - 1].split(",")
        cells[names.index(column)] = value
        lines[row - 1] = ",".join(cells)
        return "\n".join(lines) + "\n"

    return damage


def column(name: str, change: Callable[[str], str], new_name: str | None = None) -> Damage:
    """Change every cell of a column, and its name."""

    def damage(text: str) -> str:
        lines = [line.split(",") for line in text.splitlines()]
        i = lines[0].index(name)
        for line in lines[1:]:
            line[i] = change(line[i]) if line[i] else ""
        lines[0][i] = new_name or name
        return "\n".join(",".join(line) for line in lines) + "\n"

    return damage


def without(name: str) -> Damage:
    """Drop a column."""

    def damage(text: str) -> str:
        lines = [line.split(",") for line in text.splitlines()]
        i = lines[0].index(name)
        return "\n".join(",".join(c for j, c in enumerate(line) if j != i) for line in lines) + "\n"

    return damage


def rows(change: Callable[[list[str]], list[str]]) -> Damage:
    return lambda text: "\n".join(change(text.splitlines())) + "\n"


def celsius(kelvin: str) -> str:
    return f"{float(kelvin) - 273.15:.2f}"


RECORD_TOML = {
    "unknown key": (swap("noise_sigma_K", "noise_sigma_k"), "[thermocouples.sensor] 1: unknown key `noise_sigma_k`; did you mean `noise_sigma_K`?"),
    "unknown table": (swap("[segments]", "[segment]"), "unknown key `segment`; did you mean `segments`?"),
    "missing key": (swap("density_kg_m3 = 144.2", ""), "[materials.li900]: key `density_kg_m3` is missing (density in kg/m3, above 0)"),
    "missing table": (lambda t: t[: t.index("[heating]")] + t[t.index("[reference_condition]") :], "key `heating` is missing"),
    "other format": (swap("flight-record/1", "flight-record/9"), '`format`: "flight-record/9" is not one of flight-record/1'),
    "text for a number": (swap("depth_m = 0.00038", 'depth_m = "0.38 mm"'), '[thermocouples.sensor] 1: `depth_m`: "0.38 mm" is not a number'),
    "boolean for a number": (swap("bits = 8", "bits = true"), "`bits`: true is not a whole number"),
    "NaN": (swap("density_kg_m3 = 144.2", "density_kg_m3 = nan"), "[materials.li900]: `density_kg_m3`: NaN is not a finite number"),
    "infinite": (swap("[300.0, 0.9]", "[300.0, inf]"), "[materials.rcg]: `conductivity_W_mK`, row 1, item 2: Infinity is not a finite number"),
    "negative thickness": (swap("thickness_m = 0.041", "thickness_m = -0.041"), "[stack.layer] 2: `thickness_m`: -0.041 must be above 0"),
    "zero-size layer": (swap("thickness_m = 0.041", "thickness_m = 0.0"), "[stack.layer] 2: `thickness_m`: 0.0 must be above 0"),
    "thickness in mm": (swap("thickness_m = 0.041", "thickness_m = 41.0"), "[stack.layer] 2: `thickness_m`: 41 is thicker than 5 m and looks like millimetres"),
    "layer with no material": (swap('material = "li900"', 'material = "li9000"'), "[stack.layer] 2: `material`: unknown material `li9000`; did you mean `li900`?"),
    "layer without the key": (swap('material = "li900"\n', ""), "[stack.layer] 2: key `material` is missing"),
    "no layers": (lambda t: re.sub(r"\[\[stack\.layer\]\]\n(\w+ = .*\n)+", "", t), "[stack]: key `layer` is missing ([[stack.layer]], outermost first)"),
    "absurdly dense": (swap("density_kg_m3 = 144.2", "density_kg_m3 = 1e300"), "[materials.li900]: `density_kg_m3`: 1e+300 must not be above 1e+09"),
    "thinner than an atom": (swap("thickness_m = 0.041", "thickness_m = 1e-300"), "[stack.layer] 2: `thickness_m`: 1e-300 is thinner than an atom"),
    "contact at the last layer": (swap("thickness_m = 0.003", "thickness_m = 0.003\ncontact_m2K_W = 0.1"), "[stack.layer] 3: `contact_m2K_W`: the last layer touches no other"),
    "sensor outside the stack": (swap("depth_m = 0.04138", "depth_m = 0.0444"), "[thermocouples.sensor] 2: `depth_m`: 0.0444 m is outside the stack (0 to 0.04438 m)"),
    "sensor above the surface": (swap("depth_m = 0.00038", "depth_m = -0.001"), "[thermocouples.sensor] 1: `depth_m`: -0.001 must not be below 0"),
    "sensor twice": (swap('name = "bond"', 'name = "surface"'), "[thermocouples.sensor] 2: `name`: `surface` is that of an earlier sensor"),
    "word without range": (swap("range_K = [255.0, 1644.0]\n", ""), "[thermocouples.sensor] 1: `bits`: 8 bits need `range_K`"),
    "range reversed": (swap("[255.0, 1644.0]", "[1644.0, 255.0]"), "`range_K`: [1644.0, 255.0] is not [lowest, highest]"),
    "range in Celsius": (swap("[255.0, 1644.0]", "[-18.0, 1371.0]"), "`range_K`, row 1: -18 K is below absolute zero; give K, not Celsius"),
    "column in Celsius": (swap("TEST_bond_K", "TEST_bond_C"), "[thermocouples.sensor] 2: `column`: `TEST_bond_C` ends in a unit that is not K"),
    "constant calibration": (swap("calibration = [0.0, 1.0]", "calibration = [300.0, 0.0]"), "`calibration`: [300.0, 0.0] is constant"),
    "no emissivity outside": (swap("emissivity = [[300.0, 0.85], [1600.0, 0.84]]\n", ""), "[materials.rcg]: the outermost layer radiates; add `emissivity`"),
    "emissivity above 1": (swap("[300.0, 0.85]", "[300.0, 85.0]"), "[materials.rcg]: `emissivity`, row 1, item 2: 85 is not an emissivity (must be above 0, up to 1)"),
    "emissivity a number": (swap("[[300.0, 0.85], [1600.0, 0.84]]", "0.85"), "`emissivity`: 0.85 is not a list [...] ([[T_K, value], ...]"),
    "property table unsorted": (swap("[[300.0, 0.9], [1600.0, 1.4]]", "[[1600.0, 1.4], [300.0, 0.9]]"), "`conductivity_W_mK`, row 2, item 1: 300 does not come after 1600"),
    "temperature twice": (swap("[[300.0, 0.9], [1600.0, 1.4]]", "[[300.0, 0.9], [300.0, 1.4]]"), "`conductivity_W_mK`, row 2, item 1: 300 does not come after 300"),
    "property table in Celsius": (swap("[[300.0, 0.9]", "[[-18.0, 0.9]"), "`conductivity_W_mK`, row 1, item 1: -18 K is below absolute zero; give K, not Celsius"),
    "property table empty": (swap("[[300.0, 121.0]]", "[]"), "[materials.al2024]: `conductivity_W_mK`: the table is empty"),
    "half a pair": (swap("[[300.0, 121.0]]", "[[300.0]]"), "[materials.al2024]: `conductivity_W_mK`, row 1: [300.0] is not a pair [T_K, value]"),
    "negative conductivity": (swap("[300.0, 0.9]", "[300.0, -0.9]"), "`conductivity_W_mK`, row 1, item 2: -0.9 is not a conductivity (must be above 0)"),
    "zero specific heat": (swap("[300.0, 700.0]", "[300.0, 0.0]"), "`specific_heat_J_kgK`, row 1, item 2: 0 is not a specific heat (must be above 0)"),
    "pressure axis unsorted": (swap("[10.0, 1000.0, 100000.0]", "[1000.0, 10.0, 100000.0]"), "[materials.li900.conductivity_W_mK]: `p_Pa`, row 2: 10 does not come after 1000"),
    "pressure axis from zero": (swap("[10.0, 1000.0, 100000.0]", "[0.0, 1000.0, 100000.0]"), "`p_Pa`, row 1: 0 must be above 0"),
    "pressure table with a hole": (swap("[0.06, 0.08, 0.14]", "[0.06, 0.14]"), "[materials.li900.conductivity_W_mK]: `k`, row 2: has 2 values against 3 of p_Pa"),
    "pressure table short of a row": (swap(", [0.06, 0.08, 0.14]", ""), "[materials.li900.conductivity_W_mK]: `k`: has 1 rows against 2 values of T_K"),
    "negative in a pressure table": (swap("0.08, 0.14", "-0.08, 0.14"), "`k`, row 2, item 2: -0.08 is not a conductivity"),
    "initial in Celsius": (swap("[[0.0, 290.0]", "[[0.0, 17.0]"), "[stack]: `initial_profile`, row 1, item 2: 17 is below 100 K and looks like Celsius; give K"),
    "uniform without a temperature": (swap('initial = "profile"\ninitial_profile = [[0.0, 290.0], [0.04, 292.0]]', 'initial = "uniform"'), '[stack]: `initial`: "uniform" needs `initial_K`; add it'),
    "uniform in Celsius": (swap('initial = "profile"\ninitial_profile = [[0.0, 290.0], [0.04, 292.0]]', "initial_K = 17.0"), "[stack]: `initial_K`: 17 is below 100 K and looks like Celsius"),
    "profile outside the stack": (swap("[0.04, 292.0]", "[0.4, 292.0]"), "`initial_profile`, row 2, item 1: 0.4 m is outside the stack"),
    "profile and uniform": (swap('initial = "profile"', 'initial = "uniform"\ninitial_K = 290.0'), "`initial_profile`: is given with initial = \"uniform\""),
    "back face unknown": (swap("back = { h_W_m2K = 5.0, T_K = 290.0, emissivity = 0.8 }", 'back = "cold"'), '[stack]: `back`: "cold" is not one of adiabatic'),
    "back face without temperature": (swap("h_W_m2K = 5.0, T_K = 290.0,", "h_W_m2K = 5.0,"), "[stack.back]: key `T_K` is missing"),
    "reference unknown": (swap('reference = "columns"', 'reference = "sutton-grave"'), '`reference`: "sutton-grave" is not one of columns, sutton-graves'),
    "sphere without radius": (swap('reference = "columns"\nnose_radius_m = 0.3048', 'reference = "fay-riddell"'), '[heating]: `reference`: "fay-riddell" needs `nose_radius_m`; add it'),
    "plate without length": (swap('reference = "columns"', 'reference = "eckert-turbulent"'), '"eckert-turbulent" needs `running_length_m`; add it'),
    "wall enthalpy unknown": (swap("{ cp_J_kgK = 1004.5 }", '"perfect"'), '[heating]: `wall_enthalpy`: "perfect" is not one of equilibrium-air'),
    "wall enthalpy key": (swap("cp_J_kgK = 1004.5", "cp_J_kg = 1004.5"), "[heating.wall_enthalpy]: unknown key `cp_J_kg`; did you mean `cp_J_kgK`?"),
    "segment reversed": (swap("[[0.0, 200.0]]", "[[200.0, 0.0]]"), "[segments]: `fit`, row 1: [200.0, 0.0] is not a segment; give [start_s, end_s]"),
    "segment in ms": (swap("[[100.0, 140.0]]", "[[100000.0, 140000.0]]"), "[segments]: `holdout`, row 1: [100000.0, 140000.0] lies outside the measured 0.5 to 200.5 s"),
    "file outside the record": (swap('"conditions.csv"', '"../conditions.csv"'), "[conditions]: `file`: `../conditions.csv` is not a file of this record"),
    "one file for two": (swap('"thermocouples.csv"', '"conditions.csv"'), "[conditions]: `file`: two parts of the record name the same file"),
    "truncated": (lambda t: t[: t.index("[[0.013") + 4], "line 56: Unclosed array"),
    "syntax": (swap("measured = false", "measured = no"), "line 6: Invalid value (column 12); this is not TOML"),
    "key twice": (swap("measured = false", "measured = false\nmeasured = true"), "line 7: Cannot overwrite a value"),
}  # fmt: skip


@pytest.mark.parametrize("case", RECORD_TOML)
def test_a_damaged_declaration_is_answered_with_table_key_and_rule(tile: Path, case: str) -> None:
    damage, expected = RECORD_TOML[case]
    assert expected in problem(tile, "record.toml", damage)


CONDITIONS = {
    "missing column": (without("alpha_deg"), "there is no column `alpha_deg`; add it"),
    "reference column missing": (without("H_r_J_kg"), "there is no column `H_r_J_kg`"),
    "column misspelt": (swap("T_inf_K", "Tinf_K"), "there is no column `T_inf_K`; nearest in the file: `Tinf_K`"),
    "optional column misspelt": (swap("q_add_W_m2", "q_add_Wm2"), "unknown column `q_add_Wm2`; did you mean `q_add_W_m2`?"),
    "column twice": (swap("axial_accel_g", "mach"), "column `mach` is repeated; remove one"),
    "column without a name": (swap("axial_accel_g", ""), "column 18 has no name"),
    "NaN": (cell(5, "mach", "nan"), "row 5, column mach: nan is not a finite number"),
    "infinite": (cell(5, "mach", "1e999"), "row 5, column mach: 1e999 is not a finite number"),
    "empty cell": (cell(5, "alpha_deg", ""), "row 5, column alpha_deg: the cell is empty; give a number"),
    "NaN in a further column": (cell(6, "axial_accel_g", "NaN"), "row 6, column axial_accel_g: NaN is not a finite number"),
    "text": (cell(7, "beta_deg", "O.1"), 'row 7, column beta_deg: "O.1" is not a number'),
    "decimal comma": (cell(7, "beta_deg", "0,1"), "row 7: 19 cells for 18 columns; the row is damaged or cut off"),
    "short row": (rows(lambda r: [*r[:-1], r[-1][:40]]), "row 23: 7 cells for 18 columns; the row is damaged or cut off"),
    "blank row": (rows(lambda r: [*r[:9], "", *r[9:]]), "row 10: the row is blank; remove it"),
    "time back": (cell(9, "time_s", "55"), "row 9, column time_s: 55 does not come after 60; sort the rows by time_s"),
    "time twice": (cell(9, "time_s", "60"), "row 9, column time_s: 60 does not come after 60"),
    "T_inf in Celsius": (column("T_inf_K", celsius), "row 2, column T_inf_K: -68.15 is below 100 K and looks like Celsius"),
    "T_inf in counts": (swap("T_inf_K", "T_inf (counts)"), "needs the unit of `T_inf (counts)`; write `T_inf (counts) (UNIT)`"),
    "velocity in ft/s": (column("velocity_m_s", lambda v: f"{float(v) / 0.3048:.0f}"), "row 2, column velocity_m_s: 22310 is not a speed in m/s"),
    "time in us": (column("time_s", lambda v: f"{float(v) * 1e6:.0f}"), "row 3, column time_s: 1e+07 is more than 1e+06 s after the first row and looks like ms or us; give s (and 20 more rows)"),
    "altitude in km": (column("altitude_m", lambda v: f"{float(v) / 1000}"), "row 2, column altitude_m: 75 is too low for its speed and looks like km"),
    "H_r in kJ/kg": (column("H_r_J_kg", lambda v: f"{float(v) / 1000}"), "row 2, column H_r_J_kg: 23325.9 is below a hundredth of V^2/2 and looks like kJ/kg"),
    "Re for its logarithm": (column("log10_re", lambda v: f"{10 ** float(v):.0f}"), "column log10_re: 637236 is not the base-10 logarithm of a Reynolds number"),
    "negative density": (cell(3, "rho_kg_m3", "-4e-5"), "row 3, column rho_kg_m3: -4e-05 is not a density"),
    "negative film": (cell(3, "h_ref_kg_m2_s", "-0.02"), "row 3, column h_ref_kg_m2_s: -0.02 is not a film coefficient"),
    "jets above one": (cell(3, "jets", "2"), "row 3, column jets: 2 is not a share of jets firing (0 to 1)"),
    "semicolons": (lambda t: t.replace(",", ";"), "cells are separated by ';'; separate them by commas"),
    "names only": (rows(lambda r: r[:1]), "there are no rows below the column names"),
    "no names": (rows(lambda r: r[1:]), "the row of column names is missing"),
    "comments only": (lambda _: "# source: none\n", "the row of column names is missing"),
}  # fmt: skip


@pytest.mark.parametrize("case", CONDITIONS)
def test_damaged_conditions_are_answered_with_row_column_and_value(tile: Path, case: str) -> None:
    damage, expected = CONDITIONS[case]
    assert expected in problem(tile, "conditions.csv", damage)


THERMOCOUPLES = {
    "sensor without a column": (swap("TEST_bond_K", "TST_bond_K"), "there is no column `TEST_bond_K`; nearest in the file: `TST_bond_K`"),
    "no time": (without("time_s"), "there is no column `time_s`"),
    "empty time": (cell(4, "time_s", ""), "row 4, column time_s: the cell is empty"),
    "NaN for a lost sample": (cell(4, "TEST_bond_K", "NaN"), "row 4, column TEST_bond_K: NaN is not a finite number; leave the cell of a lost sample empty"),
    "text": (cell(4, "TEST_bond_K", "LOST"), 'row 4, column TEST_bond_K: "LOST" is not a number; leave the cell of a lost sample empty'),
    "a row of units": (rows(lambda r: [r[0], ",".join(["s", *["degF"] * r[0].count(",")]), *r[1:]]), 'row 2: "s", "degF", "degF" are no numbers; units are those that the names end in: convert to them and remove the row; or let `sim-heating new record --csv` convert'),
    "column of another name": (lambda t: t.replace("TEST_surface_K", "mine"), "there is no column `TEST_surface_K`; the file has `mine`: change one of the names"),
    "Celsius": (column("TEST_bond_K", celsius), "row 2, column TEST_bond_K: 17.85 is below 100 K and looks like Celsius; give K (Celsius + 273.15) (and 19 more rows)"),
    "beyond the recorder": (cell(4, "TEST_surface_K", "1700"), "row 4, column TEST_surface_K: 1700 is outside range_K = [255, 1644] of sensor surface"),
    "warm Celsius below the recorder": (cell(4, "TEST_surface_K", "221.5"), "row 4, column TEST_surface_K: 221.5 is outside range_K"),
    "time back": (rows(lambda r: [r[0], *reversed(r[1:])]), "row 3, column time_s: 190.5 does not come after 200.5"),
    "no sample of a used sensor": (column("TEST_surface_K", lambda _: ""), "column TEST_surface_K: sensor surface has no sample; set used = false"),
    "another clock": (column("time_s", lambda t: f"{float(t) + 1e6}"), "column time_s: no sample lies in the 0 to 210 s of the conditions"),
}  # fmt: skip


@pytest.mark.parametrize("case", THERMOCOUPLES)
def test_damaged_measurements_are_answered_with_row_column_and_value(tile: Path, case: str) -> None:
    damage, expected = THERMOCOUPLES[case]
    assert expected in problem(tile, "thermocouples.csv", damage)


@pytest.mark.parametrize("file", ["record.toml", "conditions.csv", "thermocouples.csv", "ratio_table.csv"])
@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "the file is empty"),
        (b" \n\n", "the file is empty"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "is a binary file (byte 8 is 0)"),
        (b"# 20 \xb0C\n", "line 1: byte 0xb0 is not UTF-8 text; save the file as UTF-8"),
        (None, "there is no such file"),
    ],
    ids=["empty", "blank", "binary", "latin-1", "missing"],
)
def test_a_file_without_text_is_named(tile: Path, file: str, content: bytes | None, expected: str) -> None:
    (tile / file).unlink() if content is None else (tile / file).write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_record(tile)
    assert file in caught.value.problems[0]
    assert expected in caught.value.problems[0]


def test_a_missing_file_is_answered_with_the_most_similar_one(tile: Path) -> None:
    (tile / "conditions.csv").rename(tile / "condition.csv")
    with pytest.raises(InputError, match=r"conditions\.csv: there is no such file; did you mean `condition\.csv`\?"):
        load_record(tile)


def test_all_problems_of_a_file_are_reported_at_once(tile: Path) -> None:
    text = (tile / "record.toml").read_text()
    text = text.replace("thickness_m = 0.041", "thickness_m = -1.0").replace("bits = 8", "bit = 8")
    (tile / "record.toml").write_text(text.replace("[segments]", "[segmets]"))
    with pytest.raises(InputError) as caught:
        load_record(tile)
    assert len(caught.value.problems) == 3
    assert all("\n" not in p and "record.toml" in p for p in caught.value.problems)


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({"mach": ["M"]}, '[columns]: `mach`: ["M"] is not a text in quotes, a number or a table'),
        ({"mach": float("nan")}, "[columns]: `mach`: NaN is not a finite number"),
        ({"mach": {"variable": "M", "unit": 5}}, "[columns.mach]: `unit`: 5 is not a text in quotes"),
        ({"mach": {"variable": "M", "units": "1"}}, "[columns.mach]: unknown key `units`; did you mean `unit`?"),
        ({"mach": {"unit": "1"}}, "[columns.mach]: key `variable` is missing"),
    ],
)
def test_a_value_of_none_of_several_types_is_reported_once(columns: dict[str, object], expected: str) -> None:
    with pytest.raises(InputError) as caught:
        check({"columns": columns}, FmuSource, "fmu.toml")
    assert caught.value.problems == (f"fmu.toml, {expected}",)


def test_a_dotted_name_without_quotes_is_answered_with_quotes() -> None:
    with pytest.raises(InputError) as caught:
        check({"start": {"body": {"mass": 3.0}}}, FmuSource, "fmu.toml")
    expected = 'write a name with dots in quotes, "body.mass" = ...'
    assert caught.value.problems == (f"fmu.toml, [start]: {expected}",)


def test_a_line_break_in_a_name_stays_inside_the_line(tile: Path) -> None:
    assert "unknown key `mea\\nsured`" in problem(
        tile, "record.toml", swap("measured = false", '"mea\\nsured" = false')
    )


def test_a_ratio_table_over_another_reference_is_refused(tile: Path) -> None:
    expected = "header `reference`: is over `sutton-graves`, the record's heating.reference is `detra-kemp-riddell`"
    damage = swap('reference = "columns"', 'reference = "detra-kemp-riddell"')
    line = problem(tile, "record.toml", damage, named="ratio_table.csv")
    assert expected in line


def test_a_record_may_name_the_reference_of_its_table(tile: Path) -> None:
    change(tile / "record.toml", swap('reference = "columns"', 'reference = "sutton-graves"'))
    change(tile / "conditions.csv", without("H_r_J_kg"))
    assert load_record(tile).declared.heating.reference == "sutton-graves"


def change(path: Path, damage: Damage) -> None:
    path.write_text(damage(path.read_text()))


def problem(tile: Path, file: str, damage: Damage, named: str | None = None) -> str:
    """The first line that a record with one damaged file is answered with."""
    change(tile / file, damage)
    with pytest.raises(InputError) as caught:
        load_record(tile)
    line = caught.value.problems[0]
    assert "\n" not in line
    assert (named or file) in line
    return line


# What `validate` says of a path --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "kind"),
    [("", "record"), ("record.toml", "record"), ("conditions.csv", "record"), ("ratio_table.csv", "ratio table")],
)
def test_the_kind_of_a_path_is_recognised_from_its_contents(path: str, kind: str) -> None:
    found = check_path(TILE / path)
    assert found.kind == kind
    assert "\n" not in found.summary


def test_a_material_file_is_recognised(tmp_path: Path) -> None:
    (tmp_path / "rtv.toml").write_text(
        "density_kg_m3 = 1410.0\nspecific_heat_J_kgK = [[255.0, 1170]]\nconductivity_W_mK = [[255.0, 0.31]]\n"
    )
    assert check_path(tmp_path / "rtv.toml").kind == "material"


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.toml", "title = 'x'\n", 'key `format` is missing; a scenario begins with format = "scenario/1"'),
        ("a.toml", "format = 'scenario/2'\n", "did you mean `scenario/1`?"),
        ("a.csv", "x,y\n1,2\n", "is not a record, vehicle, scenario or ratio table"),
        ("a.json", "{}", "is not a record, vehicle, scenario or ratio table"),
        ("a.csv", "alpha_deg,ratio\n1,2\n", "there is no column `beta_deg`"),
    ],
)
def test_a_path_of_unknown_kind_is_answered_with_the_known_kinds(
    tmp_path: Path, name: str, content: str, expected: str
) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError) as caught:
        check_path(tmp_path / name)
    assert expected in caught.value.problems[0]


def test_a_directory_of_unknown_kind_is_reported_with_its_contents(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"neither a record \(record\.toml\) nor a vehicle .*; it is empty"):
        check_path(tmp_path)
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(InputError, match=r"it holds notes\.txt"):
        check_path(tmp_path)


def test_a_folder_of_records_is_answered_with_the_names_of_records(tile: Path) -> None:
    for name in ("other", "third"):
        shutil.copytree(tile, tile.parent / name)
    with pytest.raises(
        InputError, match=r"is a folder of records, not a record; name the records, such as .*other"
    ) as e:
        load_record(tile.parent)
    assert len(e.value.problems) == 1


def test_a_missing_path_is_answered_with_the_most_similar_one(tile: Path) -> None:
    with pytest.raises(InputError, match=r"tyle: there is no such file; did you mean `tile`\?"):
        check_path(tile.parent / "tyle")


def test_problems_of_a_construction_carry_the_name_of_its_source(tile: Path) -> None:
    declared = load_record(tile).declared
    materials = {name: m for name, m in declared.materials.items() if name != "al2024"}
    with pytest.raises(InputError, match=r"NOSE\.toml, \[stack\.layer\] 3: `material`: unknown material `al2024`"):
        construct(declared.stack, materials, "NOSE.toml")


# Any damage at all ---------------------------------------------------------------------------------------------------

SNIPPETS = st.sampled_from(
    ["", "\0", "nan", "-1", "0", "1e400", "9" * 5000, "[[", "]]", "[a]\n", '"', "'''", ",", ",,", "\n", "#", "=", "{}",
     "true", "1979-05-27", "[" * 3000, "\\u0000", "\x7f", "\ufeff", "time_s", "\r", "1_000", "-0.0", "é", "'\n"]
)  # fmt: skip


@pytest.mark.thorough
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@pytest.mark.filterwarnings("ignore::UserWarning")  # names in letters of another encoding are reported, and read
@given(data=st.data())
def test_no_damage_gives_anything_but_a_record_or_an_input_error(tmp_path: Path, data: st.DataObject) -> None:
    folder = tmp_path / "record"
    shutil.copytree(TILE, folder, dirs_exist_ok=True)
    for file in data.draw(
        st.lists(st.sampled_from(sorted(p.name for p in TILE.iterdir())), min_size=1, max_size=2, unique=True)
    ):
        text = (TILE / file).read_text()
        start = data.draw(st.integers(0, len(text)))
        end = start + data.draw(st.integers(0, 40))
        new = data.draw(st.one_of(SNIPPETS, st.text(max_size=8)))
        (folder / file).write_bytes((text[:start] + new + text[end:]).encode("utf-8", "surrogatepass"))
    answered_or_read(folder)


@pytest.mark.thorough
@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_value_at_any_key_is_taken_or_refused_with_an_input_error(tmp_path: Path, data: st.DataObject) -> None:
    folder = tmp_path / "record"
    shutil.copytree(TILE, folder, dirs_exist_ok=True)
    lines = (TILE / "record.toml").read_text().splitlines()
    keys = [i for i, line in enumerate(lines) if " = " in line]
    i = data.draw(st.sampled_from(keys))
    scalar = st.one_of(st.floats(), st.integers(), st.booleans(), st.text(st.characters(codec="utf-8"), max_size=5))
    value = data.draw(st.recursive(scalar, lambda v: st.lists(v, max_size=3), max_leaves=6))
    lines[i] = lines[i].split(" = ")[0] + " = " + toml_literal(value)
    (folder / "record.toml").write_text("\n".join(lines), encoding="utf-8")
    answered_or_read(folder)


def toml_literal(value: object) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(toml_literal(v) for v in value) + "]"
    if isinstance(value, float) and value != value:
        return "nan"
    return toml_text({"k": value}).removeprefix("k = ").strip() if abs_finite(value) else str(value)


def abs_finite(value: object) -> bool:
    return not isinstance(value, float) or abs(value) < float("inf")


def answered_or_read(folder: Path) -> None:
    try:
        problems = ("read",) if load_record(folder).conditions.time_s.size else ()
    except InputError as error:
        problems = error.problems
    assert problems
    assert all(p.strip() and len(p.splitlines()) == 1 for p in problems)
