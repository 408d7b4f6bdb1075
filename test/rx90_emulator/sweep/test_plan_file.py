"""Plans as YAML files."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from rx90_common.base.errors import ConfigError
from rx90_common.base.share import config_path
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.cli.frame import run
from rx90_emulator.sweep.plan import LogUniform, Normal, Uniform, Values, load_sweep_plan, plan_hash
from rx90_emulator.sweep.sweep import Sweep

ROOT = Path(__file__).resolve().parents[3]

FULL = """
seed: 5
base: {task: line.yaml, substeps: 2, base_rate: 8000}
blocks:
  both:
    grid:
      friction.*.c0: {factor: {geomspace: [0.5, 2.0, 3]}}
      task.speed: {value: {linspace: [0.1, 0.2, 2]}}
      switches: {paths: ["controller.feed_forward.*"], value: [true, false]}
    random:
      friction.*.c2: {factor: {uniform: [0.5, 2.0]}, each: true}
      drives.rotor_inertia[1]: {value: {loguniform: [1.0, 5.0]}}
      controller.kp[*]: {factor: {normal: {mean: 1.0, deviation: 0.1, low: 0.5}}}
    draws: 20
"""


def written(folder: Path, text: str) -> Path:
    """Write a plan, and the line it may name beside it."""
    shipped = config_path("robots/rx90b/task.yaml").read_text(encoding="utf-8")
    (folder / "line.yaml").write_text(shipped, encoding="utf-8")
    file = folder / "plan.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_everything_is_read(tmp_path: Path) -> None:
    """Each form of values and distributions, the base and the seed arrive in the plan."""
    plan = load_sweep_plan(written(tmp_path, FULL))
    (block,) = plan.blocks
    assert (plan.seed, plan.base.substeps, plan.base.rates.base_hz) == (5, 2, 8000)
    assert plan.base.files.task == tmp_path / "line.yaml"
    assert [p.space for p in block.grid] == [
        Values.geomspace(0.5, 2.0, 3),
        Values((0.1, 0.2)),
        Values((True, False)),
    ]
    assert [p.space for p in block.random] == [
        Uniform(0.5, 2.0),
        LogUniform(1.0, 5.0),
        Normal(1.0, 0.1, low=0.5),
    ]
    assert [p.each for p in block.random] == [True, False, False]
    assert block.grid[2].paths == ("controller.feed_forward.*",)
    assert plan.runs == 3 * 2 * 2 * 20


def test_hash_is_of_the_content(tmp_path: Path) -> None:
    """The hash stays when the files move, and changes with any number of the plan or of a file it names."""
    hashes = []
    for folder, text in (("a", FULL), ("b", FULL), ("c", FULL.replace("seed: 5", "seed: 6"))):
        (tmp_path / folder).mkdir()
        hashes.append(plan_hash(load_sweep_plan(written(tmp_path / folder, text)).description()))
    task = tmp_path / "b" / "line.yaml"
    task.write_text(task.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    hashes.append(plan_hash(load_sweep_plan(tmp_path / "b" / "plan.yaml").description()))
    assert hashes[0] == hashes[1]
    assert len(set(hashes)) == 3


@pytest.mark.parametrize("name", sorted(p.name for p in config_path("sweep").glob("*.yaml")))
def test_shipped_plans_fit(name: str) -> None:
    """Every shipped plan is readable and names what there is."""
    assert len(Sweep(load_sweep_plan(config_path(f"sweep/{name}")))) > 0


def test_the_documented_plan_has_the_runs_that_the_page_says(tmp_path: Path) -> None:
    """The plan in docs/howto/sweep.md is read as it stands, and has as many runs as the page counts."""
    page = (ROOT / "docs/howto/sweep.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"^```yaml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    plan = tmp_path / "plan.yaml"
    plan.write_text(text, encoding="utf-8")
    said = re.search(r"This plan has .* = (\d+) runs", page)
    assert said is not None
    assert len(Sweep(load_sweep_plan(plan))) == int(said[1]) == 29


def test_help_names_plans_that_can_be_run_from_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each plan that --help names is found from any folder, and every shipped one is named."""
    monkeypatch.chdir(tmp_path)
    assert run("rx90_sweep", ["run", "--help"]) == 0
    named = set(re.findall(r"sweep/\w+\.yaml", capsys.readouterr().out))
    assert named == {f"sweep/{path.name}" for path in config_path("sweep").glob("*.yaml")}
    for name in named:
        load_sweep_plan(name)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("blocks: {}", "blocks is {}; accepted: at least one block"),
        ("blocks: {a: {}}", "blocks.a.grid is missing; accepted: one or more of grid, random"),
        ("blocks: {a: {grid: {}}}", "blocks.a.grid is {}; accepted: at least one parameter"),
        ("blocks: {a: {grid: {task.speed: {value: []}}}}", "value is []; accepted: [v1, v2, ...]"),
        ("blocks: {a: {grid: {task.speed: {value: 0.1}}}}", "value is 0.1; accepted: [v1, v2, ...]"),
        ("blocks: {a: {grid: {task.speed: {value: [fast]}}}}", "is 'fast'; accepted: finite numbers"),
        ("blocks: {a: {grid: {task.speed: {value: [true]}}}}", "a value is True; accepted: numbers"),
        ("blocks: {a: {grid: {task.speed: {value: [0.1, 0.1]}}}}", "0.1 stands twice"),
        (
            "blocks: {a: {grid: {task.speed: {value: [1], factor: [1]}}}}",
            "value and factor: both are there; accepted: one",
        ),
        ("blocks: {a: {grid: {task.speed: {}}}}", "value and factor: none is there; accepted: one of them"),
        ("blocks: {a: {grid: {task.speed: {value: {linspace: [1, 2, -3]}}}}}", "count of values is -3"),
        ("blocks: {a: {grid: {task.speed: {value: {linspace: [1, 2]}}}}}", "accepted: 3 numbers"),
        ("blocks: {a: {grid: {task.speed: {value: {logspace: [1, 2, 3]}}}}}", "linspace and geomspace: none is there"),
        ("blocks: {a: {grid: {task.speed: {value: [1], each: true}}}}", "in random draws only"),
        ("blocks: {a: {grid: {task.sped: {value: [1]}}}}", "'sped' is unknown; accepted there: accel"),
        ("blocks: {a: {grid: {task.speed: {value: [1]}, task.speed: {value: [2]}}}}", "stands twice"),
        (
            "blocks: {a: {grid: {friction.*.c0: {factor: [1]}, friction.joint_2.c0: {factor: [1]}}}}",
            "both set friction.joint_2.c0",
        ),
        (
            "blocks: {a: {random: {x: {paths: [friction.*.c0, friction.joint_1.c0], each: true, "
            "factor: {uniform: [1, 2]}}}, draws: 1}}",
            "both set friction.joint_1.c0",
        ),
        ("blocks: {a: {grid: {x: {paths: [task.speed, task.speed], value: [1]}}}}", "set a value twice"),
        ("blocks: {a: {grid: {x: {paths: [], value: [1]}}}}", "paths is []; accepted: at least one path"),
        ("blocks: {a: {grid: {seed: {paths: [task.speed], value: [1]}}}}", "the name 'seed' of a result"),
        ("blocks: {a: {grid: {controller.feed_forward.coulomb: {factor: [2]}}}}", "accepted: value"),
        ("blocks: {a: {grid: {x: {paths: [task.speed, 'task.end[0]'], value: [1]}}}}", "different units"),
        ("blocks: {a: {random: {task.speed: {value: {uniform: [1, 2]}}}}}", "draws is missing"),
        ("blocks: {a: {random: {task.speed: {value: {uniform: [1, 2]}}}, draws: -1}}", "draws is -1"),
        ("blocks: {a: {random: {task.speed: {value: {uniform: [2, 1]}}}, draws: 1}}", "bounds are 2 and 1"),
        ("blocks: {a: {random: {task.speed: {value: [1, 2]}}, draws: 1}}", "accepted: {uniform"),
        ("blocks: {a: {grid: {task.speed: {value: [1]}}, draws: 4}}", "without random parameters"),
        ("seed: -1\nblocks: {a: {grid: {task.speed: {value: [1]}}}}", "seed is -1"),
        ("sed: 1\nblocks: {a: {grid: {task.speed: {value: [1]}}}}", "sed is not a known key"),
        ("base: {task: none.yaml}\nblocks: {a: {grid: {task.speed: {value: [1]}}}}", "no file 'none.yaml'"),
        ("base: {base_rate: 3000}\nblocks: {a: {grid: {task.speed: {value: [1]}}}}", "base_rate is 3000 Hz"),
    ],
)
def test_bad_plans_get_one_line(tmp_path: Path, text: str, said: str) -> None:
    """A mistake in a plan is refused in one line that names the place, the value and what is accepted."""
    with pytest.raises(ConfigError) as error:
        Sweep(load_sweep_plan(written(tmp_path, text)))
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_plan_may_leave_the_tool_off(tmp_path: Path) -> None:
    """`tool: none` means in a plan what it means to commands and nodes: no tool, and the shipped other files."""
    text = "base: {tool: none}\nblocks: {one: {grid: {task.speed: {value: [0.1]}}}}\n"
    files = load_sweep_plan(written(tmp_path, text)).base.files
    assert files == RobotFiles(tool=None)


