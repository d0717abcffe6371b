"""The commands `sim-heating new record`, `vehicle`, `scenario`, `effect` and `study`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sim_heating.base.errors import InputError
from sim_heating.cli.console import CONSOLE, OUT, PATH, print_table
from sim_heating.cli.output import report_files, report_results

if TYPE_CHECKING:
    from sim_heating.templates.materials import LayerInput
    from sim_heating.templates.measured_csv import MeasuredCsv


@click.group("new")
def new() -> None:
    """Make a record, vehicle, scenario, effect or study to go on from, out of a few numbers.

    Each is commented, validates at once, and runs in the command that it is for.
    """


def quantity_option(unit: str, example: str) -> Any:
    """Callback of an option for a number with a unit: its value in the SI unit, None where not given."""

    def read(_: click.Context, option: click.Parameter, value: str | None) -> float | None:
        if value is None:
            return None
        from sim_heating.templates.quantities import quantity

        return quantity(value, unit, option.opts[0], f"{option.opts[0]} {example}")

    return read


def _fraction(_: click.Context, option: click.Parameter, value: float | None) -> float | None:
    """Value of an option above 0, up to 1."""
    if value is not None and not 0.0 < value <= 1.0:
        raise InputError(f"{option.opts[0]} {value:g}: must be above 0, up to 1")
    return value


def _two_times(_: click.Context, option: click.Parameter, value: str | None) -> tuple[float, float] | None:
    """Value of an option for two times `10,130` [s]."""
    if value is None:
        return None
    from sim_heating.base.files import plain_number

    try:
        first, second = (plain_number(part) for part in value.split(","))
    except ValueError:
        raise InputError(f"{option.opts[0]} {value}: write two times in s, such as {option.opts[0]} 10,130") from None
    return first, second


def _interactive() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


@new.command("record")
@click.option(
    "--csv", "csv_file", type=PATH, required=True, help="file of temperatures: a time and one column a thermocouple"
)
@OUT
@click.option(
    "--layer",
    "layers",
    multiple=True,
    metavar='"MATERIAL THICKNESS"',
    help='a layer, outermost first, such as "LI-900 51 mm"; repeat for more; a material of the library, or a '
    "TOML file of one",
)
@click.option(
    "--depth",
    "depths",
    multiple=True,
    metavar="COLUMN=DEPTH",
    help="depth of a thermocouple below the heated surface, TC1=0.4mm, or `surface`, or `back`; repeat",
)
@click.option(
    "--lamp",
    metavar="FLUX|COLUMN|FILE|unknown",
    help="what heats the wall: a flux such as 20kW/m2, a column of the CSV file, a CSV file of its own, or `unknown`",
)
@click.option(
    "--lit",
    callback=_two_times,
    metavar="ON,OFF",
    help="times in s at which a constant lamp was lit; default: throughout",
)
@click.option(
    "--absorptance", type=float, callback=_fraction, help="absorbed part of the flux; default: it is the absorbed flux"
)
@click.option(
    "--emissivity", type=float, callback=_fraction, help="emittance of the heated surface; default: of its material"
)
@click.option(
    "--initial",
    callback=quantity_option("K", "21degC"),
    metavar="T",
    help="temperature at the start; default: the first readings",
)
@click.option(
    "--surroundings",
    callback=quantity_option("K", "21degC"),
    metavar="T",
    help="what the surface radiates to; default: as --initial",
)
@click.option(
    "--back-film",
    callback=quantity_option("W/m2K", "8W/m2K"),
    metavar="H",
    help="film coefficient behind the wall; default: adiabatic",
)
@click.option(
    "--back-temperature",
    callback=quantity_option("K", "21degC"),
    metavar="T",
    help="temperature behind the wall; default: as --surroundings",
)
@click.option(
    "--back-emissivity", type=float, callback=_fraction, help="emittance of the back face; default: adiabatic"
)
@click.option(
    "--pressure",
    callback=quantity_option("Pa", "1013hPa"),
    metavar="P",
    help="air pressure, for porous insulation; default: sea level",
)
@click.option(
    "--conditions", "flight", type=PATH, help="a flight in place of a lamp: CSV with the columns of conditions.csv"
)
@click.option(
    "--reference", help="model of reference heating of that flight; default: its columns h_ref_kg_m2_s, H_r_J_kg"
)
@click.option(
    "--nose-radius", callback=quantity_option("m", "0.3m"), metavar="R", help="radius of the reference sphere"
)
@click.option(
    "--like",
    type=PATH,
    metavar="RECORD",
    help="stack, flight and heating of this record, in place of --layer and --lamp",
)
@click.option("--time", "time", metavar="COLUMN", help="column of the time, where the guess is wrong")
@click.option("--time-unit", metavar="UNIT", help="its unit: s, ms, min, h")
@click.option(
    "--period",
    callback=quantity_option("s", "0.1s"),
    metavar="T",
    help="time between rows, where there is no column of it",
)
@click.option(
    "--temperature",
    "temperatures",
    multiple=True,
    metavar="COLUMN",
    help="column of a temperature; repeat; others are left out",
)
@click.option("--temperature-unit", metavar="UNIT", help="unit of the temperatures: K, degC, degF")
@click.option(
    "--noise",
    callback=quantity_option("K", "0.5K"),
    metavar="SIGMA",
    help="random error of the thermocouples in K; default: estimated",
)
@click.option("--point", default="plate", show_default=True, help="name of the place that was measured")
@click.option("--title", default="", help="title of the record")
@click.option("--synthetic", is_flag=True, help="the temperatures are computed, not measured")
def record(csv_file: Path, out: Path, layers: tuple[str, ...], depths: tuple[str, ...], **given: Any) -> None:
    """Make a flight record from a CSV file of temperatures, of a lamp test, a heated plate, or a flight.

    Columns, units and separators are recognised and shown with the reason; each guess has an option. A lamp test:

    \b
      sim-heating new record --csv temps.csv --layer "copper 3 mm" --depth TC1=back \\
          --lamp 20kW/m2 --lit 10,130 --emissivity 0.9 --out plate

    A tile of a record that exists, with temperatures of your own:

    \b
      sim-heating new record --csv mine.csv --like scenarios/records/sts96_480 --out mine
    """
    from sim_heating.cli.path_check import describe_record
    from sim_heating.templates import record as maker
    from sim_heating.templates.measured_csv import read_measured_csv
    from sim_heating.templates.quantities import named_quantities

    if given["period"] is not None and not given["period"] > 0.0:
        raise InputError("--period: must be above 0")
    lamp = given["lamp"]
    measured = read_measured_csv(
        csv_file,
        time=given["time"],
        time_unit=given["time_unit"],
        temperatures=given["temperatures"],
        temperature_unit=given["temperature_unit"],
        period_s=given["period"],
    )
    print_table(measured.table())
    stated = named_quantities(depths, "--depth", "TC1=0.4mm")
    if given["like"] is not None:
        _refuse_with_like(layers, given)
        made, notes = maker.like_record(out, given["like"], measured, stated, given["title"], given["noise"])
    else:
        stack = _stack(layers)
        sensors = maker.sensor_columns(measured)
        depths_m = maker.depths_of(sensors, stated, stack)
        depths_m |= _asked_depths([s.name for s in sensors if s.name not in depths_m], stack)
        made, notes = maker.write_new_record(
            out,
            measured,
            maker.RecordInput(
                stack,
                depths_m,
                _heat(measured, lamp, given),
                title=given["title"],
                point=given["point"],
                measured=not given["synthetic"],
                emissivity=given["emissivity"],
                initial_K=given["initial"],
                surroundings_K=given["surroundings"],
                back=_back(given, measured),
                noise_K=given["noise"],
                pressure_Pa=given["pressure"],
                nose_radius_m=given["nose_radius"],
            ),
        )
    _print_notes(notes)
    commands = (
        f"sim-heating {c} {out} --out {out}_{c.replace('-', '_')}" for c in ("predict", "estimate", "close-loop")
    )
    _print_made(describe_record(made), out, *commands, notes=notes)


def _refuse_with_like(layers: Sequence[str], given: dict[str, Any]) -> None:
    for option, value in (("--layer", layers), ("--lamp", given["lamp"]), ("--conditions", given["flight"])):
        if value:
            raise InputError(f"{option}: comes from the record of --like; leave one of the two out")


def _stack(layers: Sequence[str]) -> list[LayerInput]:
    """Layers of the options; asked for on a terminal where there are none."""
    from sim_heating.templates.materials import layer_input, material_library

    if not layers and _interactive():
        CONSOLE.print(f"Materials: {', '.join(sorted(material_library()))}")
        asked: list[str] = []
        while text := click.prompt(
            f"Layer {len(asked) + 1}, such as copper 3 mm (empty: no more)", default="", show_default=False
        ):
            asked.append(text)
        layers = asked
    if not layers:
        known = ", ".join(sorted(material_library()))
        raise InputError(
            "--layer: is missing; give the layers from the heated surface inward, as "
            f'--layer "copper 3 mm"; materials: {known}'
        )
    return [layer_input(text) for text in layers]


def _asked_depths(names: Sequence[str], stack: Sequence[LayerInput]) -> dict[str, float]:
    """Depths [m] of the sensors without one: asked for on a terminal, else an error that names the option."""
    from sim_heating.templates.record import depth_m

    if names and not _interactive():
        options = " ".join(f"--depth {name}=0.4mm" if " " not in name else f'--depth "{name}=0.4mm"' for name in names)
        raise InputError(
            f"--depth: is missing for {', '.join(names)}; give the depth from the heated surface, `surface` or `back`: "
            f"{options}"
        )
    return {
        name: depth_m(name, click.prompt(f"Depth of {name} from the heated surface (0.4mm, surface, back)"), stack)
        for name in names
    }


def _heat(measured: MeasuredCsv, lamp: str | None, given: dict[str, Any]) -> Any:
    """What heats the wall: the option --lamp or --conditions, else the only column of a heat flux."""
    from sim_heating.templates.measured_csv import FLUX
    from sim_heating.templates.record import flown_heat, lamp_heat

    if given["flight"] is not None:
        if lamp is not None:
            raise InputError("--lamp: goes with a test on the ground, --conditions with a flight; give one of the two")
        return flown_heat(given["flight"], given["reference"])
    fluxes = [c.name for c in measured.of_kind(FLUX)]
    if lamp is None and len(fluxes) == 1:
        lamp = fluxes[0]
    if lamp is None and _interactive():
        lamp = click.prompt("Flux that heats the wall (20kW/m2, a column, or a CSV file)")
    if lamp is None:
        found = f"the columns {', '.join(fluxes)} may be it" if fluxes else "no column is a heat flux"
        raise InputError(
            f"--lamp: is missing, and {found}; give a flux such as --lamp 20kW/m2, a column, or a CSV file with a time "
            "and a flux"
        )
    return lamp_heat(measured, lamp, given["lit"], given["absorptance"])


def _back(given: dict[str, Any], measured: MeasuredCsv) -> dict[str, float] | None:
    """Keys of a cooled back face; None for an adiabatic one."""
    film, emissivity, T_K = given["back_film"], given["back_emissivity"], given["back_temperature"]
    if film is None and emissivity is None:
        if T_K is not None:
            raise InputError("--back-temperature: needs --back-film or --back-emissivity, by which the back face cools")
        return None
    if T_K is None:
        T_K = given["surroundings"] if given["surroundings"] is not None else given["initial"]
    if T_K is None:
        raise InputError("--back-temperature: is missing; give the temperature behind the wall, such as 21degC")
    return {"h_W_m2K": film or 0.0, "T_K": T_K, "emissivity": emissivity or 0.0}


def _points(_: click.Context, option: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    from sim_heating.templates.quantities import named_quantities

    return named_quantities(values, option.opts[0], "NOSE=0.3")


@new.command("vehicle")
@OUT
@click.option(
    "--length",
    callback=quantity_option("m", "4m"),
    required=True,
    metavar="L",
    help="reference length, such as 4m or 13ft",
)
@click.option(
    "--mass", callback=quantity_option("kg", "3000kg"), required=True, metavar="M", help="mass at entry, such as 3000kg"
)
@click.option(
    "--area",
    callback=quantity_option("m2", "12m2"),
    required=True,
    metavar="A",
    help="reference area of CD, such as 12m2",
)
@click.option(
    "--nose-radius",
    callback=quantity_option("m", "0.5m"),
    required=True,
    metavar="R",
    help="radius of the reference sphere",
)
@click.option(
    "--point",
    "points",
    multiple=True,
    required=True,
    metavar='NAME="LAYER / LAYER"',
    help='a control point and its layers, outermost first, NOSE="LI-900 50 mm / al2024 2 mm"; repeat',
)
@click.option(
    "--place",
    "places",
    multiple=True,
    callback=_points,
    metavar="NAME=X",
    help="its distance from the nose over the length; 0 for the first point",
)
@click.option(
    "--ratio",
    "ratios",
    multiple=True,
    callback=_points,
    metavar="NAME=R",
    help="its heating ratio over the reference sphere; default 1 at the nose, 0.3 elsewhere",
)
@click.option(
    "--surfaces/--no-surfaces",
    default=False,
    show_default=True,
    help="an elevon and a body flap, in tables and records",
)
@click.option(
    "--alpha",
    "alpha_deg",
    type=click.FloatRange(0.0, 60.0),
    default=20.0,
    show_default=True,
    help="angle of attack of the entry in deg",
)
@click.option(
    "--drag-coefficient",
    type=click.FloatRange(0.01, 5.0),
    default=1.3,
    show_default=True,
    help="CD over the reference area",
)
@click.option(
    "--lift-to-drag",
    type=click.FloatRange(0.0, 5.0),
    default=0.3,
    show_default=True,
    help="L/D at that angle of attack",
)
@click.option("--title", default="", help="title of the vehicle")
def vehicle(out: Path, points: tuple[str, ...], places: dict[str, str], ratios: dict[str, str], **given: Any) -> None:
    """Make a vehicle that flies: a directory of materials, control points, ratio tables, aerodynamics and guidance.

    The name of the vehicle is that of the directory. What is not given is estimated, with confidence C. A capsule:

    \b
      sim-heating new vehicle --length 2m --mass 800kg --area 3m2 --nose-radius 1.2m \\
          --point 'NOSE=RCG 0.4 mm / LI-900 60 mm / al2024 3 mm' \\
          --point 'SIDE=inconel625 2 mm' --place SIDE=0.5 --ratio SIDE=0.2 --out pod
    """
    from sim_heating.templates.vehicle import VehicleInput, describe_vehicle, point_inputs, write_new_vehicle

    lengths = {key: given.pop(key) for key in ("length", "mass", "area", "nose_radius")}
    made, notes = write_new_vehicle(
        out,
        VehicleInput(
            point_inputs(points, places, ratios),
            length_m=lengths["length"],
            mass_kg=lengths["mass"],
            area_m2=lengths["area"],
            nose_radius_m=lengths["nose_radius"],
            **given,
        ),
    )
    _print_notes(notes)
    _print_made(
        describe_vehicle(made), out, f"sim-heating new scenario --vehicle {out} --out {out}_flight", notes=notes
    )


@new.command("scenario")
@click.option("--vehicle", required=True, help="name or directory of the vehicle")
@OUT
@click.option("--point", "points", multiple=True, metavar="NAME", help="a control point; repeat; default: all")
@click.option(
    "--altitude", callback=quantity_option("m", "120km"), metavar="H", help="altitude of the entry; default 120 km"
)
@click.option(
    "--speed",
    callback=quantity_option("m/s", "7450m/s"),
    metavar="V",
    help="speed relative to the air; default 7450 m/s",
)
@click.option(
    "--gamma", type=click.FloatRange(-89.0, 10.0), help="path angle in deg; default -1.2 for a glider, else -1.5"
)
@click.option(
    "--until-mach",
    type=click.FloatRange(0.2, 30.0),
    default=2.0,
    show_default=True,
    help="Mach number at which the flight ends",
)
@click.option(
    "--trajectory", type=PATH, metavar="FILE", help="a recorded trajectory in place of the built-in entry, CSV"
)
@click.option("--manoeuvre", is_flag=True, help="fly a pushover-pullup at 6096 m/s (20,000 ft/s)")
@click.option("--title", default="", help="title of the scenario")
def scenario(vehicle: str, out: Path, points: tuple[str, ...], **given: Any) -> None:
    """Make a scenario, DIR/scenario.toml: an entry of a vehicle for `run`, `synthesize` and `plan`.

    \b
      sim-heating new scenario --vehicle pod --out flight
      sim-heating run flight/scenario.toml --out flight/results
    """
    from sim_heating.templates.starters import write_new_scenario

    initial = {"altitude_m": given["altitude"], "velocity_m_s": given["speed"], "gamma_deg": given["gamma"]}
    path = write_new_scenario(
        out,
        vehicle,
        title=given["title"],
        points=points,
        recorded=given["trajectory"],
        initial={name: value for name, value in initial.items() if value is not None},
        stop_mach=given["until_mach"],
        manoeuvre=given["manoeuvre"],
    )
    _print_made(
        f"scenario of {vehicle}",
        path,
        f"sim-heating run {path} --out {out}/run",
        f"sim-heating synthesize {path} --out {out}/records",
    )


@new.command("study")
@click.argument("kind", type=click.Choice(["dispersion", "envelope", "optimal"]))
@click.option("--scenario", type=PATH, required=True, help="the nominal flight; see `sim-heating new scenario`")
@OUT
@click.option(
    "--point", "points", multiple=True, metavar="NAME", help="a control point; repeat; default: those of the scenario"
)
@click.option(
    "--flights", type=click.IntRange(16), default=128, show_default=True, help="flights of a dispersion, a power of two"
)
@click.option("--title", default="", help="title of the study")
def study(kind: str, scenario: Path, out: Path, points: tuple[str, ...], flights: int, title: str) -> None:
    """Make a study of a scenario's flight, DIR/study.toml, for `sim-heating plan`.

    KIND is `dispersion` (peak temperatures of many dispersed entries), `envelope` (margins to the limits over a map of
    flights), or `optimal` (the largest cross-range within the limits).

    \b
      sim-heating new study dispersion --scenario flight/scenario.toml --out study
      sim-heating plan study/study.toml --out study/results
    """
    from sim_heating.cli.path_check import check_path
    from sim_heating.templates.starters import write_new_study

    path = write_new_study(out, kind, scenario, title=title, points=points, flights=flights)
    _print_made(check_path(path).summary, path, f"sim-heating plan {path} --out {out}/results")


@new.command("effect")
@click.argument("name")
@OUT
@click.option(
    "--mode",
    type=click.Choice(["multiply", "add", "emittance"]),
    default="multiply",
    show_default=True,
    help="a factor on the heating ratio, a term of it, or a factor on the emittance",
)
@click.option(
    "--variable",
    default="mach",
    show_default=True,
    help="what it depends on: mach, alpha_deg, beta_deg, log10_re, elevon_deg, bodyflap_deg, time_s, wall_K",
)
@click.option("--vehicle", default="orbiter", show_default=True, help="vehicle of the practice flight")
@click.option("--point", default="WING_LE", show_default=True, help="control point of the practice flight")
def effect(name: str, out: Path, mode: str, variable: str, vehicle: str, point: str) -> None:
    """Make an effect of your own: DIR/NAME.py, a check of it, and a practice flight whose truth has it.

    The folder is then named in SIM_HEATING_EFFECTS; close-loop looks for the effect in any record.

    \b
      sim-heating new effect shock-passage --variable mach --out effects
      export SIM_HEATING_EFFECTS=effects
      python -m pytest effects/checks
    """
    from sim_heating.templates.starters import write_new_effect

    files = write_new_effect(out, name, mode=mode, variable=variable, vehicle=vehicle, point=point)
    module = files[0].stem
    _print_made(
        f"effect {name}: {', '.join(str(f) for f in files)}",
        out,
        f"export SIM_HEATING_EFFECTS={out}",
        f"python -m pytest {out}/checks",
        f"sim-heating synthesize {out}/{module}.toml --out practice",
        "sim-heating close-loop practice --out closed",
        files=files,
    )


def _print_notes(notes: Sequence[str]) -> None:
    CONSOLE.print("Assumed and used:")
    for note in notes:
        CONSOLE.print(f"  {note}", soft_wrap=True)


def _print_made(
    what: str, place: Path, *commands: str, files: Sequence[Path] | None = None, notes: Sequence[str] = ()
) -> None:
    """Print what was made, and the commands that come next; state them for --json.

    files : that were made; all that the command wrote into a directory where None
    """
    from sim_heating.base.files import files_written

    if files is None:
        files = [place] if place.is_file() else sorted(place / name for name in files_written(place))
    report_files(None, files)
    report_results({"made": what, "assumed": list(notes), "next": list(commands)})
    CONSOLE.print(f"Wrote {place}: {what}", soft_wrap=True)
    CONSOLE.print("Next:")
    for command in commands:
        CONSOLE.print(f"  {command}", soft_wrap=True)
