"""Compile the numerical kernels with numba.

fastmath stays off, so that a kernel gives the same bits wherever it is inlined. docs/explanation/kernels.md explains
when to use which decorator.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core.ccallback import CFunc
from numba.core.event import Event, Listener, register
from numba.core.registry import CPUDispatcher
from numba.core.sigutils import normalize_signature
from numba.extending import overload

from rx90_common.kernels import announcement
from rx90_common.kernels.code_cache import KernelCache

_Function = TypeVar("_Function", bound=Callable[..., Any])
_compiler: Any = numba.njit  # numba's type stubs do not know the options for wrappers


class _Watch(Listener):
    """Announces the compilation of kernels; loading them from disk raises no such event."""

    def on_start(self, event: Event) -> None:  # noqa: ARG002 - the interface of Listener
        announcement.compilation_begins()

    def on_end(self, event: Event) -> None:
        cache = event.data["dispatcher"]._cache
        if sys.exc_info()[0] is not None and isinstance(cache, KernelCache):  # the event reports no failure
            cache.give_up()


register("numba:compile", _Watch())  # type: ignore[no-untyped-call]  # numba has no types there


def kernel(function: _Function) -> _Function:
    """Compile `function` in nopython mode on its first call and keep the result on disk."""
    # A wrapper for calls from C, which nobody makes, would take a tenth of the compilation.
    compiled: Any = _compiler(error_model="numpy", no_cfunc_wrapper=True)(function)
    compiled._cache = KernelCache(function)  # as its `enable_caching` does
    return cast(_Function, compiled)


class _Inlined(CPUDispatcher):
    """A function that compiled code alone can call: a wrapper for calls from Python takes long to compile."""

    def __call__(self, *_: Any, **__: Any) -> Any:
        raise TypeError(f"{self.py_func.__qualname__} is compiled into its callers; accepted: a call from a kernel")


def inlined(function: _Function) -> _Function:
    """Compile `function` into each kernel that calls it; not to be called from Python."""
    no_wrappers = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compiled: Any = _compiler(error_model="numpy", forceinline=True, **no_wrappers)(function)
    compiled.__class__ = _Inlined
    return cast(_Function, compiled)


def by_type(choose: _Function) -> _Function:
    """Return a function for kernels whose code `choose` picks by the types of the arguments, which it names alike.

    `choose` gets numba's types and returns a function of the same arguments, compiled into each kernel that calls it.
    """

    def never(*_: Any) -> Any:
        raise TypeError(f"{choose.__qualname__} is compiled into its callers; accepted: a call from a kernel")

    options: Any = {"error_model": "numpy", "forceinline": True}
    overload(never, jit_options=options, strict=False)(choose)
    return cast(_Function, never)


def c_function(signature: Any) -> Callable[[Callable[..., Any]], Callable[..., int]]:
    """Compile a function of integers and addresses when its module is imported, and keep the result on disk.

    Called from Python it takes a fraction of a kernel's time, whose arguments numba examines one by one. It keeps the
    interpreter's lock: releasing and acquiring it would take longer than most such functions.

    Args:
        signature: the numba signature; every argument is an int64 or a voidptr, and so is the result.
    """

    def compile_now(function: Callable[..., Any]) -> Callable[..., int]:
        # numba raises no event for this compilation, only for its own functions that are called, such as carray.
        types = normalize_signature(signature)  # type: ignore[no-untyped-call]  # numba has no types there
        compiled: Any = CFunc(function, types, locals={}, options={"error_model": "numpy"})
        compiled._cache = KernelCache(function)  # as its `enable_caching` does
        compiled.compile()
        arguments = [ctypes.c_void_p if kind == numba.types.voidptr else ctypes.c_int64 for kind in signature.args]
        address: int = compiled.address
        return ctypes.PYFUNCTYPE(ctypes.c_int64, *arguments)(address)

    return compile_now
