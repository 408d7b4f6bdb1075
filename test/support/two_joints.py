"""Two joints that swing: an arm with friction that is written down, bags of its runs, and the command on these."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from foreign_arms import Array, Curve, drive_torque, urdf_text, write

from rx90_emulator.cli.frame import run

RATE = 100.0
NAMES = ["shoulder", "elbow"]
CURVES = [Curve(8.0, 8.0, 8.0, 8.0, 0.1, 1.0, 5.0), Curve(3.0, 3.0, 3.0, 3.0, 0.1, 1.0, 2.0)]
NOISE = 0.15  # Nm


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


@dataclass
class Bench:
    folder: Path
    urdf: Path
    model: Any

    @classmethod
    def make(cls, folder: Path) -> Bench:
        urdf = folder / "arm.urdf"
        urdf.write_text(urdf_text(NAMES, ["0 1 0", "0 1 0"], [5.0, 3.0]), encoding="utf-8")
        return cls(folder, urdf, pin.buildModelFromXML(urdf.read_text(encoding="utf-8")))

    def torque(self, motion: tuple[Array, Array], factor: float = 1.0) -> Array:
        curves = [curve.scaled(factor) for curve in CURVES]
        return drive_torque(self.model, np.eye(2), curves, motion, RATE)

    def bag(self, name: str, seed: int, factor: float = 1.0, seconds: float = 20.0, first: int = 0) -> Path:
        motion = fourier(seed, seconds)
        return self.write(name, motion, self.torque(motion, factor) + self.noise(motion, seed), first)

    def write(self, name: str, motion: tuple[Array, Array], torque: Array, first: int = 0) -> Path:
        return write(self.folder / name, "/joint_states", NAMES, RATE, [one[first:] for one in (*motion, torque)])

    @staticmethod
    def noise(motion: tuple[Array, Array], seed: int) -> Array:
        return NOISE * np.random.default_rng(seed).normal(size=motion[0].shape)

    def identify(self, *words: object) -> int:
        return run("rx90 identify", [str(word) for word in (*words, "--urdf", self.urdf)])
