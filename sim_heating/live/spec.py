"""A link as a file: where the telemetry comes from, which of its fields are what, and what is estimated from it.

format = "link/1"
title = "..."
vehicle = "orbiter"                 # whose control points are followed, or
# records = ["../records/p06"]      # control points as records declare them
control_points = ["V09T9527"]       # those with thermocouples where absent
[[source]]                          # kind = "json-lines", "jsbsim", "ccsds", "mqtt" or "replay"; several are merged
kind = "json-lines"
transport = "udp"
port = 5500
[time]                              # field and unit of the flight time
[conditions]                        # column = "field", or { field, unit }, or { constant }
altitude_m = { field = "h", unit = "ft" }
[[sensor]]                          # sensor = "V09T9527", with field, unit, or the word of the recorder
[estimate]                          # parameters, priors, wandering ratio, lateness, start
[ahead]                             # futures, horizon, probability of "knock it off by"
[missing]                           # the sequential test of the innovations
[output]                            # page, lines of JSON, metrics, properties of a JSBSim
[journal]                           # how often what came is forced to the disk
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag, field_validator, model_validator

from sim_heating.base import files
from sim_heating.base.conditions import FRAME, SURFACES
from sim_heating.base.errors import InputError
from sim_heating.base.files.roots import Roots
from sim_heating.base.parameters import MODEL, layer_parameter
from sim_heating.heating.recorded.fields import ConditionField, check_columns, field_or_table
from sim_heating.inputs.fit_settings import dotted
from sim_heating.inputs.record import Record, load_records
from sim_heating.inputs.scenario import Scenario, load_scenario
from sim_heating.inputs.vehicle import Vehicle, load_vehicle, vehicle_place
from sim_heating.thermal.stack import Sensor

LOOPBACK = "127.0.0.1"


def _host(name: str) -> str:
    if re.fullmatch(r"[\w.:%\[\]-]+", name) is None:
        raise ValueError(f'"{name}" is no name or address of a machine, such as {LOOPBACK}')
    return name


Host = Annotated[str, AfterValidator(_host)]
DRIVING = ("q_add_W_m2", "T_surroundings_K", "T_back_K")
"""Columns that change at a wall without flow."""
NOT_OF_MODEL = ("sensor.", "sensors.", "effect.", "clock.")
"""Beginnings of names that are checked with the sensors of a link."""
PORT = Field(default=5500, ge=1, le=65535, description="port, 1 to 65535")


# Sources -------------------------------------------------------------------------------------------------------------


class Network(files.Declared):
    """Where the bytes come from.

    transport : "udp": datagrams sent to this machine; "tcp-server": others connect to it; "tcp-client": it connects to
                others; "stdin": standard input; "file": a file from its beginning to its end
    host      : address to listen on, or to connect to
    file      : file of transport = "file", relative to the link file
    """

    quantities: ClassVar = {"port": None}

    transport: Literal["udp", "tcp-server", "tcp-client", "stdin", "file"] = "udp"
    host: Host = LOOPBACK
    port: int = PORT
    file: str | None = None

    @model_validator(mode="after")
    def _check_file(self) -> Network:
        if (self.file is None) == (self.transport == "file"):
            raise files.LocatedError((("file",), 'goes with transport = "file" and no other; add or remove it'))
        return self


class JsonLines(Network):
    """Lines of JSON, one object a line; a datagram may hold several lines."""

    kind: Literal["json-lines"] = Field(description='"json-lines"')


class JSBSimOutput(Network):
    """JSBSim's own output of type SOCKET: a line of labels, then lines of values.

    fields : names of the values in order, for an output that began before the link did and so sent no labels
    """

    kind: Literal["jsbsim"] = Field(description='"jsbsim"')
    fields: list[str] = Field(default=[])


class Packets(Network):
    """CCSDS space packets described by an XTCE document.

    xtce      : the document, relative to the link file
    container : name of its root container
    apid      : application process identifiers of the packets that are read; all where absent
    """

    kind: Literal["ccsds"] = Field(description='"ccsds"')
    xtce: str
    container: str = "CCSDSPacket"
    apid: list[int] | None = Field(default=None, min_length=1)


class Mqtt(files.Declared):
    """Topics of an MQTT broker; a payload is a JSON object, or a number or text, whose field is the topic.

    host     : address of the broker
    user     : name at the broker; the password is read from the environment variable SIM_HEATING_MQTT_PASSWORD
    """

    quantities: ClassVar = {"port": None}

    kind: Literal["mqtt"] = Field(description='"mqtt"')
    host: Host = LOOPBACK
    port: int = Field(default=1883, ge=1, le=65535, description="port, 1 to 65535")
    topics: list[str] = Field(min_length=1, description="topics, as `vehicle/+/temperature`")
    user: str | None = None


class Replay(files.Declared):
    """A recorded flight, sent again.

    record : directory of the record, relative to the link file; the first of `records` where absent
    speed  : flight seconds a second; 0 as fast as it goes
    """

    quantities: ClassVar = {"speed": None}

    kind: Literal["replay"] = Field(description='"replay"')
    record: str | None = None
    speed: float = Field(default=1.0, ge=0.0, le=1e6, description="flight seconds a second; 0 as fast as it goes")


Source = Annotated[JsonLines | JSBSimOutput | Packets | Mqtt | Replay, Discriminator("kind")]


# Mapping -------------------------------------------------------------------------------------------------------------


class TimeField(files.Declared):
    """The field that holds the flight time.

    zero : time of the field at flight time 0, in its unit, as the start of a day or of the flight
    """

    quantities: ClassVar = {"zero": None}

    field: str = Field(default="time_s", min_length=1, description="name of the field")
    unit: str = Field(default="s", description="its unit, as `s` or `ms`")
    zero: float = 0.0


class SensorField(files.Declared):
    """The field that holds a thermocouple's words.

    sensor        : name of the thermocouple
    control_point : its control point, where several have a sensor of this name
    unit          : unit of the field or of what `calibration` gives, as `K` or `degC`
    calibration   : [c0, c1, ...]: temperature in `unit` = c0 + c1 w + c2 w^2 ... of the word w that is sent
    codes         : true: the words are codes of the recorder that the sensor declares by `bits` and `range_K`
    time          : field with the time of this sensor's sample, in the unit of [time]; that of the message where absent
    """

    quantities: ClassVar = {"calibration": None}

    sensor: str = Field(min_length=1)
    control_point: str | None = None
    field: str = Field(min_length=1, description="name of the field")
    unit: str = "K"
    calibration: list[float] | None = Field(default=None, min_length=2)
    codes: bool = False
    time: str | None = Field(default=None, min_length=1)

    @model_validator(mode="after")
    def _check_word(self) -> SensorField:
        if self.codes and (self.calibration is not None or self.unit != "K"):
            raise files.LocatedError((("codes",), "gives K by the declared range; remove `calibration` and `unit`"))
        return self


# What is done with it ------------------------------------------------------------------------------------------------


class EstimateSettings(files.Declared):
    """What is estimated at every control point.

    parameters      : dotted names; magnitude and derivatives of the heating ratio where absent
    wander          : standard deviation of a heating ratio that wanders about the model's; 0 where it does not
    wander_s        : its correlation time
    lateness_s      : samples up to so much behind the latest frame are put where they belong; later ones are not used
    jump_s          : frames so much ahead of the latest one are a gap, or a jump of the clock
    start           : "readings": initial temperatures by conduction, from the first readings; "declared": those
                      of the stack; "auto": the former where the readings contradict the latter
    linearise_s     : flight time after which a point is linearised about its estimate again
    corrects_mesh   : whether the error of the meshes is found beside the filter and corrected; false is faster
    """

    quantities: ClassVar = {
        "fix": None,
        "prior": None,
        **dict.fromkeys(("wander", "wander_s", "lateness_s", "jump_s", "linearise_s")),
    }

    parameters: list[str] | None = Field(default=None, min_length=1)
    fix: Annotated[dict[str, float], dotted(float)] = Field(default_factory=dict, description="name = value")
    prior: Annotated[dict[str, list[float]], dotted(list[float])] = Field(
        default_factory=dict, description="name = [mean, sigma]"
    )
    wander: float = Field(default=0.0, ge=0.0, le=10.0)
    wander_s: float = Field(default=30.0, gt=0.0, le=1e6)
    lateness_s: float = Field(default=2.0, ge=0.0, le=60.0)
    jump_s: float = Field(default=2.5, gt=0.0, le=1e4)
    start: Literal["auto", "readings", "declared"] = "auto"
    linearise_s: float = Field(default=1.0, gt=0.0, le=100.0)
    corrects_mesh: bool = True

    @field_validator("prior")
    @classmethod
    def _check_priors(cls, values: dict[str, list[float]]) -> dict[str, list[float]]:
        problems: list[tuple[files.Location, str]] = [
            ((name,), f"{value} is not [mean, sigma] with a sigma above 0")
            for name, value in values.items()
            if len(value) != 2 or not value[1] > 0.0
        ]
        files.raise_located(problems)
        return values

    @field_validator("parameters")
    @classmethod
    def _check_names(cls, names: list[str] | None) -> list[str] | None:
        for name in names or []:
            if name not in MODEL and layer_parameter(name) is None and not name.startswith(NOT_OF_MODEL):
                raise ValueError(f"unknown parameter `{name}`{files.suggestion(name, MODEL)}")
        return names


class AheadSettings(files.Declared):
    """The look-ahead.

    horizon_s   : how far ahead temperatures are predicted, 10 to 600
    scenario    : scenario of the nominal flight with its manoeuvre, relative to the link file; without one, the present
                  conditions held are the only future
    keep        : probability with which stopping the manoeuvre at "knock it off by" keeps all limits
    every_s     : time between two predictions
    heating_error : relative error of the heating ratio that the bands allow for beside the estimate, one standard
                  deviation; 0 for none. In turbulent flow it acts on the laminar part
    """

    quantities: ClassVar = dict.fromkeys(("horizon_s", "keep", "every_s", "heating_error"))

    horizon_s: float = Field(default=60.0, ge=10.0, le=600.0)
    scenario: str | None = None
    keep: float = Field(default=0.95, gt=0.5, lt=1.0)
    every_s: float = Field(default=1.0, ge=0.1, le=60.0)
    heating_error: float = Field(default=0.0, ge=0.0, le=1.0)


class MissingSettings(files.Declared):
    """The sequential test of the innovations.

    false_alarms_per_hour : rate of alarms where nothing is missing
    """

    quantities: ClassVar = dict.fromkeys(("false_alarms_per_hour",))

    false_alarms_per_hour: float = Field(default=0.01, gt=0.0, le=10.0)


class JSBSimInput(files.Declared):
    """The input socket of a running JSBSim, which the estimates are written to as properties.

    host   : address of the machine that JSBSim runs on
    prefix : folder of the properties: PREFIX/POINT/surface_K and so on
    """

    quantities: ClassVar = {"port": None}

    host: Host = LOOPBACK
    port: int = Field(default=5502, ge=1, le=65535, description="port of JSBSim's `<input>`, 1 to 65535")
    prefix: str = Field(default="heating", pattern=r"^[A-Za-z_][A-Za-z0-9_.-]*(/[A-Za-z_][A-Za-z0-9_.-]*)*/?$")


class OutputSettings(files.Declared):
    """Where the state goes.

    page    : whether a page is served
    metrics : whether a link without a page still serves its metrics and its latest state, at the address of the page
    host    : address of the page; any but this machine's own needs a token, which is printed at the start
    rate_Hz : states a second, at most 10
    lines   : other displays that lines of JSON are sent to: "udp://HOST:PORT" or "ws://HOST:PORT"
    jsbsim  : the running JSBSim that the estimates are written to, of a link with a source of kind = "jsbsim"
    """

    quantities: ClassVar = dict.fromkeys(("port", "rate_Hz"))

    page: bool = True
    metrics: bool = False
    host: Host = LOOPBACK
    port: int = Field(default=8465, ge=0, le=65535, description="port of the page; 0 for any that is free")
    rate_Hz: float = Field(default=10.0, gt=0.0, le=10.0)
    lines: list[str] = Field(default=[])
    jsbsim: JSBSimInput | None = None


class JournalSettings(files.Declared):
    """How what came is kept.

    fsync_s : each message is given to the operating system at once, and forced to the disk after so much time; 0 after
              each message
    """

    quantities: ClassVar = {"fsync_s": None}

    fsync_s: float = Field(default=1.0, ge=0.0, le=60.0)


class LinkFile(files.Declared):
    """Contents of a link file.

    records     : records whose declared stacks, tables and sensors are followed, in place of a vehicle
    conditions  : column of flight conditions -> field of the messages; a field of the column's name where absent
    sensor      : a field of the sensor's `column` where a sensor has no entry
    """

    quantities: ClassVar = {"conditions": None}

    format: str = Field(pattern="^link/1$", description='"link/1"')
    title: str = ""
    note: str = ""
    vehicle: str | None = Field(default=None, description="name of a vehicle, or its directory relative to the file")
    records: list[str] | None = Field(default=None, min_length=1)
    control_points: list[str] | None = Field(default=None, min_length=1)
    source: list[Source] = Field(default=[], description="[[source]], at least one but for a replay")
    time: TimeField = TimeField()
    conditions: dict[
        str,
        Annotated[
            Annotated[str, Tag("field")] | Annotated[ConditionField, Tag("table")], Discriminator(field_or_table)
        ],
    ] = Field(default={})
    sensor: list[SensorField] = Field(default=[])
    estimate: EstimateSettings = EstimateSettings()
    ahead: AheadSettings = AheadSettings()
    missing: MissingSettings = MissingSettings()
    output: OutputSettings = OutputSettings()
    journal: JournalSettings = JournalSettings()

    @field_validator("conditions")
    @classmethod
    def _check_columns(cls, conditions: dict[str, Any]) -> dict[str, Any]:
        return check_columns(conditions, "is the time; name its field in [time]")

    @model_validator(mode="after")
    def _check_points(self) -> LinkFile:
        if (self.vehicle is None) == (self.records is None):
            raise ValueError("give either `vehicle` or `records`, not both and not neither")
        if (name := files.repeated_name(self.control_points or [])) is not None:
            raise files.LocatedError((("control_points",), f"`{name}` is repeated; name it once"))
        return self

    @model_validator(mode="after")
    def _check_jsbsim(self) -> LinkFile:
        if self.output.jsbsim is not None and not any(isinstance(s, JSBSimOutput) for s in self.source):
            raise files.LocatedError(
                (("output", "jsbsim"), 'goes with a [[source]] of kind = "jsbsim"; add one or remove this table')
            )
        return self


# The link ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LinkPoint:
    """A control point of a link: its name and its thermocouples."""

    name: str
    sensors: tuple[Sensor, ...]


@dataclass(frozen=True, eq=False)
class Link:
    """A checked link with its vehicle or its records.

    path     : of the file; of a link that was made without one, the file that its names would be relative to
    vehicle  : whose control points are followed; None where `records` declare them
    records  : by name of the control point; empty where the vehicle declares them
    points   : control points with their sensors, in order
    columns  : columns of flight conditions that a frame needs
    scenario : of the nominal flight, or None
    roots    : folders in which it may name files;  root : the one that the user named, or None
    """

    path: Path
    declared: LinkFile
    vehicle: Vehicle | None
    records: Mapping[str, Record]
    points: tuple[LinkPoint, ...]
    columns: tuple[str, ...]
    scenario: Scenario | None
    roots: Roots
    root: Path | None = None

    def __repr__(self) -> str:
        return f"<Link {self.title!r}: {len(self.points)} control points, {len(self.declared.source)} sources>"

    @property
    def title(self) -> str:
        """Title of the link, or the name of its file."""
        return self.declared.title or self.path.stem

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the control points in order."""
        return tuple(p.name for p in self.points)

    def sensor(self, point: str, name: str) -> Sensor:
        """A sensor by the names of its control point and of itself; KeyError where there is none."""
        return next(s for p in self.points if p.name == point for s in p.sensors if s.name == name)

    @property
    def property_folders(self) -> dict[str, str]:
        """Folder of each control point among the properties of a JSBSim; empty without `[output.jsbsim]`.

        What a property's name cannot hold is an underscore there: heating/left_wing of `left wing`.
        """
        settings = self.declared.output.jsbsim
        if settings is None:
            return {}
        prefix = settings.prefix.rstrip("/")
        return {name: f"{prefix}/{_property_name(name)}" for name in self.names}

    def file(self, name: str, key: str) -> Path:
        """The path of a file that a key names; InputError where it is absent or outside the folders of the link."""
        return self.roots.existing(name, key)


