"""Arms of 1, 6 and 7 joints, with motors that turn with several of them, against other people's solvers."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
import pytest
from lugre_oracle import LuGreOracle

from benchmarks.any_arm import write_arm
from rx90_common.description.coupling import Coupling
from rx90_common.friction import FrictionSet
from rx90_emulator.loop.setup import Setup, load_setup

ALONE = [[1.0]]
SEVEN = np.eye(7).tolist()
SEVEN[5] = [0.0, 0.0, 0.0, -0.5, 0.0, 1.0, 0.0]


class Arm(NamedTuple):
    setup: Setup
    oracle: Any


@pytest.fixture(scope="module", params=[ALONE, SEVEN, None], ids=["1 joint", "7", "RX90B"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, arm_oracle: Any) -> Arm:
    turns = request.param
    if turns is None:
        shipped = arm_oracle.setup
        elements = tuple(
            e.with_parameters({"tau_c_negative": 1.3 * e.tau_c.positive, "tau_s_negative": 1.5 * e.tau_s.positive})
            for e in shipped.friction.elements
        )
        setup = dataclasses.replace(shipped, friction=FrictionSet(shipped.friction.names, elements))
        return Arm(setup, dataclasses.replace(arm_oracle, setup=setup))
    setup = load_setup(robot=write_arm(tmp_path_factory.mktemp("arm"), len(turns), turns))
    return Arm(setup, dataclasses.replace(arm_oracle, setup=setup, turns=np.array(turns)))


def test_steps_converge_to_the_solution_of_a_stiff_solver(arm: Arm) -> None:
    """Under motor torques that jump, joints and bristles come to the solver's with order 2, and are near it at once."""
    setup, n = arm.setup, len(arm.oracle.turns)
    pose, ticks = np.full(n, 0.4), 40
    pieces = np.random.default_rng(n).uniform(-0.4, 0.4, (2, n)) * setup.drives.peak_torque
    state = np.concatenate([pose, np.zeros(n + len(setup.friction.names))])
    for motor in pieces:
        state = arm.oracle.integrate(state, motor, ticks * setup.rates.period, 1e-9)
    errors = []
    for substeps in (1, 4):
        plant = setup.plant(substeps)
        plant.reset(pose)
        for motor in pieces:
            for _ in range(ticks):
                plant.step(motor)
        got = plant.state[0]
        error = np.abs(np.concatenate([got["q"], got["v"], got["z"]]) - state)
        errors.append([error[:n].max(), error[n : 2 * n].max(), error[2 * n :].max()])
    assert np.abs(state[n : 2 * n]).max() > 0.1
    assert (np.array(errors[0]) < [3e-5, 1e-3, 2e-6]).all()
    assert (np.array(errors[1]) < 0.15 * np.array(errors[0]) + 1e-12).all()  # a sixteenth, with order 2
    z, inputs, torque = plant.friction_states()
    np.testing.assert_allclose(inputs, arm.oracle.inputs @ plant.joint_states()[1], rtol=1e-12, atol=1e-15)
    want = LuGreOracle(setup.friction.elements).rates(z, inputs)[1]
    np.testing.assert_allclose(torque, want, rtol=1e-6, atol=1e-6 * np.abs(want).max())


def test_an_arm_at_rest_on_its_brakes_stays(arm: Arm) -> None:
    """Closed brakes carry the weight from the first tick on, in any pose, whatever motors turn with which joints."""
    plant, rng, heaviest = arm.setup.plant(), np.random.default_rng(8), 0.0
    for _ in range(10):
        pose = rng.uniform(arm.setup.robot.lower, arm.setup.robot.upper)
        plant.reset(pose)
        for _ in range(100):
            plant.step(None)
        assert np.abs(plant.joint_states()[0] - pose).max() < 1e-12
        heaviest = max(heaviest, np.abs(arm.oracle.mass_and_bias(pose, 0.0 * pose)[1]).max())
    assert heaviest > 1.0


def test_a_differential_turns_two_joints_by_two_motors() -> None:
    """Its inverse has halves, and each of its motors has a friction element of its own."""
    differential = Coupling(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 1.0, -1.0]]))
    assert differential.joint_turns.tolist() == [[1.0, 0.0, 0.0], [0.0, 0.5, 0.5], [0.0, 0.5, -0.5]]
    assert differential.element_of_motor == (0, 3, 4)
