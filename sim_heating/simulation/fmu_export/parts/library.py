"""From compiled kernels to a shared library that needs no Python: numba's LLVM IR, llvmlite's objects, a C linker.

numba compiles a kernel to two functions: one of plain arithmetic, and one around it that is called from Python. The
first is kept under a plain C name, the second dropped. The first may call the functions of ALLOWED_CALLS only; a kernel
that allocates memory, prints or raises needs others and is refused.

For x86-64 every function is compiled once for any processor and once for those with AVX2; the wrapper chooses. Results
do not depend on it: the arithmetic is strict, without contraction to fused operations.

A compiled model shares arrays with the C wrapper (fmu/ at the top of the repository): its numbers `R` (float64), its
integers `N` (int64) and its tables `T` (float64), which never change. The wrapper uses the first entries of R and N,
below, and the place of each variable; all others belong to the model. A model is one function, as start and step have
most of their code in common,

    advance(R, N, A, T) -> outcome   where N[MODE] is STEP, advance the state from R[NOW] to R[NEXT], inputs linear from
                                     INPUTS_NOW to INPUTS_NEXT; where it is START, set the initial state at R[NOW] from
                                     parameters and inputs; where it is RESUME, make good what depends on the kept runs
                                     of R and N: those of one instance have replaced those of another

with A the addresses of further compiled functions that it calls. An outcome is GOOD or the number of a problem of the
image (image.py); after a problem the state is of no use. Instances work in turns in the same R and N: what is not kept
(image.py) has to be constant, or to be written before it is read, or to be a cache that says what it holds.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
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
from numba import types

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files.package import data_folders
from sim_heating.base.files.text import write_bytes_atomic
from sim_heating.base.kernels.cache_folder import source_digest
from sim_heating.base.kernels.compiler import CACHE
from sim_heating.base.kernels.numba_private import plain_entry_ir, pointer_offset, portable_ir, signature_of

# What a model shares with the C wrapper ------------------------------------------------------------------------------

GOOD = -1
"""Outcome of a model without a problem."""

# First numbers of R.
NOW, NEXT, LONGEST = 0, 1, 2
"""Times of the state and of the end of the step [s]; longest communication step [s]."""
R_HEAD = 8
LONGEST_COMMUNICATION_S = 600.0
"""Longest communication step [s]; a longer one is refused, as that of a clock in other units."""

# First integers of N: place of the inputs in R and their number; places of their values at the start and at the end of
# a step, and of their slopes; 1 where a parameter has been set since the last step; timing of the inputs; what the
# model is to do; the timing again, 0 where the first one counts.
INPUTS, N_INPUTS, INPUTS_NOW, INPUTS_NEXT, INPUT_SLOPES, CHANGED, TIMING, MODE, TIMING_INTEGER = range(9)
I_HEAD = 9
STEP, START, RESUME = 0, 1, 2
"""Values of MODE."""
HELD, REACHED = 1, 2
"""Timing of inputs: values at the start of a step, held over it unless the host gives derivatives or later values; or
values at its end, reached along a straight line."""

MODEL_SIGNATURE = types.int64(
    types.CPointer(types.float64),
    types.CPointer(types.int64),
    types.CPointer(types.int64),
    types.CPointer(types.float64),
)
"""Signature of a model in C: addresses of R, N, A and T; its outcome."""


at: Any = pointer_offset
"""at(pointer, first): the pointer to a later number of an array."""


# Compiling and linking -----------------------------------------------------------------------------------------------

ALLOWED_CALLS = {
    "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil", "copysign", "cos", "cosh",
    "erf", "erfc", "exp", "exp2", "expm1", "fabs", "floor", "fmax", "fmin", "fmod", "frexp", "hypot", "ldexp",
    "lgamma", "log", "log10", "log1p", "log2", "memcpy", "memmove", "memset", "modf", "nearbyint", "pow",
    "remainder", "rint", "round", "sin", "sinh", "sqrt", "tan", "tanh", "tgamma", "trunc",
}  # fmt: skip
"""Functions of C99 that a kernel may call; libm or libc of every platform has them."""
REFUSED_INTRINSICS = {"exp10", "fma", "fmuladd", "powi", "roundeven"}
"""Intrinsics `llvm.NAME` that become calls that not every platform has, or whose rounding depends on the machine (fma).
All others become instructions or calls of ALLOWED_CALLS; which of them occur depends on the vectors of this machine."""
_package_digest = cache(source_digest)


@dataclass(frozen=True)
class Target:
    """A platform.

    triple     : its name in LLVM
    zig        : its name in ziglang's linker
    suffix     : of a shared library
    fmi2, fmi3 : folder in `binaries`; None where FMI 2 names none
    levels     : processors to compile for, the most capable last; "" where there is only one
    """

    triple: str
    zig: str
    suffix: str
    fmi2: str | None
    fmi3: str
    levels: tuple[str, ...] = ("",)

    @property
    def native(self) -> bool:
        """Whether this is the platform of the running process."""
        return _platform(self.triple) == _platform(llvm.get_process_triple())


def _platform(triple: str) -> tuple[str, str]:
    """Processor and system of a name in LLVM: `x86_64-unknown-linux-gnu`, or on a Mac `arm64-apple-darwin23.6.0`."""
    processor, _, system = triple.replace("aarch64", "arm64").replace("darwin", "macos").partition("-")
    return processor, next((name for name in ("linux", "windows", "macos") if name in system), system)


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
class CompilationUnit:
    """A function that is compiled into an object file for each processor, with all functions that it calls by name.

    name         : in C, without the suffix of a level
    signature    : of numba, or its text
    make         : returns the function, a `jit.c_function` of pointers and numbers; not called where the library or the
                   object file is in the cache
    dependencies : text of sources that it depends on in addition to the package's own
    """

    name: str
    signature: Any
    make: Callable[[], Any]
    dependencies: str = ""

    @cached_property
    def types(self) -> Any:
        """numba's signature, with the types of the arguments and of the result."""
        return signature_of(self.signature) if isinstance(self.signature, str) else self.signature

    @cached_property
    def compiled(self) -> Any:
        """The function, compiled."""
        return self.make()

    def prototype(self, name: str) -> str:
        """Declaration in C under this name."""
        kinds = [_C_TYPES[str(t)] for t in self.types.args]
        return f"{_C_TYPES[str(self.types.return_type)]} {name}({', '.join(kinds)});"

    def object_paths(self, target: Target) -> list[Path]:
        """Paths of the object files for a platform in the cache, one for each level."""
        folder = _cache_folder([self], target)
        return [folder / f"{self.name}_{k}.o" for k in range(len(target.levels))]