def _property_name(name: str) -> str:
    """A name as a part of a JSBSim property: letters of English, digits, `_`, `-` and `.`, no digit in front."""
    allowed = re.sub(r"[^A-Za-z0-9_.-]", "_", name)
    return allowed if re.match(r"[A-Za-z_]", allowed) else f"_{allowed}"


def load_link(path: str | os.PathLike[str] | Link, *, root: str | os.PathLike[str] | None = None) -> Link:
    """Read and check a link file, its vehicle or records, and its scenario.

    path   : of the TOML file; a link that has been loaded is returned as it is
    root   : folder that it may name files in; by default the nearest above it that holds `scenarios`
    raises : InputError with one line a problem

    >>> from sim_heating.live.spec import load_link
    >>> load_link("scenarios/live/popu_lines.toml").names
    ('V09T9527',)
    """
    if isinstance(path, Link):
        return path
    return make_link(files.read_toml(path, LinkFile), path, root=root)


def make_link(
    declared: LinkFile | Mapping[str, Any], path: str | os.PathLike[str], *, root: str | os.PathLike[str] | None = None
) -> Link:
    """A link from its contents, checked as one that is read from a file.

    declared : contents, or plain data of them
    path     : file that its names are relative to; it need not exist
    raises   : InputError with one line a problem
    """
    file = Path(path)
    if not isinstance(declared, LinkFile):
        declared = files.check(dict(declared), LinkFile, files.display_path(file))
    roots = files.roots_of(file, root)
    vehicle, records = None, {}
    if declared.vehicle is not None:
        vehicle = load_vehicle(vehicle_place(file, declared.vehicle, root=root), root=root)
        roots = files.roots_of(file, root, vehicle.directory)
        sensors_of = {p.name: tuple(p.sensors) for p in vehicle.control_points.values()}
    else:
        records = _followed_records(declared.records or [], roots, file, root)
        sensors_of = {name: tuple(r.sensors) for name, r in records.items()}
    points = _points(declared, sensors_of, file)
    scenario = None
    if declared.ahead.scenario is not None:
        scenario = load_scenario(roots.existing(declared.ahead.scenario, "[ahead]: `scenario`"), root=root)
    columns = _columns(declared, vehicle, {p.name: records[p.name] for p in points} if records else {})
    own_root = None if root is None else Path(root)
    link = Link(file, declared, vehicle, records, points, columns, scenario, roots, own_root)
    files.raise_problems([*_scenario_problems(link), *_property_problems(link)])
    return link


