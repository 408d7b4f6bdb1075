"""Do the 95 % intervals of the identification from excitation runs hold, and how well is an unseen run predicted?

    python -m benchmarks.excitation_coverage [arms] [--first 0] [--largest 6] [--runs 12] [--bristles]

Random arms of 2 to 6 joints, with and without coupled wrist, are recorded in runs of 24 s at 67 Hz to 5 kHz: with
noise and encoder steps alone, and with torque ripple of 2 % and Coulomb friction that grows by 5 % with the load, which
no model here knows. True are the parameters that fit best in the limit of ever more such runs (`excitation_truth`);
beside them stand those of friction without load. One more run is predicted; the noise floor of its torque, which the
error is accepted up to 1.2 times of (95 % of the joints), is what the best-fitting values leave, in the band of the
parallel filter. Of the exponents nine of ten must be within 0.05, and 90 to 99 % of the intervals must hold.

Twelve runs, five minutes of motion: with ripple and load an exponent is told to 0.05 by so much, not by the 96 s of
`--runs 4`, the harder case. Merges the figures into out/bench.json; exit code 1 when one is not accepted.

True parameters are needed because friction that grows with the load has no one Coulomb torque. What an identification
from some runs can find, and what its intervals must hold, are the parameters that a least-squares fit has in the limit
of ever more runs of the same kind: pseudo-true values (White 1982), computed from exact motions and torques with SciPy.
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import binom

from benchmarks.excitation_runs import (
    MISFIT,
    NOISE,
    Disturbances,
    ExcitationRun,
    FourierMotion,
    measured,
    torque_along,
)
from benchmarks.random_arms import SyntheticArm, random_arm
from benchmarks.report import accepted, arguments, in_processes, merge, print_table
from rx90_common.base.arrays import Array
from rx90_common.base.errors import Rx90Error
from rx90_common.estimation.law import Part
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.fitted import TRIED, FittedArm, fit_arm
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.rows.excitation import ExcitationProblem
from rx90_emulator.identification.rows.filtering import Bandwidths, filter_record

Columns = Callable[[Array, Array, Array], Array]
"""Columns of base parameters for positions, velocities and accelerations: (m, n) each to (m, n, b)."""

_SAMPLES = 60
_EXPONENT, _STRIBECK = (0.1, 2.0), (1e-3, 2.0)


@dataclass(frozen=True, eq=False)
class Truth:
    """Pseudo-true values.

    Attributes:
        base: of the base parameters, shape (b,).
        coulomb: mean of both directions, Nm, shape (n_el,), as are the following.
        viscous: torque at 1 rad/s, Nm.
        exponent: of the velocity.
        rise: static over Coulomb torque, less 1; 0 for elements without.
        omega_s: Stribeck velocity for the exponent delta = 1, rad/s; NaN for elements without.
    """

    base: Array
    coulomb: Array
    viscous: Array
    exponent: Array
    rise: Array
    omega_s: Array


def truth_of(
    arm: SyntheticArm,
    columns: Columns,
    sigma: Array,
    disturbances: Disturbances,
    motion: Callable[[int], FourierMotion],
    motions: int = 40,
) -> Truth:
    """Fit exact torques of many motions, each joint in units of `sigma`, its residuals' deviation, Nm, shape (n,).

    Args:
        arm: bristles are left out: in steady sliding they change nothing.
        columns: of the base parameters.
        sigma: weights of the joints.
        disturbances: of which the load dependence of friction is taken.
        motion: makes a random motion from a seed.
        motions: how many.
    """
    steady = replace(arm, friction=tuple(replace(law, c0=0.0, c1=0.0) for law in arm.friction))
    rng = np.random.default_rng(7)
    parts = []
    for seed in range(motions):
        one = motion(900_000 + seed)
        time = np.sort(rng.uniform(one.rest, one.duration - one.rest, _SAMPLES))
        exact = one.at(time)
        parts.append(
            (
                columns(*exact),
                exact[1] @ arm.element_matrix.T,
                torque_along(steady, time, exact, disturbances.load),
            )
        )
    linear, inputs, torque = (np.concatenate(values) for values in zip(*parts, strict=True))
    weight = 1.0 / np.asarray(sigma)
    stribeck = [k for k, law in enumerate(arm.friction) if law.rise > 0.0]
    basis, upper = np.linalg.qr((linear * weight[:, None]).reshape(-1, linear.shape[2]))
    target = (torque * weight).ravel()

    def friction(shape: Array) -> Array:
        size, sign = np.abs(inputs), np.sign(inputs)
        powers = sign * size ** shape[: inputs.shape[1]]
        decays = sign[:, stribeck] * np.exp(-size[:, stribeck] / np.exp(shape[inputs.shape[1] :]))
        acting = np.concatenate([sign, powers, decays], axis=1)
        matrix = np.concatenate(
            [arm.element_matrix, arm.element_matrix, arm.element_matrix[stribeck]]
        )
        return np.einsum("mk,kj->mjk", acting, matrix * weight).reshape(-1, len(matrix))

    def fitted(shape: Array) -> tuple[Array, Array]:
        own = friction(shape)
        free = own - basis @ (basis.T @ own)
        values = np.linalg.lstsq(free, target - basis @ (basis.T @ target), rcond=None)[0]
        rest = target - own @ values
        return values, rest - basis @ (basis.T @ rest)

    start = [law.alpha for law in arm.friction] + [
        np.log(arm.friction[k].omega_s) for k in stribeck
    ]
    low, high = np.log(_STRIBECK)
    bounds = (
        [_EXPONENT[0]] * len(arm.friction) + [low] * len(stribeck),
        [_EXPONENT[1]] * len(arm.friction) + [high] * len(stribeck),
    )
    shape = least_squares(lambda x: fitted(x)[1], start, bounds=bounds, x_scale=0.1).x
    values, _ = fitted(shape)
    base = np.linalg.solve(upper, basis.T @ (target - friction(shape) @ values))
    n = len(arm.friction)
    rise, omega = np.zeros(n), np.full(n, np.nan)
    rise[stribeck] = values[2 * n :] / values[stribeck]
    omega[stribeck] = np.exp(shape[n:])
    return Truth(base, values[:n], values[n : 2 * n], shape[:n], rise, omega)


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
    def of(
        cls,
        arm: SyntheticArm,
        disturbances: Disturbances,
        rate: float,
        periods: int = 1,
        seed: int = 0,
    ) -> Case:
        """Return the case of an arm; its description passes through a file."""
        with tempfile.TemporaryDirectory() as folder:
            urdf = Path(folder) / "arm.urdf"
            urdf.write_text(arm.urdf(wrong=0.4, seed=seed), encoding="utf-8")
            rigid = RigidArm.from_urdf(urdf, coupling=arm.coupling, spring=arm.spring)
        return cls(arm, rigid, disturbances, rate, periods, seed)

    def motion(self, seed: int) -> FourierMotion:
        """Return a random motion of 24 s."""
        count = self.periods
        return FourierMotion.random(
            self.arm, seed, period=24.0 / count, periods=count, harmonics=12 // count
        )

    def run(self, number: int) -> ExcitationRun:
        """Return one of the runs."""
        seed = 1000 * self.seed + number
        return measured(self.arm, self.motion(seed), self.rate, seed, self.disturbances)

    def problem(
        self, runs: list[ExcitationRun], bandwidths: Bandwidths | None = None
    ) -> ExcitationProblem:
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
        return np.asarray(
            values[: count * size].reshape(count, size, *values.shape[1:]).mean(axis=1)
        )

    fields = ("time", "position", "velocity", "torque")
    return replace(record, **{name: mean(getattr(record, name)) for name in fields})


def random_case(
    seed: int, disturbances: Disturbances, *, largest: int = 6, bristles: bool = False
) -> Case:
    """Return a random arm of 2 to `largest` joints, recorded at 67 Hz to 5 kHz, each motion once or twice in a run."""
    rng = np.random.default_rng((seed, 40))
    arm = random_arm(seed, int(rng.integers(2, largest + 1)), bristles=bristles)
    rate = float(rng.choice([67.0, 125.0, 250.0, 250.0, 500.0, 500.0, 1000.0, 5000.0]))
    return Case.of(arm, disturbances, rate, int(rng.integers(1, 3)), seed)


def experiment(case: Case, *, bristles: bool = False, runs: int = RUNS) -> Outcome:
    """Identify an arm from some runs and predict another one."""
    outcome = Outcome()
    problem = case.problem([case.run(number) for number in range(runs)])
    found = fit_arm(problem, (*TRIED, Part.BRISTLE) if bristles else TRIED)
    joints = range(len(case.rigid.names))
    sigma = np.array(
        [np.median(np.abs(found.fit.residual[problem.joint == joint])) for joint in joints]
    )
    truth = case.truth(problem, sigma)
    first = len(found.fit.x)
    for value, deviation, true in zip(
        found.fit.linear, found.deviation[first:], truth.base, strict=True
    ):
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
        (Part.STRIBECK in fitted.parts, law.rise > 0.0)
        for fitted, law in zip(found.laws, case.arm.friction, strict=True)
    ]
    rises = [has for has, true in there if true], [has for has, true in there if not true]
    outcome.stribeck = sum(rises[0]), len(rises[0]), sum(rises[1]), len(rises[1])
    _predict((case, case.run(runs)), problem, found, truth, outcome)
    return outcome


def _friction(found: FittedArm, truth: Truth) -> Iterator[tuple[str, float, float, float]]:
    """Yield kind, value, deviation and true value of what was identified of friction."""
    kinds = (("tau_c_positive", "Coulomb", truth.coulomb), ("c2", "viscous", truth.viscous),
             ("alpha", "exponent", truth.exponent))  # fmt: skip
    for number in range(len(found.laws)):
        estimates = found.estimates(number)
        for name, kind, values in kinds:
            estimate = estimates[name]
            if estimate.identifiable:
                yield kind, estimate.value, estimate.deviation, float(values[number])


def _predict(
    run: tuple[Case, ExcitationRun],
    problem: ExcitationProblem,
    found: FittedArm,
    truth: Truth,
    outcome: Outcome,
) -> None:
    """Predict the torque of an unseen run, and note its errors over those of the best model, and over the noise."""
    case, unseen = run
    bandwidths = problem.runs[0].bandwidths
    pieces = filter_record(as_read(unseen.record(case.arm)), bandwidths)
    there = problem.other(pieces)
    error = there.torque - found.predicted(there)
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
    columns = problem.columns.torque(position, velocity, acceleration)[
        :, :, list(problem.base.leading)
    ]
    shapes = zip(
        case.arm.friction,
        truth.coulomb,
        truth.viscous,
        truth.exponent,
        truth.rise,
        truth.omega_s,
        strict=True,
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
    other = filter_record(
        as_read(replace(run.record(case.arm), torque=torque)), problem.runs[0].bandwidths
    )
    return problem.rows_of([piece.torque[:, :, None] for piece in other])[:, 0]


CONDITIONS = {"noise": NOISE, "misfit": MISFIT}
FRICTION = ("Coulomb", "viscous", "exponent")
COVERED = (0.90, 0.99)
CHANCE = 0.05
EXPONENT, SHARE = 0.05, 90.0
PREDICTION = 1.2


def job(arguments: tuple[int, str, int, bool, int]) -> Outcome:
    """Identify one random arm, of `largest` joints at most."""
    seed, condition, largest, bristles, runs = arguments
    case = random_case(seed, CONDITIONS[condition], largest=largest, bristles=bristles)
    try:
        return experiment(case, bristles=bristles, runs=runs)
    except Rx90Error as error:
        return Outcome(refusal=str(error))


def joined(outcomes: Sequence[Outcome], name: str, kind: str | None = None) -> np.ndarray:
    """Return an attribute of all outcomes, or one kind of it, in one array."""
    values = [
        getattr(one, name) if kind is None else getattr(one, name).get(kind, []) for one in outcomes
    ]
    return np.array([value for part in values for value in part])


def coverage(condition: str, outcomes: Sequence[Outcome], figures: dict[str, float]) -> list[str]:
    """Print and add to the figures how often intervals hold; return what is not accepted."""
    rows, wrong = [], []
    unloaded = [f"{kind}{UNLOADED}" for kind in FRICTION] if CONDITIONS[condition].load else []
    for kind in ("base", *FRICTION, *unloaded):
        scores, errors = joined(outcomes, "scores", kind), joined(outcomes, "errors", kind)
        share = float(np.mean(np.abs(scores) < 1.96))
        margin = 196.0 * math.sqrt(share * (1.0 - share) / len(scores))
        typical = (
            ["", ""]
            if kind == "base"
            else [f"{v:.3f}" for v in np.percentile(np.abs(errors), (50.0, 95.0))]
        )
        rows.append((kind, str(len(scores)), f"{100.0 * share:.1f} ± {margin:.1f} %", *typical))
        figures[f"excitation_coverage_{condition}_{kind.lower().replace(' ', '_')}"] = share
        if kind not in unloaded and (share < COVERED[0] or _wide(np.abs(scores) < 1.96)):
            wrong.append(f"coverage of {kind}")
    print_table(
        (
            f"{condition}: parameter",
            "values",
            "intervals that hold",
            "median error",
            "95th percentile",
        ),
        rows,
    )
    return wrong


def _wide(hold: np.ndarray) -> bool:
    """Return whether more intervals hold than are accepted, and not by chance: fifty that all hold show nothing."""
    return bool(binom.sf(np.sum(hold) - 1, len(hold), COVERED[1]) < CHANCE)


def exponents(condition: str, outcomes: Sequence[Outcome], figures: dict[str, float]) -> list[str]:
    """Print and add to the figures the errors of exponents; return what is not accepted."""
    errors = np.abs(joined(outcomes, "errors", "exponent"))
    within = float(np.mean(errors < EXPONENT))
    middle, most = (float(np.percentile(errors, share)) for share in (50.0, SHARE))
    of = {"within": within, "median": middle, "90_percent": most}
    figures.update({f"excitation_exponent_{condition}_{name}": value for name, value in of.items()})
    print(
        f"exponents: {100.0 * within:.0f} % within {EXPONENT}; median {middle:.3f}, 90th percentile {most:.3f}"
    )
    found, there, more, without = np.sum(
        [one.stribeck for one in outcomes if not one.refusal], axis=0
    )
    print(
        f"Stribeck rise found on {found} of {there} elements that have one, and on {more} of {without} without"
    )
    return [] if most < EXPONENT else ["exponents"]


def prediction(condition: str, outcomes: Sequence[Outcome], figures: dict[str, float]) -> list[str]:
    """Print and add to the figures how well unseen runs are predicted; return what is not accepted."""
    wrong = []
    for name, text in (
        ("floor", "the best model's"),
        ("recorded", "the noise (all frequencies)"),
        ("noise", "the noise"),
    ):
        ratios = joined(outcomes, name)
        middle, most = (float(np.percentile(ratios, share)) for share in (50.0, 95.0))
        share = float(np.mean(ratios <= PREDICTION))
        figures[f"excitation_{name}_{condition}_median"] = middle
        figures[f"excitation_{name}_{condition}_95_percent"] = most
        print(f"error of an unseen run's torque over {text}: median {middle:.2f}, 95 % of joints below {most:.2f}, "
              f"{100.0 * share:.0f} % within {PREDICTION}")  # fmt: skip
        if name == "floor" and most > PREDICTION:
            wrong.append("prediction")
    return wrong


def main() -> int:
    """Print the figures and merge them; return 1 if one is not what is accepted."""
    options = arguments(
        __doc__,
        ("arms", 40, "how many"),
        ("--first", 0, "seed of the first"),
        ("--largest", 6, "joints at most"),
        ("--runs", 12, "of each arm, to identify from"),
        ("--bristles", False, "with bristles in arms and model"),
    )
    wrong, whole = [], True
    for condition in CONDITIONS:
        rest = (condition, options.largest, options.bristles, options.runs)
        jobs = [(options.first + number, *rest) for number in range(options.arms)]
        outcomes = [*in_processes(job, jobs, condition).values()]
        whole = len(outcomes) == len(jobs)
        refusals = [one.refusal for one in outcomes if one.refusal]
        print(
            f"{condition}: {len(refusals)} of {len(outcomes)} arms refused",
            *sorted(set(refusals)),
            sep="\n",
        )
        figures: dict[str, float] = {}
        for part in (coverage, exponents, prediction) if len(outcomes) > len(refusals) else ():
            wrong += [f"{condition}: {text}" for text in part(condition, outcomes, figures)]
        if not whole:
            break
        merge(figures)
    return accepted(wrong, whole)


if __name__ == "__main__":
    sys.exit(main())
