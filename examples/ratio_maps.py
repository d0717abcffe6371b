"""The ratio tables of an FMU as a tool for calibration sees them: sampled maps of FMI-LS-STRUCT. Uses FMPy only.

    sim-heating fmu export orbiter --out heating.fmu
    python examples/ratio_maps.py heating.fmu                       # each map, its axes and its range
    python examples/ratio_maps.py heating.fmu --map NOSECAP.ratio_table --scale 1.2

The second form sets the values of one map before initialization and reads the heating ratio at the start conditions,
as exported and as set.
Nodes, values and operating points come from the terminals of the FMU; `heating.ratio` alone is a name of sim_heating.
"""

from __future__ import annotations

import argparse
import zipfile
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
from fmpy.simulation import instantiate_fmu

KIND = "org.fmi-standard.fmi-ls-struct.map."


class SampledMap(NamedTuple):
    """Names of the variables of a map: nodes of its axes, where it is evaluated on each, values at the nodes."""

    name: str
    text: str
    axes: list[str]
    operating_point: list[str]
    values: str


def sampled_maps(fmu: Path) -> list[SampledMap]:
    """Maps on rectilinear grids that the terminals of an FMU declare; none where it lacks the manifest."""
    with zipfile.ZipFile(fmu) as archive:
        if "extra/org.fmi-standard.fmi-ls-struct/fmi-ls-manifest.xml" not in archive.namelist():
            return []
        root = ET.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
    found = []
    for terminal in root.iter("Terminal"):
        if terminal.get("terminalKind") == f"{KIND}rectilinearGrid":
            members: dict[str, list[str]] = {"domain": [], "domainInput": [], "codomain": []}
            for member in terminal:
                kind = member.get("variableKind", "").removeprefix(KIND)
                members.setdefault(kind, []).append(member.get("variableName", ""))
            name, text = terminal.get("name", ""), terminal.get("description", "")
            found.append(SampledMap(name, text, members["domain"], members["domainInput"], members["codomain"][0]))
    return found


def main() -> None:
    """Read the command line, print the maps, set one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("fmu", type=Path)
    parser.add_argument("--map", help="name of the map to set")
    parser.add_argument("--scale", type=float, default=1.0, help="factor on its values")
    given = parser.parse_args()
    described = fmpy.read_model_description(given.fmu)
    variables = {v.name: v for v in described.modelVariables}
    instance, exported = (instantiate_fmu(fmpy.extract(given.fmu), described, "CoSimulation") for _ in range(2))

    def get(name: str) -> np.ndarray:
        shape = [d.start for d in variables[name].dimensions]
        values = instance.getFloat64([variables[name].valueReference], nValues=int(np.prod(shape, dtype=int)))
        return np.reshape(values, shape)

    for sampled in sampled_maps(given.fmu):
        values = get(sampled.values)
        axes = ", ".join(f"{name.rpartition('.')[2]} {get(name).size}" for name in sampled.axes)
        print(f"{sampled.name}: {axes} nodes; values {values.min():.4g} to {values.max():.4g}")
        if sampled.name == given.map:
            reference = [variables[sampled.values].valueReference]
            instance.setFloat64(reference, (given.scale * values).ravel().tolist())
    if given.map:
        ratio = f"{given.map.rpartition('.')[0]}.heating.ratio"
        reference = [variables[ratio].valueReference]
        for fmu in (exported, instance):
            fmu.enterInitializationMode()
        before, after = (fmu.getFloat64(reference)[0] for fmu in (exported, instance))
        print(
            f"{ratio} at the start conditions: {before:.6g} as exported, {after:.6g} with the map times {given.scale:g}"
        )
    for fmu in (exported, instance):
        fmu.freeInstance()


if __name__ == "__main__":
    main()
