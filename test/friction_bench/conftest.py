"""Boards for the firmware tests: native, 8051 in uCsim, ATmega328P in simavr."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from needs import need
from rig_bench import Bench, greeted
from rig_simulators import simavr, ucsim
from shared_files import made_once

from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, NativeBoard, native_library
from friction_bench.rig.rig_file import Rig, load_rig
from rx90_common.base.share import share_directory

REPOSITORY = Path(__file__).resolve().parents[2]
BINARIES = {"native": "librig_native.so", "mcs51": "rig_mcs51.ihx", "avr": "rig_avr.hex"}
SIMULATORS = {"mcs51": ucsim, "avr": simavr}


@pytest.fixture(autouse=True)
def _compiler() -> None:
    """Skip without a C compiler: an emulated rig runs the firmware's own sources."""
    need("native")


def make_firmware(target: str, sources: Path, out: Path, *words: str) -> Path:
    need(target)
    command = ["make", "-s", "-C", str(sources), target, f"OUT={out}", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return out / BINARIES[target]


@pytest.fixture(scope="session")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    def build(target: str) -> Path:
        sources = REPOSITORY / "firmware"
        folder = made_once(tmp_path_factory, f"firmware_{target}", lambda out: make_firmware(target, sources, out))
        return folder / BINARIES[target]

    return cache(build)


@pytest.fixture
def make_mutant(tmp_path: Path, make_board: Callable[..., Any]) -> Callable[..., Any]:
    def make(target: str, file: str, old: str, new: str) -> Any:
        sources = tmp_path / "mutant"
        shutil.copytree(share_directory() / "firmware", sources)
        text = (sources / file).read_text()
        assert text.count(old) == 1, f"{file} holds {old!r} {text.count(old)} times"
        (sources / file).write_text(text.replace(old, new))
        return make_board(target, binary=make_firmware(target, sources, tmp_path / "out", "WARN="))

    return make


@pytest.fixture(scope="session")
def shim(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    out = tmp_path_factory.mktemp("shims")

    def build(target: str) -> Path:
        SIMULATORS[target].build_shim(out / f"{target}.so")
        return out / f"{target}.so"

    return cache(build)


@pytest.fixture
def make_board(firmware: Callable[[str], Path], shim: Callable[[str], Path]) -> Iterator[Callable[..., Any]]:
    with ExitStack() as stack:

        def make(target: str, seed: int = 1, binary: Path | None = None) -> Any:
            if target == "native":
                return NativeBoard(19200, binary or native_library({}))
            binary = binary or firmware(target)
            if target == "mcs51":
                need("ucsim")
                board: Any = ucsim.UcsimBoard(shim(target), binary, seed)
            else:
                need("simavr")
                board = simavr.SimavrBoard(shim(target), binary)
            stack.callback(board.close)
            return board

        yield make


@pytest.fixture(scope="session")
def rig() -> Rig:
    return load_rig(REPOSITORY / "config" / "rig" / "gm8224.yaml")


@pytest.fixture
def client(rig: Rig) -> RigClient:
    return greeted(rig)


@pytest.fixture
def emulated(client: RigClient) -> EmulatedRig:
    return client.port.emulated


@pytest.fixture
def bench(rig: Rig, tmp_path: Path) -> Iterator[Bench]:
    made = Bench(rig, tmp_path / "rig")
    try:
        yield made
    finally:
        made.close()


@pytest.fixture(autouse=True)
def _no_plots(undrawn: None) -> None:
    """Leave plots out where a test does not look at them; those of shared runs are drawn."""
