"""Set-points of a measured path: consistent, and a controller takes the way there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rx90_emulator.identification.excitation.filtering import Bandwidths, filter_record
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.validation.setpoints import path_setpoints
from rx90_emulator.loop.setup import Setup

NAMES = tuple(f"joint_{k}" for k in range(1, 7))


@pytest.mark.parametrize("rate", [67.0, 5000.0])
def test_set_points_are_those_of_the_motion(shipped: Setup, rate: float) -> None:
    """Position, velocity and acceleration are those of sampled sines to 1e-3, and the way there keeps the limits."""
    time = 1e9 + np.arange(0.0, 4.0, 1.0 / rate)
    middle, size = np.array([0.0, 0.3, 0.9, 0.4, 0.5, 0.0]), 0.3
    phase = 2.0 * np.pi * 0.5
    angles = phase * (time - 1e9)[:, None] + np.arange(6)
    position = middle + size * np.sin(angles)
    record = JointRecord(NAMES, time, position, np.gradient(position, time, axis=0), position, Path("bag"), "digest")
    (run,) = filter_record(record, Bandwidths(15.0, 5.0))
    edge = round(0.4 * rate)  # where the filter has forgotten the ends
    exact = -size * phase**2 * np.sin(phase * (run.time - 1e9)[:, None] + np.arange(6))
    np.testing.assert_allclose(run.acceleration[edge:-edge], exact[edge:-edge], atol=1e-2)
    found = path_setpoints(run, shipped)
    period = shipped.rates.position_period
    at = found.start + np.arange(len(found.values)) * period
    own = at >= found.begin - 0.5 * period
    angles = phase * (at[own] - 1e9)[:, None] + np.arange(6)
    expected = [middle + size * np.sin(angles), size * phase * np.cos(angles), -size * phase**2 * np.sin(angles)]
    inner = slice(100, -100)
    for k, values in enumerate(expected):
        np.testing.assert_allclose(found.values[own, k][inner], values[inner], atol=1e-3 * phase**k)
    assert not found.values[0, 1:].any()
    limits = shipped.controller.limits(shipped.robot)
    limits.check(found.values, np.arange(len(at)) * period, np.zeros(1), np.zeros(6))
