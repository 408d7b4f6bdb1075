"""`import rx90_emulator as rx`: what it offers, how it documents itself, and that it costs nothing until it is used."""

import ast
import dataclasses
import inspect
import math
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import full_friction
import numpy as np
import pytest

import rx90_emulator as rx
from rx90_common.base.share import config_path

ROOT = Path(__file__).resolve().parents[2]
LIGHT = "numpy scipy numba pinocchio rclpy rosbags matplotlib pyarrow yaml tqdm jinja2 serial"


def test_importing_costs_nothing() -> None:
    """The import itself brings in no library, no module of the project, and takes less than 50 ms of the processor."""
    code = (
        "import sys, time; began = time.process_time(); import rx90_emulator; took = time.process_time() - began; "
        f"print([m for m in '{LIGHT}'.split() if m in sys.modules], "
        "[m for m in sys.modules if m.startswith('rx90_') and m != 'rx90_emulator'], took < 0.05)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "[] [] True\n"


def test_every_name_explains_itself() -> None:
    """Each name has a docstring that begins with a sentence, and each function a type for all it takes and gives."""
    tree = ast.parse(Path(rx.__file__).read_text(encoding="utf-8"))
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))
    typed = {one.asname: node.module for node in imports for one in node.names if one.asname == one.name}
    assert typed == rx._HOMES
    assert len(typed) <= 70
    assert [name for name in dir(rx) if not name.startswith("__")] == sorted(rx.__all__) == sorted(typed)
    for name in rx.__all__:
        found = getattr(rx, name)
        text = inspect.getdoc(found)
        assert text, name
        assert not text.startswith(f"{name}("), "the docstring that dataclass() makes up"
        assert re.search(rf"\b{name}\b", rx.__doc__ or ""), name
        if inspect.isfunction(found):
            signature = inspect.signature(found)
            assert signature.return_annotation is not inspect.Signature.empty, name
            assert all(p.annotation is not inspect.Parameter.empty for p in signature.parameters.values()), name
    with pytest.raises(AttributeError, match=r"no attribute 'load_setups'; help\(rx90_emulator\) lists them"):
        _ = rx.load_setups  # type: ignore[attr-defined]


def test_parameters_are_listed_with_their_units_and_can_be_set_back() -> None:
    """Every listed path can be set, and setting all of them to what they are changes no number of plant and law."""
    setup = rx.load_setup()
    listed = rx.parameters(setup)
    assert listed["friction.joint_5_6.tau_s_negative"].unit == "Nm"
    assert listed["controller.feed_forward.coulomb"] == (True, "switch")
    assert listed["drives.gear[5]"].value == setup.drives.gear[5]
    assert len(listed) > 150
    again = rx.with_parameters(setup, {path: value for path, (value, _) in listed.items()})
    assert again.plant().constants.tobytes() == setup.plant().constants.tobytes()
    assert again.cs7b().law.tobytes() == setup.cs7b().law.tobytes()


def test_a_run_and_its_bag_give_the_same_series(shipped: rx.Setup, task: rx.LineTask, tmp_path: Path) -> None:
    """A bag gives back every topic of the run, its names, stamps and values, to the last bit."""
    run = rx.run_line(shipped, task, record_fast=True)
    rx.write_bag(run, tmp_path / "bag")
    bag = rx.read_bag(tmp_path / "bag")
    assert set(bag) == set(run.series)
    for topic, series in run.series.items():
        assert series.topic == f"/{topic}"
        assert bag[topic].names == series.names
        assert bag[topic].stamp_ns.tobytes() == series.stamp_ns.tobytes()
        assert {f: v.tobytes() for f, v in bag[topic].fields.items()} == {
            f: v.tobytes() for f, v in series.fields.items()
        }
    assert run.series["friction_states"].quantities["effort"] == "friction torque [Nm]"
    assert list(rx.read_bag(tmp_path / "bag", ["motor_states"])) == ["motor_states"]


