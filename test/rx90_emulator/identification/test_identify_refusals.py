"""Whatever a user does wrong with `rx90_identify`: one line, the documented status, and nothing written."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from bag_making import joint_state, write_ros2
from foreign_arms import Curve, Program, drive_torque, urdf_text, write, write_fallback

from rx90_emulator.cli.frame import run

CURVE = Curve(6.0, 5.5, 7.8, 7.0, 0.05, 1.2, 2.5)
RATE = 100.0
Change = Callable[["Bench"], list[object]]


class Bench:
    """A folder with a good URDF, bag and fallback of a single joint, and what else a case makes of them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.urdf = folder / "arm.urdf"
        self.urdf.write_text(urdf_text(["hinge"], ["0 1 0"], [2.0]), encoding="utf-8")
        model = pin.buildModelFromXML(self.urdf.read_text(encoding="utf-8"))
        self.position, self.velocity = Program([[1.0]], [[0.2]], np.geomspace(0.02, 1.0, 6).tolist(), RATE).motion()
        self.torque = drive_torque(model, np.eye(1), [CURVE], (self.position, self.velocity), RATE)
        self.bag = self.write("good")
        self.fallback = write_fallback(folder / "fallback.yaml", ["hinge"])

    def write(self, name: str, rows: Any = slice(None), **fields: Any) -> Path:
        """Write a bag with some fields or rows changed."""
        found = {"position": self.position, "velocity": self.velocity, "effort": self.torque} | fields
        values = [None if value is None else value[rows] for value in found.values()]
        return write(self.folder / name, "/joint_states", ["hinge"], RATE, tuple(values))  # type: ignore[arg-type]

    def file(self, name: str, text: str | bytes) -> Path:
        """Write a file."""
        path = self.folder / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """Return the good files, made once."""
    return Bench(tmp_path_factory.mktemp("bench"))


@pytest.fixture
def bench(made: Bench, tmp_path: Path) -> Bench:
    """Return the good files, with a folder of the test's own."""
    made.folder = tmp_path
    return made


def sliding(bag: Callable[[Bench], Path]) -> Change:
    """Return the options that give another bag in place of the good one."""
    return lambda bench: ["--sliding", bag(bench)]


def options(*words: object) -> Change:
    """Return options beside those of the good bag."""
    return lambda bench: ["--sliding", bench.bag, *words]


def urdf(text: Callable[[str], str]) -> Change:
    """Return the option of a changed URDF."""
    return lambda bench: ["--sliding", bench.bag, "--urdf", bench.file("bad.urdf", text(bench.urdf.read_text()))]


