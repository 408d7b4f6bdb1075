"""Brakes hold and stop the arm, end stops push it back, and a diverging state ends the run with an error."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rx90_common.base.errors import ConfigError, DivergenceError, Rx90Error
from rx90_common.friction import FrictionSet
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import Plant

COUPLING = np.eye(6)
COUPLING[5, 4] = 1.0


def test_closed_brakes_hold_every_pose_from_the_start(shipped: Setup) -> None:
    """Reset puts the arm in equilibrium on its brakes: nothing moves, in any pose, not even by a bristle."""
    plant = shipped.plant()
    rng = np.random.default_rng(8)
    for _ in range(40):
        pose = rng.uniform(shipped.robot.lower, shipped.robot.upper)
        plant.reset(pose)
        for _ in range(200):
            plant.step(None)
        assert np.abs(plant.joint_states()[0] - pose).max() < 1e-12


def test_brakes_that_close_hold_within_torque_over_stiffness(shipped: Setup) -> None:
    """Closing on a loaded arm at rest, each brake gives way by its load over its stiffness, at most."""
    rng = np.random.default_rng(9)
    for _ in range(10):
        plant = shipped.plant()
        pose = rng.uniform(shipped.robot.lower, shipped.robot.upper)
        plant.reset(pose)
        plant.step(np.zeros(6))
        closed_at = plant.joint_states()[0].copy()
        for _ in range(2000):
            plant.step(None)
        load = np.abs(np.linalg.solve(COUPLING.T, plant.state["bias"][0]))
        moved = np.abs(COUPLING @ (plant.joint_states()[0] - closed_at))
        # A neighbour's jerk passes on some of its own way.
        give = load / shipped.drives.brake_stiffness
        assert np.all(moved <= 1.01 * give + 0.3 * give.max())
        assert np.abs(plant.joint_states()[1]).max() < 1e-6


def test_brakes_stop_a_moving_arm(shipped: Setup) -> None:
    """Brakes stop every joint on the way that their torque, less gravity's, needs for the arm's energy."""
    plant = shipped.plant()
    plant.reset([0.0, 0.2, 0.5, 0.0, 0.4, 0.0])
    speed = 0.5 * shipped.robot.max_velocity * [1, 1, -1, 1, -1, 1]
    plant.step(np.zeros(6))
    plant.state["v"][0] = speed
    start = plant.joint_states()[0].copy()
    mass, bias = plant.state["mass_matrix"][0].copy(), plant.state["bias"][0].copy()
    stopped = None
    for k in range(4000):
        plant.step(None)
        if stopped is None and np.abs(plant.joint_states()[1]).max() < 1e-3:
            stopped = k
    assert stopped is not None
    way = np.abs(plant.joint_states()[0] - start)
    energy = 0.5 * speed @ mass @ speed
    # The work of gravity on the way is less than what the margin of the brakes takes.
    margin = shipped.drives.brake_torque - np.abs(bias) * 1.5
    assert np.all(way <= energy / margin)
    rest = plant.joint_states()[0].copy()
    for _ in range(4000):
        plant.step(None)
    assert np.abs(plant.joint_states()[0] - rest).max() < 1e-9


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_end_stop_pushes_back(shipped: Setup, frictionless: FrictionSet, joint: int, side: float) -> None:
    """A joint driven into its stop is held within torque over stiffness and thrown back when let go."""
    chain = shipped.robot.chain._replace(gravity=np.zeros(3))
    setup = dataclasses.replace(
        shipped,
        friction=frictionless,
        robot=dataclasses.replace(shipped.robot, chain=chain),
        drives=dataclasses.replace(shipped.drives, spring_torque=np.zeros(6)),
    )
    limit = (setup.robot.upper if side > 0 else setup.robot.lower)[joint]
    pose = np.zeros(6)
    pose[joint] = limit - side * 0.01
    plant = setup.plant()
    plant.reset(pose)
    wanted = np.zeros(6)
    wanted[joint] = side * 0.05 * shipped.drives.brake_torque[joint]
    motor = np.linalg.solve((shipped.drives.gear[:, None] * COUPLING).T, wanted)
    deepest = 0.0
    for _ in range(8000):
        plant.step(motor)
        deepest = max(deepest, side * (plant.joint_states()[0][joint] - limit))
    held = wanted[joint] * side / shipped.drives.stop_stiffness[joint]
    assert deepest > 0.5 * held
    # The push alone, and the speed picked up on the way to the stop.
    assert deepest < held + 3.0 * np.sqrt(held * 0.01) + 1e-3
    for _ in range(8000):
        plant.step(np.zeros(6))
    assert side * (plant.joint_states()[0][joint] - limit) < 1e-3 * held
    assert np.all(np.isfinite(plant.joint_states()[0]))


def beyond_a_stop(shipped: Setup, frictionless: FrictionSet, side: float) -> Plant:
    """Return an arm without weight and friction whose first joint is 1 mrad beyond its upper or lower limit."""
    drives = dataclasses.replace(shipped.drives, spring_torque=np.zeros(6))
    robot = dataclasses.replace(shipped.robot, chain=shipped.robot.chain._replace(gravity=np.zeros(3)))
    plant = dataclasses.replace(shipped, friction=frictionless, robot=robot, drives=drives).plant()
    pose = np.zeros(6)
    pose[0] = (shipped.robot.upper if side > 0 else shipped.robot.lower)[0]
    plant.reset(pose)
    plant.step(np.zeros(6))
    plant.state["q"][0, 0] += side * 1e-3
    return plant


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_end_stop_never_pulls(shipped: Setup, frictionless: FrictionSet, side: float) -> None:
    """A joint that leaves its stop fast is not held back by the stop's damper."""
    plant = beyond_a_stop(shipped, frictionless, side)
    plant.state["v"][0, 0] = -side  # 670 Nm of damping against 40 Nm of spring
    plant.step(np.zeros(6))
    assert side * plant.joint_states()[1][0] <= -1.0 + 1e-6


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_end_stop_is_a_spring_and_a_damper(shipped: Setup, frictionless: FrictionSet, side: float) -> None:
    """Beyond either limit and on its way into the stop, a joint is pushed back by k d + c v."""
    plant = beyond_a_stop(shipped, frictionless, side)
    plant.state["v"][0, 0] = side * 0.1
    plant.step(np.zeros(6))
    push = shipped.drives.stop_stiffness[0] * 1e-3 + shipped.drives.stop_damping[0] * 0.1
    slower = np.linalg.inv(plant.state["mass_matrix"][0])[0, 0] * push * shipped.rates.period
    assert 0.1 - side * plant.joint_states()[1][0] == pytest.approx(slower, rel=0.02)


