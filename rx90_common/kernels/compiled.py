"""Compile the numerical kernels with numba, and keep the code on disk.

fastmath stays off, so that a kernel gives the same bits wherever it is inlined. CONTRIBUTING.md says when to use which
decorator.

numba's own cache checks only the file of a compiled function: after a change in a kernel that it *calls* from
another file, it would run the old code. This cache therefore has a folder named after the hash of all files with
kernels and of those that they take constants from. In it a kernel is found by its module's name, not by its path:
clones, wheels and installed copies of the same sources share compiled code.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import re
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, cast
from uuid import uuid4

import llvmlite
import numba
import numpy as np
from numba.core import caching
from numba.core.ccallback import CFunc
from numba.core.event import Event, Listener, register
from numba.core.registry import CPUDispatcher
from numba.core.sigutils import normalize_signature
from numba.extending import overload

from rx90_common.base.share import sources_hash
from rx90_common.kernels import compilation_begins
from rx90_common.kernels.sources import files_with_kernels, module_file

_UNUSED_S = 28 * 24 * 3600.0  # after which the folder of other sources is removed
_FOLDER = re.compile(r"[0-9a-f]{16}")
_LONGEST_S = 120.0  # wait for another process, after which this one compiles itself
_LOOK_S = 0.02


class CompileLock:
    """The turn to compile one kernel, held by at most one process. It ends with the process, however that ends.

    Args:
        file: of the lock, there while a process compiles.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._descriptor: int | None = None

    def take(self) -> None:
        """Wait until no other process compiles this kernel; without delay where no lock can be made."""
        # the kernel is compiled again, for arguments that are literals
        if self._descriptor is not None:
            return
        try:
            descriptor = os.open(self._file, os.O_CREAT | os.O_RDWR, 0o666)
        except OSError:
            return
        try:
            _lock(descriptor)
        except BaseException:  # Ctrl-C
            os.close(descriptor)
            raise
        self._descriptor = descriptor

    def release(self) -> None:
        """Let others have it; who waits looks for the code first."""
        if self._descriptor is None:
            return
        with suppress(OSError):
            self._file.unlink()
        os.close(self._descriptor)
        self._descriptor = None


def _lock(descriptor: int) -> None:
    """Wait for the lock of a file; no longer than _LONGEST_S, and not on a file system that has none."""
    end = time.monotonic() + _LONGEST_S
    while time.monotonic() < end:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            compilation_begins()
            time.sleep(_LOOK_S)
        except OSError:
            return
        else:
            return


def cache_directory() -> Path:
    """Return the folder for compiled kernels of exactly these sources (NUMBA_CACHE_DIR wins)."""
    # Environments with the same sources share the folder: all that decides on their code counts, but for the
    # processor, which numba's index names.
    svml = getattr(numba.config, "USING_SVML", False)
    versions = (numba.__version__, llvmlite.__version__, np.__version__, sys.version_info[:2], svml)
    folder = sources_hash(files_with_kernels(), " ".join(map(str, versions)))
    base = os.environ.get("NUMBA_CACHE_DIR")
    root = Path(base) if base else Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return root / "rx90_emulator" / folder


# numba makes its settings at import, so its type stubs do not know them. Kernels outside of this project are found
# there by path and contents, as numba does it, and compiled again after a change in ours that they may call.
setattr(numba.config, "CACHE_DIR", str(cache_directory()))  # noqa: B010


@cache
def prepare(folder: Path) -> None:
    """Make the folder, or note that it is in use; with a new one, remove those not used for four weeks.

    Raises:
        OSError: if it cannot be made.
    """
    if folder.is_dir():
        with suppress(OSError):
            os.utime(folder)
        return
    folder.mkdir(parents=True)
    for other in folder.parent.iterdir():
        with suppress(OSError):  # another process may remove it, too
            if _FOLDER.fullmatch(other.name) and time.time() - other.stat().st_mtime > _UNUSED_S:
                shutil.rmtree(other, ignore_errors=True)