def test_a_plan_names_a_robot_and_an_option_another(tmp_path: Path) -> None:
    """`robot` sets all files and the task, single files win over it, and who runs the plan may take another robot."""
    blocks = "blocks: {one: {grid: {task.speed: {value: [0.1]}}}}\n"
    plan = written(tmp_path, f"base: {{robot: tx40, friction: robots/rx90b/friction.yaml}}\n{blocks}")
    rough = RobotFiles().friction
    assert load_sweep_plan(plan).base.files == replace(RobotFiles.named("tx40"), friction=rough)
    assert load_sweep_plan(plan, robot="rx90b").base.files == RobotFiles()
    assert load_sweep_plan(written(tmp_path, blocks), robot="tx40").base.files == RobotFiles.named("tx40")
    outcome = Sweep(load_sweep_plan(plan)).run(0)
    assert (outcome.error, outcome.metrics is not None) == (None, True)
    shutil.copytree(RobotFiles.named("tx40").urdf.parent, tmp_path / "my_arm")
    own = load_sweep_plan(written(tmp_path, f"base: {{robot: my_arm}}\n{blocks}")).base.files
    assert own.urdf == tmp_path / "my_arm" / "robot.urdf"
    with pytest.raises(ConfigError, match=r"base.robot: robot 'tx50': no such folder; accepted: rx90b, tx40"):
        load_sweep_plan(written(tmp_path, f"base: {{robot: tx50}}\n{blocks}"))
