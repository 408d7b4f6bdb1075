"""Five laws of friction that may explain loops: how each predicts the torque from the motion, with what it has free.

The motion is the input and the torque the prediction, as the laws themselves have it, so that no simulation runs away
from a small error. Between two readings the velocity is taken as constant, and the steps are those of the emulated
plant (rx90_common/friction), which are exact for that. A law without bristles lets nothing move below the static
torque: where a step of torque moves the joint by a count, it predicts the sliding torque.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from friction_bench.presliding.laws import DWELL
from friction_bench.presliding.sliding import SlidingFriction
from friction_bench.presliding.trace import Trace
from friction_bench.rig.plant import RigJoint, friction_over, joint_record, start
from rx90_common.base.arrays import Array
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.bristles import MOST_BREAK_AWAY, BristlesPart, ElastoPlastic, MaxwellSlip
from rx90_common.kernels.compiled import kernel


@dataclass(frozen=True, eq=False)
class LoopBlock:
    """One block of loops, beginning at rest without torque after a slide, so that nothing before it matters.

    The joint swings to rest there, which leaves no bristle bent; blocks of Maxwell slip come near to that.

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


def loop_block(trace: Trace) -> LoopBlock:
    """Return the block of a trace of loops."""
    code = trace.code
    ends = np.flatnonzero(np.diff(code) != 0.0)
    held = np.diff(ends, prepend=-1)
    slid = int(np.flatnonzero((code[:-1] > 0.0) & (code[1:] == 0.0))[0]) + 1
    first = slid + int(np.argmax(code[slid:] > 0.0)) - 1  # the last reading at rest
    readings = ends[(ends > first) & (held >= DWELL)]
    angle = settled(trace.counts)[first:] * trace.angle_step
    return LoopBlock(angle, readings - first, trace.torque[readings], trace.tick)


def settled(counts: Array) -> Array:
    """Return counts without the flicker of one: the middle of what they leave open, moved as little as they ask."""
    middle = np.empty_like(counts)
    at = counts[0]
    for k, count in enumerate(counts):
        at = min(max(at, count - 0.5), count + 0.5)
        middle[k] = at
    return middle


@kernel
def torque_along(joint: RigJoint, angle: NDArray[np.float64], tick: float) -> NDArray[np.float64]:
    """Return the mean friction torque over the tick before each reading, Nm, and 0 for the first, shape (n,)."""
    torque, z = np.zeros(angle.size), 0.0
    for k in range(1, angle.size):
        velocity = (angle[k] - angle[k - 1]) / tick
        z, torque[k] = friction_over(joint, z, angle[k], velocity, tick)
    return torque


@dataclass(frozen=True)
class FrictionLaw:
    """A law with what it has free in presliding.

    Attributes:
        name: of the law.
        parameters: so many in all, with those of sliding.
        stribeck: it has a static torque above the Coulomb one.
        start: values to begin a fit with, transformed, by the stiffness that the loops show, Nm/rad.
        bristles: stiffness and bristles from transformed values; None for a law without presliding.
    """

    name: str
    parameters: int
    stribeck: bool
    start: Callable[[float], list[list[float]]]
    bristles: Callable[[Sequence[float]], tuple[float, BristlesPart | None]] | None

    def predict(self, values: Sequence[float], sliding: SlidingFriction, block: LoopBlock) -> Array:
        """Return the torque at each of the block's readings, Nm, shape (k,)."""
        return next(self.predictions(values, sliding, [block]))

    def predictions(
        self, values: Sequence[float], sliding: SlidingFriction, blocks: Sequence[LoopBlock]
    ) -> Iterator[Array]:
        """Yield the torque at each of the readings of one block after the other, which have the same tick, Nm."""
        if self.bristles is None:
            yield from (_rigid(sliding.tau_s if self.stribeck else sliding.tau_c, block) for block in blocks)
        elif blocks:
            joint = joint_record(self.element(values, sliding), 1.0, blocks[0].tick, 0)
            for block in blocks:
                start(joint)
                yield np.asarray(torque_along(joint, block.angle, block.tick)[block.readings])

    def element(self, values: Sequence[float], sliding: SlidingFriction) -> FrictionElement:
        """Return the friction element of a law with bristles."""
        assert self.bristles is not None
        stiffness, bristles = self.bristles(values)
        coulomb, static = max(sliding.tau_c, 1e-6), max(sliding.tau_s, sliding.tau_c, 1e-6)
        lugre = FrictionElement(
            coulomb, coulomb, static, static, sliding.omega_s, 1.0, stiffness, 0.0, sliding.c2, math.inf, 1.0
        )
        return replace(lugre, bristles=bristles)


def _rigid(static: float, block: LoopBlock) -> Array:
    """Return what a joint without presliding does: it balances the torque at rest, and slides where it moves."""
    before = np.concatenate(([block.readings[0] - DWELL], block.readings[:-1]))
    moved = block.angle[block.readings] - block.angle[np.maximum(before, 0)]
    still = np.clip(block.torque, -static, static)
    return np.where(moved == 0.0, still, static * np.sign(moved))


REACHES = np.geomspace(0.15, 4.0, 6)
"""Of the blocks of Maxwell slip, in proportion: where their springs give way."""
ATTRACTION = 1e4
"""Nm/s: at once, for a velocity that is held for a tick; the readings, at rest, do not show how fast it is."""


def _maxwell(values: Sequence[float]) -> tuple[float, MaxwellSlip]:
    weight = np.exp(np.append(np.asarray(values[1:]), 0.0))
    stiffness = weight / weight.sum()
    share = stiffness * REACHES / float(stiffness @ REACHES)
    stiffness, share = (np.clip(part, 1e-6, 1.0) for part in (stiffness, share))
    stiffness, share = stiffness / stiffness.sum(), share / share.sum()
    return math.exp(values[0]), MaxwellSlip(tuple(stiffness.tolist()), tuple(share.tolist()), ATTRACTION)


def _maxwell_starts(c0: float) -> list[list[float]]:
    """Return even springs, and stiff ones that give way early; none is 0, which would take a fit's steps away."""
    return [[math.log(1.3 * c0), 0.5, 0.4, 0.3, 0.2, 0.1], [math.log(2.0 * c0), 2.0, 1.5, 1.0, 0.6, 0.2]]


def _elastic(values: Sequence[float]) -> tuple[float, ElastoPlastic]:
    return math.exp(values[0]), ElastoPlastic(MOST_BREAK_AWAY / (1.0 + math.exp(-values[1])))


COULOMB = FrictionLaw("Coulomb and viscous", 2, False, lambda _: [[]], None)
STRIBECK = FrictionLaw("Stribeck", 4, True, lambda _: [[]], None)
LUGRE = FrictionLaw("LuGre", 5, True, lambda c0: [[math.log(c0)]], lambda v: (math.exp(v[0]), None))
ELASTO_PLASTIC = FrictionLaw(
    "elasto-plastic", 6, True, lambda c0: [[math.log(c0), -0.5], [math.log(c0), 1.2]], _elastic
)
MAXWELL_SLIP = FrictionLaw("Maxwell slip", 4 + REACHES.size, True, _maxwell_starts, _maxwell)
LAWS = (COULOMB, STRIBECK, LUGRE, ELASTO_PLASTIC, MAXWELL_SLIP)
"""From the simplest to the one with most parameters."""
