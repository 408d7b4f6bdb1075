"""rx90 config: what is wrong in files, what a setup comes to, and completion in a real shell."""

import dataclasses
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from config_samples import shipped, written
from needs import need

from rx90_common.base.config import read_yaml
from rx90_common.base.share import config_path
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.cli.frame import EXECUTABLES, VERBS, run
from rx90_emulator.configuration.check import kind_of
from rx90_emulator.configuration.origins import ShownValue, rig_values, robot_values

Captured = pytest.CaptureFixture[str]
REFERENCE = Path(__file__).resolve().parents[2] / "reference/reference_task"


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    return Path(shutil.copytree(config_path("robots/rx90b"), tmp_path / "arm"))


def show(robot: str, rig: str = "rig/gm8224.yaml") -> dict[str, ShownValue]:
    return {one.name: one for one in (*robot_values(RobotFiles.named(robot)), *rig_values(rig))}


def edited(path: Path, *changes: tuple[str, str]) -> None:
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")


def line_of(path: Path, text: str) -> int:
    return 1 + next(i for i, line in enumerate(path.read_text("utf-8").splitlines()) if text in line)


def test_all_problems_of_files_are_told_with_their_lines(arm: Path, capsys: Captured) -> None:
    """Each of several faults is a line with file, line, value and what is accepted; no file hides others."""
    tool, friction, task = (arm / f"{name}.yaml" for name in ("tool", "friction", "task"))
    edited(tool, ("mass: 3.5", "mass: -3.5"), ("beam: [0.170", "beam: [high"), ("tcp:", "\u202ecolour: red\ntcp:"))
    edited(friction, ("tau_c: 18.0", "tau_c: 38.0"))
    edited(task, ("speed: 0.1", "speed: [0.1"))
    files = [str(path) for path in (tool, friction, task)]
    assert run("rx90 config", ["check", *files]) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[1:3] == [
        f"{tool}:{line_of(tool, 'mass:')}: inertial.mass is -3.5; accepted: a number > 0",
        f"{tool}:{line_of(tool, 'beam:')}: visual.cylinders.beam[0] is 'high'; accepted: a finite number",
    ]
    colour = f"{tool}:{line_of(tool, 'colour:')}: \\u202ecolour is not a known key; accepted: inertial, tcp, "
    assert said[0].startswith(colour)
    assert said[3].startswith(f"{friction}:{line_of(friction, 'joint_3:')}: elements.joint_3.tau_s is 23.0")
    assert re.match(rf"{re.escape(str(task))}:\d+: not valid YAML", said[4])
    assert run("rx90 config", ["check", "nowhere.yaml", *files]) == 2
    again = capsys.readouterr()
    assert again.out.splitlines() == said
    assert "nowhere.yaml: no such file" in again.err


LARGE = {
    "unknown keys": "".join(f"element{k}: {k}\n" for k in range(37_000)),
    "a list": f"elements: [{'x,' * 73_000}x]",
    "lists in lists": "a:\n" + "- - - - - -\n" * 70_000,
    "elements": "elements:\n" + "".join(f"  e{k}: x\n" for k in range(37_000)),
    "a long key": f'? "{"x" * 3_000_000}"\n: 1',
}


