"""The rigid arm in compiled code: base parameters, mass matrix and bias torques, inverse dynamics.

It lies on the ground because plant, controller and perturbation method share it.
"""

from rx90_common.dynamics.base_parameters import manipulator_record
from rx90_common.dynamics.manipulator import BODY_DTYPE, MANIPULATOR_DTYPE

__all__ = ["BODY_DTYPE", "MANIPULATOR_DTYPE", "manipulator", "manipulator_record"]
