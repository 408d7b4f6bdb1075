"""`rx90_identify --excitation BAG ...`: values, verdicts, files, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from foreign_arms import Curve, drive_torque, urdf_text, write

from rx90_common.base.errors import DONE
from rx90_emulator.cli.frame import run

RATE = 100.0
NAMES = ["shoulder", "elbow"]
CURVES = [Curve(8.0, 8.0, 8.0, 8.0, 0.1, 1.0, 5.0), Curve(3.0, 3.0, 3.0, 3.0, 0.1, 1.0, 2.0)]
NOISE = 0.15  # Nm
Array = np.ndarray[Any, np.dtype[np.float64]]


@dataclass
class Bench:
    """Two joints, their URDF, and runs of them."""

    folder: Path
    urdf: Path
    model: Any

    def torque(self, motion: tuple[Array, Array], factor: float = 1.0) -> Array:
        """Return the drives' torques without noise, with the friction times a factor."""
        curves = [curve.scaled(factor) for curve in CURVES]
        return drive_torque(self.model, np.eye(2), curves, motion, RATE)

    def bag(self, name: str, seed: int, factor: float = 1.0, seconds: float = 20.0) -> Path:
        """Write a run."""
        motion = fourier(seed, seconds)
        noise = NOISE * np.random.default_rng(seed).normal(size=motion[0].shape)
        return write(self.folder / name, "/joint_states", NAMES, RATE, (*motion, self.torque(motion, factor) + noise))

    def identify(self, *words: object) -> int:
        """Run the command."""
        return run("rx90_identify", [str(word) for word in ("--urdf", self.urdf, *words)])


def fourier(seed: int, seconds: float) -> tuple[Array, Array]:
    """Return positions and velocities of a random Fourier series of 0.1 to 0.5 Hz, shape (m, 2)."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1.0 / RATE)[:, None]
    position, velocity = np.zeros((2, len(time), 2))
    for number in range(1, 6):
        rate, phase = 2.0 * np.pi * 0.1 * number, rng.uniform(0.0, 2.0 * np.pi, 2)
        size = rng.uniform(0.5, 1.0, 2) / rate
        position += size * np.sin(rate * time + phase)
        velocity += size * rate * np.cos(rate * time + phase)
    return position, velocity


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """Return two links that swing, and three runs: one, another one, and another one with more friction."""
    folder = tmp_path_factory.mktemp("arm")
    urdf = folder / "arm.urdf"
    urdf.write_text(urdf_text(NAMES, ["0 1 0", "0 1 0"], [5.0, 3.0]), encoding="utf-8")
    bench = Bench(folder, urdf, pin.buildModelFromXML(urdf.read_text(encoding="utf-8")))
    bench.bag("run", 1)
    bench.bag("unseen", 2)
    bench.bag("stiff", 3, 1.8)
    return bench


@pytest.fixture(scope="module")
def identified(bench: Bench) -> Path:
    """Return the folder that the command wrote."""
    folder = bench.folder / "identified"
    bags = ["--excitation", bench.folder / "run", "--validation", bench.folder / "unseen"]
    assert bench.identify(*bags, "--output", folder) == DONE
    return folder


def test_friction_and_inertia_are_those_of_the_arm(bench: Bench, identified: Path) -> None:
    """Coulomb, viscous and gravity parameters lie within four deviations of the truth, and these within 5 % of it."""
    found = yaml.safe_load((identified / "parameters.yaml").read_text(encoding="utf-8"))
    for name, curve in zip(NAMES, CURVES, strict=True):
        for parameter in ("tau_c_positive", "tau_c_negative", "c2"):
            truth, entry = getattr(curve, parameter), found["friction"][name][parameter]
            assert abs(entry["value"] - truth) < 4.0 * entry["deviation"]
            assert entry["deviation"] < 0.05 * truth
    mass, centre = 3.0, bench.model.inertias[2].lever[2]
    gravity = next(entry for name, entry in found["base_parameters"].items() if entry["group"].startswith("mz_2"))
    assert abs(gravity["value"] - mass * centre) < 4.0 * gravity["deviation"]
    assert gravity["unit"] == "kg m"
