"""What users do with files of each format, for the walk over all keys: together these files use every key."""

from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import sim_heating as sh
from sim_heating.base.files import read_json, toml_text
from sim_heating.campaign.run import run_campaign
from sim_heating.campaign.spec import CampaignFile, load_campaign
from sim_heating.closure.prior.model_error import flight_error, heating_error_prior
from sim_heating.estimation.design.report import summary as design_summary
from sim_heating.estimation.parameter_list import contents, scenario_parameters
from sim_heating.inputs.fit_settings import FitSettings
from sim_heating.inputs.ratio_sources import RatioSource, build_tables
from sim_heating.inputs.record import RecordFile
from sim_heating.inputs.scenario import ScenarioFile
from sim_heating.inputs.vehicle_files import ControlPointFile, DerivedMaterial, VehicleFile
from sim_heating.live.engine import LinkEngine
from sim_heating.live.run import run as run_live
from sim_heating.live.spec import LinkFile, load_link
from sim_heating.live.state import plain
from sim_heating.planning.study import StudyFile, load_study
from sim_heating.simulation.predict import summary
from sim_heating.simulation.run import compare, fly_scenario
from sim_heating.thermal.stack import Material
from sim_heating.trajectory.aero import AeroFile
from sim_heating.trajectory.guidance import GuidanceFile
from tests.support.key_walk import Deed, Outcome
from tests.support.paths import ORBITER, RECORDS, SCENARIOS, TILE

Document = dict[str, Any]


def merged(document: Document, other: Mapping[str, Any]) -> Document:
    """A document with the tables and values of another put over it."""
    found = dict(document)
    for key, value in other.items():
        below = found.get(key)
        found[key] = merged(below, value) if isinstance(value, dict) and isinstance(below, dict) else value
    return found


def read(path: Path) -> Document:
    return tomllib.loads(path.read_text())


def write(path: Path, document: Document) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(toml_text(document))


# Records --------------------------------------------------------------------------------------------------------------

DESCRIBED = {"source": "invented", "confidence": "C", "note": "invented"}
LAW = {"factor": 16.0, "activation_K": 10271.0}
CATALYSIS = {
    "wall": "finite-rate", "atoms": "edge", "gamma_O": LAW, "gamma_N": {"factor": 0.07, "activation_K": 2200.0},
    "highest_K": 500.0, **DESCRIBED,
}  # fmt: skip
TRANSITION = {
    "alpha_sens": 0.01, "alpha_sens_sigma": 0.01, "width": 0.2, "width_sigma": 0.05, "alpha_0_deg": 39.0,
    "alpha_0_deg_sigma": 1.0, "hysteresis": 0.05, "hysteresis_sigma": 0.02, "spots": 1.0, **DESCRIBED,
}  # fmt: skip
WALL = {
    "nodes": 30, "surroundings_K": 100.0, "initial": "uniform", "initial_K": 300.0, "back": "adiabatic",
    "layer": [{"material": "rcg", "thickness_m": 0.0005}, {"material": "al2024", "thickness_m": 0.004}],
}  # fmt: skip


def of_record(folder: Path) -> Outcome:
    """Prediction, parameters with priors and bounds, what the model may be off, and what is told of a record."""
    record = sh.load_record(folder / "record")
    predicted = sh.predict(record)
    history, error = predicted.history, flight_error(record)
    told = summary(predicted)
    return {
        "surface": history.surface_K, "bondline": history.bondline_K, "nodes": history.nodes, "ratio": history.ratio,
        "indicated": predicted.indicated_K, "heat": dict(history.heat.columns()),
        "parameters": contents([sh.parameter_list(record)]),
        "heating error": repr(heating_error_prior(record)),
        "flight error": None if error is None else [error.directions, error.altitudes_m],
        "told": {k: v for k, v in told.items() if k not in ("program", "record")},
        "name": [record.flight, record.declared.manoeuvre],
    }  # fmt: skip


def tile(changes: Mapping[str, Any]) -> Callable[[Path], None]:
    """Writes the small record of a tile with other keys."""

    def write_tile(folder: Path) -> None:
        shutil.copytree(TILE, folder / "record", dirs_exist_ok=True)
        table = (TILE / "ratio_table.csv").read_text()
        (folder / "record" / "other.csv").write_text(table.replace(",0.1", ",0.2"))
        write(folder / "record" / "record.toml", merged(read(TILE / "record.toml"), changes))

    return write_tile


def layers() -> list[Document]:
    rcg, li900, skin = read(TILE / "record.toml")["stack"]["layer"]
    return [
        rcg | {"name": "coating", "thickness_sigma_m": 2e-5, "contact_m2K_W": 1e-4},
        li900 | {"thickness_sigma_m": 1e-3, "contact_m2K_W": 0.0},
        {"material": "gap", "name": "gap", "thickness_m": 0.005, "emissivity_outer": 0.7, "emissivity_inner": 0.6},
        skin,
    ]


def sensors() -> list[Document]:
    surface, bond = read(TILE / "record.toml")["thermocouples"]["sensor"]
    return [surface | {"noise_correlation_s": 20.0, "tau_s": 1.0}, bond | {"noise_sigma_K": 2.0, "depth_m": 0.04}]


