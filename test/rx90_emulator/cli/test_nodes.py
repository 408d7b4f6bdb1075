"""Executables that end early: nodes by signals and mistakes, and all where a package is missing or broken."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from processes import Start

from rx90_common.base.share import ROOT
from rx90_common.process.requirements import SOURCES, is_ros, missing_module
from rx90_emulator.cli.frame import COMMANDS

NODE = """
import sys, time
import rclpy
from rclpy.node import Node
from rx90_common.base.errors import ConfigError
from rx90_common.exchange import lifecycle
from rx90_common.exchange.parameters import NodeModel, NodeParameters
from rx90_common.base.models import quantity
from typing import Annotated

class Parameters(NodeModel):
    value: Annotated[float, quantity("1", "A number.", ge=0.0, le=2.0)] = 1.0

class Stub:
    def __init__(self):
        self.node = Node("stub", automatically_declare_parameters_from_overrides=True)
        self.value = Parameters.of(NodeParameters(self.node).values).value
        if self.value == 2.0:
            raise ConfigError("value is 2; accepted: less")
        self.running = True
    def tick_loop(self):
        print("up", flush=True)
        while self.running:
            time.sleep(0.01)
            if self.value == 0.5:
                raise ConfigError("the ticks have ended")
    def stop(self):
        self.running = False

def spin(args):
    print("importing done", flush=True)
    lifecycle.spin(lambda: [Stub()], args)
"""
RUN = """
import sys
from rx90_emulator.cli import frame, node
node.NODES["stub"] = "stub_node"
sys.exit(frame.execute("stub"))
"""


@pytest.fixture
def start(tmp_path: Path, ros_domain: int, start_apart: Start) -> Start:  # noqa: ARG001 - a domain of its own
    (tmp_path / "stub_node.py").write_text(NODE, encoding="utf-8")
    environment = dict(os.environ, PYTHONPATH=f"{ROOT}:{tmp_path}")
    return lambda *arguments: start_apart(sys.executable, "-c", RUN, *arguments, env=environment)


@pytest.mark.ros
@pytest.mark.parametrize(
    ("moment", "number"),
    [
        ("importing done", signal.SIGINT),
        ("importing done", signal.SIGTERM),
        ("up", signal.SIGINT),
        ("up", signal.SIGHUP),
    ],
)
def test_a_signal_ends_in_order_and_silently(
    start: Start, moment: str, number: signal.Signals, request: pytest.FixtureRequest
) -> None:
    """Ctrl-C, SIGTERM and SIGHUP, also twice, while starting and while running: exit code 0, nothing on stderr."""
    if moment == "up":
        request.getfixturevalue("warm")
    process = start()
    assert any(line == f"{moment}\n" for line in process.stdout)
    process.send_signal(number)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")


@pytest.mark.ros
@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--ros-args", "-p", "value:=2.0"), "value is 2; accepted: less"),
        (("--ros-args", "-p", "value:=0.5"), "the ticks have ended"),
        (("--ros-args", "-p", "value:=high"), "parameter value is 'high'; accepted: a number in [0, 2]"),
        (("--ros-args", "-p", "value"), "ROS arguments --ros-args -p value: refused ("),
    ],
)
@pytest.mark.usefixtures("warm")
def test_a_user_mistake_is_one_line(start: Start, arguments: tuple[str, ...], complaint: str) -> None:
    """A refused value, from ROS, the constructor or the ticks, is one line on stderr and exit code 2."""
    process = start(*arguments)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert errors.startswith("stub: ")
    assert complaint in errors
    assert errors.count("\n") == 1


CALLS = {
    "rx90_sim": ([], "rclpy"),
    "rx90_controller": ([], "numpy"),
    "rx90_cell": ([], "rclpy"),
    "friction_bench": ([], "serial"),
    "rx90 rig ramp": (["--output", "out"], "tqdm"),
    "rx90 rig emulator": ([], "numba"),
    "rx90 bag": (["record", "--output", "bag"], "rosbags"),
    "rx90 identify compare": (["bag"], "scipy"),
    "rx90 completion": (["bash"], "shtab"),
    "rx90 config": (["show"], "pinocchio"),
    "rx90 check": (["true"], "rclpy"),
    "rx90 correct": (["engine", "robots/rx90b/task.yaml", "--output", "out.yaml"], "scipy"),
    "rx90 demo": ([], "bokeh"),
    "rx90 experiment sliding": (["plan"], "rosbags"),
    "rx90 export": (["mujoco-classic", "--output", "out"], "scipy"),
    "rx90 identify": (["sliding", "bag", "--output", "out.yaml"], "yaml"),
    "rx90 line": ([], "yaml"),
    "rx90 monitor": (["engine"], "lark"),
    "rx90 path": (["paths/circle.yaml"], "numba"),
    "rx90 program": (["engine", "a.v2"], "lark"),
    "rx90 replay": (["bag"], "pinocchio"),
    "rx90 run": ([], "pinocchio"),
    "rx90 sweep": (["info", "out.parquet"], "pyarrow"),
    "rx90 view": (["--port", "0", "--no-browser"], "viser"),
}
"""A call of each executable that begins its work, and a package without which that cannot be done."""

CHILD = """
import importlib, json, os, sys, tempfile
from rx90_emulator.cli import frame