HOME = [0.0, 0.3, 1.1, 0.0, 0.7, 0.0]
JOINTS = tuple(f"joint_{i}" for i in range(1, 7))


REST = rx.TrajectoryPoints.create(JOINTS, JOINTS, [0.0, 0.1], [HOME, HOME], [[0.0] * 6] * 2, [[], []])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: rx.simulate(s, REST, duration=1e9), "4e\\+12 ticks does not fit into memory"),
        (lambda s: rx.path_accuracy(s.robot, rx.load_task(), np.zeros(5), np.zeros((4, 6))), r"accepted: \(5, 6\)"),
        (lambda s: rx.path_accuracy(s.robot, rx.load_task(), [1.0], [[np.nan] * 6]), "accepted: finite numbers"),
        (lambda _: rx.Sweep(rx.SweepPlan.of_grid({"task.speed": [0.1]})).simulate(1), "run 1; accepted: 0 to 0"),
        (lambda s: rx.run_line(rx.load_task(), s), "setup is of type LineTask; accepted: Setup"),
    ],
)
def test_nonsense_is_refused_in_one_line(call: Callable[[rx.Setup], object], message: str) -> None:
    """Values and shapes without a meaning are an Rx90Error with what is accepted, another type is a TypeError."""
    with pytest.raises(TypeError if "is of type" in message else rx.Rx90Error, match=message) as refused:
        call(rx.load_setup())
    assert "\n" not in str(refused.value)


def test_the_api_warns_of_what_rx90_run_announces() -> None:
    """Friction that is not passive (from 4 tau_c / c1 = 1 rad/s) and joints too warm for their law are warnings."""
    hot = dict.fromkeys(("highest", "start", "ambient"), 41.0)
    warm = full_friction.PARTS["temperature"].replaced(capacity=0.01, resistance=1e3, **hot)
    setup = rx.load_setup()
    first, *others = setup.friction.elements
    elements = (first.replaced(omega_d=math.inf, temperature=warm), *others)
    setup = dataclasses.replace(setup, friction=dataclasses.replace(setup.friction, elements=elements))
    with pytest.warns(rx.Rx90Warning) as caught:
        run = rx.simulate(setup, REST, duration=1.3)
    lines = [str(one.message) for one in caught]
    assert len(lines) == 2
    assert re.search(r"joint_1\.c1 is 100 Nm s/rad, not passive from 1 rad/s on", lines[0])
    assert lines[1].startswith("joint_1 at ")
    assert {one.filename for one in caught} == {__file__}
    stored = run.slow.temperatures
    assert stored[0].tolist() == [41.0] + [0.0] * 6
    assert np.ptp(stored[:, 0]) > 0.0


LATIN = """
import sys
names = set(dir())
from rx90_emulator import *
print(*sorted(set(dir()) - names - {"names"}), "rclpy" in sys.modules)
from rx90_emulator.cli.frame import execute
raise SystemExit(execute("rx90 config", ["show", "--robot", "./arm"]))
"""


@pytest.mark.slow
def test_a_star_import_brings_in_all_but_ros_where_the_locale_has_ascii_alone(tmp_path: Path) -> None:
    """Each name is bound, no other; every text file is UTF-8; a character that the output lacks is its number."""
    folder = tmp_path / "arm"
    shutil.copytree(config_path("robots/rx90b"), folder)
    file = folder / "friction.yaml"
    text = re.sub(r"^source: .*$", "source: µ of größer", file.read_text(encoding="utf-8"), count=1, flags=re.MULTILINE)
    file.write_text(text, encoding="utf-8")
    bare = {name: value for name, value in os.environ.items() if not name.startswith(("LC_", "LANG"))}
    bare |= {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run([sys.executable, "-c", LATIN], cwd=tmp_path, env=bare, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.decode().splitlines()[0].split() == [*sorted(rx.__all__), "False"]