EVERY_KEY: Document = {
    "flight": "F1", "source": "invented", "confidence": "C",
    "conditions": {
        "source": "invented", "confidence": "A",
        "uncertainty": {
            "time_shift_s": 0.5, "time_stretch": 1e-3, "density_relative": 0.1, "density_scale_m": 7000.0,
            "velocity_relative": 2e-3, "alpha_deg": 0.3,
        },
    },
    "thermocouples": {"sensor": sensors()},
    "stack": {
        "layer": layers(), "venting_tau_s": 5.0, "initial_K": 291.0,
        "back": {"natural_h_W_m2K": 2.0, "natural_exponent": 0.3},
    },
    "materials": {
        "rcg": DESCRIBED
        | {"kind": "solid", "conductivity_sigma": 0.1, "heat_capacity_sigma": 0.1, "max_use_K": 1500.0},
        "gap": {
            "kind": "gas", "density_kg_m3": 1.0, "specific_heat_J_kgK": [[300.0, 1005.0]],
            "conductivity_W_mK": [[300.0, 0.026], [1000.0, 0.07]],
        },
    },
    "heating": {"uncertainty": {"relative": 0.05, "correlation_s": 120.0}},
    "reference_condition": {"beta_deg": 0.2, "elevon_deg": 1.5, "bodyflap_deg": 7.0},
    "manoeuvre": [{"kind": "popu", "start_s": 50.0, "end_s": 90.0}],
}  # fmt: skip

FLOWN = {
    "altitude_m": 70e3, "velocity_m_s": 6500.0, "mach": 22.0, "alpha_deg": 40.0, "beta_deg": 0.1, "log10_re": 5.9,
    "elevon_deg": 2.0, "bodyflap_deg": 7.5, "rho_kg_m3": 8e-5, "T_inf_K": 219.0, "p_inf_Pa": 5.2, "p_surface_Pa": 100.0,
    "q_add_W_m2": 1e4, "jets": 0.1, "T_surroundings_K": 250.0, "T_back_K": 280.0,
}  # fmt: skip


def constants(heating: Mapping[str, Any], flown: Mapping[str, float]) -> Callable[[Path], None]:
    """Writes a record whose flight is constant: its file of conditions has times alone."""

    def write_record(folder: Path) -> None:
        tile({"conditions": dict(flown)})(folder)
        place = folder / "record" / "record.toml"
        document = read(place)
        (folder / "record" / "conditions.csv").write_text("time_s\n0.0\n100.0\n220.0\n")
        document["heating"] = dict(heating)
        write(place, document)

    return write_record


def transitional(changes: Mapping[str, Any], without: tuple[str, ...] = ()) -> Callable[[Path], None]:
    """Writes the record of a tile over which the flow turns, with other keys of [heating]."""

    def write_record(folder: Path) -> None:
        shutil.copytree(RECORDS / "sts96_468", folder / "record", dirs_exist_ok=True)
        place = folder / "record" / "record.toml"
        document = read(place)
        document["heating"]["transition"] = {
            k: v for k, v in document["heating"]["transition"].items() if k not in without
        }
        document["heating"] = merged(document["heating"], changes)
        write(place, document)

    return write_record


NOMINAL = {"reference": "fay-riddell", "nose_radius_m": 0.3, "wall_enthalpy": {"cp_J_kgK": 1004.5}, "ratio": 0.2}
SWEPT = {"reference": "swept-cylinder", "nose_radius_m": 0.3, "sweep_deg": 45.0, "wall_enthalpy": "equilibrium-air"}
INTERFACE = {
    "upstream": "ahead", "step_m": 1.0, "point_m": 1.1, "footprint_m": 0.02, "flow": "laminar", "stack": WALL,
    "source": "invented",
}  # fmt: skip
COLUMNS = {"h_ref_kg_m2_s": 0.02, "H_r_J_kg": 2.3e7, "T_upstream_K": 900.0}


def record(name: str, written: Callable[[Path], None]) -> Deed:
    return Deed(f"record, {name}", written, "record/record.toml", RecordFile, of_record)


RECORD_DEEDS = (
    record("every key", tile(EVERY_KEY)),
    record("uniform start", tile({"stack": {"initial": "uniform", "initial_K": 295.0, "initial_profile": None}})),
    record("constants", constants(NOMINAL, FLOWN)),
    record("constants of columns", constants(
        {"reference": "columns", "wall_enthalpy": {"cp_J_kgK": 1004.5}, "ratio": 0.2,
         "interface": {k: v for k, v in INTERFACE.items() if k != "stack"}}, FLOWN | COLUMNS)),
    record("swept cylinder", constants(SWEPT | {"ratio": 0.5}, FLOWN)),
    record("edge", constants(
        {"reference": "eckert-laminar", "running_length_m": 3.0, "wall_enthalpy": "equilibrium-air", "ratio": 1.0,
         "recovery": "edge-laminar", "local_angle_deg": 5.0, "elevon_factor": 0.5, "bodyflap_factor": 0.5,
         "interface": INTERFACE, "catalysis": CATALYSIS}, FLOWN)),
    record("turning by Re_theta", transitional({"transition": TRANSITION | {"re_theta_over_m_e": 300.0}})),
    record("turning by Re", transitional(
        {"transition": TRANSITION | {"log10_re_onset": 6.6, "log10_re_onset_sigma": 0.2, "factor": 1.1,
                                     "factor_sigma": 0.2}},
        ("re_theta_over_m_e", "re_theta_over_m_e_sigma"))),
)  # fmt: skip


# Vehicles -------------------------------------------------------------------------------------------------------------

POINTS = ("V09T9527", "NOSECAP", "NOSE_HRSI", "BODYFLAP", "LEE_UPPER")


def orbiter(point: str = "V09T9527", changes: Mapping[str, Any] | None = None) -> Callable[[Path], None]:
    """Writes the Orbiter with a few control points, one of them with other keys, and an entry of it."""

    def write_orbiter(folder: Path) -> None:
        vehicle = folder / "orbiter"
        shutil.copytree(ORBITER, vehicle, dirs_exist_ok=True, ignore=shutil.ignore_patterns("flight_data"))
        for path in vehicle.glob("control_points/*.toml"):
            if path.stem not in POINTS:
                path.unlink()
        place = vehicle / "control_points" / f"{point}.toml"
        write(place, merged(read(place), changes or {}))
        write(folder / "entry.toml", entry_of(POINTS))

    return write_orbiter


