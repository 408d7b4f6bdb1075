"""The limits that set-points must keep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rx90_common.errors import ConfigError, TrajectoryError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointLimits:
    """Limits of six joints, each of shape (6,): positions in rad, speeds in rad/s.

    Attributes:
        start_tolerance: how far, rad, a trajectory may start from the set-point that is held.
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    start_tolerance: float = 1e-3

    def __post_init__(self) -> None:
        if np.any(self.lower >= self.upper) or np.any(self.velocity <= 0):
            raise ConfigError(
                f"joint limits {self.lower.tolist()}, {self.upper.tolist()}, {self.velocity.tolist()}; "
                "accepted: lower < upper, velocity > 0"
            )

    def check(self, setpoints: Array, times: Array) -> None:
        """Check every set-point that will be sent.

        Args:
            setpoints: position, velocity, acceleration, shape (m, 3, 6).
            times: their times from the start of the trajectory, s, shape (m,).

        Raises:
            TrajectoryError: naming joint, time, amount and limit of the first one outside.
        """
        position, velocity = setpoints[:, 0], setpoints[:, 1]
        # A spline that should end exactly on a limit may miss it by rounding.
        slack = 1e-9
        outside = (position < self.lower - slack) | (position > self.upper + slack)
        self._refuse(outside, position, times, "position", "rad", self.lower, self.upper)
        too_fast = np.abs(velocity) > self.velocity + slack
        self._refuse(too_fast, velocity, times, "velocity", "rad/s", -self.velocity, self.velocity)

    def _refuse(
        self,
        bad: NDArray[np.bool_],
        values: Array,
        times: Array,
        what: str,
        unit: str,
        low: Array,
        high: Array,
    ) -> None:
        if not bad.any():
            return
        row, joint = np.argwhere(bad)[0]
        raise TrajectoryError(
            f"{self.names[joint]}: set-point {what} {values[row, joint]:.6g} {unit} at {times[row]:.3f} s; "
            f"accepted: [{low[joint]:.6g}, {high[joint]:.6g}]"
        )
