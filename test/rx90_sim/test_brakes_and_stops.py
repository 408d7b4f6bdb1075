"""Brakes hold and stop the arm, end stops push it back, and a diverging state ends the run with an error."""

import dataclasses
import re

import numpy as np
import pytest
from elastic_arms import WRIST

from rx90_common.base.errors import DivergenceError
from rx90_common.friction import FrictionSet
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import Plant


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
        load = np.abs(np.linalg.solve(WRIST.T, plant.state["bias"][0]))
        moved = np.abs(WRIST @ (plant.joint_states()[0] - closed_at))
        # A neighbour's jerk passes on some of its own way.
        give = load / shipped.drives.brake.stiffness
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
    way = np.abs(plant.joint_states()[0] - start)
    energy = 0.5 * speed @ mass @ speed
    # The work of gravity on the way is less than what the margin of the brakes takes.
    margin = shipped.drives.brake.torque - np.abs(bias) * 1.5
    assert np.all(way <= energy / margin)
    rest = plant.joint_states()[0].copy()
    for _ in range(4000):
        plant.step(None)
    assert np.abs(plant.joint_states()[0] - rest).max() < 1e-9


def beyond_a_stop(shipped: Setup, frictionless: FrictionSet, side: float, joint: int = 0) -> Plant:
    """Return an arm without weight and friction, a joint of which is 1 mrad beyond its upper or lower limit."""
    drives = shipped.drives.replaced(spring={"torque": np.zeros(6)})
    robot = dataclasses.replace(shipped.robot, chain=shipped.robot.chain._replace(gravity=np.zeros(3)))
    plant = dataclasses.replace(shipped, friction=frictionless, robot=robot, drives=drives).plant()
    pose = np.zeros(6)
    pose[joint] = (shipped.robot.upper if side > 0 else shipped.robot.lower)[joint]
    plant.reset(pose)
    plant.step(np.zeros(6))
    plant.state["q"][0, joint] += side * 1e-3
    return plant


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_end_stop_never_pulls(shipped: Setup, frictionless: FrictionSet, side: float) -> None:
    """A joint that leaves its stop fast is not held back by the stop's damper."""
    plant = beyond_a_stop(shipped, frictionless, side)
    plant.state["v"][0, 0] = -side  # 670 Nm of damping against 40 Nm of spring
    plant.step(np.zeros(6))
    assert side * plant.joint_states()[1][0] <= -1.0 + 1e-6


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_end_stop_is_spring_and_damper(shipped: Setup, frictionless: FrictionSet, joint: int, side: float) -> None:
    """Beyond either limit and on its way into the stop, each joint is pushed back by k d + c v."""
    plant, period = beyond_a_stop(shipped, frictionless, side, joint), shipped.rates.period
    plant.state["v"][0, joint] = side * 0.1
    plant.step(np.zeros(6))
    depth = 1e-3 + 0.5 * period * 0.1
    push = shipped.drives.end_stops.stiffness[joint] * depth + shipped.drives.end_stops.damping[joint] * 0.1
    slower = np.linalg.inv(plant.state["mass_matrix"][0])[joint, joint] * push * period
    assert 0.1 - side * plant.joint_states()[1][joint] == pytest.approx(slower, rel=0.02)


@pytest.mark.parametrize("joint", [0, 3, 5])
def test_divergence_is_an_error_that_names_joint_and_tick(shipped: Setup, joint: int) -> None:
    """A state beyond its speed limit ends the step with one line that names the joint and the tick."""
    plant = shipped.plant()  # with a micro-viscous damping too large for its step, which no setup comes to
    plant.constants["friction"]["c1"][0, joint] = 1e6
    plant.constants["friction"]["inverse_omega_d"][0, joint] = 1e-6
    with pytest.raises(DivergenceError) as caught:  # noqa: PT012 - every sample up to then is a number
        for _ in range(400):
            plant.step(0.2 * shipped.drives.peak_torque)
            for sample in (*plant.motor_states(), *plant.joint_states(), *plant.friction_states()):
                assert np.all(np.isfinite(sample))
    assert re.match(rf".*joint_{joint + 1}.*tick {plant.tick}.*accepted.*$", str(caught.value))
    assert 1 <= plant.tick < 400


def test_a_command_that_is_no_number_is_an_error(shipped: Setup) -> None:
    """A motor command of NaN ends the run with an error instead of NaN in the samples."""
    plant = shipped.plant()
    plant.step(np.zeros(6))
    with pytest.raises(DivergenceError, match=r"joint_4 .* tick 2"):
        plant.step(np.array([0.0, 0.0, 0.0, np.nan, 0.0, 0.0]))