def replayed(
    link: Link | None, record: str | os.PathLike[str], speed: float, *, root: str | os.PathLike[str] | None = None
) -> Link:
    """A link whose only source is a record that is sent again, by the names and units of a record.

    link  : whose control points, estimate and outputs are used; None for those of the record
    speed : flight seconds a second; 0 as fast as it goes
    """
    source = {"kind": "replay", "record": str(Path(record).absolute()), "speed": float(speed)}
    if link is None:
        file = Path(record).absolute().with_suffix(".toml")
        return make_link({"format": "link/1", "records": [source["record"]], "source": [source]}, file, root=root)
    declared = link.declared.model_dump(
        exclude_unset=True,
        exclude={"time": True, "conditions": True, "sensor": True, "output": {"jsbsim"}},  # a record is no JSBSim
    )
    return make_link(declared | {"source": [source]}, link.path, root=root)


def _points(declared: LinkFile, sensors_of: Mapping[str, tuple[Sensor, ...]], file: Path) -> tuple[LinkPoint, ...]:
    """The control points that are followed."""
    chosen = declared.control_points
    if chosen is None:
        chosen = [name for name, sensors in sensors_of.items() if sensors] or list(sensors_of)
    unknown = [name for name in chosen if name not in sensors_of]
    files.raise_problems(
        [
            f"{files.display_path(file)}: `control_points`: unknown control point `{n}`"
            f"{files.suggestion(n, sensors_of)}"
            for n in unknown
        ]
    )
    return tuple(LinkPoint(name, sensors_of[name]) for name in chosen)


