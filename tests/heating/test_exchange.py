"""Ratio tables and models from and to other programs: DAVE-ML, netCDF, body points of flow solvers."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.cli import main
from sim_heating.heating.atmosphere import standard_speed_of_sound, us76
from sim_heating.heating.exchange.body_points import tables_of_body_points
from sim_heating.heating.exchange.dave_ml import dave_ml_text, read_dave_ml, write_dave_ml
from sim_heating.heating.exchange.ratio_formats import FORMATS, read_table, write_table
from sim_heating.heating.reference.gas import wall_enthalpy_grid
from sim_heating.heating.reference.models import reference_heating
from tests.support.paths import ROOT

SHIPPED = ROOT / "aircraft_data" / "orbiter" / "ratio_tables" / "BODYFLAP.csv"
MODEL = """<?xml version="1.0"?>
<!DOCTYPE DAVEfunc PUBLIC "-//AIAA//DTD for Flight Dynamic Models - Functions 2.0//EN"
  "http://www.daveml.org/DTDs/2p0/DAVEfunc.dtd">
<DAVEfunc xmlns="http://daveml.org/2010/DAVEML">
 <fileHeader name="glider"><author name="a" org="b"/><creationDate date="2026-01-01"/></fileHeader>
 <variableDef name="angleOfAttack" varID="alpha" units="deg" minValue="-5"><isInput/></variableDef>
 <variableDef name="mach" varID="M" units="nd"><isInput/></variableDef>
 <variableDef name="referenceArea" varID="S" units="m2" initialValue="2.5"/>
 <variableDef name="CN0" varID="cn0" units="nd"/>
 <variableDef name="CA0" varID="ca0" units="nd"/>
 <variableDef name="lift" varID="lift" units="m2"><calculation>
  <math xmlns="http://www.w3.org/1998/Math/MathML"><apply><times/><ci>S</ci><apply><minus/>
   <apply><times/><ci>cn0</ci><apply><cos/><apply><times/><ci>alpha</ci><cn>0.0174532925</cn></apply></apply></apply>
   <piecewise><piece><ci>ca0</ci><apply><gt/><ci>M</ci><cn>1.0</cn></apply></piece><otherwise><cn>0.1</cn></otherwise>
   </piecewise></apply></apply></math></calculation><isOutput/></variableDef>
 <breakpointDef name="A" bpID="A"><bpVals>0, 10, 20</bpVals></breakpointDef>
 <breakpointDef name="B" bpID="B"><bpVals>0.5 2.0</bpVals></breakpointDef>
 <griddedTableDef name="CN" gtID="CN"><breakpointRefs><bpRef bpID="A"/><bpRef bpID="B"/></breakpointRefs>
  <dataTable>0,0, .5,.4, .9,.7</dataTable></griddedTableDef>
 <function name="normal force"><independentVarRef varID="alpha" min="0" max="20" extrapolate="neither"/>
  <independentVarRef varID="M" extrapolate="both"/><dependentVarRef varID="cn0"/>
  <functionDefn name="d"><griddedTableRef gtID="CN"/></functionDefn></function>
 <function name="axial force"><independentVarRef varID="alpha"/><independentVarRef varID="M"/>
  <dependentVarRef varID="ca0"/><functionDefn name="e"><ungriddedTableDef name="CA">
  <dataPoint>0 0 0.1</dataPoint><dataPoint>20 0 0.3</dataPoint><dataPoint>0 4 0.2</dataPoint>
  <dataPoint>20 4 0.4</dataPoint></ungriddedTableDef></functionDefn></function>
 <checkData><staticShot name="between nodes">
  <checkInputs><signal><signalName>angleOfAttack</signalName><signalValue>5</signalValue></signal>
   <signal><varID>M</varID><signalValue>1.25</signalValue></signal></checkInputs>
  <checkOutputs><signal><signalName>lift</signalName><signalValue>{lift}</signalValue><tol>1e-9</tol></signal>
  </checkOutputs></staticShot></checkData>
