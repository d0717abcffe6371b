"""From compiled kernels to a shared library that needs no Python: numba's LLVM IR, llvmlite's objects, a C linker.

numba compiles a kernel to two functions: one of plain arithmetic, and one around it that speaks Python. The first is
kept under a plain C name, the second dropped. What is left may call nothing but the functions of ALLOWED; memory,
printing or an exception in a kernel would need more, and is refused here.

For x86-64 every function is made once for any processor and once for those with AVX2; the wrapper chooses. Results
do not depend on it: the arithmetic is strict, nothing is contracted.

What a compiled model shares with the C wrapper: two arrays, and a function of them.

All numbers of a model stand in one float64 array `R`, all integers in one int64 array `N`. The wrapper (fmu/ at the
top of the repository) knows their first entries, below, and the place of each variable; everything behind them is the
model's own. A model is one function, as most of what its two deeds consist of is the same,

    move(R, N, A) -> outcome      where N[BEGINS] is 1, the initial state at R[NOW], from parameters and inputs;
                                  else from R[NOW] to R[NEXT], inputs linear from INPUTS_NOW to INPUTS_NEXT

with A the addresses of further compiled functions that it calls. An outcome is GOOD or a problem of the image
(image.py) by its number; after a problem the state is as it was.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numba
import numba.extending
from numba import types

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files.package import data_folders
from sim_heating.base.files.text import write_bytes_atomic
from sim_heating.base.kernels.jit import source_digest

ALLOWED = {
    "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil", "copysign", "cos", "cosh",
    "erf", "erfc", "exp", "exp2", "expm1", "fabs", "floor", "fmax", "fmin", "fmod", "frexp", "hypot", "ldexp",
    "lgamma", "log", "log10", "log1p", "log2", "memcpy", "memmove", "memset", "modf", "nearbyint", "pow",
    "remainder", "rint", "round", "sin", "sinh", "sqrt", "tan", "tanh", "tgamma", "trunc",
}  # fmt: skip
"""Functions of C99 that a kernel may call: every platform's libm or libc has them."""
CALLED_INTRINSICS = {"exp10", "fma", "fmuladd", "powi", "roundeven"}
"""Intrinsics `llvm.NAME` that become calls that not every platform has, or round as the machine does (fma). All others
become instructions or calls of ALLOWED; which of them there are depends on what this machine's vectors can do."""
_package_digest = cache(source_digest)


@dataclass(frozen=True)
class Target:
    """A platform.

    triple     : of LLVM
    zig        : of ziglang's linker
    suffix     : of a shared library
    fmi2, fmi3 : folder in `binaries`, None where FMI 2 has none
    levels     : processors to compile for, the most able last; "" where there is one
    """

    triple: str
    zig: str
    suffix: str
    fmi2: str | None
    fmi3: str
    levels: tuple[str, ...] = ("",)

    @property
    def native(self) -> bool:
        """Whether this is the machine that runs now."""
        own = llvm.get_process_triple()
        return self.triple.split("-")[0] == own.split("-")[0] and ("linux" in self.triple) == ("linux" in own)


X86_LEVELS = ("x86-64", "x86-64-v3")
TARGETS: Mapping[str, Target] = {
    "linux": Target("x86_64-unknown-linux-gnu", "x86_64-linux-gnu.2.17", ".so", "linux64", "x86_64-linux", X86_LEVELS),
    "linux-arm64": Target("aarch64-unknown-linux-gnu", "aarch64-linux-gnu.2.17", ".so", None, "aarch64-linux"),
    "windows": Target("x86_64-w64-windows-gnu", "x86_64-windows-gnu", ".dll", "win64", "x86_64-windows", X86_LEVELS),
    "macos": Target("x86_64-apple-macosx11.0", "x86_64-macos", ".dylib", "darwin64", "x86_64-darwin", X86_LEVELS),
    "macos-arm64": Target("arm64-apple-macosx11.0", "aarch64-macos", ".dylib", None, "aarch64-darwin"),
}
"""Platforms by the names that the command takes."""


