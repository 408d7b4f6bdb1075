"""The amplifiers' current sensors: offset, noise and steps in what is reported, their torque, the same bits again."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from rx90_common.base.errors import ConfigError
from rx90_common.description.drives import CurrentSensor
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.parameters import with_parameters
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import Plant

Array = NDArray[np.float64]
OFFSET = np.array([0.02, -0.03, 0.01, 0.0, 0.04, -0.01])
NOISE = np.array([0.01, 0.02, 0.005, 0.01, 0.02, 0.003])


def sensed(setup: Setup, sensor: CurrentSensor, seed: int = 0) -> Setup:
    """Return a setup with errors of its current sensors."""
    drives = dataclasses.replace(setup.drives, current_sensor=sensor)
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
    setup = sensed(shipped, CurrentSensor(offset=OFFSET))
    command, plant = 0.1 * setup.drives.peak_torque, setup.plant()
    reported, true = currents(plant, setup, command, 40)
    wanted = command / setup.drives.torque_constant
    lag = np.exp(-2.0 * np.pi * 800.0 * setup.rates.period * np.arange(40))[:, None]
    assert true == pytest.approx(wanted - OFFSET * (1.0 - lag), abs=1e-12)
    assert reported == pytest.approx(wanted + OFFSET * lag, abs=1e-12)
    plant.step(None)
    assert plant.joint_states()[2].tolist() == [0.0] * 6  # an amplifier that is off gives no current


def test_offset_and_noise_are_recovered(shipped: Setup) -> None:
    """Reported less true current has the offset as its mean and the noise as its deviation, white and near normal."""
    setup = sensed(shipped, CurrentSensor(OFFSET, NOISE), 5)
    count = 20_000
    reported, true = currents(setup.plant(), setup, np.zeros(6), count)
    error = reported - true
    assert np.abs(error.mean(axis=0) - OFFSET).max() < (4.0 * NOISE / np.sqrt(count)).max()
    assert error.std(axis=0) == pytest.approx(NOISE, rel=4.0 / np.sqrt(2.0 * count))
    normal = (error - OFFSET) / NOISE
    assert np.abs(np.mean(normal[1:] * normal[:-1], axis=0)).max() < 4.0 / np.sqrt(count)
    between = np.corrcoef(normal.T) - np.eye(6)
    assert np.abs(between).max() < 4.5 / np.sqrt(count)
    # The sum of four uniform numbers: its fourth moment is 2.7, the normal one's 3.
    assert np.mean(normal**4, axis=0) == pytest.approx(2.7, abs=0.15)
    # The loop passes noise on through its lag: of a first-order filter with gain g it keeps g / (2 - g).
    gain = -np.expm1(-2.0 * np.pi * 800.0 * setup.rates.period)
    wanted = np.zeros(6)
    assert (true - wanted)[100:].std(axis=0) == pytest.approx(NOISE * np.sqrt(gain / (2.0 - gain)), rel=0.05)


def test_what_is_reported_has_whole_steps(shipped: Setup) -> None:
    """With a resolution every reported current is a whole number of steps, at most half a step from the truth."""
    resolution = np.array([0.02, 0.02, 0.01, 0.01, 0.005, 0.005])
    setup = sensed(shipped, CurrentSensor(resolution=resolution))
    rng, plant = np.random.default_rng(3), setup.plant()
    for _ in range(50):
        command = rng.uniform(-0.3, 0.3, 6) * setup.drives.peak_torque
        reported, true = currents(plant, setup, command, 1)
        steps = reported[0] / resolution
        assert steps == pytest.approx(np.round(steps), abs=1e-9)
        assert np.all(np.abs(reported[0] - true[0]) <= 0.5 * resolution + 1e-12)


def test_the_same_seed_gives_the_same_bits(shipped: Setup) -> None:
    """Engine, ticks and a run after a reset have the same noise for a seed, and another one for another seed."""
    names, rest = shipped.robot.joint_names, np.zeros(6)
    move = TrajectoryPoints.create(names, names, [0.0, 0.1], [rest, rest + 0.01], [rest] * 2, [[]] * 2)
    setup = sensed(shipped, CurrentSensor(OFFSET, NOISE, np.full(6, 1e-3)), 7)
    run = simulate(setup, move, rest, 0.15, record_fast=True)
    assert run.fast is not None
    plant, law = setup.plant(), setup.cs7b()
    for _ in range(2):
        plant.reset(rest)
        law.reset(plant.motor_states()[0])
        law.trajectory.accept(move, 0, 0)
        for k in range(600):
            states = np.array(plant.motor_states())
            assert states.tobytes() == run.fast.motor_states[k].tobytes()
            plant.step(law.step(states[0], states[1]))
    other = simulate(dataclasses.replace(setup, seed=8), move, rest, 0.15, record_fast=True)
    assert other.fast is not None
    assert not np.array_equal(other.fast.motor_states, run.fast.motor_states)


def test_the_current_loop_has_one_bandwidth(shipped: Setup) -> None:
    """Drives whose sensors err through another loop than the controller's are refused; both paths together are not."""
    setup = sensed(shipped, CurrentSensor(OFFSET))
    with pytest.raises(ConfigError, match=r"bandwidth is 500 Hz for the controller; accepted: 800 Hz, as current_sens"):
        with_parameters(setup, {"controller.current_bandwidth": 500.0}).cs7b()
    both = {"controller.current_bandwidth": 500.0, "drives.current_sensor.bandwidth": 500.0}
    assert with_parameters(setup, both).cs7b().law["current_gain"] < setup.cs7b().law["current_gain"]
    with_parameters(shipped, {"controller.current_bandwidth": 500.0}).cs7b()  # ideal sensors have no part in it


def test_without_errors_the_report_is_the_torque(shipped: Setup) -> None:
    """Without the block the drives report the torque that they give, to the last bit."""
    plant = shipped.plant()
    plant.step(0.2 * shipped.drives.peak_torque)
    assert plant.motor_states()[2].tobytes() == plant.state["motor_torque"][0].tobytes()