def entry_of(points: tuple[str, ...], **trajectory: Any) -> Document:
    """A scenario: an entry of the Orbiter in a folder beside it, in three degrees of freedom."""
    entry = read(SCENARIOS / "entry_3dof.toml")
    flown = {**entry["trajectory"], "sample_s": 4.0, **trajectory}
    return {"format": "scenario/1", "title": "An entry", "vehicle": "orbiter", "control_points": list(points),
            "trajectory": flown}  # fmt: skip


def of_vehicle(folder: Path) -> Outcome:
    """Temperatures along an entry, limits, parameters with priors, credibility, records of its thermocouples."""
    scenario = sh.load_scenario(folder / "entry.toml", root=folder)
    flown = sh.run(scenario)
    records = sh.synthesize(scenario, flight=flown.flight)
    histories = {
        name: [p.history.surface_K, p.history.bondline_K, p.history.ratio, p.history.nodes,
               dict(p.history.heat.columns())]
        for name, p in flown.points.items()
    }  # fmt: skip
    return {
        "flight": dict(flown.flight.conditions.columns),
        "histories": histories,
        "limits": flown.limits,
        "parameters": contents(scenario_parameters(scenario)),
        "credibility": flown.credibility.as_json(),
        "records": {name: dict(r.thermocouples) for name, r in records.items()},
    }


def vehicle_deed(name: str, written: Callable[[Path], None], file: str, model: type) -> Deed:
    return Deed(f"vehicle, {name}", written, f"orbiter/{file}", model, of_vehicle)


OWN_POINT: Document = {
    "turbulent": {"factor": 4.0, "source": "invented"},
    "transition": TRANSITION | {"re_theta_over_m_e": 280.0, "re_theta_over_m_e_sigma": 40.0},
    "catalysis": CATALYSIS | {"atoms": "edge-oxygen"},
    "effect": [{"name": "impingement-onset", "parameters": {"slope": 0.01}, "source": "invented"}],
}


def derived(folder: Path) -> None:
    """Writes the Orbiter with a derived material as the coating of a point."""
    point = read(ORBITER / "control_points" / "V09T9527.toml")
    coated = [{**point["stack"]["layer"][0], "material": "coat"}, *point["stack"]["layer"][1:]]
    orbiter("V09T9527", {"stack": {"layer": coated}})(folder)
    write(folder / "orbiter" / "materials" / "coat.toml", {
        "based_on": "rcg", "density_kg_m3": 1700.0, "emissivity": [[300.0, 0.8]], "specific_heat_factor": 1.1,
        "conductivity_factor": 1.1, "max_use_K": 1500.0, **DESCRIBED,
    })  # fmt: skip


def swept(folder: Path) -> None:
    """Writes the Orbiter with ratios over a swept cylinder."""
    orbiter()(folder)
    place = folder / "orbiter" / "vehicle.toml"
    write(place, merged(read(place), {"heating": {"reference": "swept-cylinder", "sweep_deg": 40.0}}))
    for table in (folder / "orbiter" / "ratio_tables").glob("*.csv"):
        table.write_text(table.read_text().replace("# reference: fay-riddell", "# reference: swept-cylinder"))


VEHICLE_DEEDS = (
    vehicle_deed("whole", orbiter(), "vehicle.toml", VehicleFile),
    vehicle_deed("point", orbiter("V09T9527", OWN_POINT), "control_points/V09T9527.toml", ControlPointFile),
    vehicle_deed("behind a step", orbiter("NOSE_HRSI"), "control_points/NOSE_HRSI.toml", ControlPointFile),
    vehicle_deed("on the flap", orbiter("BODYFLAP", {"pressure": {"elevon_factor": 0.1}}),
                 "control_points/BODYFLAP.toml", ControlPointFile),
    vehicle_deed("leeside", orbiter("LEE_UPPER"), "control_points/LEE_UPPER.toml", ControlPointFile),
    vehicle_deed("material", orbiter(), "materials/li900.toml", Material),
    vehicle_deed("derived material", derived, "materials/coat.toml", DerivedMaterial),
    vehicle_deed("over a swept cylinder", swept, "vehicle.toml", VehicleFile),
)  # fmt: skip


# Scenarios ------------------------------------------------------------------------------------------------------------

