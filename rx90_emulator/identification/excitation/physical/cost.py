"""What consistency costs in torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array, Index


@dataclass(frozen=True, eq=False)
class TorqueCost:
    """RMS along the runs at each of n joints, Nm, shape (n,); 0 for a joint without rows.

    Attributes:
        added: torque that the shift of the base parameters adds.
        before: residuals with the base parameters as identified.
        after: residuals with the shifted ones.
    """

    added: Array
    before: Array
    after: Array


def torque_cost(regressor: Array, joint: Index, residual: Array, shift: Array, count: int) -> TorqueCost:
    """Return what a shift of the base parameters costs.

    Args:
        regressor: derivative of the torque by the base parameters, shape (r, p).
        joint: of each row, shape (r,).
        residual: recorded torque less that of the fit, Nm, shape (r,).
        shift: of the base parameters, shape (p,).
        count: number of joints.
    """
    rows = np.maximum(np.bincount(joint, minlength=count), 1)
    added = regressor @ shift
    return TorqueCost(
        *(np.sqrt(np.bincount(joint, values**2, count) / rows) for values in (added, residual, residual - added))
    )