def _columns(declared: LinkFile, vehicle: Vehicle | None, records: Mapping[str, Record]) -> tuple[str, ...]:
    """Columns of flight conditions that a frame needs: those of a host for a vehicle, those of the records else."""
    spared = {"time_s"}
    if vehicle is not None:
        needed: tuple[str, ...] = FRAME
        spared |= {"jets", *SURFACES} - {*vehicle.surfaces}
    else:
        first = next(iter(records.values()))
        needed = first.conditions.names
        if first.declared.heating.reference == "none":  # a wall at rest: what is not sent is as it was at the start
            spared |= {*needed} - {*declared.conditions, *DRIVING}
    if "q_Pa" in declared.conditions:  # the density follows from it
        spared |= {"rho_kg_m3"} - {*declared.conditions}
    return tuple(dict.fromkeys([*(name for name in needed if name not in spared), *declared.conditions]))


def _followed_records(
    names_of_files: Sequence[str], roots: Roots, file: Path, root: str | os.PathLike[str] | None
) -> dict[str, Record]:
    """Records of one flight by their control points; InputError where conditions differ or two have one point."""
    records = load_records([roots.existing(name, "`records`") for name in names_of_files], root=root)
    files.raise_problems(_apart(records, file))
    names = [r.declared.control_point for r in records]
    if (name := files.repeated_name(names)) is not None:
        raise InputError(f"{files.display_path(file)}: two records are of control point {name}; leave one out")
    return dict(zip(names, records, strict=True))


