"""Parts of numba that its documentation does not promise, all in this file.

A compilation that something surrounds, LLVM code for pointers, bits and calls through addresses, and the LLVM module
behind a compiled function.
tests/base/test_numba_private.py has a test for each: after a change of numba its name states what no longer works.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import llvmlite.ir
import numba
import numba.core.compiler_lock
import numba.core.sigutils
import numba.extending

from sim_heating.base.kernels.operations import WHOLE

# Compilation within a lock --------------------------------------------------------------------------------------------


def compile_within(surrounding: Callable[[Any], AbstractContextManager[None]], dispatcher: Any) -> Any:
    """The dispatcher, which now has a cache, and enters a context before it compiles or loads its function.

    surrounding : gives the context of a Python function
    """
    dispatcher.enable_caching()
    compile_now = dispatcher.compile

    def compile_(signature: Any) -> Any:
        # numba's lock first: a thread that waits for another process holds nothing that a thread here waits for.
        with numba.core.compiler_lock.global_compiler_lock:
            if tuple(numba.core.sigutils.normalize_signature(signature)[0]) in dispatcher.overloads:
                return compile_now(signature)
            with surrounding(dispatcher.py_func):
                return compile_now(signature)

    dispatcher.compile = compile_
    return dispatcher


# LLVM code within kernels --------------------------------------------------------------------------------------------


@numba.extending.intrinsic
def array_data(_typing_context: object, array: numba.types.Array):
    """C pointer to the data of a contiguous array."""
    kind = numba.types.CPointer(array.dtype)

    def codegen(context, builder, signature, args):
        return context.make_array(signature.args[0])(context, builder, args[0]).data

    return kind(array), codegen


@numba.extending.intrinsic
def pointer_offset(_typing_context, pointer, first):
    """C pointer to a later number of the array that a pointer points to; `first` counts numbers, not bytes."""

    def codegen(_context, builder, _signature, args):
        return builder.gep(args[0], [args[1]])

    return pointer(pointer, numba.types.int64), codegen


@numba.extending.intrinsic
def power_of_two_bits(_typing_context, k):
    """2^k [-] of a whole number k from -1022 to 1023, given as a float: its bits are put together."""

    def codegen(context, builder, signature, args):
        number, bits = llvmlite.ir.DoubleType(), llvmlite.ir.IntType(64)
        integer = builder.bitcast(builder.fadd(args[0], number(WHOLE)), bits)
        return builder.bitcast(builder.add(builder.shl(integer, bits(52)), bits(1023 << 52)), number)

    return numba.types.float64(numba.types.float64), codegen


@numba.extending.intrinsic
def mantissa_and_exponent_bits(_typing_context, x):
    """m [-] from 0.5 to below 1 and k with x = m 2^k, for a normal x above 0: its bits are taken apart."""

    def codegen(context, builder, signature, args):
        number, bits = llvmlite.ir.DoubleType(), llvmlite.ir.IntType(64)
        pattern = builder.bitcast(args[0], bits)
        # The exponent's bits below those of 2^52 are 2^52 + exponent: no conversion of integers, which AVX2 lacks.
        above = builder.or_(builder.lshr(pattern, bits(52)), bits(1075 << 52))
        exponent = builder.fsub(builder.bitcast(above, number), number(2.0**52 + 1022.0))
        half = builder.or_(builder.and_(pattern, bits((1 << 52) - 1)), bits(1022 << 52))
        return context.make_tuple(builder, signature.return_type, [builder.bitcast(half, number), exponent])

    float64 = numba.types.float64
    return numba.types.UniTuple(float64, 2)(float64), codegen


def _call_through_address(context, builder, signature, args):
    """LLVM code of a call whose first argument is the address of the function; the others are the function's own."""
    void = signature.return_type == numba.types.void
    result = llvmlite.ir.VoidType() if void else context.get_value_type(signature.return_type)
    kinds = [context.get_value_type(t) for t in signature.args[1:]]
    function = llvmlite.ir.FunctionType(result, kinds).as_pointer()
    returned = builder.call(builder.inttoptr(args[0], function), args[1:])
    return context.get_dummy_value() if void else returned


@numba.extending.intrinsic
def call_dispatcher_at(_typing_context, address, code, B, c, p, wall_K):
    """Value [-] of an effect dispatcher at an address: dispatcher(code, B, c, p, wall_K), wall_K [K]."""
    return numba.types.float64(address, code, B, c, p, wall_K), _call_through_address


@numba.extending.intrinsic
def call_effect_at(_typing_context, address, B, c, p, wall_K):
    """Value [-] of an effect's compiled kernel at an address: kernel(B, c, p, wall_K), wall_K [K]."""
    return numba.types.float64(address, B, c, p, wall_K), _call_through_address


@numba.extending.intrinsic
def call_step_at(_typing_context, address, B, J, table, dispatcher, dt):
    """Call a compiled step at an address: step(B, J, table, dispatcher, dt), dt [s]."""
    return numba.types.void(address, B, J, table, dispatcher, dt), _call_through_address


# Compiled functions --------------------------------------------------------------------------------------------------

_REFERENCE_COUNTS = re.compile(r"^(define [^\n]*@NRT_(?:incref|decref)\([^\n]*\{)\n.*?^\}", re.MULTILINE | re.DOTALL)
_TARGET_LINE = re.compile(r"^target (?:triple|datalayout) = .*$", re.MULTILINE)


def _module(function: Any) -> Any:
    """LLVM module of a C function with all that it calls, whether just compiled or loaded from the cache."""
    return function._library._get_module_for_linking()


def signature_of(text: Any) -> Any:
    """Signature that a text such as `float64(int64)` states; a signature is one already."""
    arguments, result = numba.core.sigutils.normalize_signature(text)
    return result(*arguments)


def can_raise(function: Any) -> bool:
    """Whether a C function can raise an exception (so can printing and allocating): numba stores each as a constant."""
    return any(constant.name.startswith(".const.picklebuf") for constant in _module(function).global_variables)


def portable_ir(function: Any) -> str:
    """LLVM IR of a C function and all that it calls, without the lines that name this machine.

    Reference counts are left out: all memory is the host's, and a kernel that allocated some is rejected elsewhere.
    """
    return _REFERENCE_COUNTS.sub(r"\1\n  ret void\n}", _TARGET_LINE.sub("", str(_module(function))))


def plain_entry_ir(function: Any, symbol: str, result: str, arguments: list[str]) -> str:
    """LLVM IR of a function in C's own convention that calls a C function of numba's.

    symbol            : name of the new function
    result, arguments : LLVM types of its result and arguments

    Convention of numba: status = f(pointer to result, pointer to exception, arguments).
    """
    native = function.native_name.removeprefix("cfunc.")
    declared = ", ".join(f"{kind} %a{i}" for i, kind in enumerate(arguments))
    passed = f"ptr %result, ptr %exception, {declared}"
    back = "ret void" if result == "void" else f"%value = load {result}, ptr %result\n  ret {result} %value"
    return f"""
define hidden {result} @{symbol}({declared}) {{
  %result = alloca i64
  %exception = alloca ptr
  store i64 0, ptr %result
  %status = call i32 @"{native}"({passed})
  {back}
}}
"""
