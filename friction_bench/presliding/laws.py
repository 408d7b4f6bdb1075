"""Five laws of friction that may explain loops, and the choice among them by prediction.

The motion is the input and the torque the prediction, as in the laws themselves, so that no simulation diverges because
of a small error. Between two readings the velocity is assumed constant, and the bristles follow it by the steps of
rx90_common/friction, which are exact for that. A law without bristles predicts no motion below the static
torque: if a step of torque moves the joint by a count, it predicts the sliding torque.

The choice is by cross-validation over whole blocks: each law is fitted to some of the blocks and predicts the others.
Blocks begin with a slide, so that no reading shares noise or memory with one of another block. Squared errors of the
blocks are compared in pairs: a law is refuted if another predicts significantly better (t-test over the
blocks, one-sided, p < SIGNIFICANCE) and by more than MIN_EXCESS, either in sliding or, among the laws that sliding does
not refute, in loops. If a law contains a simpler one that is not refuted, the simpler one is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from friction_bench.presliding.motions import DWELL_TICKS, Trace
from friction_bench.presliding.sliding import (
    DriftResult,
    DriftVerdict,
    SlidingFriction,
    SlidingReadings,
    fit_sliding_friction,
)
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.friction.compiled_elements import prescribed_torque
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.held_out import HeldOutErrors, leave_out
from rx90_common.friction.parts.bristles import MAX_BREAK_AWAY, BristlesPart, ElastoPlastic, MaxwellSlip

SIGNIFICANCE = 0.01
MIN_EXCESS = 0.1
"""Least relative excess of the squared error that counts."""
FOLDS = 5
MIN_BLOCKS = 6
BREAK_AWAY_RATIOS = np.geomspace(0.15, 4.0, 6)
"""Of the blocks of Maxwell slip, in proportion: where their springs give way."""
ATTRACTION = 1e4
"""Nm/s: at once, for a velocity that is held for a tick; the readings, at rest, do not show how fast it is."""
_SLIDING_BLOCKS = 10


@dataclass(frozen=True, eq=False)
class LoopBlock:
    """One block of loops, beginning at rest without torque after a slide, so that nothing before it matters.

    The joint swings to rest there, with undeflected bristles; blocks of Maxwell slip are then nearly undeflected.

    Attributes:
        angle: of the joint at each reading from the rest after the slide on, rad, without the encoder's flicker,
            shape (n,).
        readings: those at the end of each held torque, shape (k,).
        torque: held there, Nm, shape (k,).
        tick: s.
    """

    angle: Array
    readings: NDArray[np.int64]
    torque: Array
    tick: float

    @classmethod
    def of(cls, trace: Trace) -> LoopBlock:
        """Return the block of a trace of loops."""
        code = trace.code
        ends = np.flatnonzero(np.diff(code) != 0.0)
        slid = int(np.flatnonzero((code[:-1] > 0.0) & (code[1:] == 0.0))[0]) + 1
        first = slid + int(np.argmax(code[slid:] != 0.0)) - 1  # the last reading at rest
        readings = ends[(ends > first) & (np.diff(ends, prepend=-1) >= DWELL_TICKS)]
        angle, torque = settled(trace.counts)[first:] * trace.angle_step, code[readings] * trace.torque_step
        return cls(angle, readings - first, torque, trace.tick)


def settled(counts: Array) -> Array:
    """Return counts without the flicker of one: the middle of the possible range, with the least motion."""
    middle = np.empty_like(counts)
    at = counts[0]
    for k, count in enumerate(counts):
        at = min(max(at, count - 0.5), count + 0.5)
        middle[k] = at
    return middle


@dataclass(frozen=True)
class FrictionLaw:
    """A law with its free parameters in presliding.

    Attributes:
        name: of the law.
        parameters: their number, including those of sliding.
        stribeck: the law has a static torque above the Coulomb one.
        starts: initial values of fits: a factor of the stiffness that the loops show, and the other values,
            transformed.
        bristles: computed from the transformed values but the first, which is ln c0; None for a law without presliding.
    """

    name: str
    parameters: int
    stribeck: bool = True
    starts: tuple[tuple[float, ...], ...] = ()
    bristles: Callable[[Sequence[float]], BristlesPart | None] | None = None

    def predict(self, values: Sequence[float], sliding: SlidingFriction, blocks: Sequence[LoopBlock]) -> list[Array]:
        """Return the torque at each of the readings of blocks, Nm, each of shape (k,)."""
        if self.bristles is None:
            # It balances the torque at rest, and slides where it moves.
            ways = sliding, sliding.backward or sliding
            (static, back), found = ((way.tau_s if self.stribeck else way.tau_c) for way in ways), []
            for block in blocks:
                before = np.concatenate(([block.readings[0] - DWELL_TICKS], block.readings[:-1]))
                moved = block.angle[block.readings] - block.angle[np.maximum(before, 0)]
                still = np.clip(block.torque, -back, static)
                found.append(np.where(moved == 0.0, still, np.where(moved > 0.0, static, -back)))
            return found
        element, found = self.element(values, sliding), []
        for block in blocks:
            velocity = np.diff(block.angle)[:, None] / block.tick
            torque = prescribed_torque((element,), velocity, np.full(velocity.size, block.tick))
            found.append(torque[block.readings - 1, 0])
        return found

    def element(self, values: Sequence[float], sliding: SlidingFriction) -> FrictionElement:
        """Return the friction element of a law with bristles, without damping, which the readings do not show."""
        assert self.bristles is not None
        ways = sliding, sliding.backward or sliding
        coulomb, back = (max(way.tau_c, 1e-6) for way in ways)
        static, back_static = (max(way.tau_s, way.tau_c, 1e-6) for way in ways)
        others = sliding.omega_s, 1.0, math.exp(values[0]), 0.0, sliding.c2, math.inf, 1.0
        lugre = FrictionElement(coulomb, back, static, back_static, *others)
        return replace(lugre, bristles=self.bristles(values[1:]))

    def fit(self, sliding: SlidingFriction, blocks: Sequence[LoopBlock]) -> list[float]:
        """Return the free values, transformed, that predict the torques of blocks best."""
        if not self.starts:
            return []
        measured = np.concatenate([block.torque for block in blocks])
        rises: list[float] = []  # torque over angle where a joint begins to turn back, Nm/rad: the stiffness, roughly
        for block in blocks:
            torque, angle = np.diff(block.torque[::4]), np.diff(block.angle[block.readings][::4])
            back = (torque < 0.0) & (angle < 0.0)
            rises.extend(torque[back] / angle[back])

        def misfit(values: Array) -> Array:
            return np.asarray(np.concatenate(self.predict(values.tolist(), sliding, blocks)) - measured)

        stiffness = float(np.median(rises)) if rises else 1e6
        tries = [[math.log(factor * stiffness), *rest] for factor, *rest in self.starts]
        found = [least_squares(misfit, one, diff_step=[1e-3], xtol=1e-4, ftol=1e-4, max_nfev=40) for one in tries]
        return [float(value) for value in min(found, key=lambda one: float(one.cost)).x]


def _maxwell(values: Sequence[float]) -> MaxwellSlip:
    stiffness = np.exp(np.append(np.asarray(values), 0.0))
    stiffness /= stiffness.sum()
    share = stiffness * BREAK_AWAY_RATIOS / float(stiffness @ BREAK_AWAY_RATIOS)
    stiffness, share = (np.clip(part, 1e-6, 1.0) for part in (stiffness, share))
    stiffness, share = stiffness / stiffness.sum(), share / share.sum()
    return MaxwellSlip(tuple(stiffness.tolist()), tuple(share.tolist()), ATTRACTION)


# Maxwell slip begins with even springs, and with stiff ones that give way early; none is 0, which would take a fit's
# steps away.
COULOMB = FrictionLaw("Coulomb and viscous", 2, stribeck=False)
STRIBECK = FrictionLaw("Stribeck", 4)
LUGRE = FrictionLaw("LuGre", 5, starts=((1.0,),), bristles=lambda _: None)
ELASTO_PLASTIC = FrictionLaw(
    "elasto-plastic",
    6,
    starts=((1.0, -0.5), (1.0, 1.2)),
    bristles=lambda values: ElastoPlastic(MAX_BREAK_AWAY / (1.0 + math.exp(-values[0]))),
)
MAXWELL_SLIP = FrictionLaw(
    "Maxwell slip",
    4 + BREAK_AWAY_RATIOS.size,
    starts=((1.3, 0.5, 0.4, 0.3, 0.2, 0.1), (2.0, 2.0, 1.5, 1.0, 0.6, 0.2)),
    bristles=_maxwell,
)
LAWS = (COULOMB, STRIBECK, LUGRE, ELASTO_PLASTIC, MAXWELL_SLIP)
"""From the simplest to the one with most parameters."""
FITS = len(LAWS) * (FOLDS + 1)
"""That a choice takes."""


@dataclass(frozen=True, eq=False)
class LawScore:
    """The prediction errors of a law.

    Attributes:
        loops: mean squared errors of the held-out blocks of loops, Nm^2, shape (blocks,).
        sliding: the same of stretches of sliding readings.
        values: of the law's free parameters from all blocks, transformed.
        refuted: the reason, "" if it is not refuted.
    """

    law: FrictionLaw
    loops: Array
    sliding: Array
    values: tuple[float, ...]
    refuted: str = ""


@dataclass(frozen=True, eq=False)
class Choice:
    """The verdict.

    Attributes:
        scores: of all laws, in the order of LAWS.
        left: laws that are left.
        by_loops: laws that loops and sliding leave, without the drift.
        sliding: steady sliding, from all readings.
    """

    scores: tuple[LawScore, ...]
    remaining: tuple[FrictionLaw, ...]
    by_loops: tuple[FrictionLaw, ...]
    sliding: SlidingFriction

    @property
    def text(self) -> str:
        """Return the verdict in words."""
        if len(self.remaining) > 1:
            return f"cannot tell: {' or '.join(law.name for law in self.remaining)}"
        return self.remaining[0].name + (", by its drift" if len(self.by_loops) > 1 else "")


def choose(
    blocks: Sequence[LoopBlock],
    readings: SlidingReadings,
    drift: DriftResult | None,
    on_fit: Callable[[], object] = lambda: None,
    backward: SlidingReadings | None = None,
) -> Choice:
    """Choose the law.

    Args:
        blocks: of loops.
        readings: of the sliding joint, in the order of time.
        drift: under small cycles, None if it was not measured.
        on_fit: called after each of FITS fits.
        backward: readings of the joint sliding backward, counted that way, where loops go through zero.

    Raises:
        IdentificationError: if there is too little to compare.
    """
    if len(blocks) < MIN_BLOCKS:
        raise IdentificationError(f"{len(blocks)} blocks of loops; accepted: at least {MIN_BLOCKS}")
    sliding = {stribeck: fit_sliding_friction(readings, stribeck) for stribeck in (False, True)}
    if backward is not None:
        sliding = {key: replace(one, backward=fit_sliding_friction(backward, key)) for key, one in sliding.items()}
    held_out = {stribeck: _sliding_errors(readings, stribeck) for stribeck in (False, True)}
    scores = with_refutations(
        [_score(law, blocks, sliding[law.stribeck], held_out[law.stribeck], on_fit) for law in LAWS]
    )
    by_loops = [score.law for score in scores if not score.refuted]
    for simple in (COULOMB, STRIBECK):  # each contained in all that follow
        if simple in by_loops:
            by_loops = [simple]
    remaining = by_loops
    if drift is not None and drift.verdict is not DriftVerdict.UNKNOWN and by_loops[0].bristles is not None:
        drifts = drift.verdict is DriftVerdict.DRIFTS
        remaining = [law for law in by_loops if (law is LUGRE) is drifts] or by_loops
    return Choice(tuple(scores), tuple(remaining), tuple(by_loops), sliding[True])


def _score(
    law: FrictionLaw,
    blocks: Sequence[LoopBlock],
    friction: SlidingFriction,
    sliding: Array,
    on_fit: Callable[[], object],
) -> LawScore:
    """Fit a law to all blocks but those of each fold, and to all."""
    numbers = list(range(len(blocks)))
    folds = [numbers[fold::FOLDS] for fold in range(FOLDS)]

    def fit(left_out: list[int]) -> list[float]:
        values = law.fit(friction, [block for i, block in enumerate(blocks) if i not in left_out])
        on_fit()
        return values

    def squares(values: list[float], fold: list[int]) -> Array:
        unseen = [blocks[i] for i in fold]
        pairs = zip(law.predict(values, friction, unseen), unseen, strict=True)
        return np.array([np.mean((torque - block.torque) ** 2) for torque, block in pairs])

    loops = np.empty(len(blocks))
    loops[np.concatenate(folds)] = leave_out(folds, fit, squares)[1]
    return LawScore(law, loops, sliding, tuple(fit([])))


def _sliding_errors(readings: SlidingReadings, stribeck: bool) -> Array:
    """Return the mean squared errors of stretches of sliding readings, from a fit to the others, shape (stretches,)."""
    every = np.arange(readings.speed.size)
    return leave_out(
        [np.isin(every, stretch) for stretch in np.array_split(every, _SLIDING_BLOCKS)],
        lambda stretch: fit_sliding_friction(readings.rows(~stretch), stribeck),
        lambda friction, stretch: np.array([np.mean(friction.misfit(readings.rows(stretch)) ** 2)]),
    )[1]


def with_refutations(scores: Sequence[LawScore]) -> list[LawScore]:
    """Return the scores with the reasons for refutation.

    In loops only the laws that sliding does not refute are compared. If the encoder cannot resolve presliding, loops
    are counts of creep: the law that predicts the least torque there is nearest, however wrong it is in sliding.
    """
    laws = [score.law.name for score in scores]
    sliding = HeldOutErrors({score.law.name: score.sliding for score in scores}, floor=1e-12)
    loops = HeldOutErrors({score.law.name: score.loops for score in scores}, floor=1e-12)
    by_sliding = {law: sliding.refutes(law, laws, SIGNIFICANCE, MIN_EXCESS) for law in laws}
    standing = [law for law in laws if by_sliding[law] is None]
    verdicts = []
    for score in scores:
        name = score.law.name
        rivals = {"loops": loops.refutes(name, standing, SIGNIFICANCE, MIN_EXCESS), "sliding": by_sliding[name]}
        reasons = [f"{kind}: {best} predicts better" for kind, best in rivals.items() if best is not None]
        verdicts.append(replace(score, refuted="; ".join(reasons)))
    return verdicts