def ringing(setup: Setup, joint: int) -> Plant:
    """Return a plant whose joint has a micro-viscous damping too large for its step, which no setup comes to."""
    plant = setup.plant()
    plant.constants["friction"]["c1"][0, joint] = 1e6
    plant.constants["friction"]["inverse_omega_d"][0, joint] = 1e-6
    return plant


@pytest.mark.parametrize("joint", [0, 3, 5])
def test_divergence_is_an_error_that_names_joint_and_tick(shipped: Setup, joint: int) -> None:
    """A state beyond its speed limit ends the step with one line that names the joint and the tick."""
    plant = ringing(shipped, joint)
    with pytest.raises(DivergenceError) as caught:  # noqa: PT012 - every sample up to then is a number
        for _ in range(400):
            plant.step(0.2 * shipped.drives.peak_torque)
            for sample in (*plant.motor_states(), *plant.joint_states(), *plant.friction_states()):
                assert np.all(np.isfinite(sample))
    text = str(caught.value)
    assert f"joint_{joint + 1}" in text
    assert f"tick {plant.tick}" in text
    assert 1 <= plant.tick < 400
    assert "accepted" in text
    assert "\n" not in text
    assert isinstance(caught.value, Rx90Error)


def test_a_command_that_is_no_number_is_an_error(shipped: Setup) -> None:
    """A motor command of NaN ends the run with an error instead of NaN in the samples."""
    plant = shipped.plant()
    plant.step(np.zeros(6))
    with pytest.raises(DivergenceError, match=r"joint_4 .* tick 2"):
        plant.step(np.array([0.0, 0.0, 0.0, np.nan, 0.0, 0.0]))


def test_infinite_torque_is_the_peak_torque(shipped: Setup) -> None:
    """A motor command of infinity is limited like any other that is too large."""
    plant = shipped.plant()
    plant.step(np.array([np.inf, -np.inf, 0.0, 0.0, 0.0, 0.0]))
    assert plant.motor_states()[2][:2] == pytest.approx(shipped.drives.peak_torque[:2] * [1, -1])
    assert np.all(np.isfinite(plant.joint_states()[0]))


def test_a_brake_weaker_than_nothing_is_refused(shipped: Setup) -> None:
    """A brake without stiffness is refused, not divided by."""
    with pytest.raises(ConfigError, match=r"brake_stiffness\[0\] is 0.0; accepted: 1 to 7 numbers, each a number > 0"):
        dataclasses.replace(shipped.drives, brake_stiffness=np.zeros(6))
