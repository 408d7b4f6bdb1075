"""Sweeps with known friction for the tests of the identification."""

import io
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from hinge_arm import Hinge, make_hinge
from shared_files import made_once

import rx90_emulator as rx
from benchmarks.random_friction import random_friction
from benchmarks.synthetic_sweeps import Noise, Program, drive_torque, measured
from rx90_common.base.errors import DONE
from rx90_common.friction import FrictionSet
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.records import JointRecord

Sweeps = Callable[..., tuple[JointRecord, FrictionSet]]


@pytest.fixture(scope="session")
def arm(shipped: rx.Setup) -> rx.RigidArm:
    return rx.RigidArm.from_setup(shipped)


@pytest.fixture(scope="session")
def sweeps(shipped: rx.Setup) -> Sweeps:
    """Return a maker of synthetic records: `sweeps(joints, seed, noise, payload, **program)`."""

    def make(
        joints: Sequence[int],
        seed: int = 0,
        noise: Noise | None = None,
        payload: float = 0.0,
        friction: FrictionSet | None = None,
        **program: float,
    ) -> tuple[JointRecord, FrictionSet]:
        rng = np.random.default_rng(seed)
        friction = friction or random_friction(shipped.friction, rng)
        short = {"count": 12, "poses": 1, "longest": 2.0}
        motion = Program(joints, **(short | program)).motion(shipped, seed)  # type: ignore[arg-type]
        torque = drive_torque(shipped, friction, motion, payload)
        return measured(shipped, motion, torque, rng, noise or Noise()), friction

    return make


@pytest.fixture(scope="session")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    def make(folder: Path) -> None:
        words = ["--quick", "--group", "joint_3", "--output", str(folder)]
        assert run("rx90 experiment sliding engine", words) == DONE

    return made_once(tmp_path_factory, "series", make)


@pytest.fixture(scope="session")
def identified(series: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    def make(folder: Path) -> None:
        folder.mkdir()
        with redirect_stdout(io.StringIO()) as said:
            code = run("rx90 identify sliding", [str(series), "--output", str(folder / "friction.yaml")])
        assert code == DONE, said.getvalue()
        (folder / "said.txt").write_text(said.getvalue(), encoding="utf-8")

    folder = made_once(tmp_path_factory, "identified", make)
    return folder / "friction.yaml", (folder / "said.txt").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def hinge(tmp_path_factory: pytest.TempPathFactory) -> Hinge:
    return make_hinge(tmp_path_factory.mktemp("hinge"))


@pytest.fixture(autouse=True)
def _no_plots(undrawn: None) -> None:
    """Leave plots out where a test does not look at them; those of shared runs are drawn."""