</DAVEfunc>
"""
LIFT = 2.5 * (0.225 * np.cos(5.0 * 0.0174532925) - (0.1 + 0.2 * 5.0 / 20.0 + 0.1 * 1.25 / 4.0))


@pytest.fixture
def model_file(tmp_path, monkeypatch) -> Path:
    """A small model of an aircraft: a gridded and an ungridded table, a calculation, a check case."""
    monkeypatch.chdir(tmp_path)
    Path("glider.dml").write_text(MODEL.replace("{lift}", repr(float(LIFT))))
    return Path("glider.dml")


def test_a_model_meets_its_check_data(model_file):
    model = read_dave_ml(model_file)
    assert len(model.cases) == 1
    assert model.check_problems() == []


def test_check_data_that_a_model_misses_are_told_with_their_case(model_file):
    model_file.write_text(MODEL.replace("{lift}", "0.5"))
    assert read_dave_ml(model_file).check_problems()[0].startswith("check case `between nodes`: `lift` is 0.107")


def test_a_model_comes_back_from_its_file_to_1e_9(model_file):
    model = read_dave_ml(model_file)
    write_dave_ml("again.dml", model)
    again = read_dave_ml("again.dml")
    rng = np.random.default_rng(2)
    x = {"alpha": rng.uniform(-10.0, 30.0, 500), "M": rng.uniform(0.0, 5.0, 500)}
    before, after = model.evaluate(x), again.evaluate(x)
    assert max(float(np.max(np.abs(before[i] - after[i]))) for i in before) <= 1e-9
    assert dave_ml_text(again) == dave_ml_text(model)


def test_an_input_with_an_initial_value_stays_an_input(model_file):
    """Such as those of NASA's F-16_prop.dml: an initial value stands in for an input that is not given."""
    text = MODEL.replace('minValue="-5"', 'minValue="-5" initialValue="5"').replace("{lift}", repr(float(LIFT)))
    model_file.write_text(text)
    model = read_dave_ml(model_file)
    assert model.inputs == ("alpha", "M")
    assert repr(model) == "<DaveModel 'glider': 2 inputs, 1 outputs, 1 check cases>"
    assert float(model.evaluate({"M": 1.25})["lift"]) == pytest.approx(LIFT)
    with pytest.raises(InputError, match="`aplha` is no variable of the model; did you mean `alpha`"):
        model.evaluate({"M": 1.25, "aplha": 5.0})


def test_a_ratio_over_inputs_with_initial_values_keeps_all_its_nodes(tmp_path):
    table = read_table(SHIPPED)
    write_table(tmp_path / "table.dml", table)
    text = (tmp_path / "table.dml").read_text()
    changed = text.replace('name="angleOfAttack"', 'name="angleOfAttack" initialValue="40"', 1)
    assert changed != text
    (tmp_path / "table.dml").write_text(changed)
    again = read_table(tmp_path / "table.dml")
    assert np.array_equal(again.axes[0], table.axes[0])
    assert np.max(np.abs(again.ratio - table.ratio)) <= 1e-9


@pytest.mark.skipif("DAVE_ML_MODELS" not in os.environ, reason="DAVE_ML_MODELS names a folder of public models")
def test_public_models_meet_their_check_data_and_come_back(tmp_path):
    """Such as the F-16 of NASA's simupy-flight: F16_aero.dml, F16_prop.dml."""
    rng = np.random.default_rng(0)
    for path in sorted(Path(os.environ["DAVE_ML_MODELS"]).glob("*.dml")):
        if "(2/5)" in path.read_text():  # one of them has `(2/5)\u03c0` for a number
            with pytest.raises(InputError, match=r"variableDef `XIXX`, initialValue: .* is not a number"):
                read_dave_ml(path)
            continue
        model = read_dave_ml(path)
        assert model.check_problems() == []
        write_dave_ml(tmp_path / path.name, model)
        x = {i: rng.uniform(-40.0, 60.0, 500) for i in model.inputs}
        before, after = model.evaluate(x), read_dave_ml(tmp_path / path.name).evaluate(x)
        assert all(np.allclose(before[i], after[i], rtol=1e-9, atol=1e-9, equal_nan=True) for i in before), path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<ci>cn0</ci>", "<ci>cn1</ci>", "variable `lift`: reads `cn1`, which is not defined; did you mean `cn0`?"),
        ("<times/><ci>S", "<tims/><ci>S", "variableDef `lift`: operator <tims> of MathML is not known"),
        (".9,.7<", ".9<", "griddedTableDef `CN`: 5 values, and its breakpoints make 6"),
        ("0, 10, 20", "0, 20, 10", "breakpointDef `A`: must increase"),
        ('"2.5"', '"2.5 m"', "variableDef `S`, initialValue: `2.5 m` is not a number"),
        ('gtID="CN"/>', 'gtID="CM"/>', "function `normal force`: table `CM` is not defined"),
        ('extrapolate="both"', 'interpolate="cubicSpline"', "variable `M`: `cubicSpline` is not read here"),
        ("<ci>S</ci>", "<ci>lift</ci>", "variables need each other in a circle: "),
        ('2p0/DAVEfunc.dtd">', '2p0/DAVEfunc.dtd" [<!ENTITY a "b">]>', r"line \d: a document type"),
        ("</DAVEfunc>", "", "line .*: is not XML"),
    ],
)
def test_a_damaged_model_is_refused_with_file_and_element(model_file, old, new, message):
    assert old in MODEL
    model_file.write_text(MODEL.replace("{lift}", "1").replace(old, new, 1))
    with pytest.raises(InputError, match=rf"^glider\.dml: .*{message}"):
        read_dave_ml(model_file)


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_ratio_table_comes_back_from_every_format_as_it_was(tmp_path, suffix):
    table = read_table(SHIPPED)
    write_table(tmp_path / f"table{suffix}", table)
    again = read_table(tmp_path / f"table{suffix}")
    assert all(np.array_equal(a, b) for a, b in zip(again.axes, table.axes, strict=True))
    assert np.max(np.abs(again.ratio - table.ratio)) <= 1e-9
    assert np.max(np.abs(again.sigma - table.sigma)) <= 1e-9
    assert dict(again.header) == dict(table.header)


