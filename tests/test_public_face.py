"""What a user imports: `import sim_heating as sh` and its names, each documented by an example that runs."""

from __future__ import annotations

import ast
import doctest
import importlib
import json
import pkgutil
import re
import subprocess
import sys

import pytest

import sim_heating as sh
from tests.support.paths import ROOT

NAMES = (
    "load_vehicle", "load_scenario", "load_record", "run", "synthesize", "predict", "estimate", "close_loop",
    "stated_error",
    "update_tables", "plan", "design", "HeatingPlugin", "export_fmu", "export_ssp", "Effect", "effects", "InputError",
    "RunError", "__version__",
)  # fmt: skip
"""Names that every release keeps."""
FUNCTIONS = sorted(n for n in sh.__all__ if n.islower() and callable(getattr(sh, n)))
HEAVY = ("numpy", "scipy", "numba", "matplotlib", "pandas", "xarray", "pydantic", "jsbsim", "fmpy")


def python(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout


def import_everything() -> None:
    for module in pkgutil.walk_packages(sh.__path__, "sim_heating."):
        if module.name != "sim_heating.__main__":
            importlib.import_module(module.name)


def test_the_promised_names_are_there():
    assert set(NAMES) <= set(sh.__all__)
    assert set(dir(sh)) == set(sh.__all__)


def test_importing_the_package_imports_nothing_heavy():
    loaded = json.loads(python("import json, sys, sim_heating; dir(sim_heating); print(json.dumps(list(sys.modules)))"))
    assert not set(HEAVY) & set(loaded)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="simulate"):
        sh.simulate  # noqa: B018


@pytest.mark.thorough
@pytest.mark.parametrize("name", [n for n in NAMES if n != "__version__"])
def test_the_example_of_a_public_name_runs(name: str, monkeypatch: pytest.MonkeyPatch):
    """With every module of the package imported: that binds the name of a subpackage in the package above, and a folder
    with the name of a function would hide it.
    """
    monkeypatch.chdir(ROOT)
    example = doctest.DocTestParser().get_doctest(getattr(sh, name).__doc__ or "", {}, name, None, 0)
    assert example.examples, f"{name} has no example"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    said: list[str] = []
    import_everything()
    assert runner.run(example, out=said.append).failed == 0, "".join(said)


def test_no_module_hides_a_public_name():
    before = {name: getattr(sh, name) for name in sh.__all__}
    import_everything()
    assert {name: getattr(sh, name) for name in sh.__all__} == before


def shown_to_users():
    """Python that a user reads: blocks of the pages, and the examples."""
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))):
        for k, block in enumerate(re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)):
            yield pytest.param(block, id=f"{page.name}-{k}")
    for path in sorted((ROOT / "examples").rglob("*.py")):
        yield pytest.param(path.read_text(), id=path.relative_to(ROOT).as_posix())


@pytest.mark.parametrize("code", list(shown_to_users()))
def test_what_users_are_shown_uses_the_public_face_alone(code: str):
    tree = ast.parse(code)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("sim_heating"):
            assert node.module in ("sim_heating", "sim_heating.live"), f"line {node.lineno}: {node.module}"
            assert {a.name for a in node.names} <= set(importlib.import_module(node.module).__all__)
        elif isinstance(node, ast.Import):
            assert not [a.name for a in node.names if a.name.startswith("sim_heating.")]
    aliases = {a.asname or a.name for n in ast.walk(tree) if isinstance(n, ast.Import)
               for a in n.names if a.name == "sim_heating"}  # fmt: skip
    used = {
        n.attr
        for n in ast.walk(tree)
        if isinstance(n, ast.Attribute) and isinstance(n.value, ast.Name) and n.value.id in aliases
    }
    assert used <= set(sh.__all__)


def test_paths_that_pages_name_exist():
    """Files in backticks: of the repository, or of the package. A decision names the files of its day."""
    wrong = []
    pages = [p for p in sorted((ROOT / "docs").rglob("*.md")) if not {"decisions", "_build"} & set(p.parts)]
    for page in (ROOT / "README.md", *pages):
        for path in re.findall(r"`((?:[\w.-]+/)+[\w.-]+\.(?:py|toml|c|h))`", page.read_text()):
            places = [ROOT / path, ROOT / "sim_heating" / path]
            tops = {p.name for root in (ROOT, ROOT / "sim_heating") for p in root.iterdir()}
            if path.split("/")[0] in tops and not any(p.is_file() for p in places):
                wrong.append(f"{page.name}: {path}")
    assert not wrong, "\n".join(wrong)


def test_what_a_user_loads_has_a_representation_of_one_line():
    scenarios = ROOT / "scenarios"
    loaded = [
        sh.load_vehicle("capsule"),
        sh.load_scenario(scenarios / "recorded_sts107.toml"),
        sh.load_record(scenarios / "records" / "practice" / "p06"),
    ]
    assert [repr(x) for x in loaded] == [
        "<Vehicle 'capsule', revision 1: 4 control points>",
        "<Scenario 'Recorded trajectory: STS-107 early entry': orbiter, 4 control points>",
        "<Record 'p06' of LS: 2 sensors, 0 to 1453 s>",
    ]
