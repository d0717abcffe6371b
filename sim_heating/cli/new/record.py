"""The command `sim-heating new record`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from sim_heating.base.errors import InputError
from sim_heating.cli.console import CONSOLE, OUT, PATH, print_table
from sim_heating.cli.named_values import named_texts
from sim_heating.cli.new.options import (
    flight_options,
    fraction_option,
    interactive,
    quantity_option,
    title_option,
    two_times,
)
from sim_heating.cli.new.printing import print_made, print_notes

if TYPE_CHECKING:
    from sim_heating.templates.materials import LayerInput
    from sim_heating.templates.measured_csv import MeasuredCsv

OF_REFERENCE = ("reference_length", "nose_radius", "running_length", "sweep", "local_angle", "recovery")
_OF_WALL = ("layer", "lamp", "lit", "absorptance", "emissivity", "initial", "surroundings", "pressure", "point")
_OF_BACK = ("back-film", "back-temperature", "back-emissivity")
_OF_FLIGHT = ("conditions", "field", "atmosphere", "reference", "ratio", "ratio-table", *OF_REFERENCE)
OF_THE_OTHER_RECORD = tuple(f"--{name.replace('_', '-')}" for name in (*_OF_WALL, *_OF_BACK, *_OF_FLIGHT))
"""Options of the stack, the flight and the heating, which `--like` takes from its record."""


@click.command("record")
@click.option(
    "--csv",
    "csv_file",
    type=PATH,
    required=True,
    metavar="FILE",
    help="file of temperatures, CSV or another table of a logger: a time and one column a thermocouple",
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
    callback=named_texts("TC1=0.4mm"),
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
    callback=two_times,
    metavar="ON,OFF",
    help="times in s at which a constant lamp was lit; default: throughout",
)
@fraction_option("--absorptance", "absorbed part of the flux; default: it is the absorbed flux")
@fraction_option("--emissivity", "emittance of the heated surface; default: of its material")
@quantity_option("--initial", "K", "initial_K", "21degC", "T", "temperature at the start; default: the first readings")
@quantity_option("--surroundings", "K", "T_K", "21degC", "T", "what the surface radiates to; default: as --initial")
@quantity_option(
    "--back-film", "W/m2K", "h_W_m2K", "8W/m2K", "H", "film coefficient behind the wall; default: adiabatic"
)
@quantity_option(
    "--back-temperature", "K", "T_K", "21degC", "T", "temperature behind the wall; default: as --surroundings"
)
@fraction_option("--back-emissivity", "emittance of the back face; default: adiabatic")
@quantity_option(
    "--pressure", "Pa", "p_surface_Pa", "1013hPa", "P", "air pressure, for porous insulation; default: sea level"
)
@click.option(
    "--conditions", "flight", type=PATH, help="a flight in place of a lamp: CSV or JSON lines, names with units"
)
@flight_options
@quantity_option(
    "--reference-length", "m", "reference_length_m", "1m", "L", "of the Reynolds number; default: that of a metre"
)
@click.option(
    "--reference", help="model of reference heating of that flight; default: its columns h_ref_kg_m2_s, H_r_J_kg"
)
@click.option("--ratio", type=float, help="constant heating ratio of that flight, over its reference heating")
@click.option("--ratio-table", "ratio_table", type=PATH, help="CSV file of its heating ratio, copied into the record")
@quantity_option("--nose-radius", "m", "nose_radius_m", "0.3m", "R", "radius of the reference sphere or cylinder")
@quantity_option(
    "--running-length", "m", "running_length_m", "0.8m", "X", "distance from the leading edge, for a flat plate"
)
@quantity_option("--sweep", "deg", "sweep_deg", "45deg", "ANGLE", "sweep of the reference cylinder")
@quantity_option(
    "--local-angle", "deg", "local_angle_deg", "5deg", "ANGLE", "of the surface to the x axis: its pressure, its edge"
)
@click.option(
    "--recovery",
    type=click.Choice(["total", "edge-laminar", "edge-turbulent", "attachment-line"]),
    help="enthalpy that the ratio is reduced with; default: that of --reference",
)
@click.option(
    "--like",
    type=PATH,
    metavar="RECORD",
    help="stack, flight and heating of this record, in place of --layer and --lamp",
)
@click.option("--time", "time", metavar="COLUMN", help="column of the time, where the guess is wrong")
@click.option("--time-unit", metavar="UNIT", help="its unit: s, ms, min, h; of a clock hh:mm, mm:ss")
@quantity_option("--period", "s", "period_s", "0.1s", "T", "time between rows, where there is no column of it")
@click.option(
    "--temperature",
    "temperatures",
    multiple=True,
    metavar="COLUMN",
    help="column of a temperature; repeat; others are left out",
)
@click.option("--temperature-unit", metavar="UNIT", help="unit of the temperatures: K, degC, degF")
@click.option("--flux-unit", metavar="UNIT", help="unit of a column of heat flux: W/m2, kW/m2, BTU/ft2-s")
@click.option(
    "--thermocouple",
    type=click.Choice(["B", "E", "J", "K", "N", "R", "S", "T"]),
    help="type of the thermocouples whose emf, in mV or V, the file holds (ITS-90)",
)
@click.option(
    "--reference-junction",
    metavar="TEMPERATURE|COLUMN",
    help="temperature of their terminals, 25degC, or the column of it; 0degC for an ice bath",
)
@click.option("--separator", metavar="SIGN", help="between cells: `;`, `,`, tab, blank")
@click.option("--decimal", type=click.Choice([".", ","]), help="decimal sign; the other one is that of thousands")
@click.option("--dates", type=click.Choice(["day-first", "month-first", "year-first"]), help="order of dates")
@click.option("--lost", metavar="NUMBERS", help="readings that stand for a lost sample: --lost=-9999,9.9E37")
@click.option(
    "--repeated", type=click.Choice(["spread", "first"]), help="rows of one time: even until the next, or the first one"
)
@click.option(
    "--sheet", metavar="NAME", help="sheet of a workbook, group of a TDMS file, or segment of an LVM file, by number"
)
@click.option("--layout", "layout_file", type=PATH, metavar="FILE", help="layout that was kept of another file (TOML)")
@click.option("--keep-layout", type=PATH, metavar="FILE", help="write the layout of this file, for --layout")
@quantity_option(
    "--noise", "K", "noise_sigma_K", "0.5K", "SIGMA", "random error of the thermocouples in K; default: estimated"
)
@click.option("--point", default="plate", show_default=True, help="name of the place that was measured")
@title_option("record")
@click.option("--synthetic", is_flag=True, help="the temperatures are computed, not measured")
def new_record(csv_file: Path, out: Path, layers: tuple[str, ...], depths: dict[str, str], **options: Any) -> None:
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
    from sim_heating.templates.loggers.layout_file import write_layout

    if options["like"] is not None:
        _refuse_with_like()
    if options["period"] is not None and not options["period"] > 0.0:
        raise InputError("--period: must be above 0")
    measured = _read_csv(csv_file, options)
    depths = {measured.name_of(name): depth for name, depth in depths.items()}
    print_table(measured.table())
    print_table(measured.first_rows())
    if options["like"] is not None:
        record, notes = maker.like_record(
            out,
            options["like"],
            measured,
            depths,
            options["title"],
            options["noise"],
            is_measured=not options["synthetic"],
        )
    else:
        record, notes = maker.write_new_record(out, measured, _record_input(measured, layers, depths, options))
    if options["keep_layout"] is not None:
        notes.append(f"layout of {csv_file.name} kept in {options['keep_layout']}: --layout reads the next files by it")
        write_layout(options["keep_layout"], measured.stated, csv_file.name, depths)
    print_notes(notes)
    commands = ["estimate", "close-loop"] if record.lacks_ratio else ["predict", "estimate", "close-loop"]
    lines = (f"sim-heating {c} {out} --out {out}_{c.replace('-', '_')}" for c in commands)
    print_made(describe_record(record), out, *lines, notes=notes)


def _read_csv(csv_file: Path, options: dict[str, Any]) -> MeasuredCsv:
    from sim_heating.templates.loggers.layout_file import read_layout
    from sim_heating.templates.measured_csv import lost_values, read_measured_csv

    signs = {None: None, "tab": "\t", "blank": " "}
    return read_measured_csv(
        csv_file,
        time=options["time"],
        time_unit=options["time_unit"],
        temperatures=options["temperatures"],
        temperature_unit=options["temperature_unit"],
        flux_unit=options["flux_unit"],
        thermocouple=options["thermocouple"],
        reference_junction=options["reference_junction"],
        period_s=options["period"],
        separator=signs.get(options["separator"], options["separator"]),
        decimal=options["decimal"],
        dates=options["dates"],
        lost=() if options["lost"] is None else lost_values(options["lost"]),
        repeated=options["repeated"],
        sheet=options["sheet"],
        layout=None if options["layout_file"] is None else read_layout(options["layout_file"]),
        flux=options["lamp"],
    )


def _record_input(
    measured: MeasuredCsv, layers: tuple[str, ...], depths: dict[str, str], options: dict[str, Any]
) -> Any:
    """What a record is made of beside its readings; depths : by column."""
    from sim_heating.templates import record as maker

    stack = _stack(layers)
    sensors = maker.sensor_columns(measured)
    depths_m = maker.depths_of(measured, depths, stack)
    depths_m |= _asked_depths([s.name for s in sensors if s.name not in depths_m], stack, measured.path)
    return maker.RecordInput(
        stack,
        depths_m,
        _heat(measured, options),
        title=options["title"],
        point=options["point"],
        measured=not options["synthetic"],
        emissivity=options["emissivity"],
        initial_K=options["initial"],
        surroundings_K=options["surroundings"],
        back=_back(options, measured),
        noise_K=options["noise"],
        pressure_Pa=options["pressure"],
        nose_radius_m=options["nose_radius"],
        running_length_m=options["running_length"],
        sweep_deg=options["sweep"],
        local_angle_deg=options["local_angle"],
        recovery=options["recovery"],
        ratio=options["ratio"],
        ratio_table=options["ratio_table"],
    )


def _refuse_with_like() -> None:
    """Refuse what `--like` would leave unused."""
    context = click.get_current_context()
    for option in context.command.params:
        is_given = context.get_parameter_source(option.name or "") is ParameterSource.COMMANDLINE
        if is_given and option.opts[0] in OF_THE_OTHER_RECORD:
            raise InputError(f"{option.opts[0]}: comes from the record of --like; leave one of the two out")


def _stack(layers: Sequence[str]) -> list[LayerInput]:
    """Layers of the options; asked for on a terminal where there are none."""
    from sim_heating.templates.materials import layer_input, material_library

    if not layers and interactive():
        CONSOLE.print(f"Materials: {', '.join(sorted(material_library()))}")
        answers: list[str] = []
        while text := click.prompt(
            f"Layer {len(answers) + 1}, such as copper 3 mm (empty: no more)", default="", show_default=False
        ):
            answers.append(text)
        layers = answers
    if not layers:
        materials = ", ".join(sorted(material_library()))
        raise InputError(
            "--layer: is missing; give the layers from the heated surface inward, as "
            f'--layer "copper 3 mm"; materials: {materials}'
        )
    return [layer_input(text) for text in layers]


def _asked_depths(names: Sequence[str], stack: Sequence[LayerInput], path: Path) -> dict[str, float]:
    """Depths [m] of the sensors without one: asked for on a terminal, else an error that names the option."""
    from sim_heating.base.files import display_path
    from sim_heating.templates.record import depth_m

    if names and not interactive():
        options = " ".join(f"--depth {name}=0.4mm" if " " not in name else f'--depth "{name}=0.4mm"' for name in names)
        raise InputError(
            f"--depth: is missing for {', '.join(names)} of {display_path(path)}; give the depth from the heated "
            f"surface, `surface` or `back`: {options}"
        )
    answers = {n: click.prompt(f"Depth of {n} from the heated surface (0.4mm, surface, back)") for n in names}
    return {name: depth_m(text, stack, f"--depth {name}={text}") for name, text in answers.items()}


def _heat(measured: MeasuredCsv, options: dict[str, Any]) -> Any:
    """What heats the wall: the option --lamp or --conditions, else the only column of a heat flux."""
    from sim_heating.templates.measured_csv import FLUX
    from sim_heating.templates.record import flown_heat, lamp_heat

    lamp = options["lamp"]
    if options["flight"] is not None:
        if lamp is not None:
            raise InputError("--lamp: goes with a test on the ground, --conditions with a flight; give one of the two")
        for name in ("lit", "absorptance"):
            if options[name] is not None:
                raise InputError(f"--{name}: is of a lamp; leave it out, or --conditions")
        return flown_heat(
            options["flight"],
            options["reference"],
            fields=options["fields"],
            atmosphere=options["atmosphere"],
            reference_length_m=options["reference_length"],
            local_angle_deg=options["local_angle"],
            has_pressure=options["pressure"] is not None,
        )
    _refuse_without_flight(options)
    lamp = _lamp_of([c.name for c in measured.of_kind(FLUX)]) if lamp is None else measured.name_of(lamp)
    return lamp_heat(measured, lamp, options["lit"], options["absorptance"])


def _lamp_of(fluxes: Sequence[str]) -> str:
    """The only column of a heat flux; else asked for on a terminal, or an error that names the option."""
    if len(fluxes) == 1:
        return fluxes[0]
    if interactive():
        return str(click.prompt("Flux that heats the wall (20kW/m2, a column, or a CSV file)"))
    candidates = f"the columns {', '.join(fluxes)} may be it" if fluxes else "no column is a heat flux"
    raise InputError(
        f"--lamp: is missing, and {candidates}; give a flux such as --lamp 20kW/m2, a column, or a CSV file with a "
        "time and a flux"
    )


def _refuse_without_flight(options: dict[str, Any]) -> None:
    """Refuse options of a flight where there is none.

    raises : InputError with the first of them
    """
    for name in ("fields", "atmosphere", "reference", *OF_REFERENCE):
        if options[name] not in (None, {}):
            option = "--field" if name == "fields" else f"--{name.replace('_', '-')}"
            raise InputError(f"{option}: is of a flight; give --conditions FLIGHT.csv, or leave it out")


def _back(options: dict[str, Any], measured: MeasuredCsv) -> dict[str, float] | None:
    """Keys of a cooled back face; None for an adiabatic one."""
    film, emissivity, T_K = options["back_film"], options["back_emissivity"], options["back_temperature"]
    if film is None and emissivity is None:
        if T_K is not None:
            raise InputError("--back-temperature: needs --back-film or --back-emissivity, by which the back face cools")
        return None
    if T_K is None:
        T_K = options["surroundings"] if options["surroundings"] is not None else options["initial"]
    if T_K is None:
        raise InputError("--back-temperature: is missing; give the temperature behind the wall, such as 21degC")
    return {"h_W_m2K": film or 0.0, "T_K": T_K, "emissivity": emissivity or 0.0}
