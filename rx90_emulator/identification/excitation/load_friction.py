"""Coulomb friction that grows with the load of the gear."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_BLOCK = 8192  # samples whose columns are held at a time


def load_dependent(problem: ExcitationProblem, parameters: Array) -> tuple[tuple[str, ...], Array]:
    """Return names and columns, one for each element: |load| sign(v), Nm per unit of relative growth; (r, n_el).

    Where friction grows with the load and the model does not say so, Coulomb torques come out as those at the mean
    load, with deviations that know nothing of it. With these columns they are the torques of the unloaded gear.

    Args:
        problem: r rows.
        parameters: values of the problem's b base parameters, from a fit without these columns, shape (b,): they give
            the torque of the arm alone, which is the load. An element of a motor that turns with several joints
            carries the torque of that motor.
    """
    arm = problem.arm
    n = len(arm.names)
    together = [k for k in range(n) if np.count_nonzero(arm.coupling[k]) > 1]
    along = []
    for run in problem.runs:
        bare = _bare_torque(problem, run, parameters)
        motors = bare @ np.linalg.inv(arm.coupling)
        load = np.abs(np.hstack([bare, motors[:, together]]))
        along.append((load * np.sign(run.velocity @ arm.element_matrix.T))[:, :, None])
    return tuple(f"{name}.load" for name in arm.element_names), problem.element_rows(along)


def _bare_torque(problem: ExcitationProblem, run: FilteredRun, parameters: Array) -> Array:
    """Return a run's joint torques without friction and payload at its full rate, Nm, shape (m, n)."""
    leading = list(problem.base.leading)
    blocks = [slice(k, k + _BLOCK) for k in range(0, len(run.time), _BLOCK)]
    motion = run.position, run.velocity, run.acceleration
    parts = [problem.columns.torque(*(values[block] for values in motion))[:, :, leading] for block in blocks]
    return np.concatenate([part @ parameters for part in parts])
