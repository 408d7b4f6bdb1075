"""The 8051 binary in uCsim (s51), in lock-step over its console."""

import array
import contextlib
import fcntl
import os
import shutil
import subprocess
import tempfile
import termios
from pathlib import Path

SHIM = Path(__file__).with_name("ucsim_poll.c")
CRYSTAL_MHZ = 11.0592
CLOCKS_PER_INSTRUCTION = 16.0
"""Rough mean for this firmware (12 clocks a cycle); the error of one slice is made up for in the next."""
BYTES_PER_MS = 1.92  # on the line; the simulator may hold bytes of its own after the line to it has run empty
MARKER = "918273645"
MARK = "expr 918273644+1"
"""The console echoes its input in the midst of its output: the echo must not look like the answer."""


def build_shim(library: Path) -> None:
    command = ["cc", "-O2", "-fPIC", "-shared", str(SHIM), "-o", str(library)]
    subprocess.run(command, check=True, capture_output=True, text=True)


def simulator() -> str | None:
    """Return the path of uCsim's 8051, under its old or its new name."""
    return shutil.which("s51") or shutil.which("ucsim_51")


class UcsimBoard:
    """The Board interface around s51; `seed` is of the RAM's random contents at power-up."""

    def __init__(self, library: Path, firmware: Path, seed: int = 1) -> None:
        program = simulator()
        if program is None:
            raise RuntimeError("neither s51 nor ucsim_51 is installed")
        self._folder = tempfile.mkdtemp(prefix="ucsim")
        to_rig, from_rig = Path(self._folder, "in"), Path(self._folder, "out")
        for fifo in (to_rig, from_rig):
            os.mkfifo(fifo)
        # Both ends open here too, so that the simulator's own open does not block.
        self._to_rig = os.open(to_rig, os.O_RDWR | os.O_NONBLOCK)
        self._from_rig = os.open(from_rig, os.O_RDWR | os.O_NONBLOCK)
        command = [program, "-b", "-q", "-R", str(seed), "-t", "C51", "-X", f"{CRYSTAL_MHZ}M"]
        command += ["-S", f"uart=0,in={to_rig},out={from_rig}", str(firmware)]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env={**os.environ, "LD_PRELOAD": str(library)},
            text=True,
        )
        self.adc_port, self.dac_port, self.stage = 2, 1, 0x10
        """Ports of current sense and DAC, and the bit of P3 that switches the stage off."""
        self._target = 0.0
        self._clock = 0
        self._dac = 0
        self._port3 = 0xFF
        self._listen = 0.0
        self._given: set[str] = set()
        self._console([])

    def _console(self, lines: list[str]) -> list[int]:
        self._process.stdin.write("\n".join([*lines, MARK, ""]))
        self._process.stdin.flush()
        numbers = []
        for line in self._process.stdout:
            text = line.strip()
            if text == MARKER:
                return numbers
            with contextlib.suppress(ValueError):
                numbers.append(int(text))
        raise RuntimeError("the simulator ended by itself")

    def _pending(self) -> bool:
        count = array.array("i", [0])
        fcntl.ioctl(self._to_rig, termios.FIONREAD, count)
        return count[0] > 0

    def write(self, data: bytes) -> None:
        if data:
            os.write(self._to_rig, data)
            self._listen = max(self._listen, 0.0) + len(data) / BYTES_PER_MS

    def read(self) -> bytes:
        try:
            return os.read(self._from_rig, 4096)
        except BlockingIOError:
            return b""

    def run(self, slice_us: int, edges: int, adc: int) -> None:
        self._target += slice_us * CRYSTAL_MHZ
        steps = max(1, round((self._target - self._clock) / CLOCKS_PER_INSTRUCTION))
        # The simulator looks for input every million instructions, unless told; twice the time that the bytes take.
        self._listen -= 0.5e-3 * slice_us
        listens = self._listen > 0.0 or self._pending()
        given = {f"expr uart0_check_often={int(listens)}", f"set hw port[{self.adc_port}] {adc}", "set hw port[3] 255"}
        lines = sorted(given - self._given)
        self._given = given
        for _ in range(edges):
            lines += [f"step {max(1, steps // (edges + 1))}", "set hw port[3] 251", "step 4", "set hw port[3] 255"]
        self._look([*lines, f"step {max(1, steps // (edges + 1))}"])

    def _look(self, lines: list[str]) -> None:
        lines = [*lines, "expr sim_ticks", f"expr port{self.dac_port}_odr", "expr port3_odr"]
        *_, self._clock, self._dac, self._port3 = self._console(lines)

    def reset(self) -> None:
        self._given = set()
        self._look(["reset"])
        self._target = float(self._clock)

    def port(self, number: int) -> int:
        return self._console([f"expr port{number}_odr"])[-1] & 0xFF

    def instructions(self, count: int) -> None:
        """Execute single instructions, for a look at what happens within microseconds of power-up."""
        self._look(["expr uart0_check_often=1", f"step {count}"])
        self._target = float(self._clock)

    def clock_when(self, address: int, value: int, not_before: int = 0) -> int:
        """Return the clock when a byte of internal RAM becomes `value`; by single instructions from `not_before` on."""
        for _ in range(100_000):
            count = 250 if self._clock < not_before else 1
            *_, found, self._clock = self._console([f"step {count}", f"expr iram[{address}]", "expr sim_ticks"])
            if self._clock >= not_before and found & 0xFF == value:
                self._target = float(self._clock)
                return self._clock
        raise RuntimeError(f"the byte at {address} never became {value}")

    @property
    def time(self) -> float:
        return self._clock / (CRYSTAL_MHZ * 1e6)

    @property
    def dac(self) -> int:
        return self._dac & 0xFF

    @property
    def stage_on(self) -> bool:
        return not self._port3 & self.stage

    def close(self) -> None:
        """End the simulator: one that is left behind takes a whole core."""
        self._process.kill()
        self._process.wait()
        for descriptor in (self._to_rig, self._from_rig):
            os.close(descriptor)
        shutil.rmtree(self._folder)
