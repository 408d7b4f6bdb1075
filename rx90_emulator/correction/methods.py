"""Two methods of learning, by name: a filtered one that needs no model, and the norm-optimal one.

The filtered method is iterative learning control in its simplest form,

    c(t) <- Q [c(t) + gain e(t + lead)],

with a zero-phase low-pass filter Q (Bristow, Tharayil and Alleyne 2006, "A survey of iterative learning control", IEEE
Control Systems Magazine 26): the lead compensates the lag of the position loop; beyond the cut-off, where it no longer
does, nothing is learned. The norm-optimal method is that of `response`.

Both learn from the joints' errors by the encoders, or from the error of a measured tip, which the Jacobian of the path
relates to the joints.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import numpy as np
from scipy.signal import butter, sosfiltfilt

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.description.kinematics import jacobian
from rx90_emulator.correction.path import TrajectoryPath
from rx90_emulator.correction.response import best_change, gains, response
from rx90_emulator.loop.setup import Setup

LEAD_IN = 0.3
"""Time before the path from which errors count, s, gradually: so the error at rest is corrected when the path
begins."""
_MIN_SHARE = 0.05  # of the largest singular value: directions that take 20 times the joints' motion are hardly used
_ORDER = 2  # of the Butterworth filter, which is run forwards and backwards

Update: TypeAlias = Callable[[Array, Array, float], Array]
"""Returns the next offsets for offsets, rad, (n, joints), their error, and a share of the gain. The error is that of
the joints by the encoders, rad, (n, joints), or that of the tip, m, (n, 3)."""


class Method(Protocol):
    """A method of learning; frozen, checked."""

    def prepare(self, setup: Setup, nominal: TrajectoryPath, *, tip: bool) -> Update:
        """Return the update along a motion, from the error of the tip or from those of the encoders."""


@dataclass(frozen=True)
class Filtered:
    """The filtered method.

    Attributes:
        gain: share of an error that is added to the correction, 0 to 2.
        lead: s; None for the lag of the position loop without velocity feed-forward, 1/kp.
        cutoff: of the filter, Hz.

    Raises:
        ConfigError: naming the value and what is accepted.
    """

    gain: float = 1.0
    lead: float | None = None
    cutoff: float = 40.0

    def __post_init__(self) -> None:
        _check(self, gain=(0.0, 2.0, ""), lead=(0.0, 1.0, " s"), cutoff=(0.0, 1e6, " Hz"))

    def prepare(self, setup: Setup, nominal: TrajectoryPath, *, tip: bool) -> Update:
        """Return the update."""
        lead = float(np.mean(1.0 / setup.controller.kp)) if self.lead is None else self.lead
        rows = np.minimum(np.arange(len(nominal.counts)) + round(lead / nominal.period), len(nominal.counts) - 1)
        counted, low_pass = lead_in(nominal)[:, None], zero_phase(self.cutoff, nominal.period)
        inverse = _to_joints(setup, nominal) if tip else None

        def update(offsets: Array, error: Array, share: float) -> Array:
            joints = error if inverse is None else np.einsum("nij,nj->ni", inverse, error)
            return low_pass(offsets + share * self.gain * (joints * counted)[rows])

        return update


@dataclass(frozen=True)
class NormOptimal:
    """The norm-optimal method; both weights are relative to an error of a metre at the tip.

    Attributes:
        effort: weight of a change of the correction, m/rad. A smaller one learns faster and up to higher frequencies,
            relies more on the model, and transmits more noise.
        joints: weight of each joint's own error beside that of the tip, m/rad, with encoders; it also preserves the
            tool's orientation.
        cutoff: of a zero-phase filter of the correction, Hz; None for none.

    Raises:
        ConfigError: naming the value and what is accepted.
    """

    effort: float = 0.1
    joints: float = 0.005
    cutoff: float | None = None

    def __post_init__(self) -> None:
        _check(self, effort=(0.0, 1e3, " m/rad"), joints=(0.0, 1e3, " m/rad"), cutoff=(0.0, 1e6, " Hz"))

    def prepare(self, setup: Setup, nominal: TrajectoryPath, *, tip: bool) -> Update:
        """Return the update."""
        a, b, stride = response(setup, nominal.setpoints)
        slopes = jacobian(setup.robot.chain, nominal.setpoints[::stride, 0])
        by_tip = np.ascontiguousarray(np.swapaxes(slopes[:, :3], 1, 2))
        weight = by_tip @ slopes[:, :3] + (0.0 if tip else self.joints**2) * np.eye(slopes.shape[2])
        counted, point = lead_in(nominal), np.arange(len(nominal.counts)) // stride
        feedback, factors = gains(a, b, stride, weight, self.effort, counted)
        towards = (by_tip if tip else weight)[point] * counted[:, None, None]
        low_pass = None if self.cutoff is None else zero_phase(self.cutoff, nominal.period)

        def update(offsets: Array, error: Array, share: float) -> Array:
            weighted = np.einsum("nij,nj->ni", towards, error)
            changed = offsets + share * best_change(a, b, stride, feedback, factors, weighted)
            return changed if low_pass is None else low_pass(changed)

        return update


def method_named(name: str, **options: float) -> Filtered | NormOptimal:
    """Return the method "norm-optimal" or "filtered", with options instead of the defaults.

    Raises:
        ConfigError: for an option of the other method, and a value that is not accepted.
    """
    method = NormOptimal() if name == "norm-optimal" else Filtered()
    for option in options:
        if not hasattr(method, option):
            raise ConfigError(f"the method {name} has no option {option!r}; accepted: {', '.join(vars(method))}")
    return replace(method, **options)  # type: ignore[arg-type]


def lead_in(nominal: TrajectoryPath) -> Array:
    """Return the weights of the errors of set-points, 0 to 1, shape (n,)."""
    counts = nominal.counts.astype(np.float64)
    begin = int(np.argmax(nominal.counts))
    rows = min(round(LEAD_IN / nominal.period), begin)
    counts[begin - rows : begin] = np.arange(rows) / max(rows, 1)
    return counts


def zero_phase(cutoff: float, period: float) -> Callable[[Array], Array]:
    """Return a low-pass filter of rows, run forwards and backwards, which extends its input by its last value.

    Raises:
        ConfigError: if the cut-off is not below half the rate.
    """
    if not cutoff < 0.5 / period:
        raise ConfigError(f"cutoff is {cutoff:g} Hz; accepted: below {0.5 / period:g} Hz, half the rate of set-points")
    sections = butter(_ORDER, cutoff, fs=1.0 / period, output="sos")
    return lambda rows: np.ascontiguousarray(sosfiltfilt(sections, rows, axis=0, padtype="constant"))


def _to_joints(setup: Setup, nominal: TrajectoryPath) -> Array:
    """Return the damped pseudo-inverse of the tip's Jacobian along the motion, rad/m, shape (n, joints, 3)."""
    slopes = jacobian(setup.robot.chain, nominal.setpoints[:, 0])[:, :3]
    square = slopes @ np.swapaxes(slopes, 1, 2)
    damping = (_MIN_SHARE**2 * np.linalg.eigvalsh(square)[:, -1])[:, None, None] * np.eye(3)
    return np.asarray(np.swapaxes(slopes, 1, 2) @ np.linalg.inv(square + damping))


def _check(method: object, **ranges: tuple[float, float, str]) -> None:
    for name, (low, high, unit) in ranges.items():
        value = getattr(method, name)
        if value is not None and not low < value <= high:
            raise ConfigError(f"{name} is {value:g}{unit}; accepted: a number > {low:g}, up to {high:g}")
