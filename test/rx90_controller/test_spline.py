"""Splines against SciPy's, by what the points carry."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BPoly, CubicHermiteSpline, PPoly

from rx90_controller.trajectory.spline import Bounds, interpolate

Array = NDArray[np.float64]
TIMES = np.array([0.0, 0.13, 0.5, 0.51, 1.7, 2.0])
RNG = np.random.default_rng(11)
POSITION = RNG.uniform(-1.0, 1.0, (6, 6))
VELOCITY = RNG.uniform(-2.0, 2.0, (6, 6))
ACCELERATION = RNG.uniform(-9.0, 9.0, (6, 6))
INSIDE = np.sort(RNG.uniform(0.0, 2.0, 500))


def test_velocities_make_it_cubic() -> None:
    """With velocities the set-points are SciPy's cubic Hermite spline and its two derivatives."""
    got = interpolate(TIMES, POSITION, VELOCITY, None).sample(INSIDE)
    spline = CubicHermiteSpline(TIMES, POSITION, VELOCITY)
    for order in range(3):
        want = spline(INSIDE, order)
        assert got[:, order] == pytest.approx(want, abs=1e-11 * np.abs(want).max())


def test_accelerations_make_it_quintic() -> None:
    """With accelerations the set-points are SciPy's quintic through positions and both derivatives."""
    got = interpolate(TIMES, POSITION, VELOCITY, ACCELERATION).sample(INSIDE)
    given = np.stack([POSITION, VELOCITY, ACCELERATION], axis=1)
    spline = BPoly.from_derivatives(TIMES, given)
    for order in range(3):
        want = spline(INSIDE, order)
        assert got[:, order] == pytest.approx(want, abs=1e-10 * np.abs(want).max())


def test_bounds_are_the_control_points() -> None:
    """Positions, velocities and accelerations lie between the least and the most of SciPy's Bernstein coefficients."""
    coefficients = interpolate(TIMES, POSITION, VELOCITY, ACCELERATION).coefficients
    bounds = Bounds.of(coefficients, np.diff(TIMES))
    curve = PPoly(np.moveaxis(coefficients[:, ::-1], 1, 0), TIMES)
    for row in range(3):
        control = BPoly.from_power_basis(curve.derivative(row) if row else curve).c
        scale = np.abs(control).max()
        assert bounds.low[row] == pytest.approx(control.min(axis=(0, 1)), abs=1e-11 * scale)
        assert bounds.high[row] == pytest.approx(control.max(axis=(0, 1)), abs=1e-11 * scale)
    coefficients[2, 3, 4] = np.nan
    low, high = Bounds.of(coefficients, np.diff(TIMES))
    assert np.all(low[:, 4] == -np.inf)
    assert np.all(high[:, 4] == np.inf)
    assert np.isfinite(low[:, :4]).all()
