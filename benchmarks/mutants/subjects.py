"""The files that are damaged, and the commands that read them: small cases that take tenths of a second."""

from __future__ import annotations

import json
import os
import random
import shutil
import tempfile
from collections.abc import Callable, Sequence
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path

import jsbsim

from benchmarks.journals import message
from sim_heating.base.errors import InputError
from sim_heating.cli import main
from tests.support.small_fmus import COMPILER, glide_fmu, library

ROOT = Path(__file__).resolve().parents[2]
POINT = "V09T9527"
TILE = "STS96_480"
"""A control point of one sensor, as a measured history needs it."""
CAPSULE_POINTS = ("HOT_SKIN", "FACE")
OUT = "out"
"""Where a command writes, in the folder that it runs in; {out} in its arguments."""

Command = tuple[str, ...] | Callable[[Path], int]


@dataclass(frozen=True)
class Subject:
    """One format, by the files of it that are damaged and the commands that read them.

    format   : as the table of results names it
    inputs   : entries of the folder of whole files that the commands need
    damaged  : globs of the files that are damaged
    checks   : commands that only read
    computes : commands that compute and write
    may_change : globs of inputs that a command may change
    share    : of all mutants, relative to the others
    """

    format: str
    inputs: tuple[str, ...]
    damaged: tuple[str, ...]
    checks: tuple[Command, ...] = ()
    computes: tuple[Command, ...] = ()
    may_change: tuple[str, ...] = ()
    share: float = 1.0


