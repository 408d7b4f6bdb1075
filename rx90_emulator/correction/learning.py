"""Learning from trial to trial: measurement, acceptance and end; on the engine in one call.

A trial plays a correction and measures the error. It is accepted if the worst distance from the path is no larger than
with the best correction so far plus the noise; the next correction starts from the best one. After a trial that is
worse, half of the step from the best correction is tried, and the gain is halved. Learning has failed if trial after
trial is worse.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

from rx90_common.base.arrays import Array, rms
from rx90_common.base.errors import (
    ConfigError,
    DivergenceError,
    FailureError,
    SupervisionError,
    TrajectoryError,
    check_type,
)
from rx90_common.base.quoting import counted
from rx90_common.description.kinematics import tip_position
from rx90_controller.lines.task import LineTask
from rx90_controller.paths.path import Path
from rx90_controller.trajectory.correction import FADE, Correction
from rx90_emulator.correction.methods import NormOptimal
from rx90_emulator.correction.path import CorrectablePath, TrajectoryPath
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.learned_motion import check_correction, learned_motion
from rx90_emulator.loop.line import plan_path
from rx90_emulator.loop.result import RunResult
from rx90_emulator.loop.setup import Setup

NOISE = 1e-6
"""Default of the growth of the worst distance that counts as noise, m: that of encoder counts."""
ENCODERS = "encoders"
TIP = "tip"
ENGINE = "engine"
NODES = "nodes"
RECORD = "record"
Measurement: TypeAlias = Literal[
    "encoders, engine",
    "encoders, nodes",
    "encoders, record",
    "tip, engine",
    "tip, nodes",
    "tip, record",
]
"""By what and where a trial was measured; path errors that were measured in another way cannot be compared."""
_LONGEST = 600_000  # set-points: the feedback of norm-optimal takes 1.5 kB for each
MAX_WORSE_TRIALS = 4
"""Successive worse trials, after which learning has failed: if an eighth of a step is still worse, the step is not too
long but has the wrong direction."""
_OFFSET_TOLERANCE = 1e-7  # rad: of offsets, far below an encoder's count
_SETTLING_S = 1.0  # s from the release of the brakes to the first counted path error: the integrators take some 0.1 s


class CorrectionError(FailureError):
    """Learning did not make the path better, or trial after trial made it worse."""


@dataclass(frozen=True, eq=False)
class Measured:
    """The errors of a trial at set-points 0, 1, ... of its trajectory.

    Attributes:
        joints: set-points less joint angles by the encoders, rad, shape (n, j).
        tip: required less measured position of the tip, m, shape (n, 3); None if it was not measured.
        played: offsets that were added, rad, shape (n, j); None if they are not known.
    """

    joints: Array
    tip: Array | None = None
    played: Array | None = None


@dataclass(frozen=True, eq=False)
class TrialRecord:
    """One trial.

    Attributes:
        worst: largest measured distance from the path, m.
        rms: root mean square distance, m.
        kept: whether it is better than all earlier trials, or worse by no more than the noise.
        gain: share of the method's gain with which it was made.
    """

    worst: float
    rms: float
    kept: bool
    gain: float


class Learner:
    """Learns a correction of one path on one arm, wherever the trials run.

    Args:
        setup: robot and controller in the method's model; friction and payload need not be right.
        path: the path to correct.
        method: of learning.
        tip: whether it learns from a measured tip instead of the encoders.
        noise: growth of the worst distance from trial to trial that counts as noise, m.
        previous: offsets to continue from, rad, shape (n, j).

    Attributes:
        nominal: the motion that the path requires.
        offsets: to play in the next trial, rad, shape (n, j).
        best: those of the last accepted trial; the given ones, or 0, before the first.
        trials: so far.

    Raises:
        ConfigError: for a noise below 0, offsets of another number of set-points, and a path that takes too long.
        TrajectoryError: if the controller would refuse the trajectory.
    """

    def __init__(
        self,
        setup: Setup,
        path: CorrectablePath,
        method: NormOptimal | None = None,
        *,
        tip: bool = False,
        noise: float = NOISE,
        previous: Array | None = None,
    ) -> None:
        if not 0.0 <= noise < math.inf:
            raise ConfigError(f"noise is {noise:g} m; accepted: a number >= 0")
        self.setup = setup
        self.path = path
        self.method = method or NormOptimal()
        self.tip = tip
        self.noise = noise
        period = setup.rates.position_period
        if not path.points.times[-1] <= _LONGEST * period:
            raise ConfigError(
                f"a path of {path.points.times[-1]:g} s; accepted: up to {_LONGEST * period:g} s"
            )
        self.nominal = TrajectoryPath.of(setup, path.points, path.counted)
        shape = len(self.nominal.counts), len(setup.robot.joint_names)
        self.offsets = np.zeros(shape) if previous is None else np.array(previous, dtype=np.float64)
        if self.offsets.shape != shape:
            raise ConfigError(f"offsets of shape {self.offsets.shape}; accepted: {shape}")
        self.best = self.offsets
        self.trials: list[TrialRecord] = []
        self._update = self.method.prepare(setup, self.nominal, tip=tip)
        self._least = math.inf
        self._gain = 1.0
        self._worse = 0

    def go_on(self, best: Array, worst: Sequence[float]) -> None:
        """Compare the next trial with the earlier ones in a correction file.

        Args:
            best: offsets of the best of them, rad, shape (n, j).
            worst: their largest distances from the path, m, for trials that were measured as the next one is.
        """
        self._least = min(worst)
        self.best = np.asarray(best)
        self._worse = (
            len(worst)
            - 1
            - max(k for k, error in enumerate(worst) if error <= self._least + self.noise)
        )
        self._gain = 0.5**self._worse

    def measurement(self, where: str) -> str:
        """Return by what and where trials are measured, see Measurement."""
        return f"{TIP if self.tip else ENCODERS}, {where}"

    @property
    def correction(self) -> Correction:
        """Return the correction for the next trial.

        Raises:
            TrajectoryError: if it is larger or faster than a correction may be.
        """
        return Correction(self.offsets, self.nominal.period)

    def distance(self, measured: Measured) -> Array:
        """Return the measured distance of the tip from the path at the counted set-points, m."""
        counts = self.nominal.counts
        times = self.nominal.counted_times
        if self.tip:
            assert measured.tip is not None
            return self.path.distance(self.nominal.tip[counts] - measured.tip[counts], times)
        joints = self.nominal.setpoints[counts, 0] - measured.joints[counts]
        return self.path.distance(tip_position(self.setup.robot.chain, joints), times)

    def take(self, measured: Measured) -> TrialRecord:
        """Evaluate the errors of a trial with `offsets`, and make the next offsets.

        After a trial that is worse than the best one, the next offsets are the mean of both.

        Raises:
            ConfigError: if the tip is needed and was not measured, a number is not finite, or other offsets were
                played.
            CorrectionError: if trial after trial was worse.
        """
        error = measured.tip if self.tip else measured.joints
        if error is None:
            raise ConfigError(
                "the tip was not measured; accepted: its path, or learning from the encoders"
            )
        if error.shape[0] != len(self.nominal.counts) or not np.isfinite(error).all():
            raise ConfigError(
                f"errors of shape {error.shape}, finite: {bool(np.isfinite(error).all())}; accepted: finite numbers on "
                f"{counted(len(self.nominal.counts), 'set-point')}"
            )
        if measured.played is not None:
            full = np.flatnonzero(self.nominal.counts)
            full = full[full * self.nominal.period >= FADE]  # before, it may still fade in
            difference = float(np.abs(measured.played - self.offsets)[full].max(initial=0.0))
            if difference > _OFFSET_TOLERANCE:
                raise ConfigError(
                    f"the offsets that were played are up to {difference:.3g} rad from those that are learned from, up "
                    f"to {np.abs(self.offsets).max():.3g} rad; accepted: a trial with this correction, --previous"
                )
        distance = self.distance(measured)
        worst = float(distance.max())
        kept = worst <= self._least + self.noise
        trial = TrialRecord(worst, rms(distance), kept, self._gain)
        self.trials.append(trial)
        if kept:
            self._least = min(self._least, worst)
            self._gain = min(1.0, 2.0 * self._gain)
            self._worse = 0
            self.best = self.offsets
            self.offsets = self._update(self.best, error, self._gain)
            return trial
        self._worse += 1
        self._gain *= 0.5
        if self._worse >= MAX_WORSE_TRIALS:
            raise CorrectionError(
                f"{self._worse} trials in a row have made the path worse, the last one {worst * 1e3:.4f} mm after "
                f"{self._least * 1e3:.4f} mm; accepted: another model or --effort"
            )
        self.offsets = 0.5 * (self.best + self.offsets)
        return trial


@dataclass(frozen=True, eq=False)
class LearnedCorrection:
    """The result of learning.

    Attributes:
        setup: the arm in the method's model.
        path: the corrected path.
        method: of learning.
        measurement: by what and where the trials were measured, see Measurement.
        correction: the best one; after a record, the one for the next trial.
        trials: all of them; the first is without correction, or with the one that learning continued from.
        best_offsets: of the best trial, rad, shape (n, j).
        remark: why it ended early; empty if it did not.
    """

    setup: Setup
    path: CorrectablePath
    method: NormOptimal
    measurement: str
    correction: Correction
    trials: tuple[TrialRecord, ...]
    best_offsets: Array = field(repr=False)
    remark: str = ""

    @classmethod
    def of(
        cls, learner: Learner, where: str, offsets: Array, remark: str = ""
    ) -> LearnedCorrection:
        """Return the result of a learner with trials at `where`, and the offsets to be played, rad."""
        motion = learned_motion(learner.setup, learner.path.points)
        played = Correction(offsets, learner.nominal.period, motion)
        return cls(
            learner.setup,
            learner.path,
            learner.method,
            learner.measurement(where),
            played,
            tuple(learner.trials),
            learner.best,
            remark,
        )

    @property
    def best(self) -> TrialRecord:
        """Return the last accepted trial."""
        return next(trial for trial in reversed(self.trials) if trial.kept)


def learn(
    learner: Learner,
    play: Callable[[Correction], Measured],
    trials: int,
    where: str,
    on_trial: Callable[[], None] = lambda: None,
) -> LearnedCorrection:
    """Play and learn: one trial with the initial correction, then `trials` more, each learned from the previous one.

    Args:
        learner: evaluates the trials.
        play: runs one trial.
        trials: number of trials after the first.
        where: they run, ENGINE or NODES.
        on_trial: called behind each trial.

    If a later trial fails, for example with an offset beyond the limits, learning ends with the best correction so far.
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
        on_trial()
        if remark:
            break
    return LearnedCorrection.of(learner, where, learner.best, remark)


