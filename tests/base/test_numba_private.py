"""What kernels use of numba beyond its documentation; each test names what no longer works when numba changes it."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import math
import pickle
import re
import subprocess
import sys

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest
from numba import types

from sim_heating.base.kernels import compiler
from sim_heating.base.kernels.cache_folder import PACKAGE
from sim_heating.base.kernels.jit import STEP_SIGNATURE, address_of, c_function, force_inline, njit
from sim_heating.base.kernels.numba_private import (
    call_effect_at,
    can_raise,
    compile_within,
    plain_entry_ir,
    pointer_offset,
    portable_ir,
)
from sim_heating.base.kernels.operations import call_dispatcher, call_step, pointer, power_of_two, split
from sim_heating.heating.effects import transition

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")  # type: ignore[attr-defined]

LANES = 8
ONE_NUMBER = types.float64(types.float64)
DISPATCHER = types.float64(types.int64, types.CPointer(types.float64), types.int64, types.int64, types.float64)
EFFECT = types.float64(types.CPointer(types.float64), types.int64, types.int64, types.float64)


def twice(x):
    return 2.0 * x


def one_llvm(kernel) -> str:
    """LLVM IR of a kernel that was compiled for one set of arguments."""
    (text,) = kernel.inspect_llvm().values()
    return str(text)


# Compilers -----------------------------------------------------------------------------------------------------------


def test_kernels_have_no_entry_for_c(tmp_path, monkeypatch):
    # from the cache the outer one would come whole, and the inner one would not be compiled
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    @njit
    def first_of(B):
        return B[0]

    @njit
    def outer(B):
        return first_of(pointer(B))

    assert outer(np.array([7.0])) == 7.0
    assert "cfunc." not in one_llvm(outer)
    assert "cfunc." not in one_llvm(first_of)


def test_a_forced_inline_leaves_no_call_in_its_caller():
    @force_inline
    def square(x):
        return x * x

    @njit
    def outer(x):
        return square(x) + 1.0

    assert outer(3.0) == 10.0
    body = re.search(r"^define [^\n]*outer[^\n]*\{\n.*?^\}", one_llvm(outer), re.MULTILINE | re.DOTALL)
    assert body is not None
    assert "square" not in body[0].split("\n", 1)[1]


def test_a_loop_over_eight_lanes_becomes_vectors_of_doubles():
    @njit
    def add_rows(B):
        for lane in range(LANES):
            B[lane] = B[LANES + lane] + B[2 * LANES + lane]

    @njit
    def outer(B):
        add_rows(pointer(B))

    outer(np.zeros(3 * LANES))
    assert re.search(r"fadd <\d+ x double>", one_llvm(outer))


def test_a_pickled_kernel_is_the_kernel_of_the_process_that_has_it():
    kernel = njit(twice)
    assert pickle.loads(pickle.dumps(kernel)) is kernel


def test_an_effect_of_the_package_is_the_packages_own_in_a_process_that_it_is_sent_to():
    """As a user's it would be compiled again and probed by the interpreter when each worker starts."""
    code = """
import pickle, sys
sent = pickle.load(sys.stdin.buffer)
from sim_heating.heating.effects import transition
from tests.support.paths import ROOT
assert sent.built_in
assert sent.kernel is transition.EFFECT.kernel
"""
    sent = pickle.dumps(transition.EFFECT)
    subprocess.run([sys.executable, "-c", code], input=sent, check=True, cwd=PACKAGE.parent)