def truncated(bench: Bench, storage: str, rosbag2: bool = True) -> Path:
    """Return a bag whose storage file ends in the middle."""
    rows = (bench.position, None, bench.torque)
    path = write(bench.folder / ("cut" if rosbag2 else "cut.bag"), "/joint_states", ["hinge"], RATE, rows, storage)
    file = next(path.glob(f"*.{'db3' if storage == 'sqlite3' else storage}")) if rosbag2 else path
    os.truncate(file, file.stat().st_size // 2)
    return path


def stamped_back(bench: Bench) -> Path:
    """Return a bag whose stamps go back once."""
    rows = [("/joint_states", 10**9 + k, joint_state(stamp, ["hinge"], [0.0], [], [1.0]))
            for k, stamp in enumerate((2 * 10**9, 3 * 10**9, 10**9))]  # fmt: skip
    return write_ros2(bench.folder / "back", rows)


def directory(bench: Bench, name: str) -> Path:
    """Return a new folder."""
    path = bench.folder / name
    path.mkdir()
    return path


def copied(bench: Bench) -> Path:
    """Return a copy of the good bag under another name."""
    return Path(shutil.copytree(bench.bag, bench.folder / "copy"))


def pinned(bench: Bench) -> Path:
    """Return a URDF in which a second joint mimics the first."""
    text = urdf_text(["hinge", "jaw"], ["0 1 0", "0 1 0"], [2.0, 1.0])
    head, tail = text.rsplit("</joint>", 1)
    return bench.file("mimic.urdf", f'{head}<mimic joint="hinge"/></joint>{tail}')


REFUSED = [
    # what the motions must be
    (
        "speeds",
        sliding(lambda b: b.write("few", slice(0, 820))),
        r"hinge slides at \d speeds in positive and \d in .*5 or more",
    ),
    (
        "forward",
        sliding(lambda b: b.write("forward", np.flatnonzero(b.velocity[:, 0] >= 0.0))),
        "at positive velocities only; accepted: sweeps in both",
    ),
    ("rest", sliding(lambda b: b.write("rest", slice(0, 20))), "no stretch of constant velocity; accepted"),
    (
        "slow_presliding",
        lambda b: ["--sliding", b.bag, "--presliding", b.bag],
        "100 samples per second; accepted: 500 or more",
    ),
    (
        "no_presliding",
        options("--fallback", "none"),
        "no bag with micro-oscillations, .*accepted: --presliding BAG ..., or --fallback FILE",
    ),
    (
        "unmoved",
        lambda b: ["--sliding", b.bag, "--validation", b.write("still", slice(0, 4)), "--force"],
        "still: the arm does not move; accepted",
    ),
    (
        "other_fallback",
        options("--fallback", "robots/rx90b/friction.yaml"),
        "friction.yaml: elements.hinge is missing; accepted",
    ),
    # the bags
    ("nowhere", sliding(lambda b: b.folder / "nowhere"), "nowhere: no such bag"),
    ("empty", sliding(lambda b: b.write("empty", slice(0, 0))), "empty"),
    ("folder", sliding(lambda b: directory(b, "plain")), "plain"),
    ("text", sliding(lambda b: b.file("text.mcap", "no bag")), "text.mcap"),
    ("truncated_mcap", sliding(lambda b: truncated(b, "mcap")), "cut: cut.mcap is cut off"),
    ("truncated_db3", sliding(lambda b: truncated(b, "sqlite3")), "cut: cut.db3 is damaged: "),
    ("truncated_ros1", sliding(lambda b: truncated(b, "ros1", rosbag2=False)), "cut.bag: cut.bag is damaged: "),
    ("topic", options("--topic", "leg"), "no topic /leg; JointState topics: /joint_states"),
    ("zeros", options("--zero", "1", "2"), "--zero: 2 values; accepted: 1 for 1 joints"),
    ("names", options("--names", "elbow"), "no joint 'elbow'; there are hinge"),
    (
        "effort",
        sliding(lambda b: b.write("effort", effort=np.zeros((len(b.torque), 0)))),
        "carries no effort; accepted",
    ),
    ("nan_effort", sliding(lambda b: b.write("nan", effort=b.torque * np.nan)), "carries no effort; accepted"),
    ("nan_position", sliding(lambda b: b.write("nan", position=b.position * np.nan)), "carries no position; accepted"),
    ("back", sliding(stamped_back), "goes back from 3.0* s to 1.0* s; accepted"),
    (
        "unstamped",
        sliding(
            lambda b: write(
                b.folder / "zero", "/joint_states", ["hinge"], RATE, (b.position, None, b.torque), header=False
            )
        ),
        "every stamp is 0.0* s; accepted: .*--record-time",
    ),
    ("twice", lambda b: ["--sliding", b.bag, b.bag], "good: given twice for --sliding"),
    ("both", lambda b: [b.folder, "--sliding", b.bag], "accepted: a folder or single bags, not both"),
    ("none", lambda _: [], "no bag with sweeps"),
    ("long_series", lambda b: [b.folder / ("s" * 300)], "no experiments.yaml; accepted"),
    ("no_series", lambda b: [b.folder], "no experiments.yaml; accepted"),
    (
        "checked_by_itself",
        lambda b: ["--sliding", b.bag, "--validation", copied(b)],
        "copy: also used for the identification as .*good",
    ),
    ("driven", sliding(lambda b: b.write("driven", effort=-b.torque)), "hinge: the torque does not oppose the motion"),
    (
        "motor_angles",
        sliding(lambda b: b.write("motor", position=1e3 * b.position, velocity=1e3 * b.velocity)),
        r"hinge moves through \d+ rad, in its URDF through 6 rad at most; accepted: .*--gear",
    ),
    ("kinds", options("--bristle-kinds"), "--bristle-kinds without micro-oscillations; accepted: with --presliding"),
    # the robot
    ("no_urdf", options("--urdf", "nowhere.urdf"), r"nowhere.urdf: cannot be read \(No such file"),
    ("xml", urdf(lambda text: text[:-20]), "bad.urdf: no URDF that Pinocchio can read"),
    (
        "limit",
        urdf(lambda text: text.replace("<limit", "<no")),
        r"\[hinge\] is of type REVOLUTE but it does not specify limits",
    ),
    # Pinocchio 2 hands on another text of its URDF parser than Pinocchio 4.
    ("effort_limit", urdf(lambda text: text.replace("effort=", "strength=")), "limit has no effort|limit: no effort"),
    (
        "massless",
        urdf(lambda text: text.replace('mass value="2.0"', 'mass value="0"')),
        "'hinge' moves a mass of 0 kg; accepted: links with <inertial>",
    ),
    (
        "prismatic",
        urdf(lambda text: text.replace("revolute", "prismatic")),
        "'hinge' is prismatic; accepted: revolute and continuous",
    ),
    ("fixed", urdf(lambda text: text.replace("revolute", "fixed")), "no movable joint"),
    ("mimic", lambda b: ["--sliding", b.bag, "--urdf", pinned(b)], "'jaw' mimics hinge; accepted: .*--joints hinge"),
    ("joint", options("--joints", "elbow"), "no movable joint 'elbow'; there are hinge"),
    ("gears", options("--gear", 1, 2), "--gear: 2 values; accepted: 1 for 1 joints"),
    ("coupling_size", options("--coupling", 1, 2), "--coupling: 2 values; accepted: 1 for 1 joints"),
    ("coupling", options("--coupling", 0), r"coupling: \[\[0.0\]\]; accepted: an invertible matrix"),
    ("tool", options("--tool", "none"), "--tool with --urdf; accepted"),
    ("fallback", options("--fallback", "nowhere.yaml"), "nowhere.yaml"),
    (
        "bad_fallback",
        lambda b: ["--sliding", b.bag, "--fallback", b.file("bad.yaml", "elements: 3")],
        "elements is 3; accepted",
    ),
    # the result
    (
        "exists",
        lambda b: ["--sliding", b.bag, "--output", b.file("mine.yaml", "mine")],
        "mine.yaml exists; accepted: another name, or --force",
    ),
    (
        "report_exists",
        lambda b: ["--sliding", b.bag, "--report", b.file("mine.html", "mine")],
        "mine.html exists; accepted",
    ),
    (
        "is_folder",
        lambda b: ["--sliding", b.bag, "--force", "--output", directory(b, "out")],
        "out is a folder; accepted",
    ),
    ("device", options("--force", "--output", "/dev/full"), "/dev/full is no regular file; accepted"),
    ("no_folder", options("--output", "nowhere/f.yaml"), "nowhere does not exist; accepted"),
    ("long", lambda b: ["--sliding", b.bag, "--output", b.folder / f"{'f' * 300}.yaml"], "File name too long"),
    ("same", lambda b: ["--sliding", b.bag, "--output", b.folder / "f.html"], "--output and --report are both"),
]
WRONG = [
    (["--gear", "ten"], "argument --gear: 'ten'; accepted: a finite number other than 0"),
    (["--gear", "0"], "argument --gear: '0'; accepted"),
    (["--torque-constant", "nan"], "argument --torque-constant: 'nan'; accepted"),
    (["--coupling", "inf"], "argument --coupling: 'inf'; accepted: a finite number"),
    (["--rotor-inertia", "-1"], "argument --rotor-inertia: '-1'; accepted: 0 or a positive number"),
    (["--torque-delay", "1"], "argument --torque-delay: '1'; accepted: s, from -0.05 to 0.05"),
    (["--torque-tolerance", "0"], "argument --torque-tolerance: '0'; accepted: a positive number"),
]


def everything(folder: Path) -> dict[Path, bytes]:
    """Return all files below a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def arguments_of(bench: Bench, words: list[object]) -> list[str]:
    """Return the command's arguments: those of the good run first, which others override."""
    good = ["--urdf", bench.urdf, "--fallback", bench.fallback, "--output", bench.folder / "f.yaml"]
    return [str(word) for word in (*good, *words)]


@pytest.mark.parametrize(("change", "message"), [pytest.param(*case[1:], id=case[0]) for case in REFUSED])
def test_refused(bench: Bench, change: Change, message: str, capfd: pytest.CaptureFixture[str]) -> None:
    """A user's mistake is one line with what is accepted and status 3, and leaves every file as it was."""
    arguments = arguments_of(bench, change(bench))
    before = everything(bench.folder)
    assert run("rx90_identify", arguments) == 2
    said = [line for line in capfd.readouterr().err.replace("\r", "\n").splitlines() if line and "| " not in line]
    assert len(said) == 1, said
    assert said[0].startswith("rx90_identify: ")
    assert re.search(message, said[0]), said[0]
    assert everything(bench.folder) == before


@pytest.mark.parametrize(("words", "message"), WRONG)
def test_wrong_usage(bench: Bench, words: list[object], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A number that cannot be one ends with the value, what is accepted, and status 2."""
    assert run("rx90_identify", arguments_of(bench, ["--sliding", bench.bag, *words])) == 2
    assert message in capsys.readouterr().err.splitlines()[-1]