START = {
    "altitude_m": 75000.0, "velocity_m_s": 6800.0, "gamma_deg": -0.1, "heading_deg": 60.0, "latitude_deg": 10.0,
    "longitude_deg": 20.0, "bank_deg": 50.0,
}  # fmt: skip
ENTRY = {
    "altitude_m": 121920.0, "velocity_m_s": 7450.0, "gamma_deg": -1.2, "heading_deg": 60.0, "latitude_deg": -10.0,
    "longitude_deg": 170.0, "bank_deg": 0.0,
}  # fmt: skip
GUIDANCE = {
    "alpha_deg": [[5000.0, 38.0], [6800.0, 40.0]], "alpha_against": "velocity_m_s", "alpha_limits_deg": [0.0, 40.2],
    "alpha_rate_deg_s": 0.05, "drag_m_s2": [[6000.0, 6.0], [6800.0, 4.0]], "start_drag_m_s2": 2.0,
    "bank_limits_deg": [10.0, 60.0], "bank_rate_deg_s": 5.0, "first_bank": "left", "reversals_m_s": [6750.0],
    "frequency_rad_s": 0.03, "damping": 0.8, "scale_height_m": 7100.0,
}  # fmt: skip
APPROACH = {
    "below_mach": 2.5, "qbar_Pa": [[0.0, 12000.0], [2.5, 9000.0]], "alpha_limits_deg": [5.0, 12.0], "bank_deg": 20.0,
    "frequency_rad_s": 0.07, "damping": 0.7, "flare_altitude_m": 900.0, "flare_time_s": 12.0,
}  # fmt: skip
MANOEUVRES: list[Document] = [
    {"kind": "popu", "at_time_s": 5.0, "down_deg": 4.0, "up_deg": 3.0, "rate_deg_s": 1.0, "hold_s": 2.0,
     "first": "up"},
    {"kind": "popu", "at_time_s": 35.0, "hold_down_s": 3.0, "hold_up_s": 1.0},
    {"kind": "elevon-pulse", "at_time_s": 70.0, "amplitude_deg": 3.0, "rate_deg_s": 8.0, "hold_s": 2.0,
     "pause_s": 1.0, "count": 2, "alternate": False, "alpha": "held"},
    {"kind": "elevon-sweep", "at_time_s": 90.0, "from_deg": -2.0, "to_deg": 3.0, "rate_deg_s": 1.0, "hold_s": 1.0,
     "alpha": "held"},
    {"kind": "bodyflap-pulse", "at_time_s": 115.0, "amplitude_deg": -3.0, "rate_deg_s": 1.5, "hold_s": 2.0,
     "pause_s": 1.0, "count": 2, "alternate": False, "alpha": "held"},
    {"kind": "bodyflap-sweep", "at_time_s": 140.0, "from_deg": 1.0, "to_deg": -3.0, "rate_deg_s": 1.0, "hold_s": 1.0,
     "alpha": "held"},
    {"kind": "sideslip-doublet", "at_time_s": 160.0, "amplitude_deg": 2.0, "rate_deg_s": 1.0, "hold_s": 1.0},
    {"kind": "jet-firing", "at_time_s": 180.0, "level": 0.8, "on_s": 3.0, "off_s": 2.0, "count": 2, "rise_s": 0.5},
]  # fmt: skip
AIR = {
    "density_factor": [[0.0, 1.0], [50e3, 0.95], [80e3, 1.1]],
    "wind_north_m_s": [[0.0, 5.0], [80e3, 20.0]],
    "wind_east_m_s": [[0.0, 5.0], [80e3, 30.0]],
}


def of_flight(folder: Path) -> Outcome:
    """The conditions of a scenario's flight, and its manoeuvres."""
    flown = fly_scenario(sh.load_scenario(folder / "flight.toml", root=folder))
    return {"conditions": dict(flown.conditions.columns), "windows": [repr(w) for w in flown.windows]}


def flight(trajectory: Document, vehicle: str = "orbiter") -> Callable[[Path], None]:
    """Writes a scenario whose flight alone is asked for, with the vehicle beside it."""

    def write_flight(folder: Path) -> None:
        orbiter()(folder)
        shutil.copy(SCENARIOS / "data" / "sts107_early_entry.csv", folder / "flown.csv")
        write(folder / "flight.toml", entry_of(("V09T9527",)) | {"trajectory": trajectory, "vehicle": vehicle})

    return write_flight


def gliding(**more: Any) -> Document:
    """[trajectory] of a short glide in three degrees of freedom."""
    return merged({"source": "entry-3dof", "sample_s": 1.0, "initial": START, "stop": {"time_s": 200.0}}, more)


def of_scenario(folder: Path) -> Outcome:
    """What `run` and `synthesize` make of a scenario, with what is told of it."""
    scenario = sh.load_scenario(folder / "entry.toml", root=folder)
    flown = sh.run(scenario)
    records = sh.synthesize(scenario, flight=flown.flight)
    return {
        "title": [scenario.title, scenario.flight],
        "points": {
            name: [p.history.time_s, p.history.surface_K, p.history.bondline_K, p.history.ratio]
            for name, p in flown.points.items()
        },
        "plugin": flown.plugin_apart_K,
        "compared": [
            [c.measured.label, c.residual_K, c.flux, c.measured.segments, c.measured.source, c.measured.confidence]
            for c in compare(flown)
        ],
        "records": {
            name: [dict(r.thermocouples), dict(r.conditions.columns), r.declared.model_dump(mode="json")]
            for name, r in records.items()
        },
    }


def measured(**keys: Any) -> Callable[[Path], None]:
    """Writes a scenario of a short glide with other tables, and the Orbiter beside it."""

    def write_scenario(folder: Path) -> None:
        orbiter("V09T9527", {"stack": {"back": {"h_W_m2K": 5.0, "T_K": 290.0}}})(folder)
        shutil.copytree(ORBITER / "flight_data", folder / "orbiter" / "flight_data", dirs_exist_ok=True)
        (folder / "measured.csv").write_text(
            "time_s,temperature_K,sigma_K\n20,700,5\n60,900,5\n90,1000,5\n120,1100,5\n"
        )
        short = gliding(
            stop={"time_s": 130.0},
            manoeuvre=[MANOEUVRES[0] | {"at_time_s": 20.0}, MANOEUVRES[-1] | {"at_time_s": 50.0}],
        )
        write(folder / "entry.toml", entry_of(("V09T9527", "NOSECAP")) | {"trajectory": short} | keys)

    return write_scenario


