"""What a command leaves out of its libraries: not loaded, there when used after all, and no picture differs.

Each deed is done in a process of its own: in that of a test all libraries are loaded.
"""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from sim_heating.base import unused_parts
from sim_heating.base.unused_parts import without

pytestmark = pytest.mark.thorough

LEAVE_OUT = "import sys; from sim_heating.base.unused_parts import leave_out; leave_out()\n"
DRAW = """
import sys
from sim_heating.base.report.figure import new_figure, picture_file
figure, axes = new_figure(4.0, 3.0, 1)
axes[0].plot([0.0, 1.0, 2.0], [300.0, 900.0, 700.0], label="surface")
axes[0].legend()
axes[0].set(xlabel="time / s", ylabel="temperature / K")
sys.stdout.buffer.write(picture_file(figure, "png"))
"""


def output_of(code: str) -> bytes:
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert found.returncode == 0, found.stderr.decode()
    return found.stdout


def told(code: str, *expressions: str) -> list[object]:
    """Values of expressions after some code, in a process of its own."""
    return list(json.loads(output_of(f"{code}\nimport json, sys\nprint(json.dumps([{', '.join(expressions)}]))\n")))


def loaded(*names: str) -> list[str]:
    """Expressions that tell whether modules are loaded whole."""
    return [f"type(sys.modules.get({name!r})).__name__ == 'module'" for name in names]


GEOMETRY, FORTRAN, TESTS = "scipy.spatial._ckdtree", "numpy.f2py.crackfortran", "numpy.testing._private.utils"
SPACE = "mpl_toolkits.mplot3d.axes3d"
IS_DESCRIBED = "'Properties:' in __import__('matplotlib.lines').lines.Line2D.set.__doc__"


def test_scipy_is_imported_without_numpys_tools_for_tests_and_fortran_and_without_geometry():
    root = "scipy.optimize.brentq(lambda x: x - 2.0, 0.0, 3.0)"
    found = told(f"{LEAVE_OUT}import scipy.optimize, scipy.special", root, *loaded(GEOMETRY, FORTRAN, TESTS))
    assert found == [2.0, False, False, False]


def test_what_is_left_out_of_scipy_is_there_when_it_is_used():
    found = told(
        f"{LEAVE_OUT}import numpy, scipy.optimize, scipy.spatial.distance\nnumpy.testing.assert_allclose(2.0, 2.0)",
        "scipy.spatial.distance.euclidean([0.0, 0.0], [3.0, 4.0])",
        "scipy.spatial.KDTree([[0.0], [1.0]]).n",
        "callable(numpy.f2py.main)",
        *loaded(GEOMETRY, FORTRAN, TESTS),
    )
    assert found == [5.0, 2, True, True, True, True]


def test_matplotlib_describes_no_properties_has_no_third_dimension_and_draws_the_same_bytes():
    assert told(f"{LEAVE_OUT}import matplotlib.figure", IS_DESCRIBED, *loaded(SPACE)) == [False, False]
    drawn = output_of(LEAVE_OUT + DRAW)
    assert drawn.startswith(b"\x89PNG")
    assert drawn == output_of(DRAW)


def test_a_command_that_writes_netcdf_loads_no_array_library_that_it_does_not_use():
    load = "from sim_heating.simulation.run import load_writers; load_writers(); import xarray"
    assert told(LEAVE_OUT + load, *loaded("pint", "pyarrow", "dask", "xarray")) == [False, False, False, True]
    assert told(f"{LEAVE_OUT}{load}; import pint", *loaded("pint")) == [True]
    pytest.importorskip("dask", reason="many processes need Dask: pip install 'sim-heating[plan]'")
    assert told(load, *loaded("dask", "xarray")) == [True, True]


def test_a_program_that_imports_the_package_has_its_libraries_whole():
    load = "import sim_heating, sim_heating.__main__, matplotlib.figure, scipy.optimize"
    assert told(load, IS_DESCRIBED, *loaded(SPACE, GEOMETRY, FORTRAN, TESTS)) == [True] * 5


def test_a_module_that_is_loaded_stays_loaded_where_others_are_not_found(monkeypatch):
    monkeypatch.setattr(unused_parts, "_is_own_process", True)
    with without("json", "this"):
        import json as again

        assert again is json
        with pytest.raises(ImportError):
            import this  # noqa: F401
    assert "json" in sys.modules
    assert "this" not in sys.modules
