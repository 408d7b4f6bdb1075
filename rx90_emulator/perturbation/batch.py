"""Runs side by side in the lanes of a vector: their parameters and their state as compiled code sees them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Record
from rx90_common.friction import ELEMENT_COUNT, FrictionSet
from rx90_common.friction.bristles.step import bristles_dtype, bristles_state_dtype
from rx90_common.friction.compiled_elements import element_arrays, elements_dtype
from rx90_common.friction.parts.bristles import fill_bristles
from rx90_controller.law.parameters import CONTROLLER_DTYPE

FEW, MANY = 4, 16
"""Runs that go through the formulas together: one vector of the processor, or several to hide latency."""

_SERVO_NAMES = tuple(name for name in CONTROLLER_DTYPE.names or () if name not in ("gear", "model"))
_STATE_ROWS = {
    "q": 6,  # deviation of the joints, rad
    "v": 6,
    "acceleration": 6,  # mean over the last step
    "excess": 6,  # drive torque beyond tau0, Nm
    "z": ELEMENT_COUNT,
    "motor_position": 6,  # the drives' and the controllers' states as in the full simulation
    "motor_velocity": 6,
    "observer": 6,
    "integrator": 6,
    "position_torque": 6,
    "feed_forward": 6,
    "current": 6,
    "limited": 6,
    "saturated": 6,
    "tripped": 1,  # 1 where the supervision would have cut the power
    "diverged": 1,  # 1 where a joint exceeded its speed limit, or is not a number
    # Workspace of a step.
    "q_mid": 6,
    "v_mid": 6,
    "rhs": 6,
    "velocity": ELEMENT_COUNT,  # of the elements, nominal motion included
}


def lanes_for(runs: int) -> int:
    """Return how many runs go together in a batch of `runs`: few lanes leave fewer idle."""
    return FEW if runs <= 2 * FEW else MANY


def servo_dtype(lanes: int) -> np.dtype[np.void]:
    """Return the type of one motor's controller, a lane for each run; the fields are those of CONTROLLER_DTYPE."""
    return np.dtype([(name, np.float64, lanes) for name in _SERVO_NAMES], align=True)


def group_dtype(lanes: int) -> np.dtype[np.void]:
    """Return the type of the state of a group of runs, a lane for each run."""
    fields = [(name, np.float64, (rows, lanes)) for name, rows in _STATE_ROWS.items()]
    # The inverse of M0, C0 and K0 in the present tick serve all runs.
    return np.dtype([*fields, ("coefficients", np.float64, (3, 6, 6))], align=True)


class Groups(NamedTuple):
    """All runs, group by group; idle lanes of the last group repeat the last run.

    Attributes:
        elements: friction elements, shape (groups, 7).
        kinds: their bristles, shape (groups, 7).
        blocks: what these remember, all zero, shape (groups, 7).
        servos: controllers, shape (groups, 6).
        states: all zero, shape (groups,).
    """

    elements: Record
    kinds: Record
    blocks: Record
    servos: Record
    states: Record


def pack(frictions: Sequence[FrictionSet], laws: Sequence[Record], lanes: int) -> Groups:
    """Return the runs' parameters, lane by lane, and room for their states.

    Args:
        frictions: one for each run.
        laws: one for each run, shape (1,), CONTROLLER_DTYPE.
        lanes: runs in a group.
    """
    groups = -(-len(frictions) // lanes)
    elements = np.zeros((groups, ELEMENT_COUNT), elements_dtype(lanes))
    kinds = np.zeros((groups, ELEMENT_COUNT), bristles_dtype(lanes))
    blocks = np.zeros((groups, ELEMENT_COUNT), bristles_state_dtype(lanes))
    servos = np.zeros((groups, 6), servo_dtype(lanes))
    for run in range(groups * lanes):
        group, lane = divmod(run, lanes)
        source = min(run, len(frictions) - 1)
        arrays = element_arrays(frictions[source].elements)
        for name in arrays.dtype.names or ():
            elements[name][group, ..., lane] = arrays[name][0].T
        for name in _SERVO_NAMES:
            servos[name][group, :, lane] = laws[source][name][0]
    sources = np.minimum(np.arange(groups * lanes), len(frictions) - 1).reshape(groups, lanes)
    for group, element in np.ndindex(kinds.shape):
        fill_bristles(kinds[group, element], [frictions[run].elements[element].bristles for run in sources[group]])
    return Groups(elements, kinds, blocks, servos, np.zeros(groups, group_dtype(lanes)))
