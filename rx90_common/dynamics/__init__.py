"""The rigid arm in compiled code: base parameters, mass matrix and bias torques, inverse dynamics.

It is in rx90_common because plant, controller and perturbation method share it.
"""

from rx90_common.dynamics.base_parameters import manipulator_record
from rx90_common.dynamics.manipulator import body_dtype, manipulator_dtype

__all__ = ["body_dtype", "manipulator", "manipulator_dtype", "manipulator_record"]