SCENARIO: Document = {
    "flight": "F1", "note": "invented",
    "heating": {
        "longest_step_s": 1.0, "T_surroundings_K": [[0.0, 200.0], [100.0, 300.0]],
        "T_back_K": [[0.0, 280.0], [100.0, 300.0]], "transition": True, "catalysis": True,
    },
    "effect": [{"name": "impingement-onset", "control_points": ["V09T9527"],
                "parameters": {"slope": 0.01, "alpha_onset_deg": 39.0}}],
    "measurements": {
        "seed": 3, "rate_hz": 2.0, "sample_offset_s": 0.1, "clock_skew_s": 0.4, "jet_q_fraction": 0.1,
        "lost_fraction": 0.05, "gaps_s": [[30.0, 35.0]],
        "fault": [{"sensor": "V09T9527", "bias_K": 2.0, "gain": 1.01, "drift_K_s": 0.01, "tau_s": 0.5}],
    },
    "truth": {
        "parameters": {"ratio.scale": 0.1},
        "effect": [{"name": "alpha-curvature", "control_points": ["V09T9527"], "parameters": {"d_alpha2": 1e-4}}],
    },
    "compare": [{"control_point": "V09T9527", "file": "measured.csv", "label": "invented", "until_s": 100.0,
                 "fit_s": [[0.0, 70.0]], "holdout_s": [[70.0, 100.0]], "source": "invented", "confidence": "C"}],
}  # fmt: skip

DESIGN: Document = {
    "control_point": "V09T9527", "parameters": ["ratio.d_alpha"], "nuisance": ["ratio.scale", "clock.skew"],
    "prior": {"clock.skew": 0.5}, "criterion": "D", "start": "profile", "before_s": 10.0, "after_s": 20.0,
    "evaluations": 4, "flights": [1, 2],
    "vary": [{"manoeuvre": 1, "key": "down_deg", "low": 1.0, "high": 6.0}],
    "limits": {
        "surface_margin_K": 1.0, "bondline_margin_K": 1.0, "alpha_deg": [30.0, 48.0], "elevon_deg": [-20.0, 15.0],
        "qbar_Pa": [0.0, 16000.0], "altitude_change_m": 3000.0, "duration_s": 60.0,
    },
}  # fmt: skip


def designed(folder: Path) -> None:
    """Writes an entry to a pushover-pullup that is to be designed, and the Orbiter beside it."""
    orbiter()(folder)
    write(folder / "entry.toml", entry_of(("V09T9527",), stop={"velocity_m_s": 5900.0}) | {"design": DESIGN})


def of_design(folder: Path) -> Outcome:
    """The designed manoeuvres of a scenario, with all bounds."""
    designed = sh.design(sh.load_scenario(folder / "entry.toml", root=folder))
    return {k: v for k, v in design_summary(designed).items() if k not in ("program", "credibility")}


SCENARIO_DEEDS = (
    Deed("scenario, glide", flight(gliding(
        rate_hz=4.0, guidance=GUIDANCE, dispersions=AIR, manoeuvre=MANOEUVRES,
        vehicle={"mass_kg": 90e3, "cg_fraction": 0.665, "cm_shift": False})), "flight.toml", ScenarioFile, of_flight),
    Deed("scenario, declared flap", flight(gliding(
        stop={"time_s": 30.0}, vehicle={"bodyflap_deg": [[5000.0, 5.0], [7000.0, 12.0]],
                                        "bodyflap_against": "velocity_m_s"})), "flight.toml", ScenarioFile, of_flight),
    Deed("scenario, ends", flight(gliding(
        stop={"time_s": 100.0, "altitude_m": 74.5e3, "velocity_m_s": 6700.0, "mach": 22.0})), "flight.toml",
        ScenarioFile, of_flight),
    *(Deed(f"scenario, ends at {key}", flight(gliding(stop={key: value})), "flight.toml", ScenarioFile, of_flight)
      for key, value in {"altitude_m": 74.0e3, "velocity_m_s": 6750.0, "mach": 22.5}.items()),
    *(Deed(f"scenario, {kind} by {key}",
           flight(gliding(stop={"time_s": 120.0}, manoeuvre=[{"kind": kind, key: value}])), "flight.toml",
           ScenarioFile, of_flight)
      for kind in ("popu",) for key, value in {"at_velocity_m_s": 6780.0, "at_mach": 23.5}.items()),
    Deed("scenario, to a target", flight(gliding(
        initial=ENTRY, stop={"velocity_m_s": 4000.0, "time_s": 2000.0}, guidance={"reversals_m_s": None, "target": {
            "latitude_deg": 20.0, "longitude_deg": 230.0, "deadband_deg": 5.0}})), "flight.toml", ScenarioFile,
        of_flight),
    Deed("scenario, approach", flight(gliding(
        initial={"altitude_m": 25e3, "velocity_m_s": 760.0, "gamma_deg": -8.0},
        stop={"time_s": 600.0, "altitude_m": 0.0},
        guidance={"approach": APPROACH})), "flight.toml", ScenarioFile, of_flight),
    Deed("scenario, JSBSim", flight(gliding(
        source="jsbsim", rate_hz=60.0, stop={"time_s": 25.0},
        manoeuvre=[MANOEUVRES[2] | {"at_time_s": 3.0}, MANOEUVRES[3] | {"at_time_s": 14.0}])), "flight.toml",
        ScenarioFile, of_flight),
    Deed("scenario, recorded", flight({"source": "recorded", "file": "flown.csv"}), "flight.toml", ScenarioFile,
         of_flight),
    Deed("scenario, every key", measured(**SCENARIO), "entry.toml", ScenarioFile, of_scenario),
    Deed("scenario, alongside", measured(heating={"alongside": True}), "entry.toml", ScenarioFile, of_scenario),
    Deed("scenario, design", designed, "entry.toml", ScenarioFile, of_design),
)  # fmt: skip


# What a vehicle's other files are made of -----------------------------------------------------------------------------


def of_tables(folder: Path) -> Outcome:
    """The ratio tables that the sources of a vehicle describe."""
    tables = build_tables(folder / "orbiter", root=folder)
    return {name: [t.axes, t.ratio, t.sigma, dict(t.header)] for name, t in tables.items()}


