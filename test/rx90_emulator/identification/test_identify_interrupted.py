"""Ctrl-C, SIGTERM and a full disk in the middle of `rx90_identify` leave every file as it was."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from foreign_arms import Curve, Program, drive_torque, urdf_text, write, write_fallback

from rx90_common.base.errors import INTERRUPTED, OutputError
from rx90_common.process.files import write_all
from rx90_emulator.cli.frame import run
from rx90_emulator.identification import identify as identify_bags
from rx90_emulator.identification import job as identify_job

CURVE = Curve(6.0, 5.5, 7.8, 7.0, 0.05, 1.2, 2.5)


@pytest.fixture(scope="module")
def arguments(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return the arguments of a run that would succeed, but for its output."""
    folder = tmp_path_factory.mktemp("hinge")
    urdf = folder / "arm.urdf"
    urdf.write_text(urdf_text(["hinge"], ["0 1 0"], [2.0]), encoding="utf-8")
    model = pin.buildModelFromXML(urdf.read_text(encoding="utf-8"))
    motion = Program([[1.0]], [[0.2]], np.geomspace(0.02, 1.0, 6).tolist(), 100.0).motion()
    torque = drive_torque(model, np.eye(1), [CURVE], motion, 100.0)
    bag = write(folder / "bag", "/joint_states", ["hinge"], 100.0, (*motion, torque))
    fallback = write_fallback(folder / "fallback.yaml", ["hinge"])
    return ["--sliding", str(bag), "--urdf", str(urdf), "--fallback", str(fallback)]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("place", ["read_record", "identify_records", "report_page", "write_all"])
def test_an_interrupt_leaves_everything(
    arguments: list[str],
    tmp_path: Path,
    place: str,
    number: signal.Signals,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Ctrl-C and SIGTERM while a bag is read, fitted, drawn or written end with one line and status 130."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # as in a process of its own
    output = tmp_path / "friction.yaml"
    output.write_text("mine", encoding="utf-8")

    def interrupted(*_: Any, **__: Any) -> None:
        os.kill(os.getpid(), number)

    if place == "write_all":
        # After the first of the two files.
        whole = Path.write_bytes
        monkeypatch.setattr(Path, "write_bytes", lambda *a, **k: (whole(*a, **k), interrupted()))
    else:
        monkeypatch.setattr(identify_job if place == "report_page" else identify_bags, place, interrupted)
    assert run("rx90_identify", [*arguments, "--output", str(output), "--force"]) == INTERRUPTED
    assert capsys.readouterr().err.splitlines()[-1] == "rx90_identify: interrupted; nothing was written"
    assert [file.name for file in tmp_path.iterdir()] == ["friction.yaml"]
    assert output.read_text(encoding="utf-8") == "mine"
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


@pytest.fixture
def small_files() -> Iterator[int]:
    """Let no file grow beyond what is returned, as on a disk that is full; more than the tests' own log may need."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size := 10_000_000, before[1]))
    yield size
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_leaves_everything(tmp_path: Path, small_files: int) -> None:
    """Where the second of two files does not fit, the first keeps its old content, and the line names the second."""
    first, second = tmp_path / "a.yaml", tmp_path / "b.html"
    first.write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match=r"b\.html: cannot be written \(File too large\)"):
        write_all({first: b"new", second: bytes(small_files + 1)})
    assert [file.name for file in tmp_path.iterdir()] == ["a.yaml"]
    assert first.read_text(encoding="utf-8") == "mine"
