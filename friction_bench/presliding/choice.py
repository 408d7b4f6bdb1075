"""Which of five laws of friction the readings ask for, by cross-validation over whole blocks.

Each law is fitted to all blocks but some and predicts those: blocks begin with a slide, so that no reading shares
noise or memory with one of another block. Squared errors of the blocks are compared in pairs: a law is refuted where
another predicts better by more than chance gives (t-test over the blocks, one-sided, p < P) and by more than SHARE, be
it in sliding, or, among the laws that sliding leaves, in loops. Of laws that contain a simpler one which is not refuted
the simpler one is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import least_squares

from friction_bench.presliding.drift import DriftResult, DriftVerdict
from friction_bench.presliding.five_laws import (
    COULOMB,
    ELASTO_PLASTIC,
    LAWS,
    LUGRE,
    MAXWELL_SLIP,
    STRIBECK,
    FrictionLaw,
    LoopBlock,
)
from friction_bench.presliding.sliding import SlidingFriction, SlidingReadings, fit_sliding_friction
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.held_out import HeldOutErrors

P = 0.01
SHARE = 0.1
"""Least relative excess of the squared error that counts."""
FOLDS = 5
LEAST_BLOCKS = 6
_SLIDING_BLOCKS = 10
WITH_BRISTLES = (LUGRE, ELASTO_PLASTIC, MAXWELL_SLIP)


@dataclass(frozen=True, eq=False)
class LawScore:
    """How a law did.

    Attributes:
        loops: RMS errors of the blocks of loops that it had not seen, Nm, shape (blocks,).
        sliding: the same of sliding readings.
        values: of the law's free parameters from all blocks, transformed.
        refuted: why it is, "" if it is not.
    """

    law: FrictionLaw
    loops: Array
    sliding: Array
    values: tuple[float, ...]
    refuted: str


@dataclass(frozen=True, eq=False)
class Choice:
    """The verdict.

    Attributes:
        scores: of all laws, in the order of LAWS.
        law: that is chosen, None where several are left.
        left: names of the laws that are left.
        by_loops: names of the laws that loops and sliding leave, without the drift.
        sliding: steady sliding, from all readings.
    """

    scores: tuple[LawScore, ...]
    law: FrictionLaw | None
    left: tuple[str, ...]
    by_loops: tuple[str, ...]
    sliding: SlidingFriction

    @property
    def lugre(self) -> FrictionElement:
        """Return LuGre's element as fitted, without damping of its bristles, which the readings do not show."""
        score = next(score for score in self.scores if score.law is LUGRE)
        return LUGRE.element(score.values, self.sliding)

    @property
    def text(self) -> str:
        """Return the verdict in words."""
        if self.law is None:
            return f"cannot tell: {' or '.join(self.left)}"
        return self.law.name + (", by its drift" if len(self.by_loops) > 1 else "")


def choose(
    blocks: Sequence[LoopBlock],
    readings: SlidingReadings,
    drift: DriftResult | None,
    on_fit: Callable[[], object] = lambda: None,
) -> Choice:
    """Choose the law.

    Args:
        blocks: of loops.
        readings: of the sliding joint, in the order of time.
        drift: under small cycles, None if it was not measured.
        on_fit: called after each of `fits()` fits.

    Raises:
        IdentificationError: if there is too little to compare.
    """
    if len(blocks) < LEAST_BLOCKS:
        raise IdentificationError(f"{len(blocks)} blocks of loops; accepted: at least {LEAST_BLOCKS}")
    sliding = {stribeck: fit_sliding_friction(readings, stribeck) for stribeck in (False, True)}
    held_out = {stribeck: _sliding_errors(readings, stribeck) for stribeck in (False, True)}
    scores = []
    for law in LAWS:
        errors = np.zeros(len(blocks))
        for seen, unseen in _folds(len(blocks)):
            values = fit_law(law, sliding[law.stribeck], [blocks[i] for i in seen])
            for i in unseen:
                errors[i] = _rms(law.predict(values, sliding[law.stribeck], blocks[i]) - blocks[i].torque)
            on_fit()
        values = fit_law(law, sliding[law.stribeck], blocks)
        scores.append(LawScore(law, errors, held_out[law.stribeck], tuple(values), ""))
        on_fit()
    verdicts = judged(scores)
    left = _simplest([score.law for score in verdicts if not score.refuted])
    told = _by_drift(left, drift)
    return Choice(
        scores=tuple(verdicts),
        law=told[0] if len(told) == 1 else None,
        left=tuple(law.name for law in told),
        by_loops=tuple(law.name for law in left),
        sliding=sliding[True],
    )