def run_corrected(
    setup: Setup, path: CorrectablePath, correction: Correction | None = None
) -> tuple[RunResult, Measured]:
    """Run a path through the closed loop, with a correction or without, and measure encoders and tip.

    The arm is at rest before, so that the integrators carry its weight when the path error begins to count. The nominal
    motion is a third of a trial's work, so for several trials pass the path as a TrajectoryPath.

    Raises:
        DivergenceError: naming joint and tick.
        SupervisionError: naming joint, value, limit and time, if the controller's supervision cuts the power.
        TrajectoryError: if trajectory or correction is refused.
    """
    period = setup.rates.position_period
    lead = math.ceil(max(0.0, _SETTLING_S - path.counted[0]) / period)
    trajectory = (
        path
        if isinstance(path, TrajectoryPath)
        else TrajectoryPath.of(setup, path.points, path.counted)
    )
    count = len(trajectory.counts)
    duration = (lead + count) * period
    run = simulate(
        setup, path.points, start_time=lead * period, duration=duration, correction=correction
    )
    rows = slice(lead, lead + count)
    offsets = run.slow.correction[rows] if len(run.slow.correction) else 0.0
    tip = tip_position(setup.robot.chain, run.slow.joint_states[rows, 0])
    return run, Measured(run.slow.tracking_error[rows, 0] - offsets, trajectory.tip - tip)


