"""A random arm through the identification from excitation runs, and what came out against what is true."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.excitation_runs import Disturbances, ExcitationRun, FourierMotion, measured
from benchmarks.excitation_truth import Truth, truth_of
from benchmarks.random_arms import SyntheticArm, random_arm
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation.filtering import Bandwidths, filter_record
from rx90_emulator.identification.excitation.friction.estimates import FrictionSelection
from rx90_emulator.identification.excitation.friction.identify import (
    ALL_PARTS,
    WITHOUT_BRISTLES,
    identify_friction_parts,
    predicted_torque,
)
from rx90_emulator.identification.excitation.friction.law import Part
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.records import JointRecord

Array = NDArray[np.float64]

RUNS = 4
"""Of 24 s each, to identify from; one more is predicted."""
HIGHEST = 1000.0
"""Samples per second above which bags are averaged."""
UNLOADED = " without load"


@dataclass
class Outcome:
    """What one arm gave.

    Attributes:
        scores: by kind of parameter, errors over their deviations; against what friction is without load, where a kind
            ends so.
        errors: by kind, errors: of exponents as they are, of others in parts of the value.
        floor: of each joint, RMS error of an unseen run's torque over that of the best model of the same form.
        noise: the same over the RMS noise, which leaves out ripple and load.
        recorded: the same at all frequencies: the torque as it was recorded.
        stribeck: elements with a Stribeck rise on which one was found, all that have one, elements without on which
            one was found, all without.
        refusal: why nothing came out.
    """

    scores: dict[str, list[float]] = field(default_factory=dict)
    errors: dict[str, list[float]] = field(default_factory=dict)
    floor: list[float] = field(default_factory=list)
    noise: list[float] = field(default_factory=list)
    recorded: list[float] = field(default_factory=list)
    stribeck: tuple[int, int, int, int] = (0, 0, 0, 0)
    refusal: str = ""

    def note(self, kind: str, error: float, deviation: float, scale: float) -> None:
        """Add one parameter."""
        self.errors.setdefault(kind, []).append(error / scale)
        self.scores.setdefault(kind, []).append(error / deviation if deviation > 0.0 else np.inf)


@dataclass(frozen=True, eq=False)
class Case:
    """An arm with its runs.

    Attributes:
        arm: with all that is true.
        rigid: what the identification knows of it: kinematics and couplings, masses that are wrong.
        disturbances: of the runs.
        rate: samples per second.
        periods: of a run of 24 s.
        seed: of the runs.
        motions: from which the true values are computed.
    """

    arm: SyntheticArm
    rigid: RigidArm
    disturbances: Disturbances
    rate: float
    periods: int = 1
    seed: int = 0
    motions: int = 40

    @classmethod
    def of(cls, arm: SyntheticArm, disturbances: Disturbances, rate: float, periods: int = 1, seed: int = 0) -> Case:
        """Return the case of an arm; its description passes through a file."""
        with tempfile.TemporaryDirectory() as folder:
            urdf = Path(folder) / "arm.urdf"
            urdf.write_text(arm.urdf(wrong=0.4, seed=seed), encoding="utf-8")
            rigid = RigidArm.from_urdf(urdf, coupling=arm.coupling, spring=arm.spring)
        return cls(arm, rigid, disturbances, rate, periods, seed)

    def motion(self, seed: int) -> FourierMotion:
        """Return a random motion of 24 s."""
        count = self.periods
        return FourierMotion.random(self.arm, seed, period=24.0 / count, periods=count, harmonics=12 // count)

    def run(self, number: int) -> ExcitationRun:
        """Return one of the runs."""
        seed = 1000 * self.seed + number
        return measured(self.arm, self.motion(seed), self.rate, seed, self.disturbances)

    def problem(self, runs: list[ExcitationRun], bandwidths: Bandwidths | None = None) -> ExcitationProblem:
        """Return the equations of runs."""
        records = [as_read(run.record(self.arm)) for run in runs]
        chosen = bandwidths or Bandwidths.of(records)
        filtered = [piece for record in records for piece in filter_record(record, chosen)]
        return ExcitationProblem.of(self.rigid, filtered)

    def truth(self, problem: ExcitationProblem, sigma: Array) -> Truth:
        """Return what is true of the parameters of a problem whose joints are weighted by `sigma`, Nm."""
        leading = list(problem.base.leading)

        def columns(position: Array, velocity: Array, acceleration: Array) -> Array:
            return problem.columns.torque(position, velocity, acceleration)[:, :, leading]

        return truth_of(self.arm, columns, sigma, self.disturbances, self.motion, self.motions)


def as_read(record: JointRecord) -> JointRecord:
    """Return block means of a record of more than 1 kHz, as the command reads bags."""
    rate = (len(record.time) - 1) / (record.time[-1] - record.time[0])
    size = max(1, round(rate / HIGHEST))
    count = len(record.time) // size

    def mean(values: Array) -> Array:
        return np.asarray(values[: count * size].reshape(count, size, *values.shape[1:]).mean(axis=1))

    fields = ("time", "position", "velocity", "torque")
    return replace(record, **{name: mean(getattr(record, name)) for name in fields})


def random_case(seed: int, disturbances: Disturbances, *, largest: int = 6, bristles: bool = False) -> Case:
    """Return a random arm of 2 to `largest` joints, recorded at 67 Hz to 5 kHz, each motion once or twice in a run."""
    rng = np.random.default_rng((seed, 40))
    arm = random_arm(seed, int(rng.integers(2, largest + 1)), bristles=bristles)
    rate = float(rng.choice([67.0, 125.0, 250.0, 250.0, 500.0, 500.0, 1000.0, 5000.0]))
    return Case.of(arm, disturbances, rate, int(rng.integers(1, 3)), seed)


def experiment(case: Case, *, bristles: bool = False, runs: int = RUNS) -> Outcome:
    """Identify an arm from some runs and predict another one."""
    outcome = Outcome()
    problem = case.problem([case.run(number) for number in range(runs)])
    found = identify_friction_parts(problem, ALL_PARTS if bristles else WITHOUT_BRISTLES)
    truth = case.truth(problem, found.fit.sigma)
    for value, deviation, true in zip(found.fit.value, found.fit.deviation, truth.base, strict=False):
        outcome.note("base", value - true, deviation, 1.0)
    laws = case.arm.friction
    bare = replace(
        truth,
        coulomb=np.array([law.coulomb for law in laws]),
        viscous=np.array([law.c2 for law in laws]),
        exponent=np.array([law.alpha for law in laws]),
    )
    for text, values in (("", truth), (UNLOADED, bare)):
        for kind, value, deviation, true in _friction(found, values):
            outcome.note(kind + text, value - true, deviation, 1.0 if kind == "exponent" else true)
    there = [
        (Part.STRIBECK in parts, law.rise > 0.0) for parts, law in zip(found.parts, case.arm.friction, strict=True)
    ]
    rises = [has for has, true in there if true], [has for has, true in there if not true]
    outcome.stribeck = sum(rises[0]), len(rises[0]), sum(rises[1]), len(rises[1])
    _predict((case, case.run(runs)), problem, found, truth, outcome)
    return outcome


def _friction(found: FrictionSelection, truth: Truth) -> Iterator[tuple[str, float, float, float]]:
    """Yield kind, value, deviation and true value of what was identified of friction."""
    kinds = (("tau_c_positive", "Coulomb", truth.coulomb), ("c2", "viscous", truth.viscous),
             ("alpha", "exponent", truth.exponent))  # fmt: skip
    for number, one in enumerate(found.elements):
        for name, kind, values in kinds:
            estimate = one.parameters[name]
            if estimate.identifiable:
                yield kind, estimate.value, estimate.deviation, float(values[number])


def _predict(
    run: tuple[Case, ExcitationRun],
    problem: ExcitationProblem,
    found: FrictionSelection,
    truth: Truth,
    outcome: Outcome,
) -> None:
    """Predict the torque of an unseen run, and note its errors over those of the best model, and over the noise."""
    case, unseen = run
    bandwidths = problem.runs[0].bandwidths
    there = case.problem([unseen], bandwidths)
    error = there.torque - predicted_torque(found, there)
    noise = _at_rows(case, there, unseen, unseen.noise)
    best = _at_rows(case, there, unseen, unseen.torque - best_model(case, unseen, truth, there))
    # What the filter takes from the recorded torque is the same for each model that is smooth: noise and ripple.
    lost = unseen.noise + unseen.ripple
    above = np.mean(lost**2, axis=0) - _power(there, _at_rows(case, there, unseen, lost))
    rest = np.maximum(above, 0.0)
    sizes = [_power(there, values) for values in (error, best, noise)]
    outcome.floor += np.sqrt(sizes[0] / sizes[1]).tolist()
    outcome.noise += np.sqrt(sizes[0] / sizes[2]).tolist()
    outcome.recorded += np.sqrt((sizes[0] + rest) / np.mean(unseen.noise**2, axis=0)).tolist()


def _power(problem: ExcitationProblem, values: Array) -> Array:
    """Return the mean square of rows, shape (r,), for each joint, shape (n,)."""
    count = np.bincount(problem.joint, minlength=len(problem.arm.names))
    return np.bincount(problem.joint, values**2, len(problem.arm.names)) / np.maximum(count, 1)


def best_model(case: Case, run: ExcitationRun, truth: Truth, problem: ExcitationProblem) -> Array:
    """Return the torque of a run by the pseudo-true parameters along the exact motion, Nm, shape (m, n)."""
    position, velocity, acceleration = run.exact
    columns = problem.columns.torque(position, velocity, acceleration)[:, :, list(problem.base.leading)]
    shapes = zip(
        case.arm.friction, truth.coulomb, truth.viscous, truth.exponent, truth.rise, truth.omega_s, strict=True
    )
    laws = []
    for law, coulomb, viscous, exponent, rise, omega_s in shapes:
        known = {"tau_c": (coulomb, coulomb), "c2": viscous, "alpha": exponent, "rise": rise}
        laws.append(replace(law, **known, omega_s=omega_s if rise else 1.0, delta=1.0))
    inputs = velocity @ case.arm.element_matrix.T
    elements = np.column_stack([law.torque(run.time, inputs[:, k]) for k, law in enumerate(laws)])
    return np.asarray(columns @ truth.base + elements @ case.arm.element_matrix)


def _at_rows(case: Case, problem: ExcitationProblem, run: ExcitationRun, torque: Array) -> Array:
    """Return a torque along a run, filtered like the recorded one, at a problem's rows, Nm, shape (r,)."""
    other = filter_record(as_read(replace(run.record(case.arm), torque=torque)), problem.runs[0].bandwidths)
    return problem.rows_of([piece.torque[:, :, None] for piece in other])[:, 0]