@pytest.mark.parametrize("text", LARGE.values(), ids=LARGE)
def test_of_the_faults_of_a_large_file_the_first_are_told(text: str, tmp_path: Path, capsys: Captured) -> None:
    """They are some lines, of which the last one says how many more there are."""
    path = tmp_path / "large.yaml"
    path.write_text(text, encoding="utf-8")
    assert run("rx90 config", ["check", "--kind", "friction", str(path)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) < 50
    if len(lines) > 4:
        assert any(re.search("36,98[0-9] more faults, which are not told", line) for line in lines[-2:])


def test_the_kind_of_a_file_is_told_by_its_content(tmp_path: Path, capsys: Captured) -> None:
    """Every good file is taken for what it is whatever it is called; what cannot be told is refused unless named."""
    for kind, path in shipped() + written(tmp_path):
        assert kind_of(path, read_yaml(path, first=True)).name == kind, path
    odd = tmp_path / "odd.yaml"
    odd.write_text("mass: 1.0\n", encoding="utf-8")
    assert run("rx90 config", ["check", str(odd)]) == 2
    assert "odd.yaml: of no kind that its keys tell; accepted: --kind with drives, tool" in capsys.readouterr().err
    slip = tmp_path / "slip.yaml"
    for wrong, said in (
        ("joint_name: [a]\npoints: []\n", ":1: joint_name is not a known key (did you mean joint_names?); accepted"),
        ("joint_names: [a]\npoints: [{postions: [0]}]\n", ":2: points[0].postions is not a known key (did you mean po"),
        ("pth: {segments: []}\n", ":1: pth is not a known key (did you mean path?); accepted: path, posture"),
        (
            "lines: {speed: 0.1, start: [0, 0, 0]}\n",
            ":1: lines is not a known key (did you mean line?); accepted: line",
        ),
    ):
        slip.write_text(wrong, encoding="utf-8")
        assert run("rx90 config", ["check", str(slip)]) == 1
        line = capsys.readouterr().out.splitlines()[0]
        assert said in line
        assert run("rx90 correct", ["engine", str(slip), "--output", str(tmp_path / "new.yaml")]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert said.removeprefix(":1").removeprefix(":2") in line
    assert run("rx90 config", ["check", "--kind", "tool", str(odd)]) == 1
    assert f"{odd}:1: mass is not a known key" in capsys.readouterr().out


def test_a_urdf_is_checked_as_one(tmp_path: Path, shipped_files: RobotFiles, capsys: Captured) -> None:
    """A description alone is no YAML: it is read as a robot."""
    text = shipped_files.urdf.read_text(encoding="utf-8")
    path = tmp_path / "robot.urdf"
    for change, code, said in (("revolute", 0, "no problem"), ("twisting", 1, "'joint_1' type is 'twisting'")):
        path.write_text(text.replace("revolute", change), encoding="utf-8")
        assert run("rx90 config", ["check", str(path)]) == code
        assert said in capsys.readouterr().out


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        ("friction.yaml", ("joint_4:", "joint_7:"), r"friction.yaml:\d+: elements.joint_7 .*mean joint_4\?"),
        ("poses.yaml", ("[0.0, -0.6,", "[0.0, -6.6,"), r"poses.yaml:? pose 1: joint_2 is -6.6 rad; accepted: \["),
        ("robot.urdf", ("<robot", "<robott"), r"robot.urdf:(\d+:)? "),
        ("robot.urdf", ('"tool0"', '"mount"'), r"robot.urdf:? link 'tool0' is None; accepted: a link of that name"),
        ("task.yaml", ("start: [0.6,", "start: [2.6,"), r"task.yaml:? the line cannot be travelled at 0.000 m "),
    ],
)
def test_a_robot_folder_is_checked_as_a_whole(
    arm: Path, capsys: Captured, file: str, change: tuple[str, str], said: str
) -> None:
    """Names of joints and poses must fit the arm; one fault in a good folder is one line."""
    assert run("rx90 config", ["check", str(arm)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"{arm}: robot folder, no problem"
    edited(arm / file, change)
    assert run("rx90 config", ["check", str(arm)]) == 1
    lines = [line for line in capsys.readouterr().out.splitlines() if not line.endswith(", no problem")]
    assert re.search(said, lines[0]), lines
    (arm / "drives.yaml").unlink()
    assert run("rx90 config", ["check", str(arm)]) == 1
    assert f"{arm}/drives.yaml: is missing; accepted: a drives file" in capsys.readouterr().out


def leaves(content: dict[str, object], before: str, *around: object) -> Iterator[tuple[str, object, list[object]]]:
    """Yield the place of each value of a file, the value, and the mappings around it."""
    for key, value in content.items():
        if key not in {"source", "provenance", "note"} and isinstance(value, dict):
            yield from leaves(value, f"{before}.{key}", *around, content)
        elif key not in {"source", "provenance", "note"}:
            yield f"{before}.{key}", value, [*around, content]


@pytest.mark.parametrize(
    "file", ["tx40/drives", "tx40/friction", "tx40/controller", "panda/drives", "panda/controller", "rig/gm8224_lugre"]
)
def test_every_value_is_shown_with_the_line_that_it_comes_from(file: str) -> None:
    """Each value of a robot's files, and of a rig's, has the line, provenance and source that the file gives it."""
    folder, role = file.split("/")
    robot, name = (folder, f"robots/{file}.yaml")
    if folder == "rig":
        robot, role, name = "tx40", "rig", f"{file}.yaml"
    lines, data = (read(config_path(name).read_text("utf-8")) for read in (str.splitlines, yaml.safe_load))
    values = show(robot, "rig/gm8224_lugre.yaml")
    own = {key for key, one in values.items() if key.startswith(f"{role}.") and one.origin.startswith(name)}
    expected = list(leaves(data, role))
    assert own == {place for place, *_ in expected if not place.startswith("friction.identification")}
    assert len(own) > 10
    for place, value, around in expected:
        one, key = values[place], place.rpartition(".")[2]
        assert one.value == value
        assert f"{key}:" in lines[int(one.origin.rpartition(":")[2]) - 1]
        for word in ("provenance", "source"):
            given = [each[word] for each in around if isinstance(each, dict) and word in each]
            said = [each.get(key, each.get("others")) if isinstance(each, dict) else each for each in given]
            assert getattr(one, word) == ([each for each in said if each is not None] or [""])[-1]


def test_units_defaults_and_the_choice_of_files_are_shown(capsys: Captured) -> None:
    """What no file has is a default of the code; files are those of the robot, or of options."""
    usual = show("tx40")
    assert usual["friction.elements.joint_1.alpha"].origin == "default of the code"
    assert usual["drives.motor.peak_current"].unit == "A"
    assert usual["file.tool"].value == "none"
    identified = show("panda")
    said = [identified[f"friction.elements.panda_joint1.{name}"].provenance for name in ("c2", "tau_s")]
    assert said == ["identified", "assumed"]  # in one block, of which the file's block `identification` knows more
    assert usual["file.rig"].value == "rig/gm8224.yaml"
    assert usual["rig.emulation.joint_friction.model"].value == "coulomb_viscous"
    assert run("rx90 config", ["show"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"tool\.inertial\.mass +3\.5 +kg +robots/rx90b/tool\.yaml:\d+ +ASSUMED \[1\]", said)
    assert "[1] a welding head of 3.5 kg" in said
    other = show("tx40", "rig/gm8224_lugre.yaml")
    assert other["rig.emulation.joint_friction.model"].value == "lugre"


OFFERED = {
    "rx90 bag ": {"record", "compare", "info", "import"},
    "rx90 ": set(VERBS),
    "rx90 identify ": {"sliding", "excitation", "check", "compare"},
    "friction_bench --ros-": {"--ros-args"},
    "rx90 run --fee": {"--feed-forward"},
    "rx90 run --feed-forward ": {"all", "none"},
    "rx90 run --robot r": {"robots"},
    "rx90 config check m": {"my_task.yaml"},
    "rx90_sim --params-file m": {"my_task.yaml"},
    **{f"{name} --": {"--help"} for name in EXECUTABLES},
}
"""What completion offers at least behind some words, in a folder with `robots` and `my_task.yaml`."""
IN_FISH = {words: OFFERED[words] for words in ("rx90 bag ", "rx90 run --feed-forward ", "rx90 config check m")}


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_complete_verbs_options_files_and_robots(shell: str, tmp_path: Path, capsys: Captured) -> None:
    """Each executable has its completion; real shells that are there offer what there is, for verbs, too."""
    (tmp_path / "robots").mkdir()
    (tmp_path / "my_task.yaml").touch()
    assert run("rx90 completion", [shell]) == 0
    script = capsys.readouterr().out
    for name in EXECUTABLES:
        assert re.search(rf"^(complete|\s*compdef) (-c {name} |.*\b{name}$)", script, re.MULTILINE), name
    if shell != "bash":
        need(shell)
    if shell == "zsh":
        done = subprocess.run(["zsh", "-n"], input=script, capture_output=True, text=True, check=False, timeout=60)
        assert (done.returncode, done.stderr) == (0, "")
        return
    (tmp_path / "script").write_text(script, encoding="utf-8")
    asked = OFFERED if shell == "bash" else IN_FISH
    code = f"source {tmp_path / 'script'}\n"
    for words in asked:
        name, empty = words.split(" ", maxsplit=1)[0], "''" * words.endswith(" ")
        code += f"echo '= {words}'\n"
        code += (
            f"complete -C '{words}'\n"
            if shell == "fish"
            else f"""
COMP_WORDS=({words} {empty}); COMP_CWORD=$(( ${{#COMP_WORDS[@]}} - 1 )); COMPREPLY=()
$(complete -p {name} | sed 's/.*-F \\([^ ]*\\) .*/\\1/') {name}; printf '%s\\n' "${{COMPREPLY[@]}}"
"""
        )
    command = [shell, *["-N"] * (shell == "fish"), "-c", code]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60)
    blocks = {block.split("\n")[0]: block.split("\n")[1:] for block in done.stdout.split("= ")[1:]}
    assert set(blocks) == set(asked), done
    for words, block in blocks.items():
        offered = {line.split("\t")[0] for line in block if line}
        assert offered >= asked[words], words
        if shell == "bash":
            assert "my_task.yaml" not in offered or "my_task.yaml" in asked[words], words
            assert all(each.startswith(words.rpartition(" ")[2]) for each in offered), words


def test_show_names_the_files_of_the_controller_s_model(
    shipped_files: RobotFiles, edited_yaml: Callable[..., Path]
) -> None:
    """Those that the controller file names with their lines, the others beside it; none that is not there."""
    shown = {one.name: one for one in robot_values(shipped_files)}
    friction = shown["controller.model.friction"]
    assert (friction.value, friction.origin) == ("robots/rx90b/friction.yaml", "beside robots/rx90b/controller.yaml")
    shared = {role: shipped_files.text(role) for role in ("urdf", "drives", "friction")}
    named = dataclasses.replace(shipped_files, controller=edited_yaml(shipped_files.controller, ("model",), shared))
    of_model = {one.name: one.value for one in robot_values(named) if one.name.startswith("controller.model.")}
    assert of_model == {f"controller.model.{role}": name for role, name in {**shared, "tool": "none"}.items()}


_SLOW = {f"scipy.{part}" for part in ("signal", "interpolate", "optimize", "stats", "sparse")}
_SLOW |= {"matplotlib", "bokeh", "pyarrow", "jinja2", "viser", "rclpy"}


def test_small_verbs_wait_for_no_library_that_they_do_not_use() -> None:
    """What takes long to import is left out: of SciPy, Matplotlib, Bokeh, PyArrow, Jinja, the page and ROS."""
    verbs = [
        f"bag info {REFERENCE}",
        f"bag path {REFERENCE}",
        f"config check {config_path('robots/rx90b/task.yaml')}",
        "config show",
        "line --dry-run",
        "run",
        "path paths/circle.yaml --dry-run",
    ]
    code = "import sys; from rx90_emulator.cli.frame import run\nfor words in sys.argv[1:]:\n"
    code += "    assert run('rx90', words.split()) == 0\n    print('loaded:', *sys.modules)"
    done = subprocess.run([sys.executable, "-c", code, *verbs], capture_output=True, text=True, check=True, timeout=120)
    loaded = [_SLOW & set(line.split()) for line in done.stdout.splitlines() if line.startswith("loaded: ")]
    assert loaded == [set()] * 6 + [{"scipy.interpolate", "scipy.optimize", "scipy.sparse"}]