def sources(changes: Mapping[str, Mapping[str, Any]]) -> Callable[[Path], None]:
    """Writes the Orbiter with other ratio sources, by name."""

    def write_sources(folder: Path) -> None:
        vehicle = folder / "orbiter"
        shutil.copytree(ORBITER, vehicle, dirs_exist_ok=True, ignore=shutil.ignore_patterns("flight_data"))
        for path in vehicle.glob("ratio_sources/*.toml"):
            if path.stem not in ("oms_pod", "bodyflap", "made"):
                path.unlink()
        for name, document in changes.items():
            write(vehicle / "ratio_sources" / f"{name}.toml", dict(document))
        (vehicle / "ratio_sources" / "curve.csv").write_text(
            "alpha_deg,log10_re,ratio\n20,6,0.1\n20,7,0.11\n40,6,0.2\n40,7,0.22\n"
        )

    return write_sources


BY_FILE: Document = {
    "format": "ratio-source/1", "control_points": ["LEE_UPPER"], "revision": "1", "flow": "laminar",
    "relative_sigma": 0.2, **DESCRIBED,
    "axes": {"alpha_deg": [20.0, 40.0], "beta_deg": [0.0], "log10_re": [6.0, 7.0], "elevon_deg": [0.0],
             "bodyflap_deg": [0.0]},
    "base": {"file": "curve.csv", "column": "ratio", "file_length_over_L": 0.1, "length": "x_over_L",
             "length_exponent": -0.5},
}  # fmt: skip
SCALED: Document = {
    "recovery": "total",
    "scaling": {"regime": "transitional", "x_over_L": 0.1, "inclination_deg": 5.0, "method_sigma": 0.2,
                "correction_sigma": 0.4, "onset_sigma": 0.2,
                "tunnel": {"velocity_m_s": 1160.0, "T_inf_K": 52.0, "wall_K": 310.0, "length_m": 0.57,
                           "nose_radius_m": 0.0053, "recovery": "total"},
                "flight": {"velocity_m_s": 5500.0, "T_inf_K": 231.0, "wall_K": 700.0, "length_m": 32.8,
                           "nose_radius_m": 0.3048, "recovery": "total"},
                "tunnel_transition": {"onset_log10_re": 6.9, "width": 0.15},
                "flight_transition": {"onset_log10_re": 7.0, "width": 0.15}},
}  # fmt: skip


def source_deed(name: str, file: str, changes: Mapping[str, Mapping[str, Any]] | None = None) -> Deed:
    return Deed(
        f"ratio source, {name}", sources(changes or {}), f"orbiter/ratio_sources/{file}.toml", RatioSource, of_tables
    )


SOURCE_DEEDS = (
    source_deed("scaled to flight", "oms_pod"),
    source_deed("theory on a deflected surface", "bodyflap"),
    source_deed("by file", "made", {"made": BY_FILE}),
    source_deed("scaled by angle", "made", {"made": merged(BY_FILE, SCALED)}),
)


def aero(folder: Path) -> None:
    flight(gliding(vehicle={"cm_shift": True}, manoeuvre=MANOEUVRES[2:6]))(folder)
    place = folder / "orbiter" / "aero" / "aero.toml"
    write(place, read(place))


def aero_in_six(folder: Path) -> None:
    turning = {**MANOEUVRES[6], "at_time_s": 3.0}
    pulse = {**MANOEUVRES[2], "at_time_s": 8.0, "alpha": "free"}
    flight(gliding(source="jsbsim", rate_hz=60.0, stop={"time_s": 15.0}, manoeuvre=[turning, pulse]))(folder)
    place = folder / "orbiter" / "aero" / "aero.toml"
    write(place, read(place))


def guided(folder: Path) -> None:
    flight(gliding())(folder)
    place = folder / "orbiter" / "guidance.toml"
    write(place, {"format": "guidance/1", "source": "invented", "confidence": "C", **GUIDANCE})


def guided_to(target: bool) -> Callable[[Path], None]:
    """Writes a vehicle whose own guidance has a target, or an approach."""

    def write_guided(folder: Path) -> None:
        low = {"altitude_m": 25e3, "velocity_m_s": 760.0, "gamma_deg": -8.0}
        if target:
            flight(gliding(initial=ENTRY, stop={"velocity_m_s": 4000.0, "time_s": 2000.0}))(folder)
            own: Document = {"target": {"latitude_deg": 20.0, "longitude_deg": 230.0, "deadband_deg": 5.0}}
        else:
            flight(gliding(initial=low, stop={"time_s": 600.0, "altitude_m": 0.0}))(folder)
            own = {"approach": APPROACH}
        place = folder / "orbiter" / "guidance.toml"
        whole = {k: v for k, v in read(place).items() if k not in ("approach", "reversals_m_s")}
        write(place, whole | own)

    return write_guided


FLIGHT_DEEDS = (
    Deed("aero, point mass", aero, "orbiter/aero/aero.toml", AeroFile, of_flight),
    Deed("aero, six degrees of freedom", aero_in_six, "orbiter/aero/aero.toml", AeroFile, of_flight),
    Deed("guidance", guided, "orbiter/guidance.toml", GuidanceFile, of_flight),
    Deed("guidance, target", guided_to(True), "orbiter/guidance.toml", GuidanceFile, of_flight),
    Deed("guidance, approach", guided_to(False), "orbiter/guidance.toml", GuidanceFile, of_flight),
)


# Fits -----------------------------------------------------------------------------------------------------------------


