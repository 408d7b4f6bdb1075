"""The emulated rig: the real firmware, wired to an emulated plant, in virtual or in real time.

The firmware's C core is built for this computer on first use; each rig has a copy of its own.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import select
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path

from friction_bench.rig.messages import ResetCause, RigError, RigInputError
from friction_bench.rig.plant import SLICE, RigPlant
from friction_bench.rig.rig_file import CODES, Rig
from rx90_common.base.share import share_directory
from rx90_common.process.lines import PseudoTerminal

SLICE_US = round(SLICE * 1e6)
"""Firmware and plant exchange DAC, ADC and encoder this often."""
_LONGEST_STEP = 0.02
_SOURCES = ("core/frame.c", "core/rig.c", "native/hal_native.c")
_HEADERS = ("core/frame.h", "core/hal.h", "core/rig.h", "core/rig_config.h")


def compile_core(sources: Path, library: Path, figures: Mapping[str, int]) -> None:
    """Compile the firmware in `sources` for this computer into `library`; `figures` replace those of rig_config.h.

    Raises:
        RigError: if there is no C compiler or it refuses the sources.
    """
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
    if not compiler:
        raise RigError(
            "the emulated rig runs the real firmware and needs a C compiler: none found as cc or gcc"
        )
    command = [*compiler.split(), "-std=c11", "-O2", "-fPIC", "-shared", f"-I{sources / 'core'}"]
    command += [f"-D{name}={value}u" for name, value in figures.items()]
    command += [str(sources / name) for name in _SOURCES] + ["-o", str(library)]
    done = subprocess.run(
        command, capture_output=True, encoding="utf-8", errors="replace", check=False
    )
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["no message"])[0]
        raise RigError(f"the C compiler {compiler} refused the firmware: {reason}")


def native_library(figures: Mapping[str, int]) -> Path:
    """Return the compiled firmware, building it where these sources were not built with these figures before."""
    sources = share_directory() / "firmware"
    digest = hashlib.sha256()
    for name in (*_SOURCES, *_HEADERS):
        digest.update((sources / name).read_bytes())
    if figures:
        digest.update(repr(sorted(figures.items())).encode())
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    library = base / "rx90_emulator" / "firmware" / f"librig_{digest.hexdigest()[:16]}.so"
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
        library: the compiled firmware.
    """

    def __init__(self, baud: int, library: Path) -> None:
        # The core keeps its state in globals, as a microcontroller does: each board loads a copy of its own.
        with tempfile.TemporaryDirectory() as folder:
            copy = shutil.copy(library, folder)
            self._core = ctypes.CDLL(copy)
        self._baud = baud
        self._buffer = ctypes.create_string_buffer(4096)
        self._core.native_run.argtypes = (ctypes.c_uint32, ctypes.c_uint16, ctypes.c_uint8)
        self._core.native_run.restype = None
        for name in ("native_dac", "native_stage", "native_switched"):
            getattr(self._core, name).restype = ctypes.c_uint8
        self.reset(ResetCause.POWER)

    def reset(self, cause: ResetCause) -> None:
        """Start the firmware anew, as a reset of the board does."""
        self._core.native_power_up(ctypes.c_uint32(self._baud), ctypes.c_uint8(cause))

    def write(self, data: bytes) -> None:
        """Put bytes on the line to the board; bytes beyond its 4 KiB buffer are lost, as on a real line."""
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

    def switched_on(self) -> bool:
        """Return whether the power stage was switched on since the last call."""
        return bool(self._core.native_switched())


