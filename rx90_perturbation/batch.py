"""Runs side by side in the lanes of a vector: their parameters and their state as compiled code sees them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_controller.cs7b_parameters import CONTROLLER_DTYPE
from rx90_sim.friction import ELEMENT_COUNT, FrictionSet
from rx90_sim.friction.bristle import elements_dtype

Array = NDArray[np.float64]
Record = NDArray[Any]

LANES = 8
"""Runs that go through the formulas together: two vectors of the processor hide each other's waiting times."""

_SERVO_NAMES = tuple(name for name in CONTROLLER_DTYPE.names or () if name != "gear")
SERVO_DTYPE = np.dtype([(name, np.float64, LANES) for name in _SERVO_NAMES], align=True)
"""One motor's controller, a lane for each run; the fields are those of CONTROLLER_DTYPE."""

GROUP_DTYPE = np.dtype(
    [
        (name, np.float64, (rows, LANES))
        for name, rows in (
            ("q", 6),  # deviation of the joints, rad
            ("v", 6),
            ("acceleration", 6),  # mean over the last step
            ("drive_torque", 6),  # joint side, Nm
            ("z", ELEMENT_COUNT),
            ("motor_position", 6),  # the drives' and the controllers' states as in the full simulation
            ("motor_velocity", 6),
            ("observer", 6),
            ("integrator", 6),
            ("position_torque", 6),
            ("feed_forward", 6),
            ("current", 6),
            ("limited", 6),
            ("saturated", 6),
            ("lost", 1),  # 1 where a joint left its speed limit far behind, or is not a number
            # Workspace of a step.
            ("q_mid", 6),
            ("v_mid", 6),
            ("rhs", 6),
            ("velocity", ELEMENT_COUNT),  # of the elements, nominal motion included
        )
    ]
    + [("coefficients", np.float64, (3, 6, 6))],  # inverse of M0, C0, K0 in the present tick
    align=True,
)
"""State of a group of runs, the run last."""


class Groups(NamedTuple):
    """Parameters of all runs in groups of LANES; idle lanes of the last group repeat its last run.

    Attributes:
        elements: shape (groups, 7), friction elements.
        servos: shape (groups, 6), SERVO_DTYPE.
    """

    elements: Record
    servos: Record


def pack(frictions: Sequence[FrictionSet], laws: Sequence[Record]) -> Groups:
    """Return the runs' parameters, lane by lane.

    Args:
        frictions: one for each run.
        laws: one for each run, shape (1,), CONTROLLER_DTYPE.
    """
    groups = -(-len(frictions) // LANES)
    elements = np.zeros((groups, ELEMENT_COUNT), elements_dtype(LANES))
    servos = np.zeros((groups, 6), SERVO_DTYPE)
    for run in range(groups * LANES):
        group, lane = divmod(run, LANES)
        source = min(run, len(frictions) - 1)
        records = frictions[source].records()
        for name in records.dtype.names or ():
            elements[name][group, ..., lane] = records[name]
        for name in _SERVO_NAMES:
            servos[name][group, :, lane] = laws[source][name][0]
    return Groups(elements, servos)