INITIAL = """
[trajectory.initial]
altitude_m = 75000.0
velocity_m_s = 6800.0
gamma_deg = -0.1
heading_deg = 60.0
latitude_deg = 10.0
longitude_deg = -120.0
[trajectory.stop]
time_s = {seconds}
mach = 2.5
"""
HEAD = """format = "scenario/1"
title = "A short flight"
vehicle = "{vehicle}"
note = "small"
control_points = ["{point}"]
"""
GLIDE = (
    HEAD
    + """
[trajectory]
source = "entry-3dof"
sample_s = 1.0
[trajectory.vehicle]
mass_kg = 87000.0
cg_fraction = 0.667
[trajectory.guidance]
alpha_deg = [[8.0, 30.0], [20.0, 40.0]]
bank_limits_deg = [0.0, 100.0]
[trajectory.dispersions]
density_factor = [[0.0, 1.0], [50000.0, 0.95], [75000.0, 1.1]]
wind_east_m_s = [[0.0, 5.0], [50000.0, 60.0], [90000.0, 0.0]]
"""
    + INITIAL
    + """
[[trajectory.manoeuvre]]
kind = "popu"
at_time_s = 20.0
down_deg = 5.0
up_deg = 5.0
rate_deg_s = 1.0
hold_s = 2.0
[[trajectory.manoeuvre]]
kind = "elevon-pulse"
at_velocity_m_s = 6780.0
amplitude_deg = 3.0
[measurements]
seed = 10
clock_skew_s = 0.4
lost_fraction = 0.01
gaps_s = [[30.0, 33.0]]
[[compare]]
control_point = "{point}"
file = "measured.csv"
label = "measured"
until_s = 50.0
[truth]
parameters = {{ "ratio.scale" = 0.15, "ratio.d_alpha" = 0.0006 }}
[[truth.effect]]
name = "transition"
parameters = {{ log10_re_onset = 5.9, factor = 2.0 }}
"""
)
RECORDED = HEAD + '\n[trajectory]\nsource = "recorded"\nfile = "trajectory.csv"\n[measurements]\nseed = 12\n'
JSBSIM = HEAD + '\n[trajectory]\nsource = "jsbsim"\nrate_hz = 30.0\n' + INITIAL
FMU = (
    HEAD
    + """
[trajectory]
source = "fmu"
file = "glide.fmu"
rate_hz = 4.0
[trajectory.fmu.columns]
altitude_m = "h"
velocity_m_s = "speed"
alpha_deg = "alpha"
beta_deg = 0.0
elevon_deg = 1.0
bodyflap_deg = 10.0
[trajectory.fmu.start]
sink = 40.0
[trajectory.stop]
time_s = 20.0
"""
)
STUDY = """format = "study/1"
title = "A small study"
vehicle = "orbiter"
scenario = "glide.toml"
control_points = ["{point}"]
soak_s = 60.0
[[limit]]
control_point = "{point}"
surface_K = 1500.0
[dispersion]
flights = 16
scrambles = 2
seed = 3
index_flights = 8
quantiles = [0.5, 0.9]
[[dispersion.input]]
name = "entry.gamma_deg"
sigma = 0.02
[[dispersion.input]]
name = "air.density"
sigma = 1.0
over = [[0.0, 0.02], [50000.0, 0.05], [120000.0, 0.15]]
[[dispersion.input]]
name = "vehicle.cg_fraction"
low = -0.002
high = 0.002
[[dispersion.input]]
name = "stack.rsi.conductivity_factor"
sigma = 0.06
control_points = ["{point}"]
"""
ENVELOPE = ["axes.toml", "dispersion.toml", "optimal.toml"]
CAMPAIGN = """format = "campaign/1"
title = "A small campaign"
vehicle = "./orbiter"
control_points = ["{point}"]
close_loop = false
[fit]
parameters = ["ratio.scale"]
before_s = 20.0
after_s = 40.0
[[flight]]
scenario = "glide.toml"
seeds = [11, 12]
[[flight]]
records = "record"
check = true
"""
LINK = """format = "link/1"
vehicle = "./orbiter"
control_points = ["{point}"]
[time]
field = "TIME_MS"
unit = "ms"
[conditions]
altitude_m = {{ field = "ALTITUDE_FT", unit = "ft" }}
velocity_m_s = {{ constant = 7000.0 }}
rho_kg_m3 = {{ constant = 1e-5 }}
alpha_deg = {{ constant = 40.0 }}
beta_deg = {{ constant = 0.0 }}
elevon_deg = {{ constant = 0.0 }}
bodyflap_deg = {{ constant = 0.0 }}
[[sensor]]
sensor = "{point}"
field = "TC1"
calibration = [250.0, 0.02]
[[source]]
kind = "ccsds"
xtce = "packets.xml"
[estimate]
parameters = ["ratio.scale"]
[ahead]
scenario = "glide.toml"
horizon_s = 60.0
"""
LINES = """format = "link/1"
vehicle = "{vehicle}"
control_points = ["{point}"]
[[source]]
kind = "json-lines"
transport = "file"
file = "flight.jsonl"
[[sensor]]
sensor = "{point}"
field = "tc"
unit = "K"
[estimate]
parameters = ["ratio.scale"]
"""
MESSAGES = 40
FIT = """parameters = ["ratio.scale", "ratio.d_alpha", "clock.skew"]
reference = { alpha_deg = 40.0 }
start = "declared"
fit = [[10.0, 70.0], [80.0, 150.0]]
[fix]
ratio.d_beta = 0.0
[prior]
"clock.skew" = [0.0, 0.3]
[bound]
ratio.scale = [-0.5, 0.5]
"""
LAYOUT = """format = "logger-layout/1"
title = "rig 3"
separator = ","
decimal = "."
time = "Time"
time_unit = "s"
lost = [-9999.0]
[[column]]
name = "TC1"
unit = "degC"
depth = "back"
[[column]]
name = "TC2"
unit = "degC"
depth = "surface"
"""
BODY_POINTS = "x_m,y_m,z_m,alpha_deg,log10_re,film_kg_m2_s,h_ref_kg_m2_s\n"
TEMPERATURES = "Time (s),TC1 (degC),TC2 (degC)\n"
LAMP = "Time (s),Flux (kW/m2)\n"
NEW_RECORD: tuple[str, ...] = (
    "new", "record", "--csv", "temperatures.csv", "--layer", "copper 3 mm", "--depth", "TC1=back",
    "--depth", "TC2=surface", "--out", "{out}", "--lamp",
)  # fmt: skip

