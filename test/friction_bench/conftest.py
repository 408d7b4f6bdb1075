"""Boards for the firmware tests: native, 8051 in uCsim, ATmega328P in simavr."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from rig_bench import Bench
from rig_simulators import simavr, ucsim

from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, NativeBoard, VirtualPort, compile_core, firmware_directory
from friction_bench.rig.messages import ResetCause
from friction_bench.rig.rig_file import Rig, load_rig

REPOSITORY = Path(__file__).resolve().parents[2]
TOOLS = {
    "mcs51": (("sdcc",), "sdcc sdcc-ucsim"),
    "avr": (("avr-gcc", "avr-objcopy"), "gcc-avr avr-libc libsimavr-dev"),
}
TARGETS = ("native", "mcs51", "avr")


def require(target: str, present: bool) -> None:
    """Skip, or fail where RIG_FIRMWARE_REQUIRED is set, when a target's tools are missing."""
    if present:
        return
    message = f"{target}: tools are missing; apt-get install {TOOLS[target][1]}"
    if os.environ.get("RIG_FIRMWARE_REQUIRED"):
        pytest.fail(message)
    pytest.skip(message)


def have(programs: tuple[str, ...]) -> bool:
    """Return whether all programs are installed."""
    return all(shutil.which(program) for program in programs)


@pytest.fixture(scope="session")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return a builder of a target's binary, by the firmware's own Makefile, once a session."""
    out = tmp_path_factory.mktemp("firmware")
    binaries = {"mcs51": out / "rig_mcs51.ihx", "avr": out / "rig_avr.hex"}

    def build(target: str) -> Path:
        require(target, have(TOOLS[target][0]))
        if not binaries[target].exists():
            command = ["make", "-s", "-C", str(REPOSITORY / "firmware"), target, f"OUT={out}"]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stdout + done.stderr
        return binaries[target]

    return build


class TestBoard:
    """A board that can be reset, whatever it is."""

    __test__ = False

    def __init__(self, board: NativeBoard | ucsim.UcsimBoard | simavr.SimavrBoard) -> None:
        self.inner = board
        self.write = board.write
        self.read = board.read
        self.run = board.run

    @property
    def dac(self) -> int:
        """Return the code on the DAC."""
        return self.inner.dac

    @property
    def stage_on(self) -> bool:
        """Return whether the power stage is enabled."""
        return self.inner.stage_on

    def restart(self) -> None:
        """Reset the board."""
        if isinstance(self.inner, NativeBoard):
            self.inner.reset(ResetCause.EXTERNAL)
        else:
            self.inner.reset()


@pytest.fixture
def make_mutant(tmp_path: Path, make_board: Callable[..., TestBoard]) -> Callable[..., TestBoard]:
    """Return a maker of a board with a firmware, built by its own Makefile, in which one text is replaced."""

    def make(target: str, file: str, old: str, new: str) -> TestBoard:
        require(target, have(TOOLS[target][0]))
        out = tmp_path / "mutant_firmware"
        sources = mutate(tmp_path / "mutant", file, old, new)
        command = ["make", "-s", "-C", str(sources), target, f"OUT={out}"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return make_board(target, binary=out / {"mcs51": "rig_mcs51.ihx", "avr": "rig_avr.hex"}[target])

    return make


@pytest.fixture(scope="session")
def shim(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return a builder of what couples a simulator to these tests, once a session."""
    out = tmp_path_factory.mktemp("shims")

    def build(target: str) -> Path:
        library = out / f"{target}.so"
        if not library.exists():
            {"mcs51": ucsim, "avr": simavr}[target].build_shim(library)
        return library

    return build


@pytest.fixture
def make_board(firmware: Callable[[str], Path], shim: Callable[[str], Path]) -> Iterator[Callable[[str], TestBoard]]:
    """Return a maker of boards; simulators end with the test, whatever happens."""
    with ExitStack() as stack:

        def make(target: str, seed: int = 1, binary: Path | None = None) -> TestBoard:
            if target == "native":
                return TestBoard(NativeBoard())
            binary = binary or firmware(target)
            if target == "mcs51":
                require(target, ucsim.simulator() is not None)
                board: ucsim.UcsimBoard | simavr.SimavrBoard = ucsim.UcsimBoard(shim(target), binary, seed)
            else:
                require(target, Path("/usr/include/simavr/sim_avr.h").exists())
                board = simavr.SimavrBoard(shim(target), binary)
            stack.callback(board.close)
            return TestBoard(board)

        yield make


@pytest.fixture(scope="session")
def rig() -> Rig:
    """Return the shipped rig file."""
    return load_rig(REPOSITORY / "config" / "rig" / "gm8224.yaml")


@pytest.fixture
def emulated(rig: Rig) -> EmulatedRig:
    """Return an emulated rig in virtual time."""
    return EmulatedRig(rig, 1)


@pytest.fixture
def client(emulated: EmulatedRig, rig: Rig) -> RigClient:
    """Return a greeted client of the emulated rig."""
    greeted = RigClient(VirtualPort(emulated), rig)
    greeted.connect()
    return greeted


@pytest.fixture
def bench(rig: Rig, tmp_path: Path) -> Iterator[Bench]:
    """Return a link that is connected."""
    made = Bench(rig, tmp_path / "rig")
    try:
        yield made
    finally:
        made.close()


def mutate(folder: Path, file: str, old: str, new: str) -> Path:
    """Copy the firmware's sources into `folder` with one text replaced; return the folder."""
    shutil.copytree(firmware_directory(), folder, dirs_exist_ok=True)
    text = (folder / file).read_text()
    assert text.count(old) == 1, f"{file} holds {old!r} {text.count(old)} times"
    (folder / file).write_text(text.replace(old, new))
    return folder


@pytest.fixture
def mutant(tmp_path: Path) -> Callable[[str, str, str], NativeBoard]:
    """Return a builder of a native board whose firmware has one text replaced."""

    def build(file: str, old: str, new: str) -> NativeBoard:
        sources = mutate(tmp_path / "mutant", file, old, new)
        library = tmp_path / "mutant.so"
        compile_core(sources, library, {})
        return NativeBoard(library=library)

    return build