def learn_correction(
    setup: Setup,
    path: CorrectablePath | LineTask | Path,
    trials: int = 4,
    method: NormOptimal | None = None,
    *,
    tip: bool = False,
    previous: Correction | None = None,
) -> LearnedCorrection:
    """Learn a correction on the engine.

    Args:
        setup: the arm that runs the trials, also in the method's model.
        path: a task or a path, a planned one, or any trajectory as a TrajectoryPath.
        trials: number of trials after the first one, which is without correction, or with `previous`.
        method: NormOptimal() by default.
        tip: learn from the tip's error, as a sensor at the tip measures it, instead of the encoders'.
        previous: a correction to continue from.

    Raises:
        ConfigError: for values that are not accepted.
        TrajectoryError: if the trajectory is refused, or a correction exceeds the limits.
        DivergenceError, SupervisionError: as `simulate`.
    """
    check_type(setup=(setup, Setup))
    planned = plan_path(setup, path) if isinstance(path, (LineTask, Path)) else path
    offsets = None
    if previous is not None:
        check_correction(setup, planned.points, previous, "the correction")
        offsets = previous.offsets
    learner = Learner(setup, planned, method, tip=tip, previous=offsets)
    return learn(
        learner, lambda played: run_corrected(setup, learner.nominal, played)[1], trials, ENGINE
    )


def summary(trials: Iterable[TrialRecord]) -> str:
    """Return a line for each trial."""
    return "\n".join(
        f"trial {k}: worst {trial.worst * 1e3:.4f} mm, RMS {trial.rms * 1e3:.4f} mm"
        + ("" if trial.kept else f", worse: not kept, {0.5 * trial.gain:g} of the gain from here")
        for k, trial in enumerate(trials)
    )
