"""The commands `sim-heating new record`, `vehicle`, `scenario`, `effect` and `study`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sim_heating.base.errors import InputError
from sim_heating.cli.console import CONSOLE, OUT, PATH, print_table

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
    metavar="FLUX|COLUMN|FILE",
    help="what heats the wall: a flux such as 20kW/m2, a column of the CSV file, or a CSV file of its own",
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
    CONSOLE.print("Assumed and used:")
    for note in notes:
        CONSOLE.print(f"  {note}", soft_wrap=True)
    CONSOLE.print(f"Wrote {out}: {describe_record(made)}", soft_wrap=True)
    CONSOLE.print("Next:")
    for command in ("predict", "estimate", "close-loop"):
        CONSOLE.print(f"  sim-heating {command} {out} --out {out}_{command.replace('-', '_')}", soft_wrap=True)


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
