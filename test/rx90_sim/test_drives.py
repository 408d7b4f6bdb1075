"""Drives: torque limits, gears and encoders, cogging, windings, and sensors of the current."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from elastic_arms import POSE, SOFT, WRIST, elastic, floating, random_cycles
from scipy import signal
from scipy.integrate import solve_ivp

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.base.rates import Rates
from rx90_common.description.drives import COPPER, IDEAL_SENSOR, Cogging, CurrentSensor, Windings
from rx90_common.kernels.compiled import kernel
from rx90_emulator.loop.parameters import with_parameters
from rx90_emulator.loop.setup import Setup
from rx90_sim.drives import add_cogging, current_shares, fill_windings, warm_motors, warm_windings, winding_dtype
from rx90_sim.plant import Plant


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
            assert np.abs(position - exact).max() <= count * 0.5000001


def test_the_velocity_is_the_tracking_loop_s_answer_to_the_motor_s_angle(shipped: Setup) -> None:
    """It is (1 - p)^2 / T * z (z - 1) / (z - p)^2 applied to the angle before that is rounded."""
    coarse = shipped.drives.replaced(encoder={"counts_per_revolution": 4096})
    plant = dataclasses.replace(shipped, drives=coarse).plant()
    plant.reset(np.array([0.2, 0.5, 1.0, 0.1, 0.4, 0.3]))
    start = plant.joint_states()[0].copy()
    angles, velocities = [], []
    for k in range(1500):
        plant.step(0.3 * shipped.drives.peak_torque * math.sin(k / 150))
        angles.append(shipped.drives.gear * (WRIST @ (plant.joint_states()[0] - start)))
        velocities.append(plant.motor_states()[1].copy())
    p = math.exp(-2 * math.pi * shipped.drives.velocity_bandwidth * shipped.rates.period)
    gain = (1 - p) ** 2 / shipped.rates.period
    want = signal.lfilter([gain, -gain, 0.0], [1.0, -2 * p, p * p], np.array(angles), axis=0)
    got = np.array(velocities)
    assert np.abs(got).max() > 1.0
    assert np.abs(got - want).max() < 1e-8 * np.abs(want).max()


def test_what_makes_no_plant_or_pose_is_refused(shipped: Setup) -> None:
    """An observer of half the base rate, no steps in a tick, and poses beyond limits or not finite."""
    drives = shipped.drives.replaced(encoder={"velocity_bandwidth": 500.0})
    setup = dataclasses.replace(shipped, drives=drives, rates=Rates(1000, 1000))
    with pytest.raises(ConfigError, match=r"velocity_bandwidth is 500\.0 Hz; accepted: below .* 500 Hz"):
        setup.plant()
    for substeps in (0, -1):
        with pytest.raises(ConfigError, match=rf"substeps is {substeps}; accepted"):
            shipped.plant(substeps)
    plant = shipped.plant()
    for bad in (np.inf, np.nan, 2.5):
        with pytest.raises(ConfigError, match=rf"joint_2 is {bad} rad; accepted: \[-2\.3998, 2\.3998\]"):
            plant.reset([0, bad, 0, 0, 0, 0])


def test_an_arm_that_cannot_stand_at_zero_starts_at_its_limit(shipped: Setup) -> None:
    """A robot whose limits leave out the zero pose gets a plant at the nearest pose within them."""
    lower = shipped.robot.lower.copy()
    lower[2] = 0.4
    robot = dataclasses.replace(shipped.robot, lower=lower)
    plant = dataclasses.replace(shipped, robot=robot).plant()
    assert plant.joint_states()[0].tolist() == [0, 0, 0.4, 0, 0, 0]


TERMS = Cogging(
    harmonic=[2.0, 6.0, 36.0],
    amplitude=[[0.05] * 6, [0.1] * 6, [0.02] * 6],
    phase=np.random.default_rng(1).uniform(-3.0, 3.0, (3, 6)).tolist(),
)


def cogged(setup: Setup, cogging: Cogging = TERMS) -> Setup:
    return dataclasses.replace(setup, drives=setup.drives.replaced(cogging=cogging))


@kernel
def cog(plants: Any, states: Any, angle: Array, velocity: Array, torque: Array, step: float) -> None:
    add_cogging(plants[0], states[0], angle, velocity, torque, step)


def test_the_mean_over_a_step_is_exact_at_every_speed(shipped: Setup) -> None:
    """Slow and fast, the mean of a wave is its middle times sin(x) / x with half the way in its angle as x."""
    plant, rng, step = cogged(shipped).plant(), np.random.default_rng(9), shipped.rates.period
    for speed in 10.0 ** np.arange(-6.0, 2.0, 0.25):
        angle, velocity, torque = rng.uniform(-1.0, 1.0, 6), speed * rng.uniform(0.3, 1.0, 6), np.zeros(6)
        cog(plant.constants, plant.state, angle, velocity, torque, step)
        middle, half = (shipped.drives.gear * (WRIST @ one) for one in (angle, 0.5 * step * velocity))
        harmonic = np.array(TERMS.harmonic)[:, None]
        means = TERMS.amplitude * np.cos(harmonic * middle + TERMS.phase) * np.sinc(harmonic * half / np.pi)
        assert torque == pytest.approx(WRIST.T @ (shipped.drives.gear * means.sum(axis=0)), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("gears", ["rigid", "elastic"])
def test_cogging_creates_no_energy(shipped: Setup, gears: str) -> None:
    """Over 10^4 random cycles the motors' work is what arm and cogging gain, to 3e-6 of what was moved to and fro."""
    setup = cogged(floating(shipped))
    if gears == "elastic":
        setup = elastic(setup, SOFT)
    cogging, harmonic = setup.drives.cogging, np.array(setup.drives.cogging.harmonic)[:, None]

    def wells(motors: Array) -> float:
        return float(-np.sum(cogging.amplitude / harmonic * np.sin(harmonic * motors + cogging.phase)))

    created, moved = random_cycles(setup, 12, 4, wells)
    assert moved > 500.0  # J
    assert abs(created) < 3e-6 * moved


