"""The arm's constants as compiled code sees them."""

from __future__ import annotations

from typing import Any

import numpy as np

from rx90_common.description.chain import RigidChain
from rx90_common.description.drives import DriveParameters
from rx90_common.dynamics.base_parameters import base_parameters
from rx90_common.dynamics.manipulator import MANIPULATOR_DTYPE


def manipulator_record(chain: RigidChain, drives: DriveParameters) -> np.ndarray[Any, Any]:
    """Return the constants of an arm with its rotors and springs, shape (1,), dtype MANIPULATOR_DTYPE."""
    record = np.zeros(1, MANIPULATOR_DTYPE)
    arm = record[0]
    parameters = base_parameters(chain)
    arm["frame"] = parameters.frame.transpose(2, 1, 0)
    for name in ("next_origin", "first_moment", "second_moment"):
        arm[name] = getattr(parameters, name).T
    arm["first_origin"] = parameters.first_origin
    arm["base_acceleration"] = -chain.gravity
    arm["rotor"] = drives.rotor_matrix
    arm["spring_torque"] = drives.spring_torque
    return record
