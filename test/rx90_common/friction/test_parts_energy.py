"""No part creates energy: over random cycles friction gives back at most what its bristles had stored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from parted_joint import SPEED, Array, Seven, along, any_element

from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.part import FrictionPart
from rx90_common.friction.parts.ripple import RipplePart
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_common.friction.parts.temperature import TemperaturePart

LOAD = LoadPart(0.2, 0.4, 0.2, 0.1, 0.005, 0.002)
RIPPLE = RipplePart((1.0, 3.0), (0.3, 0.2), (0.5, 1.0), (2.0,), (0.45,))
SCATTER = ScatterPart(0.2, 0.05)
WARM = TemperaturePart(40.0, 20.0, 90.0, 70.0, 20.0, 1e-3, 50.0, 20.0, 0.3, 0.02, -0.015)
CYCLES, STEPS, ROUNDS = 50, 40, 30
"""Times seven elements: 10,500 cycles."""


def cycles(rng: np.random.Generator) -> tuple[Array, float]:
    """Return closed motions from presliding to full speed under loads that jump, (n, 3, 7), and their step, s."""
    amplitude = 10.0 ** rng.uniform(-5, -1, (CYCLES, 1, 7))
    phase = 2.0 * np.pi * (np.arange(STEPS + 1) / STEPS)[None, :, None]
    way = amplitude * (np.sin(phase) + rng.uniform(-1, 1, (CYCLES, 1, 7)) * (np.cos(rng.integers(2, 5) * phase) - 1.0))
    angle = rng.uniform(-3.0, 3.0, (CYCLES, 1, 7)) + 0.5 * (way[:, 1:] + way[:, :-1])
    loads = 50.0 * rng.standard_normal((CYCLES, STEPS, 7))
    step = np.abs(np.diff(way, axis=1)).max() / SPEED * 10.0 ** rng.uniform(0, 2)
    motion = (angle, np.diff(way, axis=1) / step, loads)
    return np.stack([part.reshape(-1, 7) for part in motion], axis=1), float(step)


def gained(seven: Seven, rng: np.random.Generator) -> Array:
    """Return, for each step of many cycles, what the bristles gain beyond what they were given, J over Nm of tau_c."""
    motion, step = cycles(rng)
    before = 0.5 * seven.elements["c0"][0] * seven.z**2
    torque, stored = along(seven, motion, step)
    given = torque * motion[:, 1] * step
    return np.asarray((np.diff(stored, axis=0, prepend=before[None]) - given) / seven.elements["tau_c"][0, 0])


@pytest.mark.parametrize(
    "parts",
    [(LOAD,), (RIPPLE,), (SCATTER,), (WARM,), (LOAD, RIPPLE, SCATTER, WARM)],
    ids=["load", "ripple", "scatter", "temperature", "together"],
)
def test_no_part_creates_energy(parts: tuple[FrictionPart, ...]) -> None:
    """In every step of 10,500 random cycles the storage c0 z^2 / 2 grows by the work that goes in, or by less."""
    rng = np.random.default_rng(8)
    for _ in range(ROUNDS):
        element = any_element(rng, **{part.name: part for part in parts})
        elements = [replace(element, c1=0.0), *[element] * 6]
        assert gained(Seven.of(elements, seed=3), rng).max() < 1e-12


def test_a_ripple_that_pushes_would_be_seen() -> None:
    """Amplitudes beyond 1, which a file may not have, turn the friction's sign for a while, and energy comes of it."""
    rng = np.random.default_rng(8)
    seven = Seven.of([any_element(rng, ripple=RIPPLE)] * 7)
    seven.parts["ripple"]["cosine"] *= 1.5
    seven.parts["ripple"]["sine"] *= 1.5
    with np.errstate(invalid="ignore"):  # what grows without bound may end beyond all numbers
        assert not gained(seven, rng).max() < 1e-6