class EmulatedRig:
    """Board and plant, advanced together; nothing happens between calls.

    Args:
        rig: the rig file; it must have an `emulation` section.
        seed: of all noise.
        board: where the firmware runs; by default this computer.

    Raises:
        RigError: if the firmware cannot be built.
    """

    def __init__(self, rig: Rig, seed: int = 0, board: NativeBoard | None = None) -> None:
        self.plant = RigPlant(rig, seed)
        self.rig = rig
        self._off_time = self.plant.parameters.amplifier.off_time
        self.board = board or NativeBoard(rig.baud, native_library(rig.firmware_figures))
        self.time = 0.0
        self._edges = 0
        self._adc = 0
        self._on = False

    def advance(self, seconds: float) -> None:
        """Let whole slices of virtual time pass, at least one."""
        for _ in range(max(1, round(seconds * 1e6 / SLICE_US))):
            self.board.run(SLICE_US, self._edges, self._adc)
            was_on = self._on
            self._on = self.board.stage_on
            if self._on and not was_on:
                self.plant.new_ramp()
            command = self.rig.commanded_torque(self.board.dac) if self._on else 0.0
            if self._off_time and self.board.switched_on():
                command *= 1.0 - self._off_time / SLICE
            self._edges = self.plant.advance(command, SLICE)
            self._adc = min(
                CODES, round(self.plant.current_reading() / self.rig.torque.adc_full_scale * CODES)
            )
            self.time += SLICE


class VirtualPort:
    """A line to an emulated rig on which waiting costs no time."""

    def __init__(self, emulated: EmulatedRig) -> None:
        self.emulated = emulated

    def now(self) -> float:
        """Return virtual time, s."""
        return self.emulated.time

    def write(self, data: bytes, *, first: bool = False) -> None:  # noqa: ARG002 - nothing waits here
        """Send bytes to the rig."""
        self.emulated.board.write(data)

    def read(self, timeout: float) -> bytes:
        """Return the next bytes of the rig; after `timeout` seconds, none."""
        end = self.emulated.time + timeout
        while True:
            data = self.emulated.board.read()
            if data or self.emulated.time >= end:
                return data
            self.emulated.advance(SLICE)

    def close(self) -> None:
        """Leave the rig to itself."""


class PtyRig:
    """Runs an emulated rig on a thread until `close`.

    Time that the computer does not give to this program is lost to the rig, too: it never runs faster than real
    time to catch up, because to its host, which was starved as well, it would seem silent.

    Args:
        emulated: the rig.
        link: a path that shall point to the pseudo-terminal, replaced if it is a symbolic link already.

    Attributes:
        line: to the serial program.
        path: what that opens.
    """

    def __init__(self, emulated: EmulatedRig, link: Path | None = None) -> None:
        self.emulated = emulated
        self.line = PseudoTerminal()
        self.path = self.line.name
        self._link = link
        if link is not None:
            try:
                if link.is_symlink():
                    link.unlink()
                link.symlink_to(self.path)
            except OSError as error:
                raise RigInputError(
                    f"{link}: cannot point to the emulated rig ({error.strerror})"
                ) from error
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="emulated rig", daemon=True)
        self._thread.start()

    def load(self, loaded: bool) -> None:
        """Couple the revolute joint, or take it off."""
        with self._lock:
            self.emulated.plant.load(loaded)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stop.is_set():
            behind = time.monotonic() - due
            if behind < SLICE:
                select.select([self.line.device], [], [], 2 * SLICE)
            if behind > _LONGEST_STEP:
                due += behind - _LONGEST_STEP
                behind = _LONGEST_STEP
            slices = int(behind / SLICE)
            if slices:
                due += slices * SLICE
                with self._lock:
                    self._exchange(slices * SLICE)

    def _exchange(self, seconds: float) -> None:
        """Advance time, between reading the line and writing to it."""
        self.emulated.board.write(self.line.read())
        self.emulated.advance(seconds)
        self.line.write(self.emulated.board.read())  # a full line loses bytes, as a real one does

    def close(self) -> None:
        """End the rig: for its opener, this is an unplugged cable."""
        self._stop.set()
        self._thread.join()  # however late: it must not write to another file that got the descriptor's number since
        # The link first: its target may soon be another program's pseudo-terminal.
        if (
            self._link is not None
            and self._link.is_symlink()
            and str(self._link.readlink()) == self.path
        ):
            self._link.unlink(missing_ok=True)  # unless another rig has taken the name over
        self.line.close()
