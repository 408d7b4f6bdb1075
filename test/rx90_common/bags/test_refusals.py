"""What `rx90_bag`, and others that make bags, cannot do: one line that says what is accepted, and nothing is made."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from bag_making import series

from rx90_common.bags.writing import write_joint_states
from rx90_emulator.cli.frame import run

LONG = "x" * 250
TOO_LONG = "its name has 250 bytes; accepted: up to 243"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make the bags a, off (other numbers), later (by 1000 s) and more (of two topics), and files in the way."""
    folder, a = tmp_path_factory.mktemp("bags"), series()
    write_joint_states(folder / "a", [a])
    write_joint_states(folder / "off", [series(seed=1)])
    write_joint_states(folder / "later", [replace(a, stamp_ns=a.stamp_ns + 10**12)])
    write_joint_states(folder / "more", [a, series(topic="motor_states")])
    (folder / "odd.yaml").write_text("joint_states: {speed: 1.0}")
    (folder / "mine.html").write_text("mine")
    (folder / "taken").mkdir()
    (folder / "taken" / "notes.txt").write_text("mine")
    return folder


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("compare a off --tolerance joint_states:speed=1", "accepted: position, velocity, effort"),
        ("compare a off --tolerance position=-1", "accepted: a finite number >= 0"),
        ("compare a off --tolerance position", "accepted: [TOPIC:[JOINT:]]FIELD=VALUE"),
        ("compare a off --tolerance joint_state:position=1", "/joint_state, which is in neither bag"),
        ("compare a off --tolerance joint_states:joint_9:position=1", "joint_9, which no compared topic has"),
        ("compare a off --tolerance *:joint_9:position=1", "joint_9, which no compared topic has"),
        ("compare a off --tolerances odd.yaml", "joint_states.speed is not a known key"),
        ("compare a off --topics elbow", "/elbow is in neither bag; JointState topics: /joint_states"),
        ("compare a off --from soon", "--from is 'soon'; accepted: a time in s"),
        (
            "compare a off --from 1e999999",
            "--from is '1e999999'; accepted: a time in s, e.g. 1.25, up to 4,294,967",
        ),
        ("compare a off --from 2 --to 1", "accepted: a start before the end"),
        ("compare a off --from 100", "in the time window"),
        ("compare a nowhere", "nowhere: no such bag"),
        (
            "compare a a --align trajectory",
            "no trajectory in it; accepted: a bag with rx90_controller/trajectory",
        ),
        ("plot a --topic joints", "no topic /joints; JointState topics: /joint_states"),
        ("plot a --joint elbow", "/joint_states: no joint 'elbow'; there are joint_1, joint_2, joint_3"),
        ("plot a --output a.gif", "a.gif: the suffix says what it is; accepted: .html, .png, .svg, .pdf"),
        ("plot a --output mine.html", "mine.html exists; accepted: another name, or --force"),
        ("plot a later", "/joint_states: no stamp is in both bags, t = 0 to 0.019 s and 1000 to 1000.019 s; accep"),
        ("plot a off --align x", "--align is 'x'; accepted: start, trajectory, or a time in s"),
        ("export more --output x.csv", "x.csv would hold 2 topics, /joint_states, /motor_states"),
        ("export more --output x.npz --topic joints", "no topic /joints; JointState topics: "),
        ("export a --output taken", "taken exists; accepted: a new name"),
        ("export a --output x.mat", "x.mat: the suffix says the format; accepted: .csv, .parquet, .npz, or none"),
        ("export nowhere --output x.csv", "nowhere: no such bag"),
        ("record -o taken", "taken exists; accepted: a new name"),
        ("record -o new 'joint states'", "topic 'joint states': no name that ROS accepts"),
        ("record -o new a /a", "topic /a stands twice; accepted: each topic once"),
        ("record -o new a --ros-args nonsense", "ROS arguments --ros-args nonsense: refused"),
        ("record -o taken/notes.txt/bag", "taken/notes.txt/bag: cannot be written (Not a directory)"),
        (f"record -o {LONG}", TOO_LONG),
        (f"import none.csv {LONG}", TOO_LONG),
        (f"export none -o {LONG}", TOO_LONG),
        (f"rx90_run --start 0.6 -0.2 0.2 --end 0.6 0.2 0.2 --output {LONG}", TOO_LONG),
        (f"rx90_experiment run --engine --output {LONG}", TOO_LONG),
    ],
)
def test_what_cannot_be_done_is_one_line(
    folder: Path, words: str, complaint: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, one line with what is wrong, nothing on standard output; no file is made or overwritten."""
    monkeypatch.chdir(folder)
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    name, *arguments = shlex.split(words if words.startswith("rx90_") else f"rx90_bag {words}")
    assert run(name, arguments) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(f"{name}: ")
    assert complaint in err
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
