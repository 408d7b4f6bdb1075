"""The path error in a bag: that of the run, across the path of the set-points, of one arm."""

from pathlib import Path

import numpy as np
import pytest
from bag_making import joint_state, write_ros2
from pinocchio_chain import tip_place

import rx90_emulator as rx
from rx90_common.base.errors import BagError
from rx90_controller.lines.plan import approached
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.recorded_setup import ends_in_motion
from rx90_emulator.loop.run_messages import trajectory_message
from rx90_emulator.loop.setup import Setup
from rx90_emulator.measured_runs.recorded_path import RecordedAccuracy, recorded_accuracy

REFERENCE = Path(__file__).resolve().parents[2] / "reference" / "reference_task"
JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
MOTORS = [f"motor_{k}" for k in range(1, 7)]
STEP = 1_000_000
SETPOINTS = "/rx90_controller/reference"


def test_the_approach_counts_apart(shipped: Setup, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The first line is what the line's own task counts, whatever the way to it; a cut recording is said to be one."""
    task = rx.load_task()
    plan = rx.plan_path(shipped, task)
    here = plan.start_pose + 0.05
    limits = shipped.controller.limits(shipped.robot)
    line = approached(plan, here, limits, shipped.rates.position_period, True)
    for name, duration in (("whole", line.duration), ("cut", line.duration - 3.0)):
        result = rx.simulate(shipped, line.points, here, duration)
        rx.write_bag(result, tmp_path / name)
        expected = rx.path_accuracy(shipped.robot, task, result.times, result.slow.joint_states[:, 0], line.approach)
        assert run("rx90 bag", ["path", str(tmp_path / name)]) == 0
        first, second, *cut = capsys.readouterr().out.splitlines()
        assert first == f"{tmp_path / name}: {expected.words}"
        assert second.startswith(f"{tmp_path / name}: approach: path error ")
        said = [f"{tmp_path / name}: the recording ends while the set-points still move"] if name == "cut" else []
        assert cut == said
        assert run("rx90 bag", ["info", str(tmp_path / name)]) == 0
        assert [row for row in capsys.readouterr().out.splitlines() if "ends" in row] == said


def test_the_bag_of_a_line_has_its_error(shipped: Setup, capsys: pytest.CaptureFixture[str]) -> None:
    """Across and along the line, and of the tool: as for the same states, a line for each bag."""
    states = rx.read_joint_states(REFERENCE, "joint_states", JOINTS)
    expected = rx.path_accuracy(shipped.robot, rx.load_task(), states.time, states.fields["position"])
    assert run("rx90 bag", ["path", str(REFERENCE), str(REFERENCE)]) == 0
    assert capsys.readouterr().out.splitlines() == [f"{REFERENCE}: {expected.words}"] * 2


def arc() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return stamps, ms, set-points of an arc about the base between two rests, and an arm that is 2 ms late, rad."""
    stamps = np.arange(600)
    time = stamps * 1e-3
    target = np.zeros((600, 6))
    target[:, 0] = 0.5 * np.clip(time, 0.05, 0.3)
    target[:, 1:] = [0.3, 1.2, 0.1, 0.4, 0.2]
    arm = target.copy()
    arm[:, 0] = np.minimum(arm[:, 0], 0.5 * np.clip(time - 0.002, 0.05, 0.298))  # and never quite there
    return stamps, target, arm


def test_it_is_the_distance_across_the_path(shipped: Setup, tmp_path: Path) -> None:
    """What lags behind is no path error; nothing counts before the motion, 0.2 s after it, and without set-points."""
    stamps, target, arm = arc()
    for row in (20, 150, 350, 510):
        arm[row, 1] += 1e-3
    asked = np.r_[0:200, 210:600]
    series = [
        rx.JointSeries("/joint_states", JOINTS, stamps * STEP, arm),
        rx.JointSeries(SETPOINTS, JOINTS, asked * STEP, target[asked]),
    ]
    rx.write_joint_states(tmp_path / "bag", series)
    found, _ = recorded_accuracy(tmp_path / "bag", shipped.robot, rx.RobotFiles())
    counted = np.rint(found.times * 1e3).astype(int)
    np.testing.assert_array_equal(counted, np.r_[50:200, 210:501])
    lag = np.linalg.norm(tip_place(shipped.robot, arm[100]) - tip_place(shipped.robot, target[100]))
    error = dict(zip(counted.tolist(), found.perpendicular.tolist(), strict=True))
    for row in (150, 350):
        off = tip_place(shipped.robot, arm[row]) - tip_place(shipped.robot, target[row])
        tangent = np.cross([0.0, 0.0, 1.0], tip_place(shipped.robot, target[row]))
        across = off - (off @ tangent) * tangent / (tangent @ tangent)
        assert error.pop(row) == pytest.approx(np.linalg.norm(across), rel=5e-3)
    near = [far for row, far in error.items() if not 190 < row < 220]  # a chord leads across the gap of the set-points
    assert max(near) < lag**2  # of an arc with a radius of some 0.7 m


@pytest.mark.parametrize(("first", "second", "kinds"), [(900, [], ["approach"]), (400, [100], ["line", "approach"])])
def test_an_approach_lasts_until_it_is_replaced(
    shipped: Setup, tmp_path: Path, capsys: pytest.CaptureFixture[str], first: int, second: list[int], kinds: list[str]
) -> None:
    """One that takes all of the bag is told as such; another trajectory without one ends it where it starts, 100 ms."""
    stamps, target, arm = arc()
    series = [
        rx.JointSeries(topic, JOINTS, stamps * STEP, q) for topic, q in (("/joint_states", arm), (SETPOINTS, target))
    ]
    messages = []
    for begin, rest in ((0, first), *((begin, 0) for begin in second)):
        times = [{"sec": 0, "nanosec": (rest + more) * STEP} for more in (0, 50)]
        points = [{"positions": [0.0] * 6, "velocities": [0.0] * 6, "time_from_start": time} for time in times]
        content = {"joint_names": list(JOINTS), "points": points}
        messages.append(trajectory_message("/rx90_controller/trajectory_accepted", begin * STEP, content))
    rx.write_joint_states(tmp_path / "bag", series, messages=messages)
    found = recorded_accuracy(tmp_path / "bag", shipped.robot, rx.RobotFiles())._asdict()
    counted = {kind: np.rint(part.times * 1e3).astype(int).tolist() for kind, part in found.items() if part is not None}
    border = 100 if second else 501
    ways = {"line": range(border, 501), "approach": range(50, border)}
    assert counted == {kind: [*ways[kind]] for kind in kinds}
    assert run("rx90 bag", ["path", str(tmp_path / "bag")]) == 0
    said = capsys.readouterr().out.splitlines()
    assert ["approach" if ": approach: path error" in line else "line" for line in said] == kinds


def test_a_recording_is_cut_where_set_points_have_a_speed(tmp_path: Path) -> None:
    """0.9 mrad/s at 1 kHz are one; set-points without positions tell nothing."""
    stamps = np.arange(5)
    moving = np.outer(stamps, [0.9e-6] * 6)
    for field, cut in (("position", True), ("velocity", False)):
        rx.write_joint_states(tmp_path / field, [rx.JointSeries(SETPOINTS, JOINTS, stamps * STEP, **{field: moving})])
        assert ends_in_motion(tmp_path / field) is cut


def test_joints_are_found_in_a_namespace_and_behind_gears(shipped: Setup, tmp_path: Path) -> None:
    """In any order and company, after a reset, and from the motors' states, motor 6 with joints 5 and 6."""
    stamps, target, arm = arc()
    motors = shipped.drives.gear * np.column_stack([arm[:, :5], arm[:, 4] + arm[:, 5]])
    order = [*JOINTS[::-1], "rail"]
    of_joints = [("/cell/joint_states", 0, joint_state(10**12, order, [0.0] * 7))]  # before the reset
    of_motors = []
    for k in stamps.tolist():
        time = k * STEP
        of_joints.append(("/cell/joint_states", time, joint_state(time, order, [*arm[k, ::-1], 7.0])))
        of_joints.append(("/cell/sampled/joint_states", time, joint_state(time, JOINTS, [0.0] * 6)))
        of_joints.append((f"/cell{SETPOINTS}", time, joint_state(time, JOINTS, target[k])))
        of_motors.append(("/motor_states", time, joint_state(time, MOTORS, motors[k])))
        of_motors.append((SETPOINTS, time, joint_state(time, JOINTS, target[k])))
    errors = []
    for name, messages in (("joints", of_joints), ("motors", of_motors)):
        found, _ = recorded_accuracy(write_ros2(tmp_path / name, messages), shipped.robot, rx.RobotFiles())
        errors.append(found.perpendicular)
    assert len(errors[0]) == 451
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-12)


def test_what_has_none_is_said_and_what_is_another_arm_refused(shipped: Setup, tx40: Setup, tmp_path: Path) -> None:
    """No set-points: nothing. Two arms, another robot's bag: a line with what is accepted."""
    states = [("/joint_states", k, joint_state(k * STEP, JOINTS, [0.1] * 6)) for k in range(3)]
    assert (
        recorded_accuracy(write_ros2(tmp_path / "none", states), shipped.robot, rx.RobotFiles()) == RecordedAccuracy()
    )
    two = [(f"/{arm}/joint_states", k, message) for arm in "ab" for _, k, message in states]
    with pytest.raises(BagError, match="holds several arms, /a/joint_states, /b/joint_states; accepted: a bag of one"):
        recorded_accuracy(write_ros2(tmp_path / "two", two), shipped.robot, rx.RobotFiles())
    with pytest.raises(BagError, match=r"recorded of the robot 'rx90b'.*--robot"):
        recorded_accuracy(REFERENCE, tx40.robot, rx.RobotFiles.named("tx40"))