def test_a_user_takes_a_shipped_table_to_dave_ml_and_back(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["table", "orbiter/BODYFLAP", "--out", "flap.dml"]) == 0
    assert main(["table", "flap.dml", "--out", "flap.csv"]) == 0
    assert np.array_equal(read_table("flap.csv").ratio, read_table(SHIPPED).ratio)
    assert read_dave_ml("flap.dml").check_problems() == []
    assert main(["table", "flap.dml", "--out", "flap.csv"]) == 2
    assert "flap.csv: exists; choose another name, or --force replaces it" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["flap.mat"], "flap.mat: `.mat` is no format of ratio tables; there are .csv"),
        (["glider.dml"], "glider.dml: no output named `heatingRatio` or `ratio` (outputs: lift)"),
        (["broken.nc"], "broken.nc: is no netCDF file that can be read"),
        ([str(SHIPPED), "--out", "a.xml"], "a system of JSBSim needs the wall of a point; give VEHICLE/POINT"),
    ],
)
def test_what_is_no_ratio_table_is_refused_in_one_line(model_file, capsys, arguments, message):
    Path("broken.nc").write_bytes(b"CDF\x01 and no more")
    assert main(["table", *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line


HEAD = "x_m,y_m,z_m,alpha_deg,"
WIND = ((20.0, 5.0), (20.0, 6.0), (40.0, 5.0), (40.0, 6.0))


def body_file(path: Path, head: str, row) -> Path:
    """Two body points in four cases; the second point is 3 m behind the first."""
    lines = [f"{x},0.0,0.0,{a},{row(x, a, r)}" for a, r in WIND for x in (1.0, 4.0)]
    path.write_text("\n".join([HEAD + head, *lines]) + "\n")
    return path


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("log10_re,film_kg_m2_s,h_ref_kg_m2_s", lambda x, a, r: f"{r},{0.04 * 0.01 * a / x},0.04"),
        ("re,q_W_m2,q_ref_W_m2", lambda x, a, r: f"{10**r},{2e5 * 0.01 * a / x},2e5"),
    ],
)
def test_body_points_become_tables_of_the_nearest_control_points(tmp_path, head, row):
    file = body_file(tmp_path / "cfd.csv", head, row)
    made = tables_of_body_points(file, {"A": (1.1, 0.0, 0.0), "B": (4.0, 0.1, 0.0), "C": (9.0, 0.0, 0.0)}, 10.0)
    assert list(made) == ["A", "B"]
    assert np.allclose(made["A"].ratio[:, 0, :, 0, 0], [[0.2, 0.2], [0.4, 0.4]])
    assert np.allclose(made["B"].ratio[:, 0, :, 0, 0], [[0.05, 0.05], [0.1, 0.1]])
    assert made["A"].axes[2].tolist() == [5.0, 6.0]


def test_mach_with_altitude_gives_the_reynolds_number(tmp_path):
    lines = [f"1.0,0.0,0.0,{a},{M},60e3,0.01,0.04" for a in (20, 40) for M in (15, 20)]
    file = tmp_path / "cfd.csv"
    file.write_text("\n".join([HEAD + "mach,altitude_m,film_kg_m2_s,h_ref_kg_m2_s", *lines]) + "\n")
    log_re = tables_of_body_points(file, {"A": (1.0, 0.0, 0.0)}, 32.8)["A"].axes[2]
    assert log_re[1] - log_re[0] == pytest.approx(np.log10(20.0 / 15.0), abs=1e-5)


