"""The closed loop without ROS: its bits, its series, its refusals, its errors."""

import dataclasses
import math
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from elastic_arms import SOFT, elastic
from full_drives import DRIVE_BLOCKS
from full_friction import PARTS
from own_model import by_model, with_friction
from unchecked import unchecked

import rx90_emulator as rx
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, DivergenceError, TrajectoryError
from rx90_common.base.share import config_path
from rx90_common.friction.parts.bristles import MaxwellSlip
from rx90_emulator.loop.closed_loop import simulate, simulate_commands
from rx90_emulator.loop.result import MotionCommand, RunResult
from tools.digests import committed, digests

NAMES = tuple(f"joint_{i}" for i in range(1, 7))
HOME = np.array([0.1, 0.3, 1.1, -0.2, 0.7, 0.3])
REST = np.zeros(6)
REFERENCE = Path(__file__).parents[2] / "reference" / "reference_task"


def there_and_back(size: float = 0.09) -> rx.TrajectoryPoints:
    turn = HOME + size * np.array([1, -1, 1, -1, 1, -1])
    rows = [HOME, turn, HOME]
    return rx.TrajectoryPoints.create(NAMES, NAMES, [0.0, 0.3, 0.6], rows, [REST] * 3, [REST] * 3)


def step_by_step(
    setup: rx.Setup, commands: tuple[MotionCommand, ...], duration: float, substeps: int
) -> dict[str, Array]:
    plant, controller = setup.plant(substeps), setup.cs7b()
    plant.reset(HOME)
    controller.reset(plant.motor_states()[0])
    seen: dict[str, list[Array]] = defaultdict(list)
    for k in range(round(duration * setup.rates.base_hz)):
        slow = k % setup.rates.ratio == 0
        for start, points, _ in commands:
            if k == start * setup.rates.ratio:
                if points is None:
                    controller.trajectory.stop(start, start)
                else:
                    controller.trajectory.accept(points, start, start)
        if slow:
            seen["joint_states"].append(np.array(plant.joint_states()))
            seen["friction_states"].append(np.array(plant.friction_states()))
        position, velocity, torque = plant.motor_states()
        seen["motor_states"].append(np.array([position, velocity, torque]))
        command = controller.step(position, velocity, torque).copy()
        seen["motor_commands"].append(command)
        if slow:
            seen["reference"].append(np.array(controller.reference()))
            seen["tracking_error"].append(np.array(controller.tracking_error()))
            seen["details"].append(np.array(controller.details()))
        if k % setup.rates.base_hz == 0 and (setup.drives.winding.used or setup.friction.elements[0].temperature):
            seen["temperatures"].append(plant.temperatures.copy())
            seen["windings"].append(plant.winding_temperatures())
        plant.step(command)
    empty = {"temperatures": np.empty((0, 7)), "windings": np.empty((0, 6)), "correction": np.empty((0, 6))}
    return empty | {name: np.array(rows) for name, rows in seen.items()}


def series(result: RunResult) -> dict[str, Array]:
    return {**result.fast._asdict(), **result.slow._asdict()}


CASES = {
    "as shipped": (rx.Rates(), 1, 0),
    "other rates": (rx.Rates(8000, 500), 1, 5),
    "one rate": (rx.Rates(2000, 2000), 2, 0),
    "elastic gears with play": (rx.Rates(), 1, 0),
    "sensors and windings": (rx.Rates(), 1, 0),
    "the controller's model and all parts": (rx.Rates(), 1, 0),
}