def test_brakes_hold_against_cogging(shipped: Setup) -> None:
    """After a reset nothing moves: the brakes hold weight and cogging, behind rigid and elastic gears."""
    for setup in (cogged(shipped), cogged(elastic(shipped, SOFT))):
        plant = setup.plant()
        plant.reset(POSE)
        links = plant.joint_states()[0].copy()
        for _ in range(100):
            plant.step(None)
        assert np.abs(plant.joint_states()[0] - links).max() < 1e-11


def windings(**changes: object) -> Windings:
    six = np.ones(6)
    values = {
        "resistance": 2.0 * six, "thermal_resistance": 1.5 * six, "heat_capacity": 40.0 * six, "ambient": 25.0,
        "initial": 25.0, "derating": 120.0, "limit": 140.0,
    }  # fmt: skip
    return Windings(**{**values, **changes})  # type: ignore[arg-type]


def test_resistance_that_rises_against_a_solver(shipped: Setup) -> None:
    """Of copper or with constant resistance, 50 seeded windings follow SciPy's answer, also where they run away."""
    rng = np.random.default_rng(6)
    for _ in range(50):
        resistance, capacity = rng.uniform(0.5, 5.0, 6), rng.uniform(20.0, 200.0, 6)
        outwards, current = rng.uniform(0.5, 3.0, 6), rng.uniform(0.0, 8.0, 6)
        slope = float(rng.choice([0.0, COPPER]))
        parts = windings(
            resistance=resistance, heat_capacity=capacity, thermal_resistance=outwards, derating=1e6, limit=2e6,
            coefficient=slope,
        )  # fmt: skip

        def rates(_: float, t: Array, r: Array = resistance, c: Array = capacity, o: Array = outwards,
                  i: Array = current, a: float = slope) -> Array:  # fmt: skip
            return np.asarray((r * i**2 * (1.0 + a * (t - 20.0)) - (t - 25.0) / o) / c)

        want = solve_ivp(rates, (0.0, 60.0), np.full(6, 25.0), "LSODA", rtol=1e-11, atol=1e-10).y[:, -1]
        record, found = np.zeros(1, winding_dtype(6)), np.full(6, parts.initial)
        fill_windings(record[0], parts, shipped.drives.torque_constant)
        for _ in range(600):
            warm_windings(record[0], current * shipped.drives.torque_constant, found, 0.1)
        assert found == pytest.approx(want, rel=1e-8)


def test_the_amplifier_folds_back(shipped: Setup) -> None:
    """Above the first temperature the peak torque falls linearly, at the limit it is 0; a reset cools the windings."""
    drives = shipped.drives.replaced(
        winding=windings(heat_capacity=np.full(6, 0.02), thermal_resistance=np.full(6, 9.0))
    )
    plant = dataclasses.replace(shipped, drives=drives).plant()
    peak = drives.peak_torque
    hot = np.array([100.0, 120.0, 125.05, 130.0, 138.0, 150.0])
    plant.state["temperature"][0] = hot
    words = warm_motors(plant.constants, hot).split(", ")
    assert words[0] == "motor_3 at 125.0 °C has 74 % of its peak current"  # 74.75: no more than there is
    assert len(words) == 4
    plant.step(2.0 * peak)
    share = np.clip((140.0 - hot) / 20.0, 0.0, 1.0)
    assert plant.motor_states()[2] == pytest.approx(peak * share, abs=1e-12)
    assert plant.saturated.tolist() == [1] * 6
    assert current_shares(plant.constants, plant.winding_temperatures()) == pytest.approx(
        np.clip((140.0 - plant.winding_temperatures()) / 20.0, 0.0, 1.0), abs=1e-12
    )
    plant.reset(np.zeros(6))
    assert plant.winding_temperatures() == pytest.approx(25.0)
    for _ in range(2000):
        plant.step(np.sign(np.arange(6) % 2 - 0.5) * peak * (np.arange(6) > 3))
    assert np.all(plant.winding_temperatures() < 140.0)
    assert plant.winding_temperatures()[4] > 120.0


