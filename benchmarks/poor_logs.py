"""Do intervals hold, and are verdicts right, where a log is poor?

    python -m benchmarks.poor_logs [arms] [--first SEED]

Random arms of 2 and 3 joints with Coulomb and viscous friction, of which everything is known, pass through what
`rx90 identify excitation` does with a log: bandwidths, signs, fit. Three runs of 12 s at 200 Hz are recorded
as they should be, or with jittering stamps, gaps, 25 samples per second, one run alone, one joint whose effort is noise
alone, one whose effort is negated. Of the others' parameters 95 % intervals are counted; a negated effort has to be
refused by the name of its joint, nothing else at all, and an unseen run has to be confirmed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.excitation_coverage import Case
from benchmarks.excitation_runs import NOISE, FourierMotion, measured
from benchmarks.random_arms import FrictionLaw, SyntheticArm, random_arm
from benchmarks.report import arguments, in_processes, print_table
from rx90_common.base.arrays import Array
from rx90_common.base.errors import INTERRUPTED, IdentificationError
from rx90_emulator.identification.fitted import simplest_fit
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.rows.excitation import ExcitationProblem
from rx90_emulator.identification.rows.filtering import Bandwidths, filter_record
from rx90_emulator.identification.sanity import Recorded, alarms

CONDITIONS = ("good", "jitter", "gaps", "low rate", "few instants", "dead joint", "negated torque")
RATE, LOW_RATE, RUNS = 200.0, 25.0, 3
HELD = (0.93, 0.97)
CONFIRMED = 0.1
"""Of the torque of all joints, as the command's limit."""


@dataclass
class Outcome:
    """One arm in one condition: which 95 % intervals hold, the unseen torque error, and what was said wrongly."""

    held: list[bool] = field(default_factory=list)
    unseen: float = np.nan
    wrong: str = ""


def plain(seed: int) -> SyntheticArm:
    """Return a random arm of 2 or 3 joints without coupled wrist, with Coulomb and viscous friction."""
    arm = random_arm(seed, 2 + seed % 2, coupled=False, stribeck=False)
    return replace(
        arm, friction=tuple(FrictionLaw((law.coulomb, law.coulomb), law.c2) for law in arm.friction)
    )


def log(arm: SyntheticArm, seed: int, condition: str) -> JointRecord:
    """Return a run as it was recorded in a condition; the joint that is dead or negated is the last."""
    rng = np.random.default_rng((seed, 60))
    rate = LOW_RATE if condition == "low rate" else RATE
    jitter = replace(NOISE, jitter=0.3, stamp=0.02 / RATE) if condition == "jitter" else NOISE
    record = measured(arm, FourierMotion.random(arm, seed, periods=1), rate, seed, jitter).record(
        arm
    )
    if condition == "gaps":
        keep = np.ones(len(record.time), dtype=np.bool_)
        for start in rng.integers(100, len(keep) - 100, 6).tolist():
            keep[start : start + int(rng.integers(4, 9))] = False
        fields = ("time", "position", "velocity", "torque")
        record = replace(record, **{name: getattr(record, name)[keep] for name in fields})
    torque = record.torque.copy()
    if condition == "dead joint":
        torque[:, -1] = 0.02 * arm.torque[-1] * rng.normal(size=len(torque))
    if condition == "negated torque":
        torque[:, -1] *= -1.0
    return replace(record, torque=torque)


def truth(problem: ExcitationProblem, arm: SyntheticArm) -> Array:
    """Return the true base parameters."""
    standard = [arm.link_parameters, arm.rotor, arm.spring[arm.spring != 0.0], arm.offset]
    return np.asarray(problem.base.combination @ np.concatenate(standard))


def experiment(arguments: tuple[int, str]) -> Outcome:
    """Identify one arm in one condition."""
    seed, condition = arguments
    arm = plain(seed)
    rigid, last = Case.of(arm, NOISE, RATE, seed=seed).rigid, arm.names[-1]

    numbers = [1000 * seed + number for number in range(1 if condition == "few instants" else RUNS)]
    records = [log(arm, number, condition) for number in numbers]
    try:
        bandwidths = Bandwidths.of(records)
        problem = ExcitationProblem.of(
            rigid, [run for record in records for run in filter_record(record, bandwidths)]
        )
        doubts = alarms(rigid, Recorded.of(records, rigid))
        if doubts:
            raise IdentificationError(doubts[0])
    except IdentificationError as error:
        right = condition == "negated torque" and f"sign of the effort of {last}:" in str(error)
        return Outcome(wrong="" if right else f"refused: {error}")
    if condition == "negated torque":
        return Outcome(wrong="a negated torque was not noticed")
    found = simplest_fit(problem)
    outcome = Outcome()
    first = len(found.fit.x)
    if condition != "dead joint":
        pairs = zip(found.fit.linear, found.deviation[first:], truth(problem, arm), strict=True)
        outcome.held += [abs(value - true) < 1.96 * deviation for value, deviation, true in pairs]
    for number, (name, law) in enumerate(zip(arm.names, arm.friction, strict=True)):
        if condition != "dead joint" or name != last:
            for key, true in (("tau_c_positive", law.coulomb), ("c2", law.c2)):
                estimate = found.estimates(number)[key]
                if estimate.identifiable:
                    outcome.held.append(abs(estimate.value - true) < 1.96 * estimate.deviation)
    if condition != "dead joint":
        there = problem.other(filter_record(log(arm, 1000 * seed + RUNS, "good"), bandwidths))
        left = there.torque - found.predicted(there)
        outcome.unseen = float(np.linalg.norm(left) / np.linalg.norm(there.torque))
        if outcome.unseen > CONFIRMED:
            outcome.wrong = f"an unseen run of the same arm is not confirmed: {outcome.unseen:.1%}"
    return outcome


def main() -> int:
    """Print the figures; return 1 where intervals hold too seldom or too often, or a verdict is wrong."""
    options = arguments(__doc__, ("arms", 40, "how many"), ("--first", 0, "seed of the first"))
    rows, wrong, whole = [], [], True
    for condition in CONDITIONS:
        jobs = [(options.first + number, condition) for number in range(options.arms)]
        outcomes = [*in_processes(experiment, jobs, condition).values()]
        whole = len(outcomes) == len(jobs)
        held = np.array([one for outcome in outcomes for one in outcome.held])
        said = [outcome.wrong for outcome in outcomes if outcome.wrong]
        shown = ["-", "-"]
        if len(held):
            share, error = float(np.mean(held)), float(np.std(held) / np.sqrt(len(held)))
            unseen = [outcome.unseen for outcome in outcomes if np.isfinite(outcome.unseen)]
            shown = [
                f"{share:.1%} +- {1.96 * error:.1%} of {len(held)}",
                f"{np.median(unseen):.1%}" if unseen else "-",
            ]
            if not HELD[0] <= share <= HELD[1]:
                wrong.append(f"{condition}: intervals hold {share:.1%}")
        rows.append((condition, *shown, str(len(said))))
        wrong += [f"{condition}: {text}" for text in said]
        if not whole:
            break
    print_table(
        ("log", "intervals that hold", "unseen torque error, median", "wrong verdicts"), rows
    )
    print(*wrong, sep="\n")
    return int(bool(wrong)) if whole else INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