def fits() -> int:
    """Return how many fits a choice takes."""
    return len(LAWS) * (FOLDS + 1)


def fit_law(law: FrictionLaw, sliding: SlidingFriction, blocks: Sequence[LoopBlock]) -> list[float]:
    """Return the free values of a law, transformed, that predict the torques of blocks best."""

    def misfit(values: Array) -> Array:
        found = law.predictions(values.tolist(), sliding, blocks)
        rows = [torque - block.torque for torque, block in zip(found, blocks, strict=True)]
        return np.concatenate(rows) if rows else np.empty(0)

    tries = [start for start in law.start(_stiffness(blocks)) if start]
    if not tries:
        return []
    found = [least_squares(misfit, start, diff_step=[1e-3], xtol=1e-4, ftol=1e-4, max_nfev=40) for start in tries]
    best = min(found, key=lambda one: float(one.cost))
    return [float(value) for value in best.x]


def _stiffness(blocks: Sequence[LoopBlock]) -> float:
    """Return the stiffness with which joints begin to turn back, Nm/rad, roughly: where the torque falls."""
    rises = []
    for block in blocks:
        torque, angle = block.torque, block.angle[block.readings]
        for first, last in pairwise(range(0, torque.size, 4)):
            if torque[last] < torque[first] and angle[first] > angle[last]:
                rises.append((torque[first] - torque[last]) / (angle[first] - angle[last]))
    return float(np.median(rises)) if rises else 1e6


def _folds(count: int) -> Iterator[tuple[list[int], list[int]]]:
    for fold in range(FOLDS):
        unseen = list(range(fold, count, FOLDS))
        yield [i for i in range(count) if i not in unseen], unseen


def _sliding_errors(readings: SlidingReadings, stribeck: bool) -> Array:
    """Return the RMS errors of stretches of sliding readings from a fit to the others, Nm, shape (stretches,)."""
    errors = []
    for stretch in np.array_split(np.arange(readings.speed.size), _SLIDING_BLOCKS):
        rest = np.setdiff1d(np.arange(readings.speed.size), stretch)
        friction = fit_sliding_friction(readings.chosen(rest), stribeck)
        unseen = readings.chosen(stretch)
        errors.append(_rms(friction.torque(unseen.speed) + friction.inertia * unseen.acceleration - unseen.torque))
    return np.array(errors)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def judged(scores: Sequence[LawScore]) -> list[LawScore]:
    """Return the scores with what refutes them.

    In loops the laws that sliding leaves are compared. Where the encoder sees no presliding, loops are counts of creep:
    whatever predicts least torque there is nearest, be its sliding ever so wrong.
    """
    laws = [score.law.name for score in scores]
    sliding = HeldOutErrors({score.law.name: score.sliding**2 for score in scores}, floor=1e-12)
    loops = HeldOutErrors({score.law.name: score.loops**2 for score in scores}, floor=1e-12)
    by_sliding = {law: sliding.refutes(law, laws, P, SHARE) for law in laws}
    standing = [law for law in laws if by_sliding[law] is None]
    verdicts = []
    for score in scores:
        name = score.law.name
        rivals = {"loops": loops.refutes(name, standing, P, SHARE), "sliding": by_sliding[name]}
        reasons = [f"{kind}: {best} predicts better" for kind, best in rivals.items() if best is not None]
        verdicts.append(replace(score, refuted="; ".join(reasons)))
    return verdicts


def _simplest(laws: Sequence[FrictionLaw]) -> list[FrictionLaw]:
    """Return the laws that do not contain a simpler one among them: Coulomb, Stribeck, any with bristles."""
    for simple in (COULOMB, STRIBECK):
        if simple in laws:
            return [simple]
    return list(laws)


def _by_drift(laws: Sequence[FrictionLaw], drift: DriftResult | None) -> list[FrictionLaw]:
    """Return the laws that the drift leaves."""
    if drift is None or drift.verdict is DriftVerdict.UNKNOWN or not any(law in WITH_BRISTLES for law in laws):
        return list(laws)
    drifts = drift.verdict is DriftVerdict.DRIFTS
    kept = [law for law in laws if (law is LUGRE) is drifts]
    return kept or list(laws)
