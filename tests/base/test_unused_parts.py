"""What a command leaves out of its libraries: not loaded, there when used after all, and no picture differs.

Each deed is done in a process of its own: in that of a test all libraries are loaded.
"""

from __future__ import annotations

import subprocess
import sys

import pytest

from sim_heating.base.unused_parts import without

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


def test_scipy_is_imported_without_numpys_tools_for_tests_and_fortran_and_without_geometry():
    output_of(
        LEAVE_OUT + "import scipy.optimize, scipy.special\n"
        "assert scipy.optimize.brentq(lambda x: x - 2.0, 0.0, 3.0) == 2.0\n"
        "for name in ('unittest', 'numpy.f2py.crackfortran', 'scipy.spatial._ckdtree'):\n"
        "    assert name not in sys.modules, name\n"
    )


def test_what_is_left_out_of_scipy_is_there_when_it_is_used():
    output_of(
        LEAVE_OUT + "import numpy, scipy.optimize, scipy.spatial.distance\n"
        "numpy.testing.assert_allclose(scipy.spatial.distance.euclidean([0.0, 0.0], [3.0, 4.0]), 5.0)\n"
        "assert len(scipy.spatial.KDTree([[0.0], [1.0]]).data) == 2\n"
        "assert callable(numpy.f2py.main)\n"
    )


def test_matplotlib_describes_no_properties_has_no_third_dimension_and_draws_the_same_bytes():
    drawn = output_of(
        LEAVE_OUT + DRAW + "from matplotlib.lines import Line2D\n"
        "assert 'Properties:' not in Line2D.set.__doc__\n"
        "assert 'mpl_toolkits.mplot3d.axes3d' not in sys.modules\n"
    )
    assert drawn.startswith(b"\x89PNG")
    assert drawn == output_of(DRAW)


def test_a_command_that_writes_netcdf_loads_no_array_library_that_it_does_not_use():
    output_of(
        "import sys; from sim_heating.simulation.run import load_writers; load_writers()\n"
        "import netCDF4, xarray\n"
        "assert {'dask', 'pint', 'pyarrow'}.isdisjoint(sys.modules), sorted(sys.modules)\n"
        "import pint\n"  # afterwards it is there for whoever asks
    )


def test_a_program_that_imports_the_package_has_its_libraries_whole():
    output_of(
        "import sys, sim_heating, sim_heating.__main__, matplotlib.figure, scipy.special\n"
        "from matplotlib.lines import Line2D\n"
        "assert 'Properties:' in Line2D.set.__doc__\n"
        "assert 'mpl_toolkits.mplot3d.axes3d' in sys.modules\n"
        "assert type(sys.modules['numpy.f2py']).__name__ == 'module'\n"
    )


def test_a_module_that_is_loaded_stays_loaded_where_others_are_not_found():
    with without("json", "sim_heating.no_such_module", "this"):
        import json

        assert json.loads("1") == 1
        with pytest.raises(ImportError):
            import this  # noqa: F401
    assert "json" in sys.modules
    assert "this" not in sys.modules
