"""Parts of the simulation's node: run control, publications, and the interface at the joints."""

import random
import threading
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from processes import TIMEOUT, wait_until

from benchmarks.any_arm import write_arm
from rx90_common.base.errors import ConfigError
from rx90_emulator.loop.own_controller import run_controller
from rx90_emulator.loop.setup import Setup, load_setup
from rx90_sim.node import publications
from rx90_sim.node.parameters import SimulationParameters
from rx90_sim.node.ticks import NextAction, RunControl
from rx90_sim.plant import JointInterface


class Ticking:
    def __init__(self, last_tick: int | None = None) -> None:
        self.control = RunControl(paused=True, wake=lambda: None, last_tick=last_tick)
        self.tick = 0
        self.waits = 0
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        while (turn := self.control.next_action(self.tick, 0.01)) is not NextAction.STOP:
            if turn is NextAction.RESET:
                self.tick = 0
                self.control.reset_done()
            elif turn is NextAction.STEP:
                self.tick += 1
                self.control.step_done()
            else:
                self.waits += 1

    def still(self) -> int:
        seen = self.waits
        wait_until(lambda: self.waits > seen, "a tick that is not due")
        return self.tick


def test_steps_are_exact_and_a_pause_holds_in_whatever_order_requests_come() -> None:
    """After random requests time stands when paused, goes on by as many steps as asked for, and runs when resumed."""
    ticking, dice = Ticking(), random.Random(1)
    control = ticking.control
    try:
        for _ in range(40):
            for _ in range(dice.randrange(6)):
                request = dice.choice(("pause", "resume", "step", "reset"))
                if request == "step":
                    assert control.step(dice.randint(1, 50), TIMEOUT)
                elif request == "reset":
                    assert control.reset(TIMEOUT)
                else:
                    getattr(control, request)()
            control.pause()
            before = ticking.still()
            steps = dice.randint(1, 200)
            assert control.step(steps, TIMEOUT)
            assert ticking.still() == before + steps
            assert control.paused
        control.resume()
        before = ticking.tick
        wait_until(lambda: ticking.tick > before, "ticks")
    finally:
        control.stop()
        ticking.thread.join(TIMEOUT)
    assert not ticking.thread.is_alive()


def test_steps_beyond_the_last_tick_do_not_wait_for_their_timeout() -> None:
    """Who asks for more steps than the run has is answered when the run ends, not after the timeout."""
    ticking = Ticking(last_tick=100)
    answers: list[bool] = []
    asking = threading.Thread(target=lambda: answers.append(ticking.control.step(1000, 3600.0)), daemon=True)
    asking.start()
    ticking.thread.join(TIMEOUT)
    asking.join(TIMEOUT)
    assert answers == [False]
    assert ticking.tick == 100


TICKS = 400_000  # a hundred seconds of simulated time at 4 kHz


def looked_on(monkeypatch: pytest.MonkeyPatch, pace: float, jitter: float = 0.0) -> list[int]:
    """Return the stamps, ns, published in 100 s of simulated time, every second sample late by a jitter, s."""
    stamps: list[int] = []
    publisher: Any = SimpleNamespace(get_subscription_count=lambda: 1, publish=stamps.append)
    sampled = publications.PeriodicMessage(publisher, 40, lambda stamp: stamp, 0.005)
    wall = 1e3
    monkeypatch.setattr(publications.time, "monotonic", lambda: wall)
    for tick in range(0, TICKS, 4):
        wall = 1e3 + tick / 4000.0 / pace + jitter * (tick // 40 % 2)
        sampled.publish_due(tick, tick * 250_000)
    return stamps


@pytest.mark.parametrize(("pace", "jitter"), [(0.1, 0.0), (1.0, 0.0), (1.0, 0.004)])
def test_each_is_published_at_the_pace_of_time(monkeypatch: pytest.MonkeyPatch, pace: float, jitter: float) -> None:
    """Up to real time there is one for each 10 ms of simulated time, also where every second one is 4 ms late."""
    stamps = looked_on(monkeypatch, pace, jitter)
    assert stamps == [10_000_000 * k for k in range(10_000)]


@pytest.mark.parametrize("pace", [2.5, 7.3, 400.0])
def test_no_more_are_published_than_can_be_shown(monkeypatch: pytest.MonkeyPatch, pace: float) -> None:
    """Where simulated time runs faster there are at most two hundred for each second of wall time, spread evenly."""
    stamps = looked_on(monkeypatch, pace)
    assert 100.0 * 100.0 / pace <= len(stamps) <= 200.0 * 100.0 / pace + 1
    gaps = [b - a for a, b in pairwise(stamps)]
    assert max(gaps) - min(gaps) <= 10_000_000
    assert {stamp % 10_000_000 for stamp in stamps} == {0}


TURNS = {6: np.eye(6), 7: np.eye(7)}
"""Of motors for those of the joints: of the RX90B by its manual motor 6 turns with joint 5, too."""
TURNS[6][5, 4] = 1.0
TURNS[7][6, 5] = -1.0  # motor 7 turns with joint 7, and against joint 6


@pytest.fixture(scope="module")
def seven(tmp_path_factory: pytest.TempPathFactory) -> Setup:
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
        ({"command_rate": 1000}, "command_rate is 1000; accepted: 0 with command_interface motor"),
        ({"command_interface": "joint", "command_rate": 300}, "command_rate is 300 Hz; accepted: a rate that divides"),
        (
            {"command_interface": "joint", "command_rate": 10, "time_mode": "free_running"},
            "command_age_limit is 0.1; accepted: at least two periods of the commands, 0.2 s",
        ),
    ],
)
def test_what_cannot_be_kept_is_refused(given: dict[str, object], words: str) -> None:
    """Rates that do not divide, a rate of the motor side, and limits that leave no time to answer are one line."""
    with pytest.raises(ConfigError, match=words):
        SimulationParameters.of(given)


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
