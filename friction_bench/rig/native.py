"""The firmware's C core on this computer: built on first use, one independent copy per rig."""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

from friction_bench.protocol.messages import ResetCause, RigError
from rx90_common.base.share import share_directory

_SOURCES = ("core/frame.c", "core/rig.c", "native/hal_native.c")
_HEADERS = ("core/frame.h", "core/hal.h", "core/rig.h", "core/rig_config.h")


def firmware_directory() -> Path:
    """Return the folder of the firmware's sources."""
    return share_directory() / "firmware"


def _cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "rx90_emulator" / "firmware"


def compile_core(sources: Path, library: Path, figures: Mapping[str, int]) -> None:
    """Compile the firmware in `sources` for this computer into `library`; `figures` replace those of rig_config.h.

    Raises:
        RigError: if there is no C compiler or it refuses the sources.
    """
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
    if not compiler:
        raise RigError("the emulated rig runs the real firmware and needs a C compiler: none found as cc or gcc")
    command = [*compiler.split(), "-std=c11", "-O2", "-fPIC", "-shared", f"-I{sources / 'core'}"]
    command += [f"-D{name}={value}u" for name, value in figures.items()]
    command += [str(sources / name) for name in _SOURCES] + ["-o", str(library)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["no message"])[0]
        raise RigError(f"the C compiler {compiler} refused the firmware: {reason}")


def native_library(figures: Mapping[str, int] | None = None) -> Path:
    """Return the compiled firmware, building it where these sources were not built with these figures before."""
    figures = figures or {}
    sources = firmware_directory()
    digest = hashlib.sha256()
    for name in (*_SOURCES, *_HEADERS):
        digest.update((sources / name).read_bytes())
    if figures:
        digest.update(repr(sorted(figures.items())).encode())
    library = _cache() / f"librig_{digest.hexdigest()[:16]}.so"
    if not library.exists():
        library.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=library.parent) as folder:
            fresh = Path(folder) / library.name
            compile_core(sources, fresh, figures)
            fresh.replace(library)  # atomic: two programs may build at the same time
    return library


class NativeBoard:
    """A board whose processor is this computer: same firmware, time in slices of the caller's choice.

    Args:
        library: the compiled firmware; by default the shipped one, built on first use.
    """

    def __init__(self, baud: int = 19200, library: Path | None = None) -> None:
        # The core keeps its state in globals, as a microcontroller does: each board loads a copy of its own.
        with tempfile.TemporaryDirectory() as folder:
            copy = shutil.copy(library or native_library(), folder)
            self._core = ctypes.CDLL(copy)
        self._baud = baud
        self._buffer = ctypes.create_string_buffer(4096)
        self._core.native_run.argtypes = (ctypes.c_uint32, ctypes.c_uint16, ctypes.c_uint8)
        self._core.native_run.restype = None
        for name in ("native_dac", "native_stage"):
            getattr(self._core, name).restype = ctypes.c_uint8
        self.reset(ResetCause.POWER)

    def reset(self, cause: ResetCause) -> None:
        """Start the firmware anew, as a reset of the board does."""
        self._core.native_power_up(ctypes.c_uint32(self._baud), ctypes.c_uint8(cause))

    def write(self, data: bytes) -> None:
        """Put bytes on the line to the board; what exceeds its 4 KiB buffer is lost, as on a real line."""
        self._core.native_write(data, ctypes.c_uint32(len(data)))

    def read(self) -> bytes:
        """Return the bytes that the board has sent."""
        count = self._core.native_read(self._buffer, ctypes.c_uint32(4096))
        return self._buffer.raw[:count]

    def run(self, slice_us: int, edges: int, adc: int) -> None:
        """Let `slice_us` pass, in which the encoder gave `edges` and the ADC read `adc`."""
        self._core.native_run(slice_us, edges, adc)

    @property
    def dac(self) -> int:
        """Return the code on the DAC."""
        return int(self._core.native_dac())

    @property
    def stage_on(self) -> bool:
        """Return whether the power stage is enabled."""
        return bool(self._core.native_stage())
