"""`rx90 run` refuses what it cannot do before it runs anything."""

from pathlib import Path

import pytest

import rx90_emulator as rx
from rx90_common.base.config import read_yaml
from rx90_common.base.errors import BagError
from rx90_common.base.share import config_path
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.robot import RecordedRobot

TRAJECTORY = """
header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}
joint_names: [joint_6, joint_1, joint_2, joint_3, joint_4, joint_5]
points:
- {positions: [0.5, 0.0, 0.1, 0.2, 0.0, 0.3], time_from_start: {sec: 0, nanosec: 0}}
- {positions: [0.6, 0.1, 0.1, 0.2, 0.0, 0.3], time_from_start: {sec: 0, nanosec: 500000000}}
"""


def test_a_trajectory_of_a_file_runs_into_a_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The arm starts in the file's first point and ends in its last; all series are there."""
    file, bag = tmp_path / "move.yaml", tmp_path / "bag"
    file.write_text(TRAJECTORY)
    assert run("rx90 run", [str(file), "--output", str(bag)]) == 0
    said = capsys.readouterr().out
    assert "joint_6: worst tracking error" in said
    assert "path error 0." in said
    stored = rx.read_bag(bag)
    position = stored["joint_states"].position
    assert stored["joint_states"].names == tuple(f"joint_{n}" for n in range(1, 7))
    assert position[0] == pytest.approx([0.0, 0.1, 0.2, 0.0, 0.3, 0.5])
    assert position[-1] == pytest.approx([0.1, 0.1, 0.2, 0.0, 0.3, 0.6], abs=1e-3)
    assert len(position) == 700
    assert stored["motor_commands"].effort.shape == (2800, 6)


def test_an_initial_position_has_a_number_for_each_joint(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The seven-joint arm begins where seven numbers say, eight are refused; its bag compares as measured."""
    names = ", ".join(f"panda_joint{number}" for number in range(1, 8))
    file = tmp_path / "move.yaml"
    start = ["0", "0.1", "0", "-1.5", "0", "1.5", "0"]
    point = "{positions: [0.4, 0.5, 0.4, -1.1, 0.4, 1.9, 0.4], time_from_start: {sec: 2}}"
    file.write_text(f"joint_names: [{names}]\npoints:\n- {point}\n")
    words, bag = [str(file), "--robot", "panda", "--initial-position"], str(tmp_path / "bag")
    assert run("rx90 run", [*words, *start, "--output", bag]) == 0
    assert f"begins at rest at {', '.join(start)} rad" in capsys.readouterr().out
    assert run("rx90 run", [*words, *start, "0"]) == 2
    said = "rx90 run: --initial-position has 8 numbers; accepted: 7, one for each joint"
    assert capsys.readouterr().err.splitlines()[-1] == said
    assert run("rx90 config", ["check", str(config_path("robots/panda"))]) == 0
    assert run("rx90 identify compare", [bag, "--robot", "panda", "--topic", "joint_states"]) == 0
    assert "panda_joint7" in capsys.readouterr().out


LATER = """
joint_names: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]
points:
- {positions: [0.05, 0.05, 0.1, 0.0, 0.05, 0.1], time_from_start: {sec: 0, nanosec: 400000000}}
"""


def test_a_run_found_in_a_bag_is_done_again_bit_by_bit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """From a bag alone come trajectory, start, pose and the same bits; other gains are named, another robot refused."""
    robot = ["--robot", "tx40"]
    file, first, second = tmp_path / "move.yaml", tmp_path / "fir\nst", tmp_path / "second"
    file.write_text(LATER)
    given = ["--initial-position", *["0.0"] * 6, "--seed", "4", "--start-time", "0.2"]
    assert run("rx90 run", [str(file), *given, *robot, "--output", str(first)]) == 0
    capsys.readouterr()
    for words, line in (([], "seed 4, as the bag tells\n"), (["--seed", "5"], "")):
        assert run("rx90 replay", [str(first), *robot, *words]) == 0
        out, err = capsys.readouterr()
        assert "".join(each for each in out.splitlines(keepends=True) if "seed" in each) == line
        assert err == ("rx90 replay: warning: the seed of that run was 4; here --seed 5 holds\n" if words else "")
    said = "recorded of the robot 'tx40', not of 'rx90b'; accepted: a bag of that robot, or --robot with the bag's"
    assert run("rx90 replay", [str(first), "--output", str(second)]) == 2
    assert said in capsys.readouterr().err
    with pytest.raises(BagError, match=said):
        RecordedRobot.load(rx.RobotOptions()).layout(first, fast=True)
    assert RecordedRobot.load(rx.RobotOptions(robot="tx40")).layout(first, fast=True).topic == "motor_states"
    own = read_yaml(config_path("robots/tx40/controller.yaml"))
    told = {f"{of}.{key}": value for of in ("servo", "feed_forward", "supervision") for key, value in own[of].items()}
    told |= {"servo.kv": [100.0] * 6, "feed_forward.coulomb": False, "constraints.goal_time": 3.0}
    told |= {"allow_partial_joints_goal": True, "allow_trajectory_replacement": False}
    told = {name: value for name, value in told.items() if not name.endswith((".provenance", ".source"))}
    monkeypatch.setattr("rx90_emulator.loop.recorded_run.read_values", lambda _: told)
    assert run("rx90 replay", [str(first), *robot, "--output", str(second)]) == 0
    out, err = capsys.readouterr()
    assert (
        "rx90 replay: warning: allow_partial_joints_goal, feed_forward.coulomb, servo.kv had other values in that run"
        in err
    )
    assert f"trajectories in {tmp_path}/fir\\nst: 1, from 0.200 s\nseed 0: the bag tells none\n" in out
    assert run("rx90 bag", ["compare", str(first), str(second)]) == 0
    position = rx.read_bag(first)["joint_states"].position
    assert position[0].tolist() == [0.0] * 6
    assert position[-1] == pytest.approx([0.05, 0.05, 0.1, 0.0, 0.05, 0.1], abs=1e-3)
