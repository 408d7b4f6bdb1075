"""The ripple: Coulomb and static torque along a motion of constant velocity, in closed form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from parted_joint import GEAR, Seven, along, any_element

from rx90_common.friction.parts.ripple import ANGLES, RipplePart
from rx90_common.friction.parts.scatter import ScatterPart


def any_ripple(rng: np.random.Generator) -> RipplePart:
    """Return one to four waves of each angle, whose amplitudes sum to less than 1."""
    values: dict[str, Sequence[float]] = {}
    for angle in ANGLES:
        terms = int(rng.integers(1, 5))
        values[f"{angle}_harmonic"] = tuple(rng.choice([1.0, 2.0, 3.0, 31.5], terms).tolist())
        values[f"{angle}_amplitude"] = tuple((0.45 * rng.dirichlet(np.ones(terms))).tolist())
        values[f"{angle}_phase"] = tuple(rng.uniform(-np.pi, np.pi, terms).tolist()) if rng.random() < 0.7 else ()
    return RipplePart(**values)  # type: ignore[arg-type]


def test_sliding_torque_along_the_angles() -> None:
    """At constant velocity the torque is (1 + series) times Coulomb and Stribeck, plus viscous (50 sets of values).

    Beside a random walk, which is held here, it is (1 + series) (1 + walk) times as large.
    """
    rng = np.random.default_rng(5)
    for _ in range(8):
        elements = [any_element(rng, ripple=any_ripple(rng), scatter=ScatterPart(0.1, 1.0)) for _ in range(7)]
        seven = Seven.of(elements)
        seven.parts["scatter"]["decay"], seven.parts["scatter"]["kick"] = 1.0, 0.0
        walk = seven.states["scatter_factor"][0]
        assert np.abs(walk - 1.0).max() > 0.05
        velocity = rng.choice([-1.0, 1.0], 7) * rng.uniform(0.01, 1.0, 7)
        # A long way inside each angle: the bristle has settled there before the angle is the next one.
        angle = np.repeat(rng.uniform(-3.0, 3.0, (6, 7)), 3, axis=0)
        motion = np.stack([angle, np.broadcast_to(velocity, angle.shape), 0.0 * angle], axis=1)
        torque, _ = along(seven, motion, 1e3)
        for i, element in enumerate(elements):
            part = element.ripple
            assert part is not None
            series = np.zeros(len(angle))
            for name, turns in (("joint", 1.0), ("motor", GEAR[i])):
                harmonic, amplitude = getattr(part, f"{name}_harmonic"), getattr(part, f"{name}_amplitude")
                phase = getattr(part, f"{name}_phase") or np.zeros(len(harmonic))
                for h, a, p in zip(harmonic, amplitude, phase, strict=True):
                    series += a * np.cos(h * turns * angle[:, i] + p)
            sign = np.sign(velocity[i])
            dry = sign * (1 + series) * walk[i] * element.sliding_torque(velocity[i])
            want = dry + element.viscous_torque(velocity[i])
            assert torque[2::3, i] == pytest.approx(want[2::3], rel=1e-9)
