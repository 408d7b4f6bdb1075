"""The drives: torque limits, counts, the velocity of the tracking loop."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from elastic_arms import WRIST
from scipy import signal

from rx90_common.base.errors import ConfigError
from rx90_common.base.rates import Rates
from rx90_emulator.loop.setup import Setup


def test_motor_torque_saturates_at_the_peak_and_is_counted(shipped: Setup) -> None:
    """A command beyond torque constant times peak current, be it infinite, gives the peak with its sign, counted."""
    plant = shipped.plant()
    peak = shipped.drives.torque_constant * shipped.drives.peak_current
    command = peak * [np.inf, -3.0, 0.5, 1.0, -1.0, 1.0001]
    for _ in range(7):
        plant.step(command)
    assert plant.motor_states()[2] == pytest.approx(peak * [1, -1, 0.5, 1, -1, 1], rel=1e-15)
    assert plant.saturated.tolist() == [7, 7, 0, 0, 0, 7]
    plant.reset(np.zeros(6))
    assert plant.saturated.tolist() == [0] * 6


def test_the_joint_gets_gear_times_motor_torque(shipped: Setup) -> None:
    """Torque at a joint is gear ratio times motor torque, under the limit and at it; motor 6 moves joint 5, too."""
    plant = shipped.plant()
    plant.step(np.array([0.1, -0.2, 0.3, 0.4, 0.2, 0.3]))
    wrist = 25.0 * 0.3
    assert plant.joint_states()[2] == pytest.approx([8.5, -17.0, 25.5, 24.0, 45.0 * 0.2 + wrist, wrist])


def test_without_power_there_is_no_torque(shipped: Setup) -> None:
    """A tick without command takes the torque away and closes the brakes; a command opens them again."""
    plant = shipped.plant()
    assert plant.brakes_closed
    plant.step(np.full(6, 0.1))
    assert not plant.brakes_closed
    plant.step(None)
    assert plant.brakes_closed
    assert np.all(plant.motor_states()[2] == 0.0)
    assert np.all(plant.joint_states()[2] == 0.0)
    plant.step(np.zeros(6))
    assert not plant.brakes_closed


def test_the_encoder_gives_whole_counts_next_to_the_truth(shipped: Setup) -> None:
    """Measured motor positions are whole counts, at most half a count from gear times joint position."""
    plant = shipped.plant()
    rng = np.random.default_rng(4)
    count = 2 * math.pi / shipped.drives.encoder_counts
    for _ in range(100):
        plant.reset(rng.uniform(shipped.robot.lower, shipped.robot.upper))
        for _ in range(3):
            plant.step(rng.uniform(-0.2, 0.2, 6))
            position, _, _ = plant.motor_states()
            exact = shipped.drives.gear * (WRIST @ plant.joint_states()[0])
            counts = position / count
            assert np.abs(counts - np.rint(counts)).max() < 1e-6
            assert np.abs(position - exact).max() <= count[0] * 0.5000001


def observer_filter(bandwidth: float, period: float) -> tuple[list[float], list[float]]:
    """Return the transfer function from position to velocity of a critically damped tracking observer.

    Two equal poles p = exp(-2 pi f T), a zero at z = 1 (it differentiates), unit gain for a ramp, and no
    delay: (1 - p)^2 / T * z (z - 1) / (z - p)^2.
    """
    p = math.exp(-2 * math.pi * bandwidth * period)
    gain = (1 - p) ** 2 / period
    return [gain, -gain, 0.0], [1.0, -2 * p, p * p]


def test_the_velocity_is_the_tracking_loop_s_answer_to_the_motor_s_angle(shipped: Setup) -> None:
    """Measured velocity equals the tracking loop's transfer function applied to the angle before it is rounded."""
    coarse = dataclasses.replace(shipped.drives, encoder_counts=np.full(6, 4096))
    plant = dataclasses.replace(shipped, drives=coarse).plant()
    plant.reset(np.array([0.2, 0.5, 1.0, 0.1, 0.4, 0.3]))
    start = plant.joint_states()[0].copy()
    angles, velocities = [], []
    for k in range(1500):
        plant.step(0.3 * shipped.drives.peak_torque * math.sin(k / 150))
        angles.append(shipped.drives.gear * (WRIST @ (plant.joint_states()[0] - start)))
        velocities.append(plant.motor_states()[1].copy())
    b, a = observer_filter(shipped.drives.velocity_bandwidth, shipped.rates.period)
    want = signal.lfilter(b, a, np.array(angles), axis=0)
    got = np.array(velocities)
    assert np.abs(got).max() > 1.0
    assert np.abs(got - want).max() < 1e-8 * np.abs(want).max()


def test_an_observer_beyond_the_tick_rate_is_refused(shipped: Setup) -> None:
    """A velocity bandwidth of half the base rate or more is refused with its value and the range."""
    drives = dataclasses.replace(shipped.drives, velocity_bandwidth=500.0)
    setup = dataclasses.replace(shipped, drives=drives, rates=Rates(1000, 1000))
    with pytest.raises(ConfigError, match=r"velocity_bandwidth is 500\.0 Hz; accepted: below .* 500 Hz"):
        setup.plant()


@pytest.mark.parametrize("substeps", [0, -1])
def test_no_substeps_are_refused(shipped: Setup, substeps: int) -> None:
    """Fewer than one plant step in a tick is refused with the value."""
    with pytest.raises(ConfigError, match=rf"substeps is {substeps}; accepted"):
        shipped.plant(substeps)


def test_reset_refuses_what_is_no_pose(shipped: Setup) -> None:
    """An initial position outside the limits, not finite or of another size is refused by joint and value."""
    plant = shipped.plant()
    for bad in (np.inf, np.nan, 2.5):
        with pytest.raises(ConfigError, match=rf"joint_2 is {bad} rad; accepted: \[-2\.3998, 2\.3998\]"):
            plant.reset([0, bad, 0, 0, 0, 0])
    with pytest.raises(ConfigError, match=r"shape \(5,\); accepted: \(6,\)"):
        plant.reset(np.zeros(5))


def test_an_arm_that_cannot_stand_at_zero_starts_at_its_limit(shipped: Setup) -> None:
    """A robot whose limits leave out the zero pose gets a plant at the nearest pose within them."""
    lower = shipped.robot.lower.copy()
    lower[2] = 0.4
    robot = dataclasses.replace(shipped.robot, lower=lower)
    plant = dataclasses.replace(shipped, robot=robot).plant()
    assert plant.joint_states()[0].tolist() == [0, 0, 0.4, 0, 0, 0]
