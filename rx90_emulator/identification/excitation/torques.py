"""Recorded and predicted torques of a run, how well they agree, and whether their difference drifts.

How well a fit explains the torque at each speed, and what the runs did not determine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from rx90_common.base.arrays import Array, Index
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.least_squares import LinearFit, time_blocks
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.options import ExcitationTolerances
from rx90_emulator.identification.records import BagSource

_DIFFERENCES, _DIFFERENCE_GAIN = 3, 20.0  # the third difference 1, -3, 3, -1 has 20 times the variance of white noise
_NORMAL_MAD = 0.6745  # median of a standard normal's size
_MIN_TREND_BLOCKS = 6  # over which a trend is tested
_MAX_CHI_SQUARE = 1e4  # chi^2 up to which it tells something
_TREND_LEVEL = 0.01  # chance of a false trend, over all joints and runs together


class JointTorque(NamedTuple):
    """One joint in one run where it moves; filtered, each of shape (k,).

    Attributes:
        time: s.
        velocity: rad/s.
        recorded: Nm.
        predicted: Nm.
    """

    time: Array
    velocity: Array
    recorded: Array
    predicted: Array

    @property
    def residual(self) -> Array:
        """Return recorded less predicted torque, Nm, shape (k,)."""
        return self.recorded - self.predicted


@dataclass(frozen=True, eq=False)
class RunTorques:
    """Recorded against predicted torques of one bag.

    Attributes:
        names: n joints.
        source: the bag.
        joints: one for each joint; empty arrays for one that stands still.
        noise: of the filtered torque, standard deviation if the noise is white, Nm, shape (n,).
    """

    names: tuple[str, ...]
    source: BagSource
    joints: tuple[JointTorque, ...]
    noise: Array

    def _rms(self, values: Sequence[Array]) -> Array:
        return np.array([math.sqrt(np.mean(one**2)) if len(one) else math.nan for one in values])

    @property
    def rms(self) -> Array:
        """Return the RMS torque difference, Nm, shape (n,); NaN for a joint that stands still."""
        return self._rms([joint.residual for joint in self.joints])

    @property
    def share(self) -> Array:
        """Return the RMS difference over the RMS recorded torque, shape (n,)."""
        return np.asarray(self.rms / self._rms([joint.recorded for joint in self.joints]))

    @property
    def total_share(self) -> float:
        """Return the same over all joints together."""
        residual = np.concatenate([joint.residual for joint in self.joints])
        recorded = np.concatenate([joint.recorded for joint in self.joints])
        return float(np.linalg.norm(residual) / np.linalg.norm(recorded))

    @property
    def chi_square(self) -> Array:
        """Return the mean square difference over that of the noise, shape (n,): 1 where the model fits.

        NaN for a joint that stands still or whose torque shows no noise.
        """
        return np.asarray((self.rms / np.where(self.noise > 0.0, self.noise, np.nan)) ** 2)

    @property
    def noiseless(self) -> Array:
        """Return whether the noise is below a hundredth of the difference, shape (n,): chi^2 then tells nothing."""
        return np.asarray((self.rms > 0.0) & (self.noise < self.rms / math.sqrt(_MAX_CHI_SQUARE)))


@dataclass(frozen=True, eq=False)
class TorqueValidation:
    """The verdict of a run that was not used.

    Attributes:
        torques: of the run, predicted by the identified parameters.
        consistent: the same, predicted by the inertias that bodies can have, which the robot's files hold.
        tolerances: what counts as agreement.
    """

    torques: RunTorques
    consistent: RunTorques
    tolerances: ExcitationTolerances

    @property
    def passed(self) -> bool:
        """Return whether each joint that moves, and all of them together, agree with both predictions."""
        return all(self._agrees(torques) for torques in (self.torques, self.consistent))

    def _agrees(self, torques: RunTorques) -> bool:
        share = torques.share
        within = bool((share[np.isfinite(share)] <= self.tolerances.joint).all())
        return within and torques.total_share <= self.tolerances.total


@dataclass(frozen=True)
class Trend:
    """A drift of the friction within a run.

    Attributes:
        bag: name of the run.
        joint: its name.
        change: of the friction torque from the first to the last sample, Nm; positive where it grows.
        deviation: its standard deviation, Nm.
    """

    bag: str
    joint: str
    change: float
    deviation: float

    @property
    def text(self) -> str:
        """Return it in words."""
        grows = "grows" if self.change > 0.0 else "falls"
        return (
            f"in {self.bag} the friction of {self.joint} {grows} by {abs(self.change):.3g} +- {self.deviation:.2g} Nm "
            "from begin to end"
        )


def run_torques(problem: ExcitationProblem, predicted: Array) -> tuple[RunTorques, ...]:
    """Return the torques of each bag of a problem; pieces of a bag with gaps are put together.

    Args:
        problem: the equations.
        predicted: torque of each row, known payloads left out, Nm, shape (r,).
    """
    velocity = problem.rows_of([run.velocity[:, :, None] for run in problem.runs])[:, 0]
    recorded, whole = problem.torque + problem.payload, predicted + problem.payload
    pieces: dict[str, list[int]] = {}
    for number, run in enumerate(problem.runs):
        pieces.setdefault(str(run.source.path), []).append(number)
    found = []
    for numbers in pieces.values():
        mine = np.isin(problem.run, numbers)
        rows = [np.flatnonzero(mine & (problem.joint == joint)) for joint in range(len(problem.arm.names))]
        joints = tuple(JointTorque(problem.time[k], velocity[k], recorded[k], whole[k]) for k in rows)
        runs = [problem.runs[number] for number in numbers]
        noise = np.sqrt(np.mean([torque_noise(run) ** 2 for run in runs], axis=0))
        found.append(RunTorques(problem.arm.names, runs[0].source, joints, noise))
    return tuple(found)


def torque_noise(run: FilteredRun) -> Array:
    """Return the standard deviation of the noise of the filtered torque, Nm, shape (n,).

    The median third difference of the recorded torque tells the noise of a sample: motion is smooth between samples,
    and the steps of friction are rare. Of white noise the filter passes the sum of its squared taps.
    """
    if len(run.torque) <= _DIFFERENCES:
        return np.zeros(run.torque.shape[1])
    size = np.median(np.abs(np.diff(run.torque, _DIFFERENCES, axis=0)), axis=0) / (
        _NORMAL_MAD * math.sqrt(_DIFFERENCE_GAIN)
    )
    return np.asarray(size * math.sqrt(np.sum(run.taps**2)))


def trends(runs: Sequence[RunTorques], block: float) -> tuple[Trend, ...]:
    """Return the drifts of friction that blocks of time show at 1 % over all tests together (Bonferroni).

    A line is fitted to the means of the difference times the sign of the velocity; means over blocks are nearly
    independent, where neighbouring samples are not.

    Args:
        runs: to test, joint by joint.
        block: length of the blocks, s.
    """
    tests = [(run, name, joint) for run in runs for name, joint in zip(run.names, run.joints, strict=True)]
    found = []
    for run, name, joint in tests:
        if not len(joint.time):
            continue
        number = ((joint.time - joint.time[0]) / block).astype(np.intp)
        opposing = joint.residual * np.sign(joint.velocity)
        count = np.bincount(number)
        filled = np.flatnonzero(count > 0.5 * count.max())
        if len(filled) < _MIN_TREND_BLOCKS:
            continue
        means = (np.bincount(number, opposing)[filled] / count[filled]) - opposing.mean()
        times = np.bincount(number, joint.time)[filled] / count[filled]
        times = times - times.mean()
        slope = float(times @ means / (times @ times))
        free = len(filled) - 2
        deviation = math.sqrt(float(np.sum((means - means.mean() - slope * times) ** 2)) / free / (times @ times))
        span = float(joint.time[-1] - joint.time[0])
        if abs(slope) > deviation * student.ppf(1.0 - 0.5 * _TREND_LEVEL / len(tests), free):
            found.append(Trend(run.source.path.name, name, slope * span, deviation * span))
    return tuple(found)


_SPEED_BINS = 12  # of speed
_MIN_BIN_ROWS = 5  # rows in a bin
_MISFIT_LEVEL = 0.05  # chance of a false misfit, over all bins together


@dataclass(frozen=True, eq=False)
class SpeedResiduals:
    """Mean residuals of an element's joint at several speeds of the element, k bins.

    Attributes:
        element: its name.
        velocity: mean in each bin, rad/s, shape (k,).
        residual: mean, Nm, shape (k,).
        deviation: of that mean, from the means of blocks of time, Nm, shape (k,); NaN in a bin of one block.
        blocks: how many of them, shape (k,).
    """

    element: str
    velocity: Array
    residual: Array
    deviation: Array
    blocks: Index


def residuals_by_speed(problem: ExcitationProblem, residual: Array) -> tuple[SpeedResiduals, ...]:
    """Return mean residuals over the speed of each element: what its friction curve does not say.

    The joint is the last on which the element acts. Reversals are left out.

    Args:
        problem: r rows.
        residual: recorded less predicted torque, Nm, shape (r,).
    """
    block = time_blocks(problem)
    result = []
    for e, (name, acts) in enumerate(zip(problem.arm.element_names, problem.arm.element_matrix != 0.0, strict=True)):
        rows = np.flatnonzero((problem.joint == np.flatnonzero(acts)[-1]) & ~problem.reversal)
        velocity = problem.velocity[rows, e]
        edges = (
            np.quantile(velocity, np.linspace(0.0, 1.0, _SPEED_BINS + 1)) if len(rows) else np.zeros(_SPEED_BINS + 1)
        )
        number = np.clip(np.searchsorted(edges, velocity, "right") - 1, 0, _SPEED_BINS - 1)
        bins = [rows[number == k] for k in range(_SPEED_BINS) if np.count_nonzero(number == k) >= _MIN_BIN_ROWS]
        result.append(
            SpeedResiduals(
                name,
                np.array([problem.velocity[some, e].mean() for some in bins]),
                np.array([residual[some].mean() for some in bins]),
                np.array([_deviation(residual[some], block[some]) for some in bins]),
                np.array([len(np.unique(block[some])) for some in bins], dtype=np.intp),
            )
        )
    return tuple(result)


def misfits(speeds: Sequence[SpeedResiduals]) -> list[str]:
    """Return, in words, each element's largest mean residual that is more than chance (5 % over all bins together)."""
    found = []
    tests = sum(len(one.residual) for one in speeds)
    for one in speeds:
        with np.errstate(invalid="ignore", divide="ignore"):
            size = np.nan_to_num(np.abs(one.residual) / one.deviation, posinf=0.0)
        limit = np.array([student.ppf(1.0 - 0.5 * _MISFIT_LEVEL / tests, max(k - 1, 1)) for k in one.blocks.tolist()])
        clear = np.flatnonzero(size > limit)
        if len(clear):
            worst = clear[np.argmax(np.abs(one.residual[clear]))]
            found.append(
                f"the torque of {one.element} is off by {one.residual[worst]:.3g} +- {one.deviation[worst]:.2g} Nm at "
                f"{one.velocity[worst]:.3g} rad/s"
            )
    return found


def _deviation(values: Array, block: Array) -> float:
    means = [float(values[block == k].mean()) for k in np.unique(block).tolist()]
    return float(np.std(means, ddof=1) / np.sqrt(len(means))) if len(means) > 1 else float("nan")


def undetermined(problem: ExcitationProblem, fit: LinearFit) -> tuple[str, ...]:
    """Return the base parameters that these runs do not determine, by name.

    One deviation of such a parameter alone would move torques by more than the torques' own RMS: the data would bear
    any value that an arm may have.

    Args:
        problem: r rows.
        fit: of the base parameters, and of others behind them.
    """
    count = len(problem.names)
    size = float(np.sqrt(np.mean(problem.torque**2)))
    deviation, known = fit.deviation[:count], fit.determined[:count]
    effect = np.where(known, deviation, 0.0) * np.sqrt(np.mean(problem.regressor**2, axis=0))
    bad = ~known | ~(effect < size)
    return tuple(name for name, one in zip(problem.names, bad.tolist(), strict=True) if one)