def _apart(records: Sequence[Record], file: Path) -> list[str]:
    """Records whose conditions differ: a frame holds one value of each column."""
    first = records[0].conditions
    return [
        f"{files.display_path(file)}: `records`: {r.name} and {records[0].name} differ in their conditions, as in "
        "their own h_ref_kg_m2_s; follow one of them, or the control points of a vehicle"
        for r in records[1:]
        if first.names != r.conditions.names
        or any(not np.array_equal(first[name], r.conditions[name]) for name in first.names)
    ]


def _scenario_problems(link: Link) -> list[str]:
    """A scenario of another vehicle."""
    if link.scenario is None or link.vehicle is None or link.scenario.vehicle.name == link.vehicle.name:
        return []
    return [
        f"{files.display_path(link.path)}, [ahead]: `scenario`: flies {link.scenario.vehicle.name}, the link follows "
        f"{link.vehicle.name}; they must be one vehicle"
    ]


def _property_problems(link: Link) -> list[str]:
    """Two control points whose properties in a JSBSim would be one."""
    if (folder := files.repeated_name(list(link.property_folders.values()))) is None:
        return []
    both = " and ".join(name for name, other in link.property_folders.items() if other == folder)
    return [
        f"{files.display_path(link.path)}, [output.jsbsim]: control points {both} would both be {folder} in JSBSim; "
        "follow one of them, or rename one"
    ]