class _Locator(caching._CacheLocator):
    """The place of a kernel of this project: its module's name; numba adds the function's."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._py_file = file  # numba names it in warnings
        self._line = function.__code__.co_firstlineno
        self._folder = Path(numba.config.CACHE_DIR) / function.__module__  # type: ignore[attr-defined]

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator | None:
        """Return the place, None for functions of others and where nothing can be written: numba has its own then."""
        module = module_file(py_func.__module__)
        if module is None or not Path(py_file).exists() or not module.samefile(py_file):
            return None
        locator = cls(py_func, py_file)
        try:
            prepare(locator._folder.parent)
            locator.ensure_cache_path()  # type: ignore[no-untyped-call]  # numba has no types there
        except OSError:
            return None
        return locator

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        # The folder's name was made when the program began: a file that is edited before it is imported differs.
        return _file_hash(self._py_file)

    def get_disambiguator(self) -> str:
        return str(self._line)


@cache
def _file_hash(file: str) -> str:
    return sources_hash([Path(file)])


class _Implementation(caching.CompileResultCacheImpl):
    _locator_classes = [_Locator, *caching.CompileResultCacheImpl._locator_classes]  # noqa: RUF012 - as numba has it


class _CodeFiles(caching.IndexDataCacheFile):
    """numba's files, written beside and renamed, with names that no two processes choose.

    numba numbers the files of a function. Two processes that compile it at once for other arguments would both write
    number one, and the index could name the code of the other; here one of both is compiled again later.
    """

    def _data_name(self, number: int) -> str:  # noqa: ARG002 - numba's interface
        return f"{Path(self._index_name).stem}.{uuid4().hex[:12]}.nbc"


class KernelCache(caching.FunctionCache):
    """The compiled code of one kernel on disk."""

    _impl_class = _Implementation

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]  # numba has no types there
        place = self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp()
        self._cache_file = _CodeFiles(*place)  # type: ignore[no-untyped-call]  # numba has no types there
        self._turn = CompileLock(Path(self._cache_path) / f"{self._impl.filename_base}.lock")

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the code, waiting for another process that compiles it; with None this process must compile."""
        found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]  # numba has no types there
        if found is None:
            self._turn.take()
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]  # as above
        if found is not None:
            self._turn.release()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store compiled code, if the disk has room: it runs without being stored, too."""
        try:
            with suppress(OSError):
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]  # numba has no types there
        finally:
            self._turn.release()

    def give_up(self) -> None:
        """End the turn of a kernel that could not be compiled."""
        self._turn.release()


_Function = TypeVar("_Function", bound=Callable[..., Any])
_compiler: Any = numba.njit  # numba's type stubs do not know the options for wrappers


class _Watch(Listener):
    """Announces the compilation of kernels; loading them from disk raises no such event."""

    def on_start(self, event: Event) -> None:  # noqa: ARG002 - the interface of Listener
        compilation_begins()

    def on_end(self, event: Event) -> None:
        cache = event.data["dispatcher"]._cache
        # the event reports no failure
        if sys.exc_info()[0] is not None and isinstance(cache, KernelCache):
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
        raise TypeError(
            f"{self.py_func.__qualname__} is compiled into its callers; accepted: a call from a kernel"
        )


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
        raise TypeError(
            f"{choose.__qualname__} is compiled into its callers; accepted: a call from a kernel"
        )

    options: Any = {"error_model": "numpy", "forceinline": True}
    overload(never, jit_options=options, strict=False)(choose)
    return cast(_Function, never)


def c_function(signature: Any) -> Callable[[Callable[..., Any]], Callable[[], Callable[..., int]]]:
    """Replace a function of integers and addresses by one that compiles it once, keeps it on disk, and returns it.

    Called from Python it takes a fraction of a kernel's time, whose arguments numba examines one by one. It keeps the
    interpreter's lock: releasing and acquiring it would take longer than most such functions. Commands that import its
    module, and never call it, do not wait for it.

    Args:
        signature: the numba signature; every argument is an int64 or a voidptr, and so is the result.
    """

    def compile_once(function: Callable[..., Any]) -> Callable[..., int]:
        # numba raises no event for this compilation, only for its own functions that are called, such as carray.
        types = normalize_signature(signature)  # type: ignore[no-untyped-call]  # numba has no types there
        compiled: Any = CFunc(function, types, locals={}, options={"error_model": "numpy"})
        compiled._cache = KernelCache(function)  # as its `enable_caching` does
        compiled.compile()
        arguments = [
            ctypes.c_void_p if kind == numba.types.voidptr else ctypes.c_int64
            for kind in signature.args
        ]
        address: int = compiled.address
        return ctypes.PYFUNCTYPE(ctypes.c_int64, *arguments)(address)

    return lambda function: cache(partial(compile_once, function))
