"""Compile the numerical kernels with numba; the cache on disk never gives code of older sources.

numba's own cache looks at the file of a compiled function alone: after a change in a kernel that it *calls* from
another file, it would run the old code. The cache therefore lies in a folder named after the hash of all files
that hold kernels and of what they import. fastmath stays off, so that a kernel gives the same bits wherever it
is inlined. docs/explanation/kernels.md explains when to use which decorator.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.event import Event, Listener, register

from rx90_common.base.sources import importers_of, sources_hash, with_imports
from rx90_common.kernels import announcement

_Function = TypeVar("_Function", bound=Callable[..., Any])


def _kernels_hash() -> str:
    files = with_imports(importers_of("rx90_common.kernels"))
    return sources_hash(files, f"{numba.__version__} {sys.version_info[:2]}")


def cache_directory() -> Path:
    """Return where compiled kernels of exactly these sources are kept (NUMBA_CACHE_DIR wins)."""
    base = os.environ.get("NUMBA_CACHE_DIR")
    root = Path(base) if base else Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return root / "rx90_emulator" / _kernels_hash()


# numba makes its settings at import, so its type stubs do not know them.
setattr(numba.config, "CACHE_DIR", str(cache_directory()))  # noqa: B010


class _Watch(Listener):
    """Announces the compilation of kernels; loading them from disk raises no such event."""

    def on_start(self, event: Event) -> None:  # noqa: ARG002 - the interface of Listener
        announcement.compilation_begins()

    def on_end(self, event: Event) -> None:
        pass


register("numba:compile", _Watch())  # type: ignore[no-untyped-call]  # numba has no types there


def kernel(function: _Function) -> _Function:
    """Compile `function` in nopython mode on its first call and keep the result on disk."""
    return cast(_Function, numba.njit(cache=True, error_model="numpy")(function))


def inlined(function: _Function) -> _Function:
    """Compile `function` into each kernel that calls it; not to be called from Python."""
    return cast(_Function, numba.njit(error_model="numpy", forceinline=True)(function))


def c_function(signature: Any, *, releases_lock: bool = False) -> Callable[[Callable[..., Any]], Callable[..., int]]:
    """Compile a function of integers and addresses when its module is imported, and keep the result on disk.

    Called from Python it costs a fraction of a kernel, whose arguments numba examines one by one, and it holds the
    interpreter's lock: giving it up and taking it back would cost more than what such a function mostly does.

    Args:
        signature: the numba signature; every argument is an int64 or a voidptr, and so is the result.
        releases_lock: for a function that takes long: other threads run Python meanwhile.
    """
    prototype = ctypes.CFUNCTYPE if releases_lock else ctypes.PYFUNCTYPE

    def compile_now(function: Callable[..., Any]) -> Callable[..., int]:
        # numba raises no event for this compilation, only for its own functions that are called, such as carray.
        compiled = numba.cfunc(signature, cache=True, error_model="numpy")(function)
        arguments = [ctypes.c_void_p if kind == numba.types.voidptr else ctypes.c_int64 for kind in signature.args]
        address: int = compiled.address  # type: ignore[assignment]  # the stubs know it only before compilation
        return prototype(ctypes.c_int64, *arguments)(address)

    return compile_now