PLATE: tuple[str, ...] = (
    "new", "record", "--layer", "copper 3 mm", "--emissivity", "0.9", "--out", "{out}",
)  # fmt: skip
LOGGERS = {
    "benchlink.csv": ("Chan 101",),
    "hobo_am_pm.csv": ("Temp",),
    "toa5.dat": ("TC1_Avg", "TC2_Avg"),
    "labview.lvm": ("TC1", "TC2"),
    "excel97.xls": ("TC1",),
    "boxcar.txt": ("Temperature",),
    "long_format.csv": ("TC1", "TC2"),
    "unit_in_cells.csv": ("TC1",),
}
"""Files as loggers write them -> their temperatures."""
FLOWN: tuple[str, ...] = (
    *PLATE, "--csv", "descent.csv", "--depth", "TC1=back", "--reference", "sutton-graves", "--nose-radius", "0.3m",
    "--ratio", "1",
)  # fmt: skip
FLIGHTS = ("own_columns.csv", "own_columns_units_names.csv", "jsbsim_out.csv")
AIR = ("msis_profile.csv", "wyoming_sounding.txt")
"""Flights and soundings as tools write them."""

MODEL_FILES = ("orbiter/aero/*", "orbiter/guidance.toml")


def _run(name: str) -> Command:
    return ("run", name, "--out", "{out}")


def _validate(name: str) -> Command:
    return ("validate", name)


