"""Surface temperatures of a host beside those of the simulator: how far they are apart. Uses nothing of sim_heating.

    sim-heating run scenarios/entry_3dof.toml --out run
    python examples/compare_with_run.py ecos.csv run

The CSV file of the host has a time in s (`time_s` or `time`) and columns that end in `POINT.surface_K`, as ecos, FMPy
and the examples of this folder write them; `run` has a folder for each control point.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np

SURFACE = ".surface_K"


def columns(path: Path) -> dict[str, np.ndarray]:
    """Columns of a CSV file by name, each (time,); NaN where a cell is empty."""
    with path.open(newline="") as file:
        names, *rows = csv.reader(file)
    values = np.array([[float(cell or "nan") for cell in row] for row in rows])
    return dict(zip(names, values.T, strict=True))


def main() -> None:
    """Read the command line, print one line a control point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("host", type=Path, help="CSV file that the host wrote")
    parser.add_argument("run", type=Path, help="directory that `sim-heating run` wrote")
    given = parser.parse_args()
    if not given.host.is_file():
        raise SystemExit(f"{given.host}: there is no such file; give the CSV file that the host wrote")
    host = columns(given.host)
    clock = next((host[name] for name in ("time_s", "time") if name in host), None)
    if clock is None:
        raise SystemExit(f"{given.host}: there is no column `time_s` or `time`")
    surfaces = {name.removesuffix(SURFACE).rpartition("::")[2]: name for name in host if name.endswith(SURFACE)}
    both = [point for point in surfaces if (given.run / point / "temperatures.csv").is_file()]
    if not both:
        raise SystemExit(f"{given.run}: has none of the points {', '.join(surfaces)}; fly them in the scenario")
    for point in both:
        flown = columns(given.run / point / "temperatures.csv")
        time_s, own_K = flown["time_s"], flown["surface_K"]
        shared = (time_s >= clock[0]) & (time_s <= clock[-1])
        apart_K = np.interp(time_s[shared], clock, host[surfaces[point]]) - own_K[shared]
        worst = int(np.argmax(np.abs(apart_K)))
        print(
            f"{point}: within {abs(apart_K[worst]):.2f} K over {time_s[shared][-1] - time_s[shared][0]:.0f} s, "
            f"farthest at {time_s[shared][worst]:.0f} s; hottest {np.max(own_K[shared]):.1f} K, "
            f"in the host {np.max(host[surfaces[point]]):.1f} K"
        )


if __name__ == "__main__":
    main()
