"""The formats of files that people write, read or exchange: what each is for, its model or its columns, an example.

The keys of a format are those of the model that reads it; the schemas (`schema_files`) and the pages (`page`) are made
from it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from sim_heating.base.conditions import DESCRIPTIONS, HEATING, RATIO_VARIABLES, STATE, SURFACES
from sim_heating.base.errors import InputError
from sim_heating.base.files import suggestion
from sim_heating.inputs.record import OPTIONAL_COLUMNS
from sim_heating.trajectory.recorded import OPTIONAL, REQUIRED


@dataclass(frozen=True)
class FileFormat:
    """A format.

    name    : short name, as `record`; of its page and its schema
    file    : name of such a file, or its pattern
    title   : one line
    about   : paragraphs of the page
    example : path of a shipped file below the repository
    """

    name: str
    file: str
    title: str
    about: str = ""
    example: str | None = None


@dataclass(frozen=True)
class ModelFormat(FileFormat):
    """A TOML or JSON file with the keys of a model.

    model : `module:Class` of the package
    files : patterns of shipped files, below the repository
    """

    model: str = ""
    files: tuple[str, ...] = ()

    @property
    def language(self) -> str:
        """`toml` or `json`."""
        return self.file.rpartition(".")[2]

    def load(self) -> Any:
        """The model of pydantic that reads the file."""
        module, _, name = self.model.partition(":")
        return getattr(import_module(f"sim_heating.{module}"), name)


@dataclass(frozen=True)
class ColumnFormat(FileFormat):
    """A CSV file: columns that it must have and columns that it may have, with what each holds."""

    required: Mapping[str, str] = field(default_factory=dict)
    optional: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class KeyFormat(FileFormat):
    """A JSON file that the program writes: its keys with what each holds; `a.b` is the key b of the object a."""

    keys: Mapping[str, str] = field(default_factory=dict)


def _columns(*names: str) -> dict[str, str]:
    return {n: DESCRIPTIONS[n] for n in names}


FORMATS: tuple[FileFormat, ...] = (
    ModelFormat(
        "record", "record.toml", "flight record: what was flown, on what, and what was measured",
        "A record is a directory: `record.toml`, [`conditions.csv`](conditions.md), "
        "[`thermocouples.csv`](thermocouples.md) and, where the heating is known before, "
        "[`ratio_table.csv`](ratio_table.md). A test on the ground with `reference = \"none\"` needs no column but "
        "`time_s`; a constant may stand in `[conditions]` in place of a column.\n\n"
        "**Segments.** `fit` and `holdout` in `[segments]` are lists of `[start_s, end_s]`, both ends included. What "
        "is also in `holdout` is taken out of `fit`. Samples held out are never fitted, and errors over them are "
        "reported by themselves. Without `[segments]` all samples are fitted.",
        "scenarios/records/practice/p08/record.toml",
        "inputs.record:RecordFile", ("scenarios/records/*/record.toml", "scenarios/records/practice/*/record.toml"),
    ),
    ColumnFormat(
        "conditions", "conditions.csv", "flight conditions of a record, one row a sample",
        "Conditions are linear in time between rows. `rho_kg_m3` may be left out where `q_Pa` is given. "
        "`h_ref_kg_m2_s` and `H_r_J_kg` are needed with `reference = \"columns\"` alone; otherwise the reference "
        "heating that `[heating]` names is computed. A deflection may be left out where no ratio table depends on it. "
        "With `reference = \"none\"` only `time_s` is needed. Further "
        "columns of numbers are kept; `axial_accel_g` serves as independent evidence.\n\n"
        "**Other names and units.** A file with other names states its units in them, `Altitude (ft)`, `vel_ft_s`, "
        "`rho [slug/ft3]`; names of JSBSim, OpenRocket and RocketPy are known "
        "([own_record](../../how_to/own_record.md)). What follows from what is there is derived, with a warning: air "
        "of the standard atmosphere, Mach number, log10 Re of a metre, the pressure at the stagnation point or at "
        "`local_angle_deg`. A density of the standard atmosphere lowers the confidence of `[conditions]` by a letter.",
        "scenarios/records/practice/p08/conditions.csv",
        _columns(*(name for name in STATE if name not in SURFACES), "p_surface_Pa"),
        _columns(*SURFACES, *HEATING[1:], *OPTIONAL_COLUMNS, "axial_accel_g"),
    ),
    ColumnFormat(
        "thermocouples", "thermocouples.csv", "measured temperatures of a record, one column a sensor",
        "An empty cell is a lost sample. Times need not be those of the conditions, nor uniform. Temperatures are in "
        "kelvin: a column below 150 K is refused, since it looks like degrees Celsius.",
        "scenarios/records/practice/p08/thermocouples.csv",
        {**_columns("time_s"), "NAME_K": "temperature in K that a sensor indicates; the name is its `column` in "
         "`[[thermocouples.sensor]]`"},
        {"NAME_Pa": "pressure in Pa that a transducer indicates, its `column` in `[[thermocouples.transducer]]`"},
    ),
    ColumnFormat(
        "ratio_table", "ratio_table.csv", "heating ratios of a control point over five variables",
        "First optional lines `# key: value` (`source`, `confidence`, `revision`, `reference`: the reference heating "
        "that the ratio is over, `recovery`), then one row a node. The nodes form a full rectangular grid; an axis may "
        "have one value. Multilinear inside, constant outside. A flight more than 0.05 from the node of an axis of one "
        "value is outside as well, which `run`, `predict` and the plug-in tell.",
        "aircraft_data/orbiter/ratio_tables/V09T9527.csv",
        {**_columns(*RATIO_VARIABLES), "ratio": "film coefficient over the reference film coefficient"},
        {"sigma": "one standard deviation of the ratio"},
    ),
    ColumnFormat(
        "trajectory", "FLIGHT.csv", "recorded trajectory of a scenario with source = \"recorded\"",
        "Times in seconds, angles in degrees. What is left out is derived: temperature and pressure from the standard "
        "atmosphere, Mach and Reynolds number from them. Columns are compared with each other, so that a speed in ft/s "
        "or a 'Mach' that is V / 1000 ft/s is refused. A deflection is needed where the heating of the vehicle depends "
        "on it, else it is 0; of `rho_kg_m3` and `q_Pa` one is needed.",
        "scenarios/data/sts107_early_entry.csv",
        _columns(*REQUIRED),
        _columns(*SURFACES, *OPTIONAL),
    ),
    ModelFormat(
        "scenario", "SCENARIO.toml", "scenario: a flight with its manoeuvres, measurements and truth",
        "Read by `run`, `synthesize`, `design`, `figures` and `fmu trajectory`. A manoeuvre begins when speed or Mach "
        "falls through a value, or at a time: exactly one of `at_velocity_m_s`, `at_mach`, `at_time_s`.",
        "scenarios/popu_mach20.toml", "inputs.scenario:ScenarioFile",
        ("scenarios/*.toml", "examples/entry_fmu.toml", "examples/shock_passage.toml", "examples/flow_separation.toml"),
    ),
    ModelFormat(
        "credibility", "credibility.toml", "credibility: signed reviews of a vehicle or a record",
        "Stands next to `vehicle.toml` or `record.toml`; `sim-heating credibility review` adds to it. A review counts "
        "while `reviewed` is the digest of the other files there: [the statement](../../evidence/credibility.md).",
        "examples/credibility.toml", "credibility.reviews:ReviewFile", ("examples/credibility.toml",),
    ),
    ModelFormat(
        "vehicle", "vehicle.toml", "vehicle: its reference length, reference heating, transition and catalysis",
        "A vehicle is a directory with `vehicle.toml`, [`control_points/*.toml`](control_point.md), "
        "[`materials/*.toml`](material.md) and [`ratio_tables/*.csv`](ratio_table.md); with [`aero/`](aero.md) and "
        "[`guidance.toml`](guidance.md) it can be flown.",
        "aircraft_data/capsule/vehicle.toml", "inputs.vehicle_files:VehicleFile", ("aircraft_data/*/vehicle.toml",),
    ),
    ModelFormat(
        "control_point", "control_points/NAME.toml", "control point: one place of the heat shield with its stack",
        "", "aircraft_data/capsule/control_points/FACE.toml",
        "inputs.vehicle_files:ControlPointFile", ("aircraft_data/*/control_points/*.toml",),
    ),
    ModelFormat(
        "material", "materials/NAME.toml", "material of a layer",
        "The keys of `[materials.NAME]` in a record. With `based_on` it is a [derived material](derived_material.md).",
        "aircraft_data/capsule/materials/al2219.toml",
        "thermal.stack:Material", ("aircraft_data/*/materials/*.toml",),
    ),
    ModelFormat(
        "derived_material", "materials/NAME.toml", "material that is derived from another one",
        "", "aircraft_data/orbiter/materials/li2200.toml", "inputs.vehicle_files:DerivedMaterial", (),
    ),
    ModelFormat(
        "ratio_source", "ratio_sources/NAME.toml", "source of ratio tables: a curve, a file or a theory with factors",
        "`sim-heating ratio-tables VEHICLE` writes the tables from these files.",
        "aircraft_data/capsule/ratio_sources/face.toml",
        "inputs.ratio_sources:RatioSource", ("aircraft_data/*/ratio_sources/*.toml",),
    ),
    ModelFormat(
        "aero", "aero/aero.toml", "aerodynamics and mass of a vehicle",
        "", "aircraft_data/capsule/aero/aero.toml", "trajectory.aero:AeroFile", ("aircraft_data/*/aero/aero.toml",),
    ),
    ModelFormat(
        "guidance", "guidance.toml", "entry guidance of a vehicle",
        "A scenario replaces single keys in `[trajectory.guidance]`.",
        "aircraft_data/capsule/guidance.toml",
        "trajectory.guidance:GuidanceFile", ("aircraft_data/*/guidance.toml",),
    ),
    ModelFormat(
        "logger_layout", "LAYOUT.toml", "layout of a recorder's files: how `new record --layout` reads them",
        "Written by `new record --csv FILE --keep-layout LAYOUT.toml`. What is absent is recognised in each file, or "
        "refused. A unit that a file states itself prevails; where it contradicts the layout, the file is refused.",
        "examples/logger_layout.toml", "templates.loggers.layout_file:LoggerLayout", ("examples/logger_layout.toml",),
    ),
    ModelFormat(
        "fit_settings", "FIT.toml", "what `estimate --settings` estimates, and what is known of the parameters before",
        "", "examples/fit_settings.toml", "inputs.fit_settings:FitSettings", ("examples/fit_settings.toml",),
    ),
    ModelFormat(
        "campaign", "CAMPAIGN.toml", "campaign: all manoeuvres of many flights, and the tables that they revise",
        "", "scenarios/campaigns/sts2_sts4.toml", "campaign.spec:CampaignFile", ("scenarios/campaigns/*.toml",),
    ),
    ModelFormat(
        "link", "LINK.toml", "link to a flight that is being flown: its telemetry, and what is estimated from it",
        "Read by `live`. Each `[[source]]` gives messages with fields; `[time]`, `[conditions]` and `[[sensor]]` state "
        "which field is what, in which unit. A column of flight conditions without an entry is a field of its own name "
        "and unit; so is a sensor, by its `column`, or by `POINT.COLUMN` where several have that column. A field whose "
        "name states its unit, `h_ft` or `Altitude (ft)`, is in that unit where none is given; it is found by that "
        "name where a column has no entry and no field of its own name is sent. What is not sent and follows from what "
        "is, is derived: the density $2q/V^2$ of `q_Pa`, air of the standard atmosphere, Mach and Reynolds number, "
        "the surface pressure. Units are "
        "those that pint knows, such as `ft`, `ft/s`, `slug/ft3`, `degF`, as loggers spell them: `C` is a temperature, "
        "`mil` a length. A null or an empty text is a lost sample.\n\n"
        "**Columns in several messages.** A message with all columns is a frame at once. Columns that come apart are "
        "gathered by their time; where a later time comes first, absent ones have their latest values.\n\n"
        "**The journal.** Each message is given to the operating system as it comes and forced to the disk every "
        "`fsync_s`: a link that is killed loses none, a machine that loses power at most so much. "
        "`live --to-record` makes a [record](record.md) of it.",
        "scenarios/live/popu_lines.toml", "live.spec:LinkFile", ("scenarios/live/*.toml",),
    ),
    ModelFormat(
        "study", "STUDY.toml", "study: dispersed entries, envelopes, the next flight's manoeuvres",
        "Read by `plan`. Exactly one of `scenario` and `[trajectory]` gives the base entry.",
        "scenarios/studies/small_envelope.toml", "planning.study:StudyFile", ("scenarios/studies/*.toml",),
    ),
    ModelFormat(
        "optimal_entry", "STUDY.toml", "study of the entry with the greatest cross-range within temperature limits",
        "Read by `validate` and, in Python, `load_optimal_study`. A study takes its keys in the table `[optimal]`.",
        "scenarios/studies/optimal_entry.toml",
        "planning.optimal.spec:OptimalStudyFile", ("scenarios/studies/optimal_*.toml",),
    ),
    ModelFormat(
        "estimate", "estimate.json", "result of `estimate`: parameters with bounds, errors, correlations",
        "`update-tables` and `campaign` read it. Values are in the unit that each parameter states; `sigma` is one "
        "standard deviation, corrected for coloured residuals.", "docs/reference/formats/examples/estimate.json",
        "estimation.report.estimate_file:Estimate", (),
    ),
    KeyFormat(
        "closure", "closure.json", "result of `close-loop`: the missing effect, the error before and after",
        "The format is `closure-report/2`. Errors are `{rmse_K, max_abs_K, n}`, pooled over the used sensors; "
        "`holdout` is null where the record declares none. A parameter is `{value, sigma, unit}`.",
        "docs/reference/formats/examples/closure.json",
        {
            "format": "`closure-report/2`",
            "records": "directories of the records",
            "sensors": "names of the sensors that were fitted",
            "predicted": "errors with the declared tables, nothing fitted: `fit`, `holdout`",
            "before": "errors with the declared model, its derivatives fitted",
            "after": "errors with the best model that may be named and everything fitted again, whether it is stated "
            "as the cause or not; those before where there is none",
            "noise_floor_K": "root mean square of noise and rounding over the fitted samples in K",
            "reference_condition": "conditions that the derivatives are about",
            "effect": "the effect named first: `name`, `posterior`, `parameters`; `none` or `unknown` where nothing is",
            "effects": "all effects in the order in which they were added; empty where none is stated",
            "finding": "`found`, `one of`, `partly`, `unknown` or `none`",
            "alternatives": "for each thing found, the names that this record cannot tell apart, the likeliest first",
            "alternative_values": "estimates of each member of a set, or of what the residual resembles, each fitted "
            "without the others, by their names in `alternatives`",
            "adequacy": "whether the model with what was named explains the record: `p_value`, `chi2_fit`, "
                        "`chi2_holdout`, `lag1`",
            "probability": "calibrated probability that the named effect is missing; null where none is stated",
            "not_effects": "causes that no name of an effect covers, as a wrong material or a clock that jumps",
            "converged": "whether the last fit converged",
            "would_tell_apart": "what to measure or fly so that the alternatives differ",
            "resembles": "for `partly` and `unknown`, the names in the model that `after` is of",
            "model_error": "error of that model: `relative_heating` with its 95 % limit, `correlation_s`, `rms_K`, "
            "`largest_phase`, `flight`, whose parts are null where the record does not tell them apart, and "
            "`flight_scale`, the probabilities of factors on the standard deviations of the flight, as stated or by "
            "its confidence, null where it has none, `form_relative`, the standard deviation of the errors that the "
            "forms of its causes have, 0 where they are exact; null where the model is exact",
            "barred": "models that fit better and may not be named: `names`, `reason`, `delta_evidence`",
            "candidates": "of the first round: `name`, `delta_bic`, `fit_rmse_K`, `holdout_rmse_K`",
            "residual_heating": "name of the CSV with the residual as a heating ratio: `time_s, delta_ratio, sigma`",
            "curve": "file and variable of the curve that an unexplained residual follows, else null",
            "estimated": "all parameters of the last fit",
            "residual": "size and bandwidth of the residual heating before the effects",
            "residual_after": "of the residual heating after them",
            "evidence": "what the residual correlates with, and the effect that this proposes",
            "data_faults": "errors of the record itself: `kind`, `message`",
            "false_alarm": "chance of naming an effect where nothing is missing",
            "samples": "number of readings that were fitted, held out, and left out with the reason",
            "warnings": "on the fit and its residual",
            "remarks": "estimates that nature does not have, or that mean less than their sigma or errors say: `kind`, "
            "`parameters`, `message`, `meaning`",
            "program": "name and version of the program",
            "provenance": "origin: `command`, `inputs` with their digests, `seed`, `versions`, `platform`",
            "credibility": "self-assessment: the level of each factor with its reason, and what it was computed from",
        },
    ),
)  # fmt: skip


def formats_with_schema() -> Iterator[ModelFormat]:
    """The formats that have a JSON Schema."""
    return (f for f in FORMATS if isinstance(f, ModelFormat))


def format_named(name: str) -> FileFormat:
    """A format by its name; InputError with the nearest known name where there is none."""
    by_name = {f.name: f for f in FORMATS}
    if name not in by_name:
        raise InputError(f"there is no format `{name}`{suggestion(name, by_name)}")
    return by_name[name]
