"""`import rx90_emulator as rx`: what it offers, how it documents itself, and that it costs nothing until it is used."""

from __future__ import annotations

import ast
import inspect
import os
import pydoc
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import rx90_emulator as rx
from rx90_common.base.errors import ConfigError

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/python.md"
EXAMPLES = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
LIGHT = "numpy scipy numba pinocchio rclpy rosbags matplotlib pyarrow yaml tqdm jinja2 serial"


def fresh(code: str) -> str:
    """Run code in a new interpreter and return what it printed."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_costs_nothing() -> None:
    """The import itself brings in no library, no module of the project, and takes less than 50 ms of the processor."""
    code = (
        "import sys, time; began = time.process_time(); import rx90_emulator; took = time.process_time() - began; "
        f"print([m for m in '{LIGHT}'.split() if m in sys.modules], "
        "[m for m in sys.modules if m.startswith('rx90_') and m != 'rx90_emulator'], took < 0.05)"
    )
    assert fresh(code) == "[] [] True\n"


def test_nothing_of_the_api_needs_ros() -> None:
    """With every name of the API imported, rclpy is not."""
    code = "import sys, rx90_emulator as rx; [getattr(rx, n) for n in rx.__all__]; print('rclpy' in sys.modules)"
    assert fresh(code) == "False\n"


def test_a_star_import_brings_in_the_whole_api() -> None:
    """`from rx90_emulator import *` binds every name, and no other."""
    code = "names = set(dir()); from rx90_emulator import *; print(*sorted(set(dir()) - names - {'names'}))"
    assert fresh(code).split() == sorted(rx.__all__)


def test_type_checkers_and_the_interpreter_see_the_same_names() -> None:
    """The imports for type checkers, the lazy imports and `__all__` agree, name by name and module by module."""
    tree = ast.parse(Path(rx.__file__).read_text(encoding="utf-8"))
    typed = {
        (node.module, alias.name) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names
    } - {("__future__", "annotations"), ("importlib", "import_module"), ("typing", "TYPE_CHECKING"), ("typing", "Any")}
    lazy = {(module, name) for module, names in rx._HOMES.items() for name in names.split()}
    assert typed == lazy
    assert sorted(rx.__all__) == sorted(name for _, name in lazy)


@pytest.mark.parametrize("name", rx.__all__)
def test_every_name_explains_itself(name: str) -> None:
    """Each name has a docstring of its own that begins with a sentence, and stands in the module's overview."""
    found = getattr(rx, name)
    text = inspect.getdoc(found)
    assert text
    assert not text.startswith(f"{name}("), "the docstring that dataclass() makes up"
    assert text.splitlines()[0].rstrip().endswith((".", ":")) or "\n\n" not in text
    assert re.search(rf"\b{name}\b", rx.__doc__ or "")


@pytest.mark.parametrize("name", [name for name in rx.__all__ if inspect.isfunction(getattr(rx, name))])
def test_every_function_is_typed(name: str) -> None:
    """Each function has a type for every parameter and for what it returns."""
    signature = inspect.signature(getattr(rx, name))
    assert signature.return_annotation is not inspect.Signature.empty
    assert [p.name for p in signature.parameters.values() if p.annotation is inspect.Parameter.empty] == []


def test_help_shows_the_api() -> None:
    """`help(rx)` begins with the overview, documents every name, and dir() has them too."""
    text = pydoc.plain(pydoc.render_doc(rx))
    assert text.index("Setups ") < text.index("PACKAGE CONTENTS")
    documented = set(re.findall(r"^    (?:class )?(\w+)(?:\(| = class)", text, re.MULTILINE))
    assert set(rx.__all__) <= documented
    assert set(rx.__all__) <= set(dir(rx))


def test_an_unknown_name_is_an_attribute_error() -> None:
    """A misspelt name is refused as of any module, with where to look."""
    with pytest.raises(AttributeError, match=r"no attribute 'load_setups'; help\(rx90_emulator\) lists them"):
        _ = rx.load_setups  # type: ignore[attr-defined]


def test_the_documented_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every example of docs/python.md runs, one after the other, in an empty folder, and leaves what it names."""
    import matplotlib

    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for example in EXAMPLES:
        exec(compile(example, str(PAGE), "exec"), names)
    for made in (
        "path_error.png",
        "friction.png",
        "run.npz",
        "reference_run/metadata.yaml",
        "grid.parquet",
        "scatter.parquet",
    ):
        assert (tmp_path / made).is_file()


def test_the_first_example_is_short_and_shows_an_effect() -> None:
    """Changing tau_s, running the line, plotting the path error: under 15 lines, and the plotted errors differ."""
    import matplotlib.pyplot as plt

    lines = [line for line in EXAMPLES[0].splitlines() if line.strip()]
    assert len(lines) < 15
    plt.switch_backend("Agg")
    plt.figure()
    exec("\n".join(line for line in lines if "savefig" not in line), {})
    errors = [np.asarray(line.get_ydata()) for line in plt.gca().get_lines()]
    assert len(errors) == 3
    assert errors[0].max() < errors[1].max() < errors[2].max() < 1.0
    assert plt.gca().get_ylabel() == "path error [mm]"
    plt.close("all")


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


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("friction.joint_2.tau_x", 1.0, "'tau_x' is unknown; accepted there: c0"),
        ("task.speed", 0.1, "'task' is unknown; accepted there: arm, controller, drives, friction"),
        ("controller.feed_forward.coulomb", 0.5, "'controller.feed_forward.coulomb': a value is 0.5; accepted: true"),
        ("friction.joint_2.c0", True, "a value is True; accepted: numbers"),
        ("friction.joint_2.c0", "stiff", "a value is stiff; accepted: numbers"),
        ("friction.joint_2.c0", -1.0, "friction.joint_2: c0 is -1.0"),
    ],
)
def test_parameters_that_are_none_are_refused(shipped: rx.Setup, path: str, value: float, said: str) -> None:
    """A path that names nothing of a setup, or a value it cannot have, is refused in one line; the setup stays."""
    with pytest.raises(ConfigError, match=re.escape(said)) as caught:
        rx.with_parameters(shipped, {path: value})
    assert "\n" not in str(caught.value)


def test_a_later_path_counts(shipped: rx.Setup) -> None:
    """Of a path with a star and one of its places, the one that is given later decides."""
    setup = rx.with_parameters(shipped, {"friction.*.c0": 1e5, "friction.joint_2.c0": 2e5})
    assert [element.c0 for element in setup.friction.elements] == [1e5, 2e5, 1e5, 1e5, 1e5, 1e5, 1e5]
    assert shipped.friction["joint_2"].c0 not in (1e5, 2e5)


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
