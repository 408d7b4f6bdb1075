"""The trapezoidal velocity profile."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rx90_common.base.errors import LineError
from rx90_controller.lines.task import TrapezoidalProfile

LENGTHS = st.floats(1e-4, 3.0)
SPEEDS = st.floats(1e-3, 2.0)
ACCELERATIONS = st.floats(1e-2, 20.0)


def test_the_reference_line_by_hand() -> None:
    """0.4 m at 0.1 m/s and 1 m/s^2: 5 mm in each ramp of 0.1 s, 4.1 s in all."""
    profile = TrapezoidalProfile(0.4, 0.1, 1.0)
    assert profile.corners == pytest.approx((0.0, 0.1, 4.0, 4.1), abs=1e-14)
    motion = profile.sample(np.array([-1.0, 0.05, 0.1, 2.05, 4.05, 4.1, 9.0]))
    np.testing.assert_allclose(motion.distance, [0, 0.00125, 0.005, 0.2, 0.39875, 0.4, 0.4], atol=1e-15)
    np.testing.assert_allclose(motion.speed, [0, 0.05, 0.1, 0.1, 0.05, 0, 0], atol=1e-14)
    np.testing.assert_array_equal(motion.acceleration[[0, 1, 3, 4, 6]], [0, 1, 0, -1, 0])


def test_a_short_line_is_a_triangle_by_hand() -> None:
    """4 mm at 1 m/s^2 peak at sqrt(0.004) m/s in the middle and never reach 0.1 m/s."""
    profile = TrapezoidalProfile(0.004, 0.1, 1.0)
    assert profile.peak_speed == pytest.approx(np.sqrt(0.004))
    assert profile.corners == pytest.approx((0.0, np.sqrt(0.004), 2 * np.sqrt(0.004)))
    assert profile.sample(np.array([np.sqrt(0.004)])).distance[0] == pytest.approx(0.002)


@given(LENGTHS, SPEEDS, ACCELERATIONS)
def test_distance_is_the_integral_of_speed_and_speed_that_of_acceleration(
    length: float, speed: float, acceleration: float
) -> None:
    """Summed over the pieces between corners, acceleration gives speed and speed gives the whole length."""
    profile = TrapezoidalProfile(length, speed, acceleration)
    corners = np.array(profile.corners)
    middle = profile.sample((corners[:-1] + corners[1:]) / 2.0)
    at = profile.sample(corners)
    span = np.diff(corners)
    rounding = 1e-14 * acceleration * profile.duration
    np.testing.assert_allclose(np.diff(at.speed), middle.acceleration * span, atol=rounding)
    # Speed is linear within a piece: the midpoint rule is exact.
    np.testing.assert_allclose(np.diff(at.distance), middle.speed * span, atol=1e-9 * length)
    assert at.speed[0] == at.speed[-1] == 0.0
    assert at.distance[-1] == length
    assert profile.peak_speed <= speed


@given(LENGTHS, SPEEDS, ACCELERATIONS, st.floats(0.0, 1.0))
def test_speed_by_distance_is_speed_by_time(length: float, speed: float, acceleration: float, share: float) -> None:
    """The speed asked for by distance is the one the profile has when it is there."""
    profile = TrapezoidalProfile(length, speed, acceleration)
    motion = profile.sample(np.array([share * profile.duration]))
    # Near rest the distance carries its square root's rounding into the speed.
    tolerance = 1e-6 * profile.peak_speed
    assert profile.speed_at(motion.distance)[0] == pytest.approx(motion.speed[0], abs=tolerance)


@pytest.mark.parametrize("bad", [0.0, -0.1, float("nan"), float("inf")])
@pytest.mark.parametrize("which", ["length", "speed", "acceleration"])
def test_values_that_make_no_motion_are_refused(which: str, bad: float) -> None:
    """Zero, negative and non-finite length, speed or acceleration are refused by name and value."""
    values = {"length": 0.4, "speed": 0.1, "acceleration": 1.0, which: bad}
    with pytest.raises(LineError, match=rf"the line's {which} is {bad:g} .*accepted: a number > 0"):
        TrapezoidalProfile(**values)