@dataclass(frozen=True)
class Unit:
    """A function that is compiled into an object file for each processor, with all that it calls by name.

    name      : in C, without the suffix of a level
    signature : numba's
    make      : gives the function, `jit.c_function` of pointers and numbers; not asked where a library or an object is
                in the cache
    more      : what it depends on beside the package's own sources
    """

    name: str
    signature: Any
    make: Callable[[], Any]
    more: str = ""

    @cached_property
    def compiled(self) -> Any:
        """The function, compiled."""
        return self.make()

    def prototype(self, name: str) -> str:
        """Declaration in C under this name."""
        kinds = [_C_TYPES[str(t)] for t in self.signature.args]
        return f"{_C_TYPES[str(self.signature.return_type)]} {name}({', '.join(kinds)});"

    def objects(self, target: Target) -> list[Path]:
        """Where the object files for a platform are kept, one for each level."""
        folder = _folder([self], target)
        return [folder / f"{self.name}_{k}.o" for k in range(len(target.levels))]


_C_TYPES = {"float64": "double", "int64": "int64_t", "none": "void", "float64*": "double *", "int64*": "int64_t *"}
_IR_TYPES = {"float64": "double", "int64": "i64", "none": "void", "float64*": "ptr", "int64*": "ptr"}


def _plain_c(unit: Unit, symbol: str) -> str:
    """IR of the function's plain C face. numba's own: status f(result *, exception **, arguments)."""
    signature = unit.signature
    native = unit.compiled.native_name.removeprefix("cfunc.")
    kinds = [_IR_TYPES[str(t)] for t in signature.args]
    result = _IR_TYPES[str(signature.return_type)]
    given = ", ".join(f"{kind} %a{i}" for i, kind in enumerate(kinds))
    handed = f"ptr %result, ptr %exception, {given}"
    back = "ret void" if result == "void" else f"%value = load {result}, ptr %result\n  ret {result} %value"
    return f"""
define hidden {result} @{symbol}({given}) {{
  %result = alloca i64
  %exception = alloca ptr
  store i64 0, ptr %result
  %status = call i32 @"{native}"({handed})
  {back}
}}
"""


_COUNTING = re.compile(r"^(define [^\n]*@NRT_(?:incref|decref)\([^\n]*\{)\n.*?^\}", re.MULTILINE | re.DOTALL)
_TARGET_LINE = re.compile(r"^target (?:triple|datalayout) = .*$", re.MULTILINE)


def _module_text(unit: Unit, symbol: str) -> str:
    """IR of a unit's function and all that it calls.

    Whether it has just been compiled or comes from the cache: `inspect_llvm` knows only the first. Reference counts
    are left out: all memory is the host's, and a kernel that asked for some would be refused.
    """
    text = str(unit.compiled._library._get_module_for_linking())
    text = _COUNTING.sub(r"\1\n  ret void\n}", _TARGET_LINE.sub("", text))
    return text + _plain_c(unit, symbol)


def _forbidden(module: llvm.ModuleRef) -> list[str]:
    """What a module calls that no host has."""
    called = {f.name for f in module.functions if f.is_declaration}
    intrinsics = {name for name in called if name.startswith("llvm.")}
    return sorted({n for n in intrinsics if n.split(".")[1] in CALLED_INTRINSICS} | (called - intrinsics - ALLOWED))


def object_code(unit: Unit, target: Target, level: str, suffix: str = "") -> bytes:
    """Object file of a compiled function for a platform and a processor.

    suffix : of its name in C
    raises : RunError naming what it calls that a host without Python does not have
    """
    module, machine = _module_and_machine(unit, target, level, suffix)
    forbidden = _forbidden(module)
    if forbidden:
        raise RunError(f"{unit.name}: needs {', '.join(forbidden)}, which a host without Python does not have")
    return bytes(machine.emit_object(module))


