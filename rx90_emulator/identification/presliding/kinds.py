"""Which kind of bristles a joint has: cross-validation over its micro-motions, where the data can tell.

Each kind is fitted to all micro-motions but one, and compared with the one that is left, in turn. c0 and the kind's own
numbers are found by least squares; c1 and the error of the inertia, on which the torque depends linearly, are solved
for; each motion has a start deflection of its own. What is left over in the motions that were not fitted, line by line
of the spectrum, says how well a kind predicts.

A kind is told from the best one if the logarithm of its residual power in a line, noise included, is larger by more
than three standard errors in the mean over the lines. If every other kind is told from the best one, that is the
joint's; else the data cannot tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.friction import FrictionElement
from rx90_common.friction.parts.bristles import BristlesPart
from rx90_emulator.identification.presliding.kind_model import FAMILIES, KindFamily, KindMotion
from rx90_emulator.identification.presliding.micro_motion import MicroMotion

LEAST_MOTIONS = 3
"""Micro-motions of a joint, below which nothing is left to be predicted."""

_MOST_MOTIONS = 5
_TOLD = 3.0  # standard errors
_INERTIA = 0.05  # prior standard deviation of its relative error
_STARTS = (-0.8, -0.4, 0.0, 0.4, 0.8)
_EVALUATIONS = 15


@dataclass(frozen=True, eq=False)
class KindTrial:
    """What became of a kind of bristles.

    Attributes:
        family: the kind.
        bristles: fitted to all motions; None is LuGre's.
        c0: Nm/rad.
        c1: Nm s/rad.
        missed: RMS of what it misses in motions that were not fitted, over the RMS of the friction torque.
        behind: by how many standard errors it predicts worse than the best kind; 0 for that.
    """

    family: KindFamily
    bristles: BristlesPart | None
    c0: float
    c1: float
    missed: float
    behind: float

    @property
    def told(self) -> bool:
        """Return whether the data tell it from the best kind."""
        return self.behind > _TOLD


@dataclass(frozen=True, eq=False)
class KindChoice:
    """The kinds of bristles that were tried for a joint."""

    trials: tuple[KindTrial, ...]

    @property
    def possible(self) -> tuple[KindTrial, ...]:
        """Return the trials that the data cannot tell from the best, which is among them."""
        return tuple(trial for trial in self.trials if not trial.told)

    @property
    def kind(self) -> str | None:
        """Return "LuGre", "elasto-plastic" or "Maxwell slip"; None where the data cannot tell."""
        kinds = {trial.family.name.partition(",")[0] for trial in self.possible}
        return kinds.pop() if len(kinds) == 1 else None

    def table(self) -> list[tuple[str, ...]]:
        """Return a row for each kind: name, c0, c1, what it misses, how far it is behind."""
        return [
            (t.family.name, f"{t.c0:.4g}", f"{t.c1:.3g}", f"{100.0 * t.missed:.2f} %", f"{t.behind:.1f}")
            for t in self.trials
        ]


@dataclass(frozen=True, eq=False)
class _Fit:
    """A kind fitted to some motions."""

    family: KindFamily
    c0: float
    shape: Array
    linear: Array  # c1 and the relative error of the inertia

    def bristles(self, motion: KindMotion) -> BristlesPart | None:
        return self.family.bristles(self.shape, motion.element.tau_c_positive)


def choose_kind(
    motions: Sequence[MicroMotion], element: FrictionElement, c0: float, families: Sequence[KindFamily] = FAMILIES
) -> KindChoice:
    """Return which kind of bristles a joint's element has.

    Args:
        motions: micro-motions of a joint with one element of its own, the largest first; LEAST_MOTIONS or more.
        element: its sliding regime; its c0 and c1 are not used.
        c0: a first guess, Nm/rad, such as that of the fit with LuGre's bristles.
        families: what is tried.

    Raises:
        IdentificationError: for fewer motions, or those of joints that share elements.
    """
    if len(motions) < LEAST_MOTIONS:
        raise IdentificationError(f"{len(motions)} micro-motions of a joint; accepted: {LEAST_MOTIONS} or more")
    if any(len(motion.joints) > 1 for motion in motions):
        raise IdentificationError("micro-motions of joints that share elements; accepted: those of a single joint")
    used = [KindMotion.of(motion, element) for motion in motions[:_MOST_MOTIONS]]
    whole = [_fitted(family, used, c0) for family in families]
    powers = [_left_out(fit, used) for fit in whole]
    noise = float(np.median(np.min(powers, axis=0)))
    scores = [np.log(power + noise) for power in powers]
    best = int(np.argmin([score.sum() for score in scores]))
    friction = float(np.sum(np.concatenate([motion.target for motion in used]) ** 2))
    trials = []
    for fit, power, score in zip(whole, powers, scores, strict=True):
        difference = score - scores[best]
        spread = float(np.std(difference)) * np.sqrt(difference.size)
        behind = float(difference.sum() / spread) if spread > 0.0 else 0.0
        missed = float(np.sqrt(power.sum() / friction))
        trials.append(KindTrial(fit.family, fit.bristles(used[0]), fit.c0, float(fit.linear[0]), missed, behind))
    return KindChoice(tuple(trials))


def _left_out(whole: _Fit, motions: Sequence[KindMotion]) -> Array:
    """Return the residual power of each spectral line of each motion, fitted to the others."""
    found = []
    for index, motion in enumerate(motions):
        others = [other for i, other in enumerate(motions) if i != index]
        fit = _fitted(whole.family, others, whole.c0, whole.shape)
        power = min((_residual(fit, motion, start) ** 2 for start in _fine_starts(fit, motion)), key=np.sum)
        lines = np.unique(motion.line, return_inverse=True)[1]
        found.append(np.bincount(lines, power))
    return np.concatenate(found)


def _fine_starts(fit: _Fit, motion: KindMotion) -> list[float]:
    """Return start deflections about the best of the coarse ones."""
    coarse = min(_STARTS, key=lambda start: float(np.sum(_residual(fit, motion, start) ** 2)))
    return [coarse + shift for shift in (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3)]


def _residual(fit: _Fit, motion: KindMotion, start: float) -> Array:
    torque, rate = motion.bristles(fit.bristles(motion), fit.c0, start)
    return np.asarray(motion.target - torque - rate * fit.linear[0] - motion.inertial * fit.linear[1])


def _fitted(family: KindFamily, motions: Sequence[KindMotion], c0: float, shape: Array | None = None) -> _Fit:
    """Fit a kind to motions, from a shape or from each of the family's guesses; the best fit counts."""

    def missed(x: Array) -> Array:
        return _projected(family, motions, x)[0]

    results = []
    for guess in family.guesses() if shape is None else [shape]:
        first = [_first_start(family, motion, c0, guess) for motion in motions]
        x = np.concatenate([[np.log(c0)], guess, first])
        result = least_squares(missed, x, x_scale=0.1, max_nfev=_EVALUATIONS, xtol=1e-5, ftol=1e-7)
        results.append(result)
    best = min(results, key=lambda result: float(result.cost)).x
    count = len(best) - len(motions)
    return _Fit(family, float(np.exp(best[0])), best[1:count], _projected(family, motions, best)[1])