_C_TYPES = {"float64": "double", "int64": "int64_t", "none": "void", "float64*": "double *", "int64*": "int64_t *"}
_IR_TYPES = {"float64": "double", "int64": "i64", "none": "void", "float64*": "ptr", "int64*": "ptr"}


def _module_text(unit: CompilationUnit, symbol: str) -> str:
    """IR of a unit's function under a plain C name, and of all that it calls."""
    kinds = [_IR_TYPES[str(t)] for t in unit.types.args]
    result = _IR_TYPES[str(unit.types.return_type)]
    return portable_ir(unit.compiled) + plain_entry_ir(unit.compiled, symbol, result, kinds)


def forbidden_calls(module: llvm.ModuleRef) -> list[str]:
    """Names of the functions that a module calls and a host without Python does not have."""
    called = {f.name for f in module.functions if f.is_declaration}
    intrinsics = {name for name in called if name.startswith("llvm.")}
    return sorted(
        {n for n in intrinsics if n.split(".")[1] in REFUSED_INTRINSICS} | (called - intrinsics - ALLOWED_CALLS)
    )


def object_code(unit: CompilationUnit, target: Target, level: str, suffix: str = "") -> bytes:
    """Object file of a compiled function for a platform and a processor.

    suffix : of its name in C
    raises : RunError naming the functions that it calls and a host without Python does not have
    """
    module, machine = _module_and_machine(unit, target, level, suffix)
    forbidden = forbidden_calls(module)
    if forbidden:
        raise RunError(f"{unit.name}: needs {', '.join(forbidden)}, which a host without Python does not have")
    return bytes(machine.emit_object(module))


def missing_functions(unit: CompilationUnit) -> list[str]:
    """Names of the functions that a unit calls and a host without Python does not have."""
    target = TARGETS["linux"]
    return forbidden_calls(_module_and_machine(unit, target, target.levels[0])[0])