def test_a_kernel_is_compiled_or_loaded_within_a_lock(tmp_path, monkeypatch):
    module = tmp_path / "thrice.py"
    module.write_text("def thrice(x):\n    return 3.0 * x\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(compiler, "CACHE", tmp_path)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    function = importlib.import_module("thrice").thrice
    entered = []

    @contextlib.contextmanager
    def surrounding(function):
        entered.append(function.__name__)
        yield

    def thrice():
        return compile_within(surrounding, numba.njit(cache=True)(function))

    first = thrice()
    assert (first(2.0), first(2.0), entered) == (6.0, 6.0, ["thrice"])
    second = thrice()
    assert (second(2.0), sum(second.stats.cache_hits.values()), entered) == (6.0, 1, ["thrice"] * 2)
    third = thrice()  # other arguments are another compilation
    assert (third(2), sum(third.stats.cache_hits.values()), entered) == (6, 0, ["thrice"] * 3)


# LLVM code within kernels --------------------------------------------------------------------------------------------


def test_a_pointer_reads_and_writes_the_array_and_its_offset_a_later_number():
    @njit
    def write(B):
        p = pointer(B)
        p[1] = pointer_offset(p, 2)[0]

    B = np.array([1.0, 2.0, 3.0])
    write(B)
    assert B.tolist() == [1.0, 3.0, 3.0]


@pytest.mark.parametrize("k", [-1022.0, -1.0, 0.0, 1.0, 52.0, 1023.0])
def test_bits_put_together_are_powers_of_two(k):
    assert njit(lambda x: power_of_two(x))(k) == math.ldexp(1.0, int(k))


@pytest.mark.parametrize("x", [2.0**-1022, 0.3, 0.5, 1.0, math.pi, 1.7e308])
def test_bits_taken_apart_are_mantissa_and_exponent(x):
    assert njit(lambda x: split(x))(x) == math.frexp(x)


def test_compiled_functions_are_called_through_their_addresses():
    def dispatch(code, B, c, p, wall_K):
        return code + B[c] + B[p] + wall_K

    def effect(B, c, p, wall_K):
        return B[c] - B[p] + wall_K

    def step(B, J, table, dispatcher, dt):
        B[0] = table[J[0]] + dispatcher + dt

    made = [
        c_function(DISPATCHER, dispatch, cache=False),
        c_function(EFFECT, effect, cache=False),
        c_function(STEP_SIGNATURE, step, cache=False),
    ]

    @njit
    def call_all(dispatch_at, effect_at, step_at, B, J):
        p = pointer(B)
        values = call_dispatcher(dispatch_at, 1, p, 0, 1, 100.0), call_effect_at(effect_at, p, 0, 1, 100.0)
        call_step(step_at, p, pointer(J), p, 3, 0.5)
        return values

    B, J = np.array([10.0, 20.0]), np.array([1])
    assert call_all(*(address_of(f) for f in made), B, J) == (131.0, 90.0)
    assert B[0] == 23.5


# Compiled functions --------------------------------------------------------------------------------------------------


def test_a_function_that_can_raise_is_known_by_its_exceptions():
    def raising(x):
        if x < 0.0:
            raise ValueError("below 0")
        return x

    assert can_raise(c_function(ONE_NUMBER, raising, cache=False))
    assert not can_raise(c_function(ONE_NUMBER, twice, cache=False))


def test_portable_code_names_no_machine_and_counts_no_references():
    def first(x):
        return np.full(3, x)[0]

    text = portable_ir(c_function(ONE_NUMBER, first, cache=False))
    assert "target triple" not in text
    assert "target datalayout" not in text
    counts = re.findall(r"^define [^\n]*@NRT_(?:incref|decref)\([^\n]*\{\n(.*?)^\}", text, re.MULTILINE | re.DOTALL)
    assert counts
    assert {body.strip() for body in counts} == {"ret void"}
    llvm.parse_assembly(text).verify()


def test_a_plain_entry_calls_the_compiled_function():
    function = c_function(ONE_NUMBER, twice, cache=False)
    module = llvm.parse_assembly(portable_ir(function) + plain_entry_ir(function, "plain_twice", "double", ["double"]))
    module.get_function("plain_twice").linkage = "external"
    module.verify()
    engine = llvm.create_mcjit_compiler(module, llvm.Target.from_default_triple().create_target_machine())
    engine.finalize_object()
    plain = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(engine.get_function_address("plain_twice"))
    assert plain(21.0) == 42.0