def _first_start(family: KindFamily, motion: KindMotion, c0: float, shape: Array) -> float:
    def power(start: float) -> float:
        x = np.concatenate([[np.log(c0)], shape, [start]])
        return float(np.sum(_projected(family, [motion], x)[0] ** 2))

    return min(_STARTS, key=power)


def _projected(family: KindFamily, motions: Sequence[KindMotion], x: Array) -> tuple[Array, Array]:
    """Return the residuals where c1 and the inertia's error are the best ones, and these two."""
    count = len(x) - len(motions)
    c0, shape, starts = float(np.exp(x[0])), x[1:count], np.clip(x[count:], -1.2, 1.2)
    target, columns = [], []
    for motion, start in zip(motions, starts, strict=True):
        torque, rate = motion.bristles(family.bristles(shape, motion.element.tau_c_positive), c0, float(start))
        target.append(motion.target - torque)
        columns.append(np.column_stack([rate, motion.inertial]))
    scale = float(np.median(np.abs(np.concatenate([motion.target for motion in motions])))) + 1e-12
    matrix = np.vstack([*columns, [0.0, scale / _INERTIA]])
    right = np.append(np.concatenate(target), 0.0)
    linear = np.linalg.lstsq(matrix, right, rcond=None)[0]
    return right - matrix @ linear, linear
