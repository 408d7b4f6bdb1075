"""Recorded against predicted torques of runs: how well a fit explains them, at each speed, and over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from rx90_common.base.arrays import Array, Index
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.fit import time_blocks
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.options import ExcitationTolerances
from rx90_emulator.identification.records import BagSource
from rx90_emulator.identification.validation.verdict import Criterion, torque_criteria

_DIFFERENCES, _DIFFERENCE_GAIN = 3, 20.0  # the third difference 1, -3, 3, -1 has 20 times the variance of white noise
_NORMAL_MAD = 0.6745  # median of a standard normal's size
_MAX_CHI_SQUARE = 1e4  # chi^2 up to which it tells something


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

    @property
    def rms(self) -> Array:
        """Return the RMS torque difference, Nm, shape (n,); NaN for a joint that stands still."""
        return _rms([joint.residual for joint in self.joints])

    @property
    def share(self) -> Array:
        """Return the RMS difference over the RMS recorded torque, shape (n,)."""
        return np.asarray(self.rms / _rms([joint.recorded for joint in self.joints]))

    @property
    def total_share(self) -> float:
        """Return the same over all joints together."""
        residual, recorded = (np.concatenate([getattr(one, name) for one in self.joints])
                              for name in ("residual", "recorded"))  # fmt: skip
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


def _rms(series: Sequence[Array]) -> Array:
    return np.array([math.sqrt(np.mean(one**2)) if len(one) else math.nan for one in series])


@dataclass(frozen=True, eq=False)
class TorqueValidation:
    """The verdict of a run that was not used.

    Attributes:
        torques: of the run, predicted by the identified parameters.
        consistent: the same, predicted with the inertias that bodies can have in place of the identified ones.
        tolerances: what counts as agreement.
        files: the same, predicted by all that the robot's files hold, elements with their bristles: what
            `check_friction` of these files gives.
    """

    torques: RunTorques
    consistent: RunTorques
    tolerances: ExcitationTolerances
    files: RunTorques

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """Return what the verdict rests on, by the identified parameters and by the files."""
        limits, by = self.tolerances, {"": self.torques, " by the files": self.files}
        groups = (
            torque_criteria(one.names, one.total_share, one.share, limits.total, limits.joint, words)
            for words, one in by.items()
        )
        return tuple(one for group in groups for one in group)

    @property
    def passed(self) -> bool:
        """Return whether each joint that moves, and all of them together, agree with both predictions."""
        return all(one.passed for one in self.criteria)


_UNEXPLAINED_SHARE = 0.7  # of what varies in a torque: beyond, less than half of its square is explained


def unexplained(runs: Sequence[RunTorques]) -> dict[str, str]:
    """Return, in words by joint, whose torques a model hardly explains: their values are not to be trusted.

    A constant torque is explained by an offset and tells nothing: what counts is what varies.
    """
    found = {}
    for number, name in enumerate(runs[0].names):
        own = [run.joints[number] for run in runs if len(run.joints[number].recorded)]
        if own:
            left, varying = (
                math.sqrt(sum(float(np.sum((values - values.mean()) ** 2)) for values in series))
                for series in ([one.residual for one in own], [one.recorded for one in own])
            )
            if left > _UNEXPLAINED_SHARE * varying:
                share = left / varying if varying else 1.0
                found[name] = (
                    f"{share:.0%} of what varies in the torque of {name} is not explained: its friction and its "
                    "offset, and the inertias that it alone tells, are not to be trusted"
                )
    return found


def run_torques(problem: ExcitationProblem, predicted: Array) -> tuple[RunTorques, ...]:
    """Return the torques of each bag of a problem, of its identified joints; pieces of a bag are put together.

    Args:
        problem: the equations.
        predicted: torque of each row, known payloads left out, Nm, shape (r,).
    """
    velocity = problem.rows_of([run.velocity[:, :, None] for run in problem.runs])[:, 0]
    table = np.array([problem.time, velocity, problem.torque + problem.payload, predicted + problem.payload])
    pieces: dict[str, list[int]] = {}
    for number, run in enumerate(problem.runs):
        pieces.setdefault(str(run.source.path), []).append(number)
    found, own = [], np.flatnonzero(problem.arm.identified).tolist()
    names = tuple(problem.arm.names[j] for j in own)
    for numbers in pieces.values():
        mine, runs = np.isin(problem.run, numbers), [problem.runs[number] for number in numbers]
        joints = [JointTorque(*table[:, mine & (problem.joint == j)]) for j in own]
        noise = np.sqrt(np.mean([torque_noise(run) ** 2 for run in runs], axis=0))[own]
        found.append(RunTorques(names, runs[0].source, tuple(joints), noise))
    return tuple(found)


def torque_noise(run: FilteredRun) -> Array:
    """Return the standard deviation of the noise of the filtered torque, Nm, shape (n,).

    The median third difference of the recorded torque tells the noise of a sample: motion is smooth between samples,
    and the steps of friction are rare. Of white noise the filter passes the sum of its squared taps.
    """
    size = np.median(np.abs(np.diff(run.torque, _DIFFERENCES, axis=0)), axis=0)
    return np.asarray(size / (_NORMAL_MAD * math.sqrt(_DIFFERENCE_GAIN)) * math.sqrt(np.sum(run.taps**2)))


_MIN_TREND_BLOCKS = 6  # over which a trend is tested
_TREND_LEVEL = 0.01  # chance of a false trend, over all joints and runs together


class Trend(NamedTuple):
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
        number = ((joint.time - joint.time[:1]) / block).astype(np.intp)
        count = np.bincount(number)
        filled = np.flatnonzero(count > 0.5 * count.max(initial=0))
        if len(filled) < _MIN_TREND_BLOCKS:
            continue
        opposing = joint.residual * np.sign(joint.velocity)
        means, times = (np.bincount(number, values)[filled] / count[filled] for values in (opposing, joint.time))
        means, times = means - opposing.mean(), times - times.mean()
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


class SpeedResiduals(NamedTuple):
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
        velocity, bins = problem.velocity[rows, e], []
        if len(rows):
            edges = np.quantile(velocity, np.linspace(0.0, 1.0, _SPEED_BINS + 1))
            number = np.clip(np.searchsorted(edges, velocity, "right") - 1, 0, _SPEED_BINS - 1)
            for some in (rows[number == k] for k in range(_SPEED_BINS)):
                if len(some) >= _MIN_BIN_ROWS:
                    means = [residual[some[block[some] == k]].mean() for k in np.unique(block[some])]
                    spread = np.std(means, ddof=1) / math.sqrt(len(means)) if len(means) > 1 else math.nan
                    bins.append((problem.velocity[some, e].mean(), residual[some].mean(), spread, len(means)))
        speed, mean, deviation, blocks = np.array(bins, dtype=np.float64).reshape(-1, 4).T
        result.append(SpeedResiduals(name, speed, mean, deviation, blocks.astype(np.intp)))
    return tuple(result)


def misfits(speeds: Sequence[SpeedResiduals]) -> list[str]:
    """Return, in words, each element's largest mean residual that is more than chance (5 % over all bins together)."""
    found = []
    tests = sum(len(one.residual) for one in speeds)
    for one in speeds:
        with np.errstate(invalid="ignore", divide="ignore"):
            size = np.nan_to_num(np.abs(one.residual) / one.deviation, posinf=0.0)
        limit = student.ppf(1.0 - 0.5 * _MISFIT_LEVEL / max(tests, 1), np.maximum(one.blocks - 1, 1))
        clear = np.flatnonzero(size > limit)
        if len(clear):
            worst = clear[np.argmax(np.abs(one.residual[clear]))]
            found.append(
                f"the torque of {one.element} is off by {one.residual[worst]:.3g} +- {one.deviation[worst]:.2g} Nm at "
                f"{one.velocity[worst]:.3g} rad/s"
            )
    return found
