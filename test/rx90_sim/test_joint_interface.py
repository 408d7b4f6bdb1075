"""Efforts at the joints: their transform to the motors, what of them is refused, and what is said once."""

from __future__ import annotations

import numpy as np
import pytest
from any_arm import write_arm

from rx90_common.base.errors import ConfigError
from rx90_common.base.rates import Rates
from rx90_common.exchange.pacing import OnceLog
from rx90_emulator.loop.own_controller import run_controller
from rx90_emulator.loop.setup import Setup, load_setup
from rx90_sim.node.parameters import SimulationParameters
from rx90_sim.plant import JointInterface

TURNS = {6: np.eye(6), 7: np.eye(7)}
"""Of motors for those of the joints: of the RX90B by its manual motor 6 turns with joint 5, too."""
TURNS[6][5, 4] = 1.0
TURNS[7][6, 5] = -1.0  # motor 7 turns with joint 7, and against joint 6


@pytest.fixture(scope="module")
def seven(tmp_path_factory: pytest.TempPathFactory) -> Setup:
    """Return an arm of seven joints with a coupling of its own."""
    return load_setup(robot=write_arm(tmp_path_factory.mktemp("seven") / "arm", 7, TURNS[7].tolist()))


@pytest.mark.parametrize("robot", ["shipped", "seven"])
def test_power_is_the_same_at_motors_and_joints(request: pytest.FixtureRequest, robot: str) -> None:
    """Whatever moves: motor torque times motor speed is effort times joint speed, and what is measured is both."""
    setup: Setup = request.getfixturevalue(robot)
    plant, n, rng = setup.plant(), len(setup.robot.joint_names), np.random.default_rng(1)
    joints = JointInterface(plant, setup.rates, 1000)
    for _ in range(20):
        effort, speed = rng.normal(size=(2, n))
        motor_speed = setup.drives.gear * (TURNS[n] @ speed)
        torques = joints.motor_torques(effort).copy()
        assert torques @ motor_speed == pytest.approx(effort @ speed, rel=1e-12)
        plant.state["motor_velocity"][0], plant.state["motor_torque"][0] = motor_speed, torques
        _, measured, felt = joints.measure()
        np.testing.assert_allclose(measured, speed, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(felt, effort, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"command_interface": "gripper"}, "command_interface is 'gripper'; accepted: motor, joint"),
        ({"command_rate": 1000}, "command_rate is 1000 with command_interface motor"),
        ({"command_interface": "joint", "command_rate": 300}, "command_rate is 300 Hz; accepted: a rate that divides"),
        (
            {"command_interface": "joint", "command_rate": 10, "time_mode": "free_running"},
            "command_age_limit is 0.1 s; accepted: at least two periods of the commands, 0.2 s",
        ),
    ],
)
def test_what_cannot_be_kept_is_refused(given: dict[str, object], words: str) -> None:
    """Rates that do not divide, a rate of the motor side, and limits that leave no time to answer are one line."""
    with pytest.raises(ConfigError, match=words):
        SimulationParameters(Rates(), **given)  # type: ignore[arg-type]


def test_a_fault_is_said_once() -> None:
    """However often it comes and whatever its numbers; another fault, and one that comes back later, have lines."""
    said: list[str] = []
    now = [0.0]
    once = OnceLog(said.append, lambda: now[0])
    for k in range(1000):
        now[0] += 0.5
        once.say(f"/joint_commands: the stamp is {1.79e9 + k} s at {k:g} s")
    once.say("/joint_commands: joint name 'elbow' is unknown")
    now[0] += 31.0
    once.say("/joint_commands: the stamp is 7 s at 9 s")
    assert [line.split(" is ")[0] for line in said] == [
        "/joint_commands: the stamp",
        "/joint_commands: joint name 'elbow'",
        "/joint_commands: the stamp",
    ]


def test_the_arm_may_have_another_number_of_joints_and_another_coupling(seven: Setup) -> None:
    """The drives of seven joints give the efforts; efforts that are no number for each are refused with their count."""
    stiffness = np.array([2000.0, 2000.0, 2000.0, 1000.0, 500.0, 300.0, 100.0])
    run = run_controller(seven, lambda q, v, _t: stiffness * (0.02 - q - 0.1 * v), 0.5, command_rate=500)
    assert run.measured.shape == (250, 3, 7)
    assert np.isfinite(run.joint_states).all()
    asked = run.efforts[-2]  # which the drives have had for a period
    np.testing.assert_allclose(run.measured[-1, 2], asked, rtol=0.02, atol=0.02)
    with pytest.raises(ConfigError, match="accepted: 7 finite efforts, Nm, or None"):
        run_controller(seven, lambda _q, _v, _t: np.zeros(6), 0.01)