def of_settings(folder: Path) -> Outcome:
    """An estimate with settings from a file."""
    from sim_heating.cli import main

    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    records = [str(folder / name) for name in ("record", "other")]
    code = main(["estimate", *records, "--settings", str(folder / "fit.toml"), "--out", str(out)])
    if code != 0:
        raise ValueError(f"exit {code}")
    found = read_json(out / "estimate.json")
    return {
        k: found.get(k) for k in ("reference_condition", "parameters", "fixed", "ties", "fit", "segments", "starts")
    }


def settings(folder: Path) -> None:
    tile(EVERY_KEY)(folder)
    shutil.copytree(folder / "record", folder / "other", dirs_exist_ok=True)
    write(
        folder / "other" / "record.toml",
        merged(merged(read(TILE / "record.toml"), EVERY_KEY), {"control_point": "OTHER", "flight": "F2"}),
    )
    write(folder / "fit.toml", {
        "tie": [["stack.coating.thickness_factor"]],
        "parameters": ["ratio.scale", "stack.coating.thickness_factor"], "start": "declared",
        "reference": {"alpha_deg": 39.0, "beta_deg": 0.1, "log10_re": 6.0, "elevon_deg": 1.0, "bodyflap_deg": 5.0},
        "fix": {"ratio.d_alpha": 0.001, "ratio.d_beta": 0.001, "ratio.d_logre": 0.001, "ratio.d_elevon": 0.001,
                "ratio.d_bodyflap": 0.001},
        "prior": {"stack.coating.thickness_factor": [1.0, 0.1]}, "bound": {"ratio.scale": [-0.001, 0.001]},
        "fit": [[0.0, 150.0]],
    })  # fmt: skip


FIT_DEEDS = (Deed("fit settings", settings, "fit.toml", FitSettings, of_settings),)


# Studies, campaigns, links --------------------------------------------------------------------------------------------


def of_study(folder: Path) -> Outcome:
    """What `plan` makes of a study."""
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    done = sh.plan(load_study(folder / "study.toml", root=folder), out, workers=1)
    if done.failed:
        raise ValueError(str(done.failed))
    return {
        name: [dict(result.data), result.notes, [t.csv() for t in result.tables]]
        for name, result in done.results.items()
    }


def study(**keys: Any) -> Callable[[Path], None]:
    """Writes a study of a short glide, with the Orbiter beside it."""

    def write_study(folder: Path) -> None:
        orbiter()(folder)
        write(folder / "study.toml", {"format": "study/1", "title": "A study", "note": "invented", "vehicle": "orbiter",
                                      "control_points": ["V09T9527"], **keys})  # fmt: skip

    return write_study


GLIDE = gliding(stop={"time_s": 60.0}, sample_s=2.0, guidance={"reversals_m_s": [6760.0]})
DISPERSION: Document = {
    "flights": 16, "sampling": "sobol", "scrambles": 2, "seed": 3, "index_flights": 4, "quantiles": [0.5, 0.9],
    "confidence": 0.9, "tables": 0.5, "model_error": True, "step_s": 0.5, "thermal_step_s": 2.0, "spot_checks": 0,
    "input": [
        {"name": "entry.gamma_deg", "sigma": 0.03, "title": "path"},
        {"name": "air.density", "low": -0.1, "high": 0.2, "over": [[0.0, 0.2], [80e3, 1.0]]},
        {"name": "stack.emissivity_factor", "sigma": 0.02, "control_points": ["V09T9527"]},
    ],
}  # fmt: skip
ENVELOPE: Document = {
    "sigmas": 1.0, "station_width": 1.0, "bodyflap_above_mach": 8.0, "elevon_arm_m": 6.0, "refinements": 0,
    "map": [{"name": "alpha", "title": "offset", "axes": {"alpha_offset_deg": [-4.0, 0.0]},
             "fixed": {"drag_factor": 1.1}, "one_sided": False},
            {"name": "station", "title": "station", "axes": {"station_alpha_deg": [38.0, 42.0]},
             "fixed": {"alpha_station": 22.3, "bodyflap_deg": 14.0}}],
    "boundary": [{"name": "alpha", "title": "offset", "along": "drag_factor", "at": [0.9, 1.0],
                  "across": "alpha_offset_deg", "values": [-8.0, 0.0], "inside": -4.0, "family": "cg_fraction",
                  "of": [0.66, 0.67], "one_sided": False, "fixed": {"bodyflap_deg": 14.0}}],
}  # fmt: skip
NEXT: Document = {
    "manoeuvre": [{"name": "popu", "control_points": ["V09T9527"], "flown": [{"kind": "popu", "at_time_s": 10.0}]}]
}
COOL = [{"control_point": "V09T9527", "surface_K": 800.0, "bondline_K": 300.0}]


def study_deed(name: str, **keys: Any) -> Deed:
    return Deed(f"study, {name}", study(**keys), "study.toml", StudyFile, of_study)


CAMPAIGN: Document = {
    "format": "campaign/1", "title": "A campaign", "note": "invented", "vehicle": "orbiter",
    "control_points": ["V09T9527"],
    "flight": [{"scenario": "entry.toml", "seeds": [12]}, {"scenario": "faster.toml", "seeds": [14]},
               {"scenario": "entry.toml", "seeds": [13], "check": True}],
    "fit": {"parameters": ["ratio.scale"], "reference": {"alpha_deg": 39.0}, "fix": {"ratio.d_alpha": 0.001},
            "prior": {"ratio.scale": [0.0, 0.1]}, "bound": {"ratio.scale": [-0.5, 0.5]}, "before_s": 4.0,
            "after_s": 30.0, "start": "declared"},
    "fit_of": [{"flight": "entry-seed12", "control_point": "V09T9527", "manoeuvre": "popu-mach22", "after_s": 2.0}],
    "joint": {"fitted": True, "speed_tolerance": 0.03}, "close_loop": False, "update_tables": True,
}  # fmt: skip


