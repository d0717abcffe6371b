"""A system of FMUs (SSP) in another host: ecos flies the entry and heats the vehicle. Uses nothing of sim_heating.

    pip install ecospy tbb
    sim-heating fmu export orbiter --ssp orbiter.ssp --trajectory scenarios/entry_3dof.toml --control-points V09T9527
    python examples/ssp_in_ecos.py orbiter.ssp --step 0.25 --out ecos.csv

In each step ecos moves both FMUs at once and then passes the outputs on: the heating works with the conditions at the
start of a step. This delays its temperatures by half a step; smaller steps make the error smaller in proportion.
"""

from __future__ import annotations

import argparse
import csv
import ctypes
import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree as ET

SSD = "{http://ssp-standard.org/SSP1/SystemStructureDescription}"
PARAMETERS = "parameters"
"""Name of the parameter sets in the system; ecos applies those that it is given."""


def described(system: Path) -> tuple[list[str], float]:
    """Identifiers of the outputs of all components, as ecos names them, and the stop time of the experiment [s]."""
    if system.is_dir():
        text = (system / "SystemStructure.ssd").read_bytes()
    else:
        with zipfile.ZipFile(system) as archive:
            text = archive.read("SystemStructure.ssd")
    root = ET.fromstring(text)
    names = [
        f"{component.get('name')}::{connector.get('name')}"
        for component in root.iter(f"{SSD}Component")
        for connector in component.iter(f"{SSD}Connector")
        if connector.get("kind") == "output"
    ]
    experiment = root.find(f"{SSD}DefaultExperiment")
    return names, float(experiment.get("stopTime", "nan")) if experiment is not None else float("nan")


def load_tbb() -> None:
    """Load the oneTBB that pip installs, which the library of ecos needs and the system may not have."""
    library = Path(sys.prefix) / "lib" / "libtbb.so.12"
    if library.is_file():
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)


def simulate(system: Path, names: list[str], step_s: float, until_s: float) -> list[list[float]]:
    """Rows of time and the named outputs at every communication point."""
    load_tbb()
    from ecospy import EcosSimulation

    with EcosSimulation(step_size=step_s, ssp_path=str(system)) as simulation:
        if not simulation.init(parameter_set=PARAMETERS):
            raise SystemExit("ecos could not initialise the system")
        rows = []
        for k in range(round(until_s / step_s) + 1):
            if k > 0:
                simulation.step()
            rows.append([simulation.get_time(), *(simulation.get_real(name) for name in names)])
        simulation.terminate()
        return rows


def main() -> None:
    """Read the command line, simulate, write a CSV, print the hottest temperatures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("system", type=Path, help="a .ssp file, or the folder of an unpacked one")
    parser.add_argument("--step", type=float, default=0.25, help="communication step in s")
    parser.add_argument("--until", type=float, help="end in s; default: that of the system's experiment")
    parser.add_argument("--out", type=Path, default=Path("ecos.csv"))
    given = parser.parse_args()
    if not given.system.exists():
        raise SystemExit(f"{given.system}: there is no such file; `sim-heating fmu export VEHICLE --ssp` writes one")
    names, stop_s = described(given.system)
    rows = simulate(given.system, names, given.step, stop_s if given.until is None else given.until)
    with given.out.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", *names])
        writer.writerows(rows)
    for k, name in enumerate(names, start=1):
        if name.endswith(".surface_K"):
            hottest = max(rows, key=lambda row: row[k])
            print(f"{name}: {hottest[k]:.1f} K at {hottest[0]:.1f} s")
    print(f"Wrote {given.out}: {len(rows)} rows")


if __name__ == "__main__":
    main()
