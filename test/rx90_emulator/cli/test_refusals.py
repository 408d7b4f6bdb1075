"""What commands cannot do: one line that says what is accepted, and nothing is made."""

import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from bag_making import series

from rx90_common.bags.writing import write_joint_states
from rx90_emulator.cli.frame import run


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make the bags a, off (other numbers), later (by 1000 s), more (of two topics), files in the way."""
    folder, a = tmp_path_factory.mktemp("bags"), series()
    write_joint_states(folder / "a", [a])
    write_joint_states(folder / "off", [series(seed=1)])
    write_joint_states(folder / "later", [replace(a, stamp_ns=a.stamp_ns + 10**12)])
    write_joint_states(folder / "more", [a, series(topic="motor_states")])
    task = "{start: [0.6, 0, 0.2], end: [2.6, 0, 0.2], speed: 0.1, acceleration: 1.0, tool_rpy_degrees: [0, 180, 0]}"
    (folder / "far.yaml").write_text(f"line: {task}")
    (folder / "mine.html").write_text("mine")
    (folder / "taken").mkdir()
    (folder / "taken" / "notes.txt").write_text("mine")
    (folder / "there").symlink_to("nowhere")
    return folder


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("compare a off --tolerance joint_states:joint_9:position=1", "joint_9, which no compared topic has"),
        ("compare a off --align 1e999999", "--align is '1e999999'; accepted: start, trajectory, or a time in s"),
        ("compare a a --align trajectory", "no trajectory in it; accepted: a bag with rx90_controller/trajectory"),
        ("plot a --topic joints", "no topic /joints; JointState topics: /joint_states"),
        ("plot a --output mine.html", "mine.html exists; accepted: another name, or --force"),
        ("export more --output x.csv", "x.csv would hold /joint_states, /motor_states; accepted: one topic"),
        ("export a --output x.mat", "x.mat: the suffix says the format; accepted: .csv, .parquet, .npz, or none"),
        ("record -o taken", "taken exists; accepted: a new name"),
        ("record -o new 'joint states'", "topic 'joint states': no name that ROS accepts"),
        ("record -o new a /a", "topic /a stands twice; accepted: each topic once"),
        (f"record -o {'x' * 250}", "its name has 250 bytes; accepted: up to 243"),
        ("rx90 run --output there", "there exists; accepted: a new name"),
        ("rx90 run --start-time 1e10", "start time is 10000000000.0 s; accepted: a finite number up to 2.14748e+09 s"),
        ("rx90 rig ramp --port emulated:a", "--port 'emulated:a'; accepted: emulated, emulated:SEED"),
        ("rx90 line robots/rx90b/task.yaml --acceleration 40 --dry-run", "would refuse the line: point 2: joint_1 has"),
        ("rx90 experiment excitation plan --wall 0 0 0 1", "--wall 0 0 0 1; accepted: NX NY NZ D"),
        ("rx90 demo --task far.yaml", "out of reach"),
    ],
)
def test_what_cannot_be_done_is_one_line(
    folder: Path, words: str, complaint: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, one line with what is wrong, nothing on standard output; no file is made or overwritten."""
    monkeypatch.chdir(folder)
    before = {path: path.lstat().st_mtime_ns for path in folder.rglob("*")}
    command = words if words.startswith("rx90 ") else f"rx90 bag {words}"
    name = " ".join(command.split()[:2])
    assert run("rx90", shlex.split(command)[1:]) == 2
    out, err = capsys.readouterr()
    *usage, line = err.splitlines()
    assert out == "" or name == "rx90 line"  # which shows the line before it is sent
    assert not usage or usage[0].startswith("usage: ")
    assert line.startswith(f"{name}: ")
    assert complaint in line
    assert {path: path.lstat().st_mtime_ns for path in folder.rglob("*")} == before