RECORD_COMMANDS: tuple[Command, ...] = (
    ("predict", "record", "--out", "{out}"),
    ("estimate", "record", "--out", "{out}", "--parameters", "ratio.scale,ratio.d_alpha"),
)
UPDATE: tuple[str, ...] = ("update-tables", "fit", "--vehicle", "orbiter", "--out", "{out}")
SUBJECTS = (
    Subject(
        "scenario",
        ("glide.toml", "orbiter"),
        ("glide.toml",),
        (_validate("glide.toml"),),
        (_run("glide.toml"), ("synthesize", "glide.toml", "--out", "{out}")),
        share=3.0,
    ),
    Subject(
        "scenario of an FMU",
        ("fmu.toml", "glide.fmu", "orbiter"),
        ("fmu.toml",),
        (_validate("fmu.toml"),),
        (_run("fmu.toml"),),
        share=0.5,
    ),
    Subject(
        "scenario of JSBSim",
        ("jsbsim.toml", "orbiter"),
        ("jsbsim.toml",),
        (_validate("jsbsim.toml"),),
        (_run("jsbsim.toml"),),
        share=0.5,
    ),
    Subject(
        "study",
        ("study.toml", "glide.toml", "orbiter", *ENVELOPE),
        ("study.toml",),
        (_validate("study.toml"),),
        (("plan", "study.toml", "--workers", "1", "--out", "{out}"),),
        share=1.5,
    ),
    *(
        Subject(
            "study, other kinds",
            ("study.toml", "glide.toml", "orbiter", name),
            (name,),
            (_validate(name),),
            share=0.4,
        )
        for name in ENVELOPE
    ),
    Subject(
        "vehicle",
        ("capsule", "capsule.toml"),
        ("capsule/vehicle.toml", "capsule/control_points/*", "capsule/materials/*", "capsule/control_points/*"),
        (_validate("capsule"),),
        (_run("capsule.toml"),),
        share=3.0,
    ),
    Subject(
        "ratio table",
        ("capsule", "capsule.toml"),
        ("capsule/ratio_tables/*",),
        (_validate("capsule"), _validate("capsule/ratio_tables/HOT_SKIN.csv")),
        (_run("capsule.toml"),),
    ),
    Subject(
        "ratio source",
        ("capsule",),
        ("capsule/ratio_sources/*",),
        (),
        (("ratio-tables", "capsule"),),
        ("capsule/ratio_tables/*",),
    ),
    Subject(
        "aerodynamics and guidance",
        ("orbiter", "glide.toml"),
        MODEL_FILES,
        (_validate("glide.toml"),),
        (_run("glide.toml"),),
        share=1.5,
    ),
    Subject(
        "record.toml",
        ("record",),
        ("record/record.toml",),
        (_validate("record"),),
        RECORD_COMMANDS,
        share=3.0,
    ),
    Subject(
        "conditions.csv, thermocouples.csv",
        ("record",),
        ("record/conditions.csv", "record/thermocouples.csv"),
        (_validate("record"),),
        RECORD_COMMANDS,
        share=2.0,
    ),
    Subject("ratio_table.csv", ("record",), ("record/ratio_table.csv",), (_validate("record"),), RECORD_COMMANDS),
    Subject(
        "trajectory CSV",
        ("recorded.toml", "trajectory.csv", "orbiter"),
        ("trajectory.csv",),
        (_validate("recorded.toml"),),
        (_run("recorded.toml"),),
        share=1.5,
    ),
    Subject(
        "measured history CSV",
        ("measured.toml", "orbiter"),
        ("orbiter/measured.csv",),
        (_validate("measured.toml"),),
        (_run("measured.toml"), ("measured-records", "measured.toml", "--out", "{out}")),
        share=0.5,
    ),
    Subject(
        "estimate.json",
        ("fit", "record", "orbiter"),
        ("fit/estimate.json",),
        (_validate("fit/estimate.json"),),
        (UPDATE, (*UPDATE[:-2], "--dry-run")),
        share=2.0,
    ),
    Subject(
        "closure.json",
        ("closed", "record", "orbiter"),
        ("closed/closure.json", "closed/estimate.json", "closed/residual_heating.csv"),
        (),
        (
            ("update-tables", "closed", "--vehicle", "orbiter", "--out", "{out}"),
            ("update-tables", "closed/closure.json", "--vehicle", "orbiter", "--dry-run"),
        ),
        share=0.5,
    ),
    Subject(
        "revision_N.json",
        ("revised", "later_fit", "later_record"),
        ("revised/orbiter/ratio_revisions/*/*.json", "revised/orbiter/ratio_revisions/*/*"),
        (_validate("revised/orbiter"),),
        (
            ("update-tables", "--revert", POINT, "--vehicle", "revised/orbiter"),
            ("update-tables", "later_fit", "--vehicle", "revised/orbiter", "--out", "{out}"),
            ("update-tables", "later_fit", "--vehicle", "revised/orbiter", "--dry-run"),
        ),
        ("revised/orbiter/*/*", "revised/orbiter/*/*/*"),
        share=1.5,
    ),
    Subject(
        "effect file",
        ("effects", "effect.toml", "orbiter"),
        ("effects/*.py",),
        (_validate("effect.toml"),),
        (),
        share=1.0,
    ),
    Subject(
        "attitude control of JSBSim",
        ("jsbsim.toml", "orbiter"),
        ("orbiter/jsbsim/attitude_control.xml",),
        (_validate("jsbsim.toml"),),
        (_run("jsbsim.toml"),),
        share=0.7,
    ),
    Subject(
        "link",
        ("link.toml", "packets.xml", "glide.toml", "orbiter"),
        ("link.toml",),
        (_validate("link.toml"),),
        share=1.5,
    ),
    Subject(
        "XTCE document",
        ("link.toml", "packets.xml", "glide.toml", "orbiter"),
        ("packets.xml",),
        (_validate("link.toml"),),
        share=1.5,
    ),
    Subject(
        "campaign",
        ("campaign.toml", "glide.toml", "record", "orbiter"),
        ("campaign.toml",),
        (_validate("campaign.toml"),),
        share=1.5,
    ),
    Subject(
        "temperatures of a logger, flux of a lamp",
        ("temperatures.csv", "lamp.csv"),
        ("temperatures.csv", "lamp.csv"),
        (),
        ((*NEW_RECORD, "lamp.csv"), (*NEW_RECORD, "unknown")),
        share=2.0,
    ),
    *(
        Subject(
            "file of a logger",
            (name,),
            (name,),
            (),
            ((*PLATE, "--csv", name, "--lamp", "unknown", *(x for c in columns for x in ("--depth", f"{c}=back"))),),
            share=0.3,
        )
        for name, columns in LOGGERS.items()
    ),
    Subject(
        "layout of a logger",
        ("layout.toml", "temperatures.csv"),
        ("layout.toml",),
        (_validate("layout.toml"),),
        ((*PLATE, "--csv", "temperatures.csv", "--lamp", "20kW/m2", "--layout", "layout.toml"),),
    ),
    *(
        Subject(
            "flight of a record",
            ("descent.csv", name, AIR[0]),
            (name,),
            (),
            ((*FLOWN, "--conditions", name), (*FLOWN, "--conditions", name, "--atmosphere", AIR[0])),
            share=0.4,
        )
        for name in FLIGHTS
    ),
    *(
        Subject(
            "air of the day",
            ("descent.csv", FLIGHTS[0], name),
            (name,),
            (),
            ((*FLOWN, "--conditions", FLIGHTS[0], "--atmosphere", name),),
            share=0.5,
        )
        for name in AIR
    ),
    Subject(
        "settings of a fit",
        ("fit.toml", "record"),
        ("fit.toml",),
        (_validate("fit.toml"),),
        (("estimate", "record", "--settings", "fit.toml", "--out", "{out}"),),
    ),
    Subject(
        "credibility.toml",
        ("reviewed",),
        ("reviewed/credibility.toml",),
        (_validate("reviewed"), _validate("reviewed/credibility.toml")),
        (("predict", "reviewed", "--out", "{out}"),),
        share=0.7,
    ),
    *(
        Subject(
            "table of another program",
            (name,),
            (name,),
            (),
            (("table", name, "--out", "made.csv"),),
            ("made.csv",),
            share=0.5,
        )
        for name in ("table.dml", "table.nc")
    ),
    Subject(
        "body points",
        ("bodies.csv", "capsule"),
        ("bodies.csv",),
        (),
        (("table", "bodies.csv", "--vehicle", "capsule", "--out", "{out}"),),
        share=0.7,
    ),
    Subject(
        "link and messages of a file",
        ("lines.toml", "flight.jsonl", "orbiter"),
        ("lines.toml", "flight.jsonl", "flight.jsonl"),
        (_validate("lines.toml"),),
        (("live", "lines.toml", "--headless", "--out", "{out}", "--quiet"),),
        share=1.5,
    ),
    Subject("aircraft of JSBSim", ("ball",), ("ball/ball.xml",), (), (lambda folder: fly_ball(folder),), share=1.0),
    Subject(
        "FMU",
        ("fmu.toml", "glide.fmu", "orbiter"),
        ("glide.fmu",),
        (_validate("fmu.toml"),),
        (_run("fmu.toml"), _run("fmu.toml")),
        share=2.0,
    ),
)


