"""`python -m tools.gas_table`: compute heating/data/equilibrium_air.csv again; needs Cantera 3.

Air is that of tests/support/gas; the file's first lines are `gas_table_head.txt`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np

from sim_heating.base.files.package import PACKAGE
from tests.support.gas.cantera_air import Air

TABLE = PACKAGE / "heating" / "data" / "equilibrium_air.csv"
LOG_P = np.arange(0.0, 6.01, 0.25)
T_AXIS = np.arange(200.0, 12001.0, 50.0)


def lines(air: Air) -> Iterator[str]:
    """Rows of the table."""
    for log_p in LOG_P:
        p = float(10.0**log_p)
        for T in map(float, T_AXIS):
            h, Z, formation = air.thermodynamics(T, p)
            t, sound = air.transport(T, p), air.sound(T, p)
            yield (
                f"{log_p:.2f},{T:.0f},{h:.0f},{Z:.6f},{formation:.0f},"
                f"{t.viscosity_Pa_s:.4e},{t.viscosity_sigma:.3f},{t.prandtl:.3f},{t.prandtl_sigma:.3f},{sound:.3f}"
            )


@click.command(help="Compute the table of equilibrium air that ships with the package.")
@click.option("--out", type=click.Path(path_type=Path), default=TABLE, show_default=True)
def main(out: Path) -> None:
    """Compute and write."""
    head = Path(__file__).with_name("gas_table_head.txt").read_text(encoding="utf-8")
    out.write_text(head + "\n".join(lines(Air())) + "\n", encoding="utf-8")
    click.echo(out)


if __name__ == "__main__":
    main()