OFFSET = np.array([0.02, -0.03, 0.01, 0.0, 0.04, -0.01])
NOISE = np.array([0.01, 0.02, 0.005, 0.01, 0.02, 0.003])


def sensed(setup: Setup, sensor: CurrentSensor, seed: int = 0) -> Setup:
    drives = setup.drives.replaced(current_sensor=sensor)
    return dataclasses.replace(setup, drives=drives, seed=seed)


def currents(plant: Plant, setup: Setup, command: Array, ticks: int) -> tuple[Array, Array]:
    """Return reported and true currents of so many ticks under a constant command, A, shape (ticks, 6)."""
    constant, gear = setup.drives.torque_constant, setup.drives.gear
    reported, true = np.empty((ticks, 6)), np.empty((ticks, 6))
    for k in range(ticks):
        plant.step(command)
        reported[k] = plant.motor_states()[2] / constant
        joint = plant.joint_states()[2].copy()
        joint[4] -= joint[5]
        true[k] = joint / gear / constant
    return reported, true


def test_the_loop_turns_an_offset_into_a_torque(shipped: Setup) -> None:
    """What a drive reports is on average what was asked for; the current is off by the offset, after the loop's lag."""
    setup = sensed(shipped, IDEAL_SENSOR.replaced(offset=OFFSET))
    command, plant = 0.1 * setup.drives.peak_torque, setup.plant()
    reported, true = currents(plant, setup, command, 40)
    wanted = command / setup.drives.torque_constant
    lag = np.exp(-2.0 * np.pi * 800.0 * setup.rates.period * np.arange(40))[:, None]
    assert true == pytest.approx(wanted - OFFSET * (1.0 - lag), abs=1e-12)
    assert reported == pytest.approx(wanted + OFFSET * lag, abs=1e-12)
    plant.step(None)
    assert plant.joint_states()[2].tolist() == [0.0] * 6  # an amplifier that is off gives no current


def test_offset_and_noise_are_recovered(shipped: Setup) -> None:
    """Reported less true current has the offset as mean and the seed's noise as deviation, white and near normal."""
    noisy = IDEAL_SENSOR.replaced(offset=OFFSET, noise=NOISE)
    setup = sensed(shipped, noisy, 5)
    count = 20_000
    reported, true = currents(setup.plant(), setup, np.zeros(6), count)
    error = reported - true
    assert np.abs(error.mean(axis=0) - OFFSET).max() < (4.0 * NOISE / np.sqrt(count)).max()
    assert error.std(axis=0) == pytest.approx(NOISE, rel=4.0 / np.sqrt(2.0 * count))
    normal = (error - OFFSET) / NOISE
    assert np.abs(np.mean(normal[1:] * normal[:-1], axis=0)).max() < 4.0 / np.sqrt(count)
    between = np.corrcoef(normal.T) - np.eye(6)
    assert np.abs(between).max() < 4.5 / np.sqrt(count)
    assert not np.array_equal(currents(sensed(shipped, noisy, 6).plant(), setup, np.zeros(6), 9)[0], reported[:9])
    # The sum of four uniform numbers: its fourth moment is 2.7, the normal one's 3.
    assert np.mean(normal**4, axis=0) == pytest.approx(2.7, abs=0.15)
    # The loop passes noise on through its lag: of a first-order filter with gain g it keeps g / (2 - g).
    gain = -np.expm1(-2.0 * np.pi * 800.0 * setup.rates.period)
    assert true[100:].std(axis=0) == pytest.approx(NOISE * np.sqrt(gain / (2.0 - gain)), rel=0.05)


def test_what_is_reported_has_whole_steps(shipped: Setup) -> None:
    """With a resolution every reported current is a whole number of steps, at most half a step from the truth."""
    resolution = np.array([0.02, 0.02, 0.01, 0.01, 0.005, 0.005])
    setup = sensed(shipped, IDEAL_SENSOR.replaced(resolution=resolution))
    rng, plant = np.random.default_rng(3), setup.plant()
    for _ in range(50):
        command = rng.uniform(-0.3, 0.3, 6) * setup.drives.peak_torque
        reported, true = currents(plant, setup, command, 1)
        steps = reported[0] / resolution
        assert steps == pytest.approx(np.round(steps), abs=1e-9)
        assert np.all(np.abs(reported[0] - true[0]) <= 0.5 * resolution + 1e-12)


def test_the_current_loop_has_one_bandwidth(shipped: Setup) -> None:
    """Drives whose sensors err through another loop than the controller's are refused; both paths together are not."""
    setup = sensed(shipped, IDEAL_SENSOR.replaced(offset=OFFSET))
    with pytest.raises(ConfigError, match=r"bandwidth is 500 Hz for the controller; accepted: 800 Hz, as current_sens"):
        with_parameters(setup, {"controller.current_bandwidth": 500.0}).cs7b()
    both = {"controller.current_bandwidth": 500.0, "drives.current_sensor.bandwidth": 500.0}
    assert with_parameters(setup, both).cs7b().law["current_gain"] < setup.cs7b().law["current_gain"]
    with_parameters(shipped, {"controller.current_bandwidth": 500.0}).cs7b()  # ideal sensors have no part in it
