"""What the searches for wrong encoder zeros share: the turns they try, and what they find, with the option that helps.

A payload or a spring that the model lacks asks for other torques, as a wrong zero does; the message names it, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from rx90_common.base.arrays import Array, Mask

QUARTERS: Final = (-0.5 * math.pi, 0.5 * math.pi, math.pi)
"""Turns by which the zeros of URDF and encoder differ where they count from other poses, rad."""
SMALLEST: Final = 0.01
"""Error of a zero that counts, rad: elasticity and rounded geometry pass for less."""
STEP: Final = 1e-4
"""Of differences by an angle, rad."""


@dataclass(frozen=True, eq=False)
class ZeroCheck:
    """Which zeros would explain the recorded torques better than those given.

    Attributes:
        names: n joints.
        zero: that were used, rad, shape (n,).
        error: of them, rad, shape (n,): 0 where nothing speaks against one.
        deviation: standard deviation of small errors, rad, shape (n,); 0 where it is not known, as of quarter turns.
        told: whether the torques tell an error of the joint's zero at all, shape (n,).
        before: RMS of the torque that is left, over that of the torque, all joints together.
        after: the same with the better zeros.
    """

    names: tuple[str, ...]
    zero: Array
    error: Array
    deviation: Array
    told: Mask
    before: float
    after: float

    @property
    def text(self) -> str:
        """Return it in words; empty where nothing speaks against the zeros."""
        wrong = [
            f"{name} by {error:.4g}{f' +- {spread:.2g}' if spread else ''} rad"
            for name, error, spread in zip(self.names, self.error.tolist(), self.deviation.tolist(), strict=True)
            if error
        ]
        if not wrong:
            return ""
        better = (np.round(self.zero + self.error, 6) + 0.0).tolist()
        silent = [name for name, told in zip(self.names, self.told.tolist(), strict=True) if not told]
        rest = f"; the torques do not tell the zero of {', '.join(silent)}" if silent else ""
        return (
            f"zeros: {', '.join(wrong)} {'seem' if len(wrong) > 1 else 'seems'} to be off (unexplained torque "
            f"{self.before:.1%} -> {self.after:.1%}), or the model lacks a payload or a spring: "
            f"try --zero {' '.join(f'{value:.6g}' for value in better)}{rest}"
        )


def encoder_error(shift: Array) -> Array:
    """Return the errors of zeros, within half a turn, for joints that stand further on than assumed by `shift`, rad.

    Recorded angles lose the zero, so that a joint which stands a further on has a zero that is a less.
    """
    return np.array([math.remainder(-value, 2.0 * math.pi) if value else 0.0 for value in shift.tolist()])