@pytest.mark.parametrize(
    ("head", "units"),
    [
        ("x_m,y_m,z_m,alpha_deg,mach,altitude_m,film_kg_m2_s", (1.0, 1.0, 1.0)),
        ("X [in],Y [in],Z [in],Alpha (rad),Mach,Altitude [kft],T_wall [degF],q (W/cm^2)", (0.0254, 304.8, 1e4)),
        ("x_ft,y_ft,z_ft,alpha_deg,mach,altitude_km,wall_K,q_btu_ft2_s", (0.3048, 1e3, 11356.53)),
    ],
)
def test_a_solvers_heating_in_its_units_is_over_a_computed_sphere(tmp_path, head, units):
    """Ratio 0.3 everywhere: the file has film coefficient or flux of the point alone, of a wall of 900 K.

    units : of length [m], altitude [m] and heating in the file
    """
    length, height, flux = units
    H_w = float(wall_enthalpy_grid("equilibrium-air", [900.0], [2e3])[0, 0])
    lines = []
    for alpha in (20.0, 40.0):
        for mach, z in ((12.0, 50e3), (20.0, 65e3)):
            T, _, rho = us76([z])
            flown = Conditions(
                {
                    "time_s": np.zeros(1),
                    "velocity_m_s": mach * standard_speed_of_sound(np.array([z])),
                    "T_inf_K": T,
                    "rho_kg_m3": rho,
                }
            )
            h, H_r, _ = reference_heating("sutton-graves", flown, nose_radius_m=2.0)
            wall = ["1160.33"] if "degF" in head else ["900"] if "wall_K" in head else []
            angle = np.radians(alpha) if "rad" in head else alpha
            heating = 0.3 * h[0] * ((H_r[0] - H_w) / flux if wall else 1.0)
            row = [1.0 / length, 0.0, 0.0, angle, mach, z / height, *wall, heating]
            lines.append(",".join(map(str, row)))
    (tmp_path / "cfd.csv").write_text("\n".join([head, *lines]) + "\n")
    file, at = tmp_path / "cfd.csv", {"A": (1.0, 0.0, 0.0)}
    table = tables_of_body_points(file, at, 10.0, reference="sutton-graves", nose_radius_m=2.0)["A"]
    assert table.axes[0] == pytest.approx([20.0, 40.0])
    assert table.ratio == pytest.approx(0.3, rel=1e-5)


@pytest.mark.parametrize(
    ("head", "message"),
    [
        ("x [kg],y_m,z_m,alpha_deg", "column `x .kg.`: `kg` is no unit of m; write `x_m`, or its unit in brackets"),
        ("x,y_m,z_m,alpha_deg", "column `x`: states no unit; write `x_m`"),
        ("x_m,y_m,z_m", "there is no column `alpha_deg`"),
    ],
)
def test_a_head_without_a_unit_that_fits_is_refused(tmp_path, head, message):
    (tmp_path / "cfd.csv").write_text(f"{head}\n1,0,0,20\n")
    with pytest.raises(InputError, match=rf"cfd\.csv.*{message}"):
        tables_of_body_points(tmp_path / "cfd.csv", {"A": (1.0, 0.0, 0.0)}, 10.0)


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ("-1,150,900,3", "column `Mach` (read as mach): -1 is not above 0"),
        ("12,150,hot,3", 'column `T_wall [degF]` (read as wall_K): "hot" is not a number'),
    ],
)
def test_a_row_that_cannot_be_used_is_named_by_the_users_head(tmp_path, cells, message):
    head = "X [in],Y [in],Z [in],Alpha (deg),Mach,Altitude [kft],T_wall [degF],q (W/cm^2)"
    (tmp_path / "cfd.csv").write_text(f"{head}\n1,0,0,20,{cells}\n")
    with pytest.raises(InputError, match=rf"cfd\.csv, row 2, {re.escape(message)}"):
        tables_of_body_points(
            tmp_path / "cfd.csv", {"A": (0.0, 0.0, 0.0)}, 10.0, reference="sutton-graves", nose_radius_m=2.0
        )


@pytest.mark.parametrize(
    ("head", "row", "message"),
    [
        ("log10_re,film_kg_m2_s", lambda x, a, r: f"{r},0.01", "lacks columns; give `film_kg_m2_s` with `h_ref_kg_m2"),
        (
            "film_kg_m2_s,h_ref_kg_m2_s",
            lambda x, a, r: "0.01,0.04",
            "lacks columns; give `log10_re`, or `re`, or `mach`",
        ),
        ("re,film_kg_m2_s,h_ref_kg_m2_s", lambda x, a, r: f"{10**r},0.01,0", "row 2, column h_ref_kg_m2_s: .*above 0"),
        ("re,film_kg_m2_s,h_ref_kg_m2_s", lambda x, a, r: f"{10**r},0.01,0.04", "the nearest is 96 m away"),
    ],
)
def test_body_points_that_cannot_be_used_are_refused(tmp_path, head, row, message):
    file = body_file(tmp_path / "cfd.csv", head, row)
    with pytest.raises(InputError, match=rf"cfd\.csv.*{message}"):
        tables_of_body_points(file, {"A": (100.0, 0.0, 0.0)}, 10.0)