def needs(unit: Unit) -> list[str]:
    """What a compiled function calls that a host without Python does not have."""
    target = TARGETS["linux"]
    return _forbidden(_module_and_machine(unit, target, target.levels[0])[0])


def _module_and_machine(unit: Unit, target: Target, level: str, suffix: str = "") -> tuple[llvm.ModuleRef, Any]:
    """A unit's function with what it calls, and nothing else, for a processor; what makes code of it."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=level, opt=3, reloc="pic", codemodel="default"
    )
    symbol = unit.name + suffix
    module = llvm.parse_assembly(_module_text(unit, symbol))
    module.triple, module.data_layout = target.triple, str(machine.target_data)
    for value in [*module.functions, *module.global_variables]:
        if not value.is_declaration and value.name != symbol:
            value.linkage = "internal"
    # numba has optimised the functions already; for the most able processor the whole is looked at once more.
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=1))
    passes = builder.getModulePassManager()
    if level != target.levels[-1]:
        passes = llvm.create_new_module_pass_manager()
        passes.add_global_dead_code_eliminate_pass()
    passes.run(module, builder)
    return module, machine


def sources() -> Path:
    """The folder of the C wrapper: at the top of a checkout, within the package when installed."""
    for folder in data_folders("fmu"):
        if (folder / "wrapper.h").is_file():
            return folder
    raise InputError("the C sources of the FMU wrapper are not here; install the package anew")


def compiler(target: Target) -> list[str]:
    """Command of a C compiler that links for a platform.

    raises : InputError saying what to install
    """
    found = shutil.which("gcc") or shutil.which("cc") or shutil.which("clang")
    if target.native and found:
        return [found]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-target", target.zig]
    what = "a C compiler" if target.native else f"a linker for {target.fmi3}"
    raise InputError(f"fmu: {what} is not here; install one: pip install 'sim-heating[fmu]'")


def _table_of_functions(units: Sequence[Unit], target: Target) -> str:
    """C source that names the functions of each level, the most able one last."""
    levels = range(len(target.levels))
    lines = ['#include "wrapper.h"']
    lines += [unit.prototype(f"{unit.name}_{k}") for unit in units for k in levels]
    model, *called = units
    for k in levels:
        addresses = ", ".join(f"(int64_t)(intptr_t){unit.name}_{k}" for unit in called) or "0"
        lines.append(f"static int64_t called_{k}[] = {{{addresses}}};")
    rows = ", ".join(f"{{{model.name}_{k}, called_{k}}}" for k in levels)
    lines += [f"const Model models[] = {{{rows}}};", f"const int n_models = {len(target.levels)};", ""]
    return "\n".join(lines)


def _folder(units: Sequence[Unit], target: Target) -> Path:
    """Place in the cache by all that a library or an object is made of."""
    digest = hashlib.sha256()
    for part in (_package_digest(), numba.__version__, llvmlite.__version__, repr(target)):
        digest.update(part.encode())
    for unit in units:
        digest.update(f"{unit.name} {unit.more}".encode())
    for path in (*sorted(sources().glob("*.[ch]")), Path(inspect.getfile(object_code))):
        digest.update(path.read_bytes())
    return Path(numba.config.CACHE_DIR) / "fmu" / digest.hexdigest()[:24]  # type: ignore[attr-defined]


def library(units: Sequence[Unit], target: Target) -> Path:
    """The shared library of a model for a platform, made where it is not in the cache.

    units  : the model (native.py), and what it calls through addresses, in the order of `A`
    raises : InputError where there is no compiler, RunError where a function cannot be made or linked
    """
    folder = _folder(units, target)
    made = folder / f"model{target.suffix}"
    if made.is_file():
        return made
    command = compiler(target)
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as work:
        partial = Path(work) / made.name
        _link(units, target, command, Path(work), partial)
        partial.replace(made)
    return made


def objects(unit: Unit, target: Target) -> list[Path]:
    """Object files of a unit for each processor of a platform, made where they are not in the cache.

    raises : RunError where a function cannot be made
    """
    found = unit.objects(target)
    for k, (path, level) in enumerate(zip(found, target.levels, strict=True)):
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes_atomic(path, object_code(unit, target, level, f"_{k}"))
    return found


def parts(units: Sequence[Unit], target: Target, folder: Path) -> list[Path]:
    """What a library has beside the wrapper: objects, and the table of functions, written to a folder."""
    found = [path for unit in units for path in objects(unit, target)]
    table = folder / "functions.c"
    table.write_text(_table_of_functions(units, target))
    return [table, *found]


def wrapper_sources() -> list[Path]:
    """The C files of the wrapper."""
    return sorted(sources().glob("*.c"))


def wrapper(target: Target) -> list[Path]:
    """Object files of the C wrapper, which all libraries share, made where they are not in the cache.

    raises : InputError where there is no compiler, RunError where it fails
    """
    command = compiler(target)
    name = "zig" if "ziglang" in command else Path(command[0]).name
    folder = _folder([], target)
    made = [folder / f"{source.stem}_{name}.o" for source in wrapper_sources()]
    folder.mkdir(parents=True, exist_ok=True)
    for source, out in zip(wrapper_sources(), made, strict=True):
        if not out.is_file():
            with tempfile.TemporaryDirectory(dir=folder) as work:
                partial = Path(work) / out.name
                _run_compiler([*command, "-c", *_flags(target), "-o", partial, source], target, "compiling")
                partial.replace(out)
    return made


def _flags(target: Target) -> list[str]:
    flags = ["-O2", "-std=c11", "-ffp-contract=off", "-fvisibility=hidden", f"-I{sources()}"]
    return flags if "windows" in target.triple else [*flags, "-fPIC"]


def _link(units: Sequence[Unit], target: Target, command: Sequence[str], work: Path, out: Path) -> None:
    needed = [] if "windows" in target.triple else ["-lm"]
    needed += ["-Wl,-z,defs", "-Wl,-s"] if "linux" in target.triple else []
    files = [*parts(units, target, work), *wrapper(target)]
    _run_compiler([*command, "-shared", *_flags(target), "-o", out, *files, *needed], target, "linking")


def _run_compiler(command: Sequence[str | Path], target: Target, what: str) -> None:
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RunError(f"fmu: {what} for {target.fmi3} failed: {done.stderr.strip()}")


__all__ = ["FUNCTION", "GOOD", "at", "source_digest"]

GOOD = -1
"""Outcome of a function that has no problem."""

# First numbers of R.
NOW, NEXT = 0, 1
"""Time that the state is at, and the end of the step asked for [s]."""
R_HEAD = 8

# First integers of N: where the inputs stand in R, how many there are; where their values at the start and at the end
# of a step stand, and their slopes; whether a parameter has been set since the last step; what a given input means;
# whether the model begins.
INPUTS, N_INPUTS, INPUTS_NOW, INPUTS_NEXT, INPUT_SLOPES, CHANGED, TIMING, BEGINS = range(8)
I_HEAD = 8
HELD, REACHED = 1, 2
"""An input is given as it is at the start of the step, and held unless its host says more; or as it is at the end, and
reached along a straight line."""

FUNCTION = types.int64(types.CPointer(types.float64), types.CPointer(types.int64), types.CPointer(types.int64))
"""A model as C sees it."""


@numba.extending.intrinsic
def _at(_typing_context, pointer, first):  # type: ignore[no-untyped-def]

    def codegen(_context, builder, _signature, args):  # type: ignore[no-untyped-def]
        return builder.gep(args[0], [args[1]])

    return pointer(pointer, types.int64), codegen


at: Any = _at
"""at(pointer, first): the pointer to a later number of an array."""