def of_campaign(folder: Path) -> Outcome:
    """What a campaign found: fits, joint fits, revised tables, errors."""
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    found = run_campaign(load_campaign(folder / "campaign.toml", root=folder), out, workers=1)
    refused = [line.replace(str(folder), "") for line in found.refused]
    return {"fits": found.fits, "joint": found.joint, "omitted": found.omitted, "updates": found.updates,
            "refused": refused, "errors": found.errors, "closed": found.closed}  # fmt: skip


def campaign(folder: Path) -> None:
    measured()(folder)
    faster = merged(read(folder / "entry.toml"), {"trajectory": {"initial": {"velocity_m_s": 6850.0}}})
    write(folder / "faster.toml", faster)
    write(folder / "campaign.toml", CAMPAIGN)


def of_link(folder: Path) -> Outcome:
    """The last state of a link whose messages come from a file."""
    engine = LinkEngine(load_link(folder / "link.toml", root=folder))
    state = run_live(engine)
    return {
        "points": json.loads(json.dumps(plain(state.points))),
        "time": state.time_s,
        "title": engine.link.title,
        "missing": plain(state.missing),
        "counts": dict(engine.counts),
    }


def link(**keys: Any) -> Callable[[Path], None]:
    """Writes a link with other tables, its messages, and the Orbiter beside it."""

    def write_link(folder: Path) -> None:
        orbiter()(folder)
        rows = [
            {"t_ms": 1000.0 * t + 5000.0, "h": 246000.0 - 30.0 * t, "v": 22300.0 - 10.0 * t,
             "alpha_deg": 40.0 + 0.1 * t,
             "beta_deg": 0.0, "elevon_deg": 1.0, "bodyflap_deg": 15.0, "rho": 9e-8, "word": 20.0 + 9.0 * t,
             "w": 18.0 + 4.0 * t, "word_ms": 1000.0 * t + 5100.0}
            for t in range(30)
            if not 10 <= t < 14
        ]  # fmt: skip
        (folder / "messages.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
        write(folder / "link.toml", merged(LINK, keys))

    return write_link


LINK: Document = {
    "format": "link/1", "title": "A link", "note": "invented", "vehicle": "orbiter", "control_points": ["V09T9527"],
    "source": [{"kind": "json-lines", "transport": "file", "file": "messages.jsonl"}],
    "time": {"field": "t_ms", "unit": "ms", "zero": 5000.0},
    "conditions": {
        "altitude_m": {"field": "h", "unit": "ft"}, "velocity_m_s": {"field": "v", "unit": "ft/s"},
        "rho_kg_m3": {"field": "rho", "unit": "slug/ft3"}, "beta_deg": {"constant": 0.5},
    },
    "sensor": [
        {"sensor": "V09T9527", "control_point": "V09T9527", "field": "word", "unit": "degC", "calibration": [0.0, 1.0],
         "time": "word_ms"},
        {"sensor": "V07T9528", "field": "w", "codes": True},
    ],
    "estimate": {
        "parameters": ["ratio.scale", "stack.coating.thickness_factor"], "fix": {"ratio.d_alpha": 0.001},
        "prior": {"ratio.scale": [0.0, 0.3]}, "wander": 0.05, "wander_s": 30.0, "lateness_s": 2.0, "jump_s": 2.5,
        "start": "declared", "linearise_s": 1.0, "corrects_mesh": True,
    },
    "ahead": {"horizon_s": 60.0, "scenario": "entry.toml", "keep": 0.95, "every_s": 1.0, "heating_error": 0.05},
    "missing": {"false_alarms_per_hour": 0.02},
}  # fmt: skip


def replay(folder: Path) -> None:
    """Writes a link that sends a record again."""
    tile({})(folder)
    tile({})(folder / "second")
    shorter = folder / "second" / "record" / "thermocouples.csv"
    shorter.write_text("\n".join(shorter.read_text().splitlines()[:12]) + "\n")
    write(folder / "link.toml", {
        "format": "link/1", "records": ["record"], "source": [{"kind": "replay", "record": "record", "speed": 0.0}],
        "estimate": {"parameters": ["ratio.scale"]},
    })  # fmt: skip


PLANNING_DEEDS = (
    study_deed("dispersion", control_points=["V09T9527", "NOSECAP"], trajectory=GLIDE, soak_s=20.0, limit=COOL,
               dispersion=DISPERSION,
               effect=[{"name": "impingement-onset", "control_points": ["V09T9527"],
                        "parameters": {"slope": 0.01, "alpha_onset_deg": 39.0}}]),
    study_deed("envelope", trajectory=GLIDE, envelope=ENVELOPE, next_flight=NEXT),
    study_deed("before and after", trajectory=GLIDE, envelope={"before": "orbiter", "boundary": [
        {**ENVELOPE["boundary"][0], "greatest": "cross_range_km"}]}),
    study_deed("of a scenario", scenario="entry.toml", revision="1", envelope={"map": ENVELOPE["map"], "bands": True}),
    Deed("campaign", campaign, "campaign.toml", CampaignFile, of_campaign),
    Deed("link", link(), "link.toml", LinkFile, of_link),
    Deed("link, replay", replay, "link.toml", LinkFile, of_link),
)  # fmt: skip

DEEDS: tuple[Deed, ...] = (
    *RECORD_DEEDS,
    *VEHICLE_DEEDS,
    *SCENARIO_DEEDS,
    *SOURCE_DEEDS,
    *FLIGHT_DEEDS,
    *FIT_DEEDS,
    *PLANNING_DEEDS,
)
"""All of them: a key is looked for in the documents of all, in this order."""