@pytest.mark.parametrize("case", CASES)
def test_simulate_equals_plant_and_controller_stepped_one_by_one(shipped: rx.Setup, case: str, tmp_path: Path) -> None:
    """Every sample of every topic is the same to the last bit as from Plant and CS7B called tick by tick."""
    rates, substeps, start = CASES[case]
    setup = dataclasses.replace(shipped, rates=rates)
    if "elastic" in case:
        setup = elastic(setup, SOFT, 2e-4 * SOFT, 1e-4)
    if "windings" in case:
        drives = setup.drives.replaced(**{name: DRIVE_BLOCKS[name] for name in ("current_sensor", "winding")})
        setup = dataclasses.replace(setup, drives=drives, seed=3)
    if "model" in case:
        slip = MaxwellSlip(stiffness=(0.5, 0.3, 0.2), share=(0.2, 0.3, 0.5), attraction=500.0)
        parts = {name: part for name, part in PARTS.items() if name != "scatter"} | {"bristles": slip}
        elements = tuple(element.replaced(**parts) for element in setup.friction.elements)
        setup = dataclasses.replace(setup, friction=dataclasses.replace(setup.friction, elements=elements))
        setup = by_model(with_friction(setup, elements, tmp_path / "friction.yaml"))
    away = rx.TrajectoryPoints.create(NAMES, NAMES, [0.6], [HOME + 0.08], [REST], [REST])
    motions = ((0.0, there_and_back()), (0.4, away), (0.7, None))
    commands = tuple(MotionCommand(start + rates.start_tick(begin), points) for begin, points in motions)
    got = series(simulate_commands(setup, commands, HOME, 0.9, substeps=substeps, record_fast=True))
    want = step_by_step(setup, commands, 0.9, substeps)
    assert set(got) == set(want)
    for name, values in want.items():
        assert got[name].tobytes() == values.tobytes(), name
    assert np.abs(want["joint_states"][:, 0] - HOME).max() > 0.08


def test_recording_the_fast_series_does_not_change_the_run(shipped: rx.Setup) -> None:
    """The slow series are the same with and without the fast ones."""
    full, lean = (simulate(shipped, there_and_back(), HOME, 0.1, record_fast=fast) for fast in (True, False))
    assert (full.fast is None, lean.fast is None) == (False, True)
    assert all(a.tobytes() == b.tobytes() for a, b in zip(full.slow, lean.slow, strict=True))


def test_what_cannot_be_run_is_refused(shipped: rx.Setup) -> None:
    """A time that is none, a trajectory that starts elsewhere or in the past, and a pose out of reach are refused."""
    for duration in (0.0, -1.0, 1e-9, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match=rf"duration is {duration} s; accepted: a finite number, at least a tick"):
            simulate(shipped, there_and_back(), HOME, duration)
    for start in (float("nan"), float("inf")):
        with pytest.raises(ConfigError, match=rf"start time is {start} s; accepted: a finite number"):
            simulate(shipped, there_and_back(), HOME, 0.5, start)
    with pytest.raises(TrajectoryError, match="joint_3 starts at"):
        simulate(shipped, there_and_back(), HOME + np.array([0, 0, 0.5, 0, 0, 0]), 0.5)
    with pytest.raises(TrajectoryError, match="in the past"):
        simulate(shipped, there_and_back(), HOME, 0.5, start_time=-0.1)
    with pytest.raises(ConfigError, match=r"initial position: joint_1 is 9 rad"):
        simulate(shipped, there_and_back(), [9.0, 0, 0, 0, 0, 0], 0.5)


def test_a_diverging_run_is_an_error(shipped: rx.Setup) -> None:
    """A run whose plant diverges ends with an error that names the joint, and the tick of stepping one by one."""
    # An amplifier without limits and a far too large gain drive the fourth joint apart.
    kv = np.multiply(shipped.controller.servo.kv, [1, 1, 1, 30, 1, 1])
    loose = {"following_error": np.full(6, 1e9), "over_speed": 1e9}
    wild = unchecked(shipped.controller, servo={"kv": kv}, supervision=loose)
    drives = shipped.drives.replaced(motor={"peak_current": 1e6 * shipped.drives.peak_current})
    setup = dataclasses.replace(shipped, controller=wild, drives=drives)
    with pytest.raises(DivergenceError, match=r"joint_4 diverged in tick [1-9]\d*") as caught:
        simulate(setup, there_and_back(), HOME, 0.5)
    with pytest.raises(DivergenceError) as one_by_one:
        step_by_step(setup, (MotionCommand(0, there_and_back()),), 0.5, 1)
    assert str(caught.value) == str(one_by_one.value)


def test_saturated_amplifiers_are_counted(shipped: rx.Setup) -> None:
    """A motion beyond the amplifiers counts as many ticks as the controller limits when stepped one by one."""
    weak = shipped.drives.replaced(motor={"peak_current": shipped.drives.peak_current * [1, 0.3, 1, 1, 1, 1]})
    loose = shipped.controller.replaced(supervision={"following_error": np.full(6, 1.0)})
    setup = dataclasses.replace(shipped, drives=weak, controller=loose)
    result = simulate(setup, there_and_back(), HOME, 0.6, record_fast=True)
    at_peak = np.abs(result.fast.motor_commands) > 0.999 * weak.peak_torque
    assert result.saturated[1] > 20
    assert result.saturated[1] == pytest.approx(np.count_nonzero(at_peak[:, 1]), rel=0.2)
    assert result.saturated[3:].tolist() == [0, 0, 0]