def fly_ball(folder: Path) -> int:
    """An aircraft of JSBSim in a host of the package, as a program that uses the package would fly it."""
    from sim_heating.base.errors import RunError
    from sim_heating.cli.console import ERRORS
    from sim_heating.trajectory.jsbsim.host import VEHICLE_READS, InitialState, JSBSimHost, PropertyRead

    absent = PropertyRead("simulation/dt", 0.0)
    reads = dict(VEHICLE_READS) | {"elevon_deg": absent, "bodyflap_deg": absent, "jets": absent}
    try:
        host = JSBSimHost(folder, "ball", reads=reads, rate_hz=50.0)
        host.start(InitialState(30000.0, 2000.0, -10.0, 90.0, 0.0))
        for _ in range(100):
            host.step()
            frame = host.read_frame()
    except InputError as error:
        ERRORS.print(f"error: {error}")
        return 2
    except RunError as error:
        ERRORS.print(f"failed: {error}")
        return 1
    (folder / OUT).mkdir()
    (folder / OUT / "frame.json").write_text(json.dumps(frame.tolist()))
    return 0


def make_inputs(home: Path, closed: bool = True) -> None:
    """Write the whole files into an empty folder; records, estimates, revisions come from the commands themselves.

    closed : with the results of close-loop, which take the longest
    """
    _vehicle(home, "orbiter", (POINT, TILE), ("aero", "jsbsim", "guidance.toml"))
    _vehicle(home, "capsule", CAPSULE_POINTS, ("ratio_sources", "aero", "guidance.toml"))
    measured = "".join(f"{t}.0,{290 + 8 * t}.5,4.6\n" for t in range(0, 60, 5))
    (home / "orbiter" / "measured.csv").write_text("time_s,temperature_K,sigma_K\n" + measured)
    texts = {
        "glide.toml": GLIDE.format(vehicle="./orbiter", point=POINT, seconds=60.0),
        "jsbsim.toml": JSBSIM.format(vehicle="./orbiter", point=POINT, seconds=3.0),
        "recorded.toml": RECORDED.format(vehicle="./orbiter", point=POINT),
        "fmu.toml": FMU.format(vehicle="./orbiter", point=POINT),
        "measured.toml": GLIDE.format(vehicle="./orbiter", point=TILE, seconds=60.0),
        "capsule.toml": HEAD.format(vehicle="./capsule", point="HOT_SKIN")
        + '\n[trajectory]\nsource = "entry-3dof"\n'
        + INITIAL.format(seconds=60.0),
        "effect.toml": GLIDE.format(vehicle="./orbiter", point=POINT, seconds=30.0)
        + '[[truth.effect]]\nname = "shock-passage"\nparameters = { rise = 0.25, mach_there = 13.0, width = 1.2 }\n',
        "study.toml": STUDY.format(point=POINT),
        "campaign.toml": CAMPAIGN.format(point=POINT),
        "link.toml": LINK.format(point=POINT),
        "packets.xml": (ROOT / "tests" / "live" / "data" / "entry.xml").read_text(),
        "temperatures.csv": TEMPERATURES + "".join(f"{t},{20 + t / 2},{20 + t / 4}\n" for t in range(0, 120, 4)),
        "lines.toml": LINES.format(vehicle="./orbiter", point=POINT),
        "flight.jsonl": "".join(f"{message(k).decode()}\n" for k in range(MESSAGES)),
        "fit.toml": FIT,
        "layout.toml": LAYOUT,
        "descent.csv": "Time (s),TC1 (K)\n" + "".join(f"{t},{300 + 0.5 * (t - 300)}\n" for t in range(300, 360)),
        "bodies.csv": BODY_POINTS
        + "".join(
            f"{x},0.0,{z},{a},{r},{0.0004 * a},0.04\n"
            for a in (20, 40)
            for r in (5, 6)
            for x, z in ((0.1, 0), (1.5, 1.2))
        ),
        "lamp.csv": LAMP + "".join(f"{t},{0 if t < 10 else 20}\n" for t in range(-4, 130, 2)),
    }
    for name, text in texts.items():
        (home / name).write_text(text)
    for name in ENVELOPE:
        text = (ROOT / "tests" / "data" / "small_inputs" / name).read_text()
        points = ('"V07T9730"', '"NOSECAP"', '"V09T9527"')
        for other in points[:2]:
            text = text.replace(other, points[2])
        text = text.replace(f"[{points[2]}, {points[2]}]", f"[{points[2]}]")
        (home / name).write_text(text)
    shutil.copytree(ROOT / "examples" / "effects", home / "effects", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "tests" / "data" / "records" / "tile", home / "tile")
    shutil.copytree(Path(jsbsim.get_default_root_dir()) / "aircraft" / "ball", home / "ball")
    for name in (*FLIGHTS, *AIR):
        shutil.copy(ROOT / "tests" / "data" / "flights" / name, home)
    for name in LOGGERS:
        shutil.copy(ROOT / "tests" / "data" / "loggers" / name, home)
    rows = (ROOT / "scenarios" / "data" / "sts107_early_entry.csv").read_text().splitlines(keepends=True)
    (home / "trajectory.csv").write_text("".join(rows[:35]))
    glide, later = home / "record.toml", home / "later.toml"
    whole, _, _ = texts["glide.toml"].replace("time_s = 60.0", "time_s = 160.0").partition("[[truth.effect]]")
    glide.write_text(whole)
    later.write_text(whole.replace("altitude_m = 75000.0", "altitude_m = 72000.0").replace("seed = 10", "seed = 11"))
    steps = [
        ("synthesize", "record.toml", "--out", "record"),
        ("estimate", "record", "--out", "fit", "--parameters", "ratio.scale,ratio.d_alpha"),
        ("synthesize", "later.toml", "--out", "later_record"),
        ("estimate", "later_record", "--out", "later_fit", "--parameters", "ratio.scale"),
        ("update-tables", "fit", "--vehicle", "orbiter", "--out", "revised"),
        ("table", f"orbiter/{POINT}", "--out", "table.dml"),
        ("table", f"orbiter/{POINT}", "--out", "table.nc"),
        ("close-loop", "record", "--out", "closed"),
    ]
    if not closed:
        del steps[-1]
    with chdir(home):
        for step in steps:
            if main(list(step)) != 0:
                raise RuntimeError(f"{' '.join(step)} failed")
        shutil.copytree("record", "reviewed")
        signed = (
            "--factor",
            "history",
            "--level",
            "2",
            "--person",
            "A. Engineer",
            "--statement",
            "Flown twice.",
        )
        if main(["credibility", "review", "reviewed", *signed]) != 0:
            raise RuntimeError("the review failed")
    glide.unlink()
    later.unlink()
    _fmu(home)