# Each call does without one package: what takes time in importing the others is done once. Not rclpy: it has threads.
for library in ("pinocchio", "rosbags.rosbag2", "scipy.optimize", "matplotlib.figure", "ruamel.yaml"):
    importlib.import_module(library)
own = set(sys.modules)
importlib.import_module("rx90_emulator.loop.setup")  # numba, with all that its first function takes
own = {name for name in set(sys.modules) - own if name.startswith("rx90_")}
there = {name.partition(".")[0] for name in sys.modules}

class Blocked:
    def __init__(self, package, broken):
        self.package, self.broken = package, broken
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == self.package:
            if self.broken:  # as an extension module that finds another NumPy than it was built for
                raise ImportError("NumPy 1.26.4\\nis too old", name=f"{name}._core")
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

for program, words, package, broken in json.load(sys.stdin):
    with tempfile.TemporaryFile("w+") as errors:
        child = os.fork()
        if child == 0:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            os.dup2(errors.fileno(), 2)
            if package in there:
                for name in [name for name in sys.modules if name.partition(".")[0] == package or name in own]:
                    del sys.modules[name]
            sys.meta_path.insert(0, Blocked(package, broken))
            try:
                code = frame.run(program, words)
            finally:
                os._exit(code if "code" in locals() else 1)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        errors.seek(0)
        print(json.dumps([code, errors.read()]), flush=True)
"""


def test_every_executable_says_what_is_missing(tmp_path: Path) -> None:
    """Without a package each executable, a node too, ends with 3 and a line: package, distribution, how to get it."""
    assert {" ".join(name.split()[:2]) for name in CALLS} == set(COMMANDS)
    (tmp_path / "a.v2").write_text(".PROGRAM a()\n.END\n", encoding="utf-8")
    (tmp_path / "part.dxf").touch()
    drawn = "path: {file: {name: part.dxf}, speed: 0.1, acceleration: 1.0, tool_rpy_degrees: [0, 180, 0]}\n"
    (tmp_path / "drawn.yaml").write_text(drawn, encoding="utf-8")
    before = set(tmp_path.iterdir())
    cases = [(name, words, package, False) for name, (words, package) in CALLS.items()]
    cases += [("rx90_sim", [], "numba", broken) for broken in (False, True)]
    cases += [("rx90 sweep", ["info", "x"], "pyarrow", True), ("rx90 path", ["drawn.yaml"], "ezdxf", False)]
    done = subprocess.run(
        [sys.executable, "-c", CHILD], input=json.dumps(cases), cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True, timeout=600,
    )  # fmt: skip
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    for (program, words, package, broken), (code, errors) in zip(cases, answers, strict=True):
        assert (code, errors.count("\n")) == (3, 1), (program, words, package, errors)
        command = " ".join(program.split()[:2])
        if broken:
            start = f"{command}: {package} cannot be loaded (NumPy 1.26.4 is too old); accepted: a version"
        else:
            start = f"{command}: needs {package}, which is not installed; accepted: "
            where = "a sourced ROS 2 Jazzy" if is_ros(package) else SOURCES[package]
            assert where in errors.removeprefix(start), errors
        assert errors.startswith(start), errors
    assert set(tmp_path.iterdir()) == before


def test_each_source_is_a_distribution_of_the_set_up() -> None:
    """What pip is told to install is what setup.py requires, or offers as an extra."""
    named = set(re.findall(r'"([A-Za-z0-9-]+)>=', (ROOT / "setup.py").read_text(encoding="utf-8")))
    assert set(SOURCES.values()) <= named


def test_an_error_of_the_project_itself_is_none_of_a_package() -> None:
    """A name that a module of the project lacks stays an error with its traceback."""
    with pytest.raises(ImportError) as caught:
        exec("from rx90_common.base.errors import Nothing")
    assert missing_module(caught.value) is None
