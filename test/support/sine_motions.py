"""Motions of six joints for tests: five sines in each, to 1.5 rad."""

from __future__ import annotations

import numpy as np

from rx90_emulator.identification.excitation.problem import Motion

_HARMONICS = np.arange(1, 6)
_BASE = 2.0 * np.pi * 1.6 / 15.0  # rad/s


def motion_of(seed: int, duration: float, rate: float, start: float = 0.0) -> Motion:
    """Return position, velocity and acceleration at so many samples per second from a time, s, on; shape (m, 6)."""
    rng = np.random.default_rng((seed, 5))
    phase, size = rng.uniform(0.0, 2.0 * np.pi, (6, 5)), rng.uniform(0.5, 1.0, (6, 5)) / np.sqrt(_HARMONICS)
    size *= 1.5 / size.sum(axis=1, keepdims=True)
    turn = _BASE * _HARMONICS
    angle = (np.arange(0.0, duration, 1.0 / rate) + start)[:, None, None] * turn + phase
    return (
        (size * np.sin(angle)).sum(axis=2),
        (size * turn * np.cos(angle)).sum(axis=2),
        (-size * turn**2 * np.sin(angle)).sum(axis=2),
    )