def test_at_rest_the_torque_steps_by_no_more_than_one_count_of_the_position(shipped: rx.Setup) -> None:
    """Held for a second, each torque's steps are the proportional gain times one count, and stay within two of them."""
    pose = np.array([0.1, 0.5, 1.2, 0.2, 0.9, 0.3])
    run = simulate(
        shipped, rx.TrajectoryPoints(np.array([0.0, 1.5]), np.array([pose] * 2), None, None), record_fast=True
    )
    torque = shipped.drives.gear * run.fast.motor_commands[4000:]  # Nm at the joint, the last 0.5 s
    law, count = shipped.controller, 2 * math.pi / shipped.drives.encoder_counts / shipped.drives.gear
    one_count = law.inertia * law.servo.kv * law.servo.kp * count
    assert np.all(np.abs(np.diff(torque, axis=0)).max(axis=0) <= 1.02 * one_count)
    assert np.any(np.abs(np.diff(torque, axis=0)).max(axis=0) > 0.1 * one_count)


def test_plants_and_controllers_do_not_share_state(shipped: rx.Setup) -> None:
    """Two plants of one setup are two robots, and two controllers two cabinets."""
    plants, controllers = [shipped.plant(), shipped.plant()], [shipped.cs7b(), shipped.cs7b()]
    still = plants[1].joint_states()[1].tobytes(), controllers[1].state.tobytes()
    plants[0].step(np.full(6, 0.3))
    controllers[0].step(np.full(6, 0.3), np.zeros(6))
    assert (plants[1].joint_states()[1].tobytes(), controllers[1].state.tobytes()) == still
    assert [one.tick for one in (*plants, *controllers)] == [1, 0, 1, 0]


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("joint", range(6))
def test_the_fastest_motion_to_a_limit_stays_within_it(shipped: rx.Setup, joint: int, sign: float) -> None:
    """At full speed for 0.1 s, accelerated and braked at the limits, it ends past the limit by less than 1 mrad."""
    robot, speed = shipped.robot, shipped.robot.max_velocity[joint]
    ramp = speed / shipped.controller.max_acceleration[joint] * (1.0 + 1e-9)
    end, time = np.zeros(6), 2.0 * ramp + 0.1
    end[joint] = (robot.upper if sign > 0 else robot.lower)[joint]
    start = end.copy()
    start[joint] -= sign * speed * (ramp + 0.1)
    points = rx.TrajectoryPoints.create(robot.joint_names, robot.joint_names, [0.0, time], [start, end], [], [])
    states = simulate(shipped, points, duration=time + 0.3).slow.joint_states
    assert (robot.lower - 1e-3 < states[:, 0]).all()
    assert (states[:, 0] < robot.upper + 1e-3).all()
    assert (np.abs(states[:, 1]) < 1.01 * robot.max_velocity).all()
    assert np.abs(states[:, 1, joint]).max() > 0.99 * robot.max_velocity[joint]


def test_a_new_run_equals_the_reference_bag(shipped: rx.Setup, tmp_path: Path) -> None:
    """Every 20th message of joints, friction, references and errors is the reference bag's to the last bit."""
    rx.write_bag(rx.run_line(shipped, rx.load_task()), tmp_path / "new", decimation=20)
    comparison = rx.compare_bags(tmp_path / "new", REFERENCE)
    assert comparison.verdict is rx.Verdict.SAME, rx.comparison_text(comparison)
    assert len(comparison.topics) == 7


def test_the_feed_forward_lasts_until_the_next_set_point() -> None:
    """Where the acceleration jumps at a set-point, the arm does not lag by half of a period: 19 um on the Panda."""
    setup, task = rx.load_setup(robot="panda"), rx.load_task(config_path("robots/panda/task.yaml"))
    for speed in (task.speed, 0.03):  # corners at set-points, and in between
        assert rx.run_line(setup, dataclasses.replace(task, speed=speed)).path_accuracy.worst < 6e-6


def test_constants_set_points_and_runs_have_the_committed_digests() -> None:
    """Constants, planned lines, set-points and runs are, bit for bit, those of every machine and library version."""
    assert digests() == committed()