def _vehicle(home: Path, name: str, points: Sequence[str], more: Sequence[str]) -> None:
    """A vehicle of the repository with some of its control points."""
    source, target = ROOT / "aircraft_data" / name, home / name
    shutil.copytree(source / "materials", target / "materials")
    shutil.copy(source / "vehicle.toml", target)
    for folder, suffix in (("control_points", "toml"), ("ratio_tables", "csv")):
        (target / folder).mkdir()
        for point in points:
            for file in (source / folder).glob(f"{point}*.{suffix}"):
                if file.stem in (point, f"{point}_turbulent"):
                    shutil.copy(file, target / folder)
    for entry in more:
        (shutil.copytree if (source / entry).is_dir() else shutil.copy)(source / entry, target / entry)
    for path in (target / "ratio_sources").glob("*.toml"):
        if path.stem.upper() not in points:
            path.unlink()


def _fmu(home: Path) -> None:
    if COMPILER is None:
        return  # its subjects are left out
    with tempfile.TemporaryDirectory() as folder:
        glide_fmu(home / "glide.fmu", library(Path(folder)))


def available(home: Path) -> list[Subject]:
    """The subjects whose files exist."""
    return [s for s in SUBJECTS if all((home / name).exists() for name in s.inputs)]


def choose(subjects: Sequence[Subject], rng: random.Random) -> tuple[Subject, Command]:
    """A subject by its share, and one of its commands; half of them compute where there are both."""
    subject = rng.choices(subjects, [s.share for s in subjects])[0]
    kinds = [k for k in (subject.checks, subject.computes) if k]
    return subject, rng.choice(rng.choice(kinds))


def execute(command: Command, folder: Path) -> int:
    """Run a command of the program in this process and folder; its exit status."""
    with chdir(folder):
        os.environ.pop("SIM_HEATING_EFFECTS", None)
        if (folder / "effects").is_dir():
            os.environ["SIM_HEATING_EFFECTS"] = str(folder / "effects")
        if callable(command):
            return command(folder)
        return main([argument.format(out=OUT) for argument in command])


def command_text(command: Command) -> str:
    """A command as a person types it."""
    if callable(command):
        return "an aircraft flown through sim_heating.trajectory.jsbsim"
    return f"sim-heating {' '.join(command).format(out=OUT)}"
