"""`rx90_run` refuses what it cannot do before it runs anything."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rx90_emulator.cli.frame import run


def test_what_cannot_be_written_is_refused_before_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A decimation of 0, a start without end and a bag that exists are one line each, and nothing is simulated."""
    (tmp_path / "file").touch()
    for words, complaint in (
        (["--decimation", "0"], "--decimation is 0; accepted: a whole number >= 1"),
        (["--start-time", "inf"], "start time is inf s; accepted: a finite number up to 2.14748e+09 s"),
        (["--output", str(tmp_path)], f"--output is {tmp_path}, which exists; accepted: a new folder"),
        (["--output", f"{tmp_path}/file/bag"], f"{tmp_path}/file/bag: cannot be written (Not a directory)"),
        (["--arrays", f"{tmp_path}/file/a.npz"], f"{tmp_path}/file/a.npz: cannot be written (Not a directory)"),
    ):
        assert run("rx90_run", words) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.splitlines()[-1] == f"rx90_run: {complaint}"
        assert "Traceback" not in err


TRAJECTORY = """
header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}
joint_names: [joint_6, joint_1, joint_2, joint_3, joint_4, joint_5]
points:
- {positions: [0.5, 0.0, 0.1, 0.2, 0.0, 0.3], time_from_start: {sec: 0, nanosec: 0}}
- {positions: [0.6, 0.1, 0.1, 0.2, 0.0, 0.3], time_from_start: {sec: 0, nanosec: 500000000}}
"""


def test_a_trajectory_of_a_file_runs_into_arrays_with_units(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The arm starts in the file's first point, ends in its last, and every array is named with its unit."""
    file, arrays = tmp_path / "move.yaml", tmp_path / "run.npz"
    file.write_text(TRAJECTORY)
    assert run("rx90_run", ["--trajectory", str(file), "--arrays", str(arrays)]) == 0
    assert "joint_6: worst tracking error" in capsys.readouterr().out
    with np.load(arrays) as stored:
        assert stored["joint names"].tolist() == [f"joint_{n}" for n in range(1, 7)]
        position = stored["joint_states position [rad]"]
        assert position[0] == pytest.approx([0.0, 0.1, 0.2, 0.0, 0.3, 0.5])
        assert position[-1] == pytest.approx([0.1, 0.1, 0.2, 0.0, 0.3, 0.6], abs=1e-3)
        assert len(stored["time [s]"]) == len(position) == 700
        assert stored["motor_commands effort [Nm]"].shape == (2800, 6)
        assert stored["base time [s]"][1] == 250e-6
        assert all("[" in name or name.endswith("names") for name in stored.files)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "accepted: the YAML of a trajectory_msgs/JointTrajectory"),
        ("points: 3", "accepted: the YAML of a trajectory_msgs/JointTrajectory"),
        ("a: [", "not valid YAML"),
        (TRAJECTORY.replace("joint_6", "elbow"), "elbow"),
        (TRAJECTORY.replace("0.5, 0.0, 0.1", ".nan, 0.0, 0.1"), "joint_6"),
    ],
)
def test_a_file_that_is_no_trajectory_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, complaint: str
) -> None:
    """What cannot be followed is refused in one line that names the file."""
    file = tmp_path / "move.yaml"
    file.write_text(text)
    assert run("rx90_run", ["--trajectory", str(file)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"rx90_run: {file}: ")
    assert complaint in err
    assert err.count("\n") == 1
