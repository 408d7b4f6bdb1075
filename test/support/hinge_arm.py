"""An arm of one joint with known friction, and a bag of it, which many tests of the identification share."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from foreign_arms import Curve, Program, drive_torque, urdf_text, write, write_fallback
from numpy.typing import NDArray

from rx90_common.friction import FrictionElement
from rx90_common.friction.friction_file import FrictionFile

RATE = 100.0
CURVE = Curve(6.0, 5.5, 7.8, 7.0, 0.05, 1.2, 2.5)


@dataclass
class Hinge:
    urdf: Path
    bag: Path
    fallback: Path
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    torque: NDArray[np.float64]

    def friction(self, file: Path, factor: float = 1.0) -> Path:
        values = vars(CURVE.scaled(factor)) | {"c0": 1e5, "c1": 0.0}
        file.write_text(FrictionFile.of({"hinge": FrictionElement.of(values)}).text(), encoding="utf-8")
        return file


def make_hinge(folder: Path) -> Hinge:
    urdf = folder / "arm.urdf"
    urdf.write_text(urdf_text(["hinge"], ["0 1 0"], [2.0]), encoding="utf-8")
    model = pin.buildModelFromXML(urdf.read_text(encoding="utf-8"))
    motion = Program([[1.0]], [[0.2]], np.geomspace(0.02, 1.0, 6).tolist(), RATE).motion()
    torque = drive_torque(model, np.eye(1), [CURVE], motion, RATE)
    bag = write(folder / "run", "/joint_states", ["hinge"], RATE, (*motion, torque))
    return Hinge(urdf, bag, write_fallback(folder / "fallback.yaml", ["hinge"]), *motion, torque)