def _module_and_machine(
    unit: CompilationUnit, target: Target, level: str, suffix: str = ""
) -> tuple[llvm.ModuleRef, Any]:
    """Module of a unit's function and all that it calls, for a processor, and the machine that emits its code."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=level, opt=3, reloc="pic", codemodel="default"
    )
    symbol = unit.name + suffix
    module = llvm.parse_assembly(_module_text(unit, symbol))
    module.triple, module.data_layout = target.triple, str(machine.target_data)
    for value in [*module.functions, *module.global_variables]:
        # Both levels of a processor contain functions of the same names, which must not meet when they are linked.
        if not value.is_declaration and value.name != symbol:
            value.linkage = "internal"
    # numba has optimised the functions already; for the most capable processor the module is optimised once more.
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=1))
    passes = builder.getModulePassManager()
    # The basic level only has to be correct: it drops what is unused and is compiled as numba has left it.
    if level != target.levels[-1]:
        passes = llvm.create_new_module_pass_manager()
        passes.add_global_dead_code_eliminate_pass()
    passes.run(module, builder)
    return module, machine


def wrapper_folder() -> Path:
    """The folder of the C wrapper: at the top of a checkout, within the package when installed."""
    for folder in data_folders("fmu"):
        if (folder / "wrapper.h").is_file():
            return folder
    raise InputError("the C sources of the FMU wrapper are missing; install the package again")


def compiler_command(target: Target) -> list[str]:
    """Command of a C compiler that links for a platform.

    raises : InputError naming what to install
    """
    native = shutil.which("gcc") or shutil.which("cc") or shutil.which("clang")
    if target.native and native:
        return [native]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-target", target.zig]
    tool = "a C compiler" if target.native else f"a linker for {target.fmi3}"
    raise InputError(f"fmu: {tool} was not found; install one: pip install 'sim-heating[fmu]'")


def _function_table_source(units: Sequence[CompilationUnit], target: Target) -> str:
    """C source of the table `models`: the functions of each level, the most capable last."""
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


def _cache_folder(units: Sequence[CompilationUnit], target: Target) -> Path:
    """Folder of the cache for a library or object files, named by a digest of all that they are made of."""
    digest = hashlib.sha256()
    # Everything that the machine code depends on: an object of another version would be linked without complaint.
    for dependency in (_package_digest(), numba.__version__, llvmlite.__version__, repr(target)):
        digest.update(dependency.encode())
    for unit in units:
        digest.update(f"{unit.name} {unit.dependencies}".encode())
    for path in (*sorted(wrapper_folder().glob("*.[ch]")), Path(inspect.getfile(object_code))):
        digest.update(path.read_bytes())
    return CACHE / "fmu" / digest.hexdigest()[:24]


def shared_library(units: Sequence[CompilationUnit], target: Target) -> Path:
    """Shared library of a model for a platform, compiled and linked unless it is in the cache.

    units  : the model, and the functions that it calls through addresses in the order of `A`
    raises : InputError without a compiler, RunError where a function cannot be compiled or linked
    """
    folder = _cache_folder(units, target)
    path = folder / f"model{target.suffix}"
    if path.is_file():
        return path
    command = compiler_command(target)
    folder.mkdir(parents=True, exist_ok=True)
    # Linked aside and renamed: of two exports at once neither finds half a library.
    with tempfile.TemporaryDirectory(dir=folder) as work:
        partial = Path(work) / path.name
        _link(units, target, command, Path(work), partial)
        partial.replace(path)
    return path


def object_files(unit: CompilationUnit, target: Target) -> list[Path]:
    """Object files of a unit for each processor of a platform, compiled unless they are in the cache.

    raises : RunError where a function cannot be compiled
    """
    paths = unit.object_paths(target)
    for k, (path, level) in enumerate(zip(paths, target.levels, strict=True)):
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes_atomic(path, object_code(unit, target, level, f"_{k}"))
    return paths


def link_inputs(units: Sequence[CompilationUnit], target: Target, folder: Path) -> list[Path]:
    """Files that a library is linked from in addition to the wrapper: object files, and the table of functions.

    folder : the table is written there
    """
    paths = [path for unit in units for path in object_files(unit, target)]
    table = folder / "functions.c"
    table.write_text(_function_table_source(units, target), encoding="utf-8")
    return [table, *paths]


def wrapper_sources() -> list[Path]:
    """The C files of the wrapper."""
    return sorted(wrapper_folder().glob("*.c"))


def wrapper_objects(target: Target) -> list[Path]:
    """Object files of the C wrapper, which all libraries share, compiled unless they are in the cache.

    raises : InputError without a compiler, RunError where it fails
    """
    command = compiler_command(target)
    name = "zig" if "ziglang" in command else Path(command[0]).name
    folder = _cache_folder([], target)
    objects = [folder / f"{source.stem}_{name}.o" for source in wrapper_sources()]
    folder.mkdir(parents=True, exist_ok=True)
    for source, out in zip(wrapper_sources(), objects, strict=True):
        if not out.is_file():
            with tempfile.TemporaryDirectory(dir=folder) as work:
                partial = Path(work) / out.name
                _run_compiler([*command, "-c", *_flags(target), "-o", partial, source], target, "compiling")
                partial.replace(out)
    return objects


def _flags(target: Target) -> list[str]:
    # No contraction of a * b + c: its rounding would differ from that of the compiled kernels.
    flags = ["-O2", "-std=c11", "-ffp-contract=off", "-fvisibility=hidden", f"-I{wrapper_folder()}"]
    return flags if "windows" in target.triple else [*flags, "-fPIC"]


def _link(units: Sequence[CompilationUnit], target: Target, command: Sequence[str], work: Path, out: Path) -> None:
    needed = [] if "windows" in target.triple else ["-lm"]
    # A name that no library has is an error of the link here, not of a host that loads the FMU later.
    needed += ["-Wl,-z,defs", "-Wl,-s"] if "linux" in target.triple else []
    files = [*link_inputs(units, target, work), *wrapper_objects(target)]
    _run_compiler([*command, "-shared", *_flags(target), "-o", out, *files, *needed], target, "linking")


def _run_compiler(command: Sequence[str | Path], target: Target, task: str) -> None:
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RunError(f"fmu: {task} for {target.fmi3} failed: {done.stderr.strip()}")
