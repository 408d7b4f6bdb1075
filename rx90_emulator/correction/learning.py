"""Learning from trial to trial: what is measured, what is kept, and when it stops; on the engine in one call.

A trial plays a correction and measures the error. It is kept if the worst distance from the path is no larger than with
the best correction before, but for noise; the next correction goes on from the best one. After a trial that made it
worse half of the step from the best one is tried, and the gain halved. Learning has failed where trial after trial
makes it worse.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import (
    ConfigError,
    DivergenceError,
    FailureError,
    SupervisionError,
    TrajectoryError,
    check_type,
)
from rx90_common.description.kinematics import tip_position
from rx90_controller.lines.task import LineTask
from rx90_controller.paths.path import Path
from rx90_controller.trajectory.correction import FADE, Correction
from rx90_emulator.correction.methods import Method, NormOptimal
from rx90_emulator.correction.path import CorrectablePath, TrajectoryPath
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.line import plan_path
from rx90_emulator.loop.result import RunResult
from rx90_emulator.loop.setup import Setup

NOISE = 1e-6
"""By how much the worst distance may grow, m, unless another noise is given: of about encoder counts."""
ENCODERS, TIP = "encoders", "tip"
ENGINE, NODES, RECORD = "engine", "nodes", "record"
MEASUREMENTS: Final = tuple(f"{what}, {where}" for what in (ENCODERS, TIP) for where in (ENGINE, NODES, RECORD))
"""What a trial was measured by, and where; path errors that were measured in another way cannot be compared."""
_LONGEST = 600_000  # set-points: the feedback of norm-optimal takes 1.5 kB for each
MAX_WORSE_TRIALS: Final = 4
"""Trials in a row that make the path worse, after which learning has failed: an eighth of a step that is still worse is
not too long, but points the wrong way."""
_OFFSET_TOLERANCE = 1e-7  # rad: of offsets, far below an encoder's count
_SETTLING_S = 1.0  # s from the release of the brakes to where the path error counts: the integrators take some 0.1 s


class CorrectionError(FailureError):
    """Learning did not make the path better, or made it worse and worse."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What a trial has left on set-points 0, 1, ... of its trajectory.

    Attributes:
        joints: set-points less the joints by the encoders, rad, shape (n, j).
        tip: the tip where it should be less where it was measured, m, shape (n, 3); None where it was not.
        played: offsets that were added, rad, shape (n, j); None where nothing tells.
    """

    joints: Array
    tip: Array | None = None
    played: Array | None = None


@dataclass(frozen=True, eq=False)
class TrialRecord:
    """One trial.

    Attributes:
        worst: largest distance from the path, by what was measured, m.
        rms: root mean square distance, m.
        kept: whether what was played is better than all before, but for noise.
        gain: share of the method's gain with which it was made.
        distance: from the path on the set-points that count, m, shape (k,).
    """

    worst: float
    rms: float
    kept: bool
    gain: float
    distance: Array = field(repr=False)


class Learner:
    """Learns a correction of one path on one arm, wherever the trials are run.

    Args:
        setup: robot and controller that the method takes the arm for; friction and payload need not be right.
        path: what is corrected.
        method: how.
        tip: whether it learns from a measured tip in place of the encoders.
        noise: by how much the worst distance may grow from trial to trial, m.
        previous: offsets to go on from, rad, shape (n, j).

    Attributes:
        nominal: what the path asks for.
        offsets: to play in the next trial, rad, shape (n, j).
        best: those of the last trial that was kept; those given, or 0, before the first.
        trials: so far.

    Raises:
        ConfigError: for a noise below 0, offsets of another number of set-points, and a path that takes too long.
        TrajectoryError: if the controller would refuse the trajectory.
    """

    def __init__(
        self,
        setup: Setup,
        path: CorrectablePath,
        method: Method | None = None,
        *,
        tip: bool = False,
        noise: float = NOISE,
        previous: Array | None = None,
    ) -> None:
        if not 0.0 <= noise < math.inf:
            raise ConfigError(f"noise is {noise:g} m; accepted: a number >= 0")
        self.setup, self.path, self.method, self.tip, self.noise = setup, path, method or NormOptimal(), tip, noise
        period = setup.rates.position_period
        if not path.points.times[-1] <= _LONGEST * period:
            raise ConfigError(f"a path of {path.points.times[-1]:g} s; accepted: up to {_LONGEST * period:g} s")
        self.nominal = TrajectoryPath.of(setup, path.points, path.counted)
        shape = len(self.nominal.counts), len(setup.robot.joint_names)
        self.offsets = np.zeros(shape) if previous is None else np.array(previous, dtype=np.float64)
        if self.offsets.shape != shape:
            raise ConfigError(f"offsets of shape {self.offsets.shape}; accepted: {shape}")
        self.best, self.trials = self.offsets, list[TrialRecord]()
        self._update = self.method.prepare(setup, self.nominal, tip=tip)
        self._least, self._gain, self._worse = math.inf, 1.0, 0

    def go_on(self, best: Array, worst: Sequence[float]) -> None:
        """Judge the next trial by those before it, which a correction file has.

        Args:
            best: offsets of the best of them, rad, shape (n, j).
            worst: their largest distances from the path, m, of trials that were measured as the next one is.
        """
        self._least, self.best = min(worst), np.asarray(best)
        self._worse = len(worst) - 1 - max(k for k, one in enumerate(worst) if one <= self._least + self.noise)
        self._gain = 0.5**self._worse

    def measurement(self, where: str) -> str:
        """Return by what trials are measured, and where, as in MEASUREMENTS."""
        return f"{TIP if self.tip else ENCODERS}, {where}"

    @property
    def correction(self) -> Correction:
        """Return what is to be played in the next trial.

        Raises:
            TrajectoryError: if it is larger or faster than a correction may be.
        """
        return Correction(self.offsets, self.nominal.period)

    def distance(self, measured: Measured) -> Array:
        """Return the distance of the tip from the path on the set-points that count, m, by what was measured."""
        counts = self.nominal.counts
        if self.tip:
            assert measured.tip is not None
            return self.path.distance(self.nominal.tip[counts] - measured.tip[counts])
        joints = self.nominal.setpoints[counts, 0] - measured.joints[counts]
        return self.path.distance(tip_position(self.setup.robot.chain, joints))

    def take(self, measured: Measured) -> TrialRecord:
        """Judge what a trial with `offsets` has left, and make the next offsets.

        After a trial that is worse than the best one the next offsets lie in the middle between those of both.

        Raises:
            ConfigError: if the tip is to be learned from and was not measured, a number is not finite, or other offsets
                were played.
            CorrectionError: if trial after trial has made it worse.
        """
        error = measured.tip if self.tip else measured.joints
        if error is None:
            raise ConfigError("the tip was not measured; accepted: its path, or learning from the encoders")
        if error.shape[0] != len(self.nominal.counts) or not np.isfinite(error).all():
            raise ConfigError(
                f"errors of shape {error.shape}, finite: {bool(np.isfinite(error).all())}; accepted: finite numbers on "
                f"{len(self.nominal.counts)} set-points"
            )
        if measured.played is not None:
            full = np.flatnonzero(self.nominal.counts)
            full = full[full * self.nominal.period >= FADE]  # before, it may be on its way
            difference = float(np.abs(measured.played - self.offsets)[full].max(initial=0.0))
            if difference > _OFFSET_TOLERANCE:
                raise ConfigError(
                    f"the offsets that were played are up to {difference:.3g} rad from those that are learned from, up "
                    f"to {np.abs(self.offsets).max():.3g} rad; accepted: a trial with this correction, --previous"
                )
        distance = self.distance(measured)
        worst, rms = float(distance.max()), math.sqrt(float(np.mean(distance**2)))
        kept = worst <= self._least + self.noise
        trial = TrialRecord(worst, rms, kept, self._gain, distance)
        self.trials.append(trial)
        if kept:
            self._least, self._gain, self._worse = min(self._least, worst), min(1.0, 2.0 * self._gain), 0
            self.best = self.offsets
            self.offsets = self._update(self.best, error, self._gain)
            return trial
        self._worse, self._gain = self._worse + 1, 0.5 * self._gain
        if self._worse >= MAX_WORSE_TRIALS:
            raise CorrectionError(
                f"{self._worse} trials in a row have made the path worse, the last one {worst * 1e3:.4f} mm after "
                f"{self._least * 1e3:.4f} mm; accepted: another model, method or gain"
            )
        self.offsets = 0.5 * (self.best + self.offsets)
        return trial


@dataclass(frozen=True, eq=False)
class LearnedCorrection:
    """What learning has given.

    Attributes:
        setup: what was learned with.
        path: what is corrected.
        method: how.
        measurement: by what the trials were measured, and where, of MEASUREMENTS.
        correction: the best one; from a record, the one for the next trial.
        trials: all of them; the first is without correction, or with the one that was gone on from.
        best_offsets: of the best trial, rad, shape (n, j).
        remark: why it ended early; empty if it did not.
    """

    setup: Setup
    path: CorrectablePath
    method: Method
    measurement: str
    correction: Correction
    trials: tuple[TrialRecord, ...]
    best_offsets: Array = field(repr=False)
    remark: str = ""

    @classmethod
    def of(cls, learner: Learner, where: str, offsets: Array, remark: str = "") -> LearnedCorrection:
        """Return what a learner has learned from trials somewhere, with the offsets that are to be played, rad."""
        played = Correction(offsets, learner.nominal.period)
        return cls(learner.setup, learner.path, learner.method, learner.measurement(where), played,
                   tuple(learner.trials), learner.best, remark)  # fmt: skip

    @property
    def best(self) -> TrialRecord:
        """Return the last trial that was kept."""
        return next(trial for trial in reversed(self.trials) if trial.kept)


def learn(
    learner: Learner, play: Callable[[Correction], Measured], trials: int, where: str,
    on_trial: Callable[[TrialRecord], None] | None,
) -> LearnedCorrection:  # fmt: skip
    """Play and learn: one trial as it begins, then `trials` more, each with what the one before has taught.

    Args:
        learner: what learns.
        play: runs one trial.
        trials: how many after the first.
        where: they run, ENGINE or NODES.
        on_trial: called with each trial.

    What ends a later trial, such as an offset beyond the limits, ends learning with what it has kept.

    Raises:
        ConfigError: for less than 0 trials.
    """
    if trials < 0:
        raise ConfigError(f"{trials} trials; accepted: a whole number >= 0")
    remark = ""
    for _ in range(trials + 1):
        try:
            learner.take(play(learner.correction))
        except (CorrectionError, TrajectoryError, DivergenceError, SupervisionError) as error:
            if not learner.trials:
                raise
            remark = str(error)
        if on_trial is not None:
            on_trial(learner.trials[-1])
        if remark:
            break
    return LearnedCorrection.of(learner, where, learner.best, remark)


def run_corrected(
    setup: Setup, path: CorrectablePath, correction: Correction | None = None
) -> tuple[RunResult, Measured]:
    """Run a path through the closed loop, with a correction or without, and measure encoders and tip.

    The arm stands held before, so that its weight is taken up when the path error begins to count. What the path asks
    for is a third of a trial's work, so whoever runs several gives it as a TrajectoryPath.

    Raises:
        DivergenceError: naming joint and tick.
        SupervisionError: naming joint, value, limit and time, if the controller's supervision cuts the power.
        TrajectoryError: if trajectory or correction is refused.
    """
    points, period = replace(path.points, correction=correction), setup.rates.position_period
    lead = math.ceil(max(0.0, _SETTLING_S - path.counted[0]) / period)
    trajectory = path if isinstance(path, TrajectoryPath) else TrajectoryPath.of(setup, path.points, path.counted)
    count = len(trajectory.counts)
    run = simulate(setup, points, start_time=lead * period, duration=(lead + count) * period)
    rows = slice(lead, lead + count)
    offsets = run.slow.correction[rows] if len(run.slow.correction) else 0.0
    tip = tip_position(setup.robot.chain, run.slow.joint_states[rows, 0])
    return run, Measured(run.slow.tracking_error[rows, 0] - offsets, trajectory.tip - tip)


def learn_correction(
    setup: Setup,
    path: CorrectablePath | LineTask | Path,
    trials: int = 4,
    method: Method | None = None,
    *,
    model: Setup | None = None,
    tip: bool = False,
    noise: float = NOISE,
    previous: Correction | None = None,
    on_trial: Callable[[TrialRecord], None] | None = None,
) -> LearnedCorrection:
    """Learn a correction on the engine.

    Args:
        setup: the arm that runs the trials.
        path: what is corrected: a task or a path, a planned one, or any trajectory as a TrajectoryPath.
        trials: after the first one, which is without correction, or with `previous`.
        method: NormOptimal() unless another is given.
        model: what the method takes the arm for; `setup` itself if left out.
        tip: learn from the tip's error, as a sensor at the tip sees it, in place of the encoders'.
        noise: by how much the worst distance may grow from trial to trial, m.
        previous: a correction to go on from.
        on_trial: called with each trial.

    Raises:
        ConfigError: for values that are not accepted.
        TrajectoryError: if the trajectory is refused, or a correction beyond the limits is asked for.
        DivergenceError, SupervisionError: as `simulate`.
    """
    check_type(setup=(setup, Setup))
    planned = plan_path(setup, path) if isinstance(path, (LineTask, Path)) else path
    before = None if previous is None else previous.offsets
    learner = Learner(model or setup, planned, method, tip=tip, noise=noise, previous=before)
    trajectory = learner.nominal if model is None else TrajectoryPath.of(setup, planned.points, planned.counted)
    return learn(learner, lambda played: run_corrected(setup, trajectory, played)[1], trials, ENGINE, on_trial)


def summary(trials: Iterable[TrialRecord]) -> str:
    """Return a line for each trial."""
    return "\n".join(
        f"trial {k}: worst {trial.worst * 1e3:.4f} mm, rms {trial.rms * 1e3:.4f} mm"
        + ("" if trial.kept else f", worse: not kept, {0.5 * trial.gain:g} of the gain from here")
        for k, trial in enumerate(trials)
    )
