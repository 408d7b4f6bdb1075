"""Plans: lists and distributions of values, their YAML files, and which values each run sets."""

import math
import re
import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import rx90_emulator as rx
from rx90_common.base.errors import ConfigError
from rx90_common.base.share import config_path
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.parameters import Catalogue
from rx90_emulator.sweep.plan import DrawnValues, NormalDistribution, SweepPlan, load_sweep_plan, plan_hash
from rx90_emulator.sweep.runs import RunDescription, RunList

ROOT = Path(__file__).resolve().parents[3]
SHARES = (2.0**-54, 1e-6, 0.25, 0.5, 0.9, 1.0 - 2.0**-53)
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


@pytest.mark.parametrize(
    ("given", "oracle"),
    [
        ({"uniform": [-1.0, 3.0]}, stats.uniform(-1.0, 4.0)),
        ({"loguniform": [1e-3, 10.0]}, stats.loguniform(1e-3, 10.0)),
        ({"normal": {"mean": 1.0, "deviation": 0.2}}, stats.norm(1.0, 0.2)),
        ({"normal": {"mean": 1.0, "deviation": 0.2, "low": 0.7}}, stats.truncnorm(-1.5, np.inf, 1.0, 0.2)),
        ({"normal": {"mean": 1.0, "deviation": 0.2, "low": 0.9, "high": 1.6}}, stats.truncnorm(-0.5, 3.0, 1.0, 0.2)),
    ],
)
def test_quantiles(given: dict[str, Any], oracle: Any) -> None:
    """The quantiles are SciPy's, finite and within the bounds even at the ends of the generator's range."""
    distribution = DrawnValues.model_validate(given)
    low, high = distribution.bounds
    for share in SHARES:
        value = distribution.quantile(share)
        assert math.isfinite(value)
        assert value == pytest.approx(oracle.ppf(share), rel=1e-7, abs=1e-12)
        assert low <= value <= high


def written(folder: Path, text: str) -> Path:
    shutil.copy(config_path("robots/rx90b/task.yaml"), folder / "line.yaml")
    file = folder / "plan.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_everything_is_read(tmp_path: Path) -> None:
    """Each form of values and distributions, the base and the seed arrive in the plan."""
    plan = load_sweep_plan(written(tmp_path, FULL))
    block = plan.blocks["both"]
    assert (plan.seed, plan.base.substeps, plan.base.rates.base_hz) == (5, 2, 8000)
    assert plan.base.files.task == tmp_path / "line.yaml"
    assert [p.space for p in block.listed.values()] == [(0.5, 1.0, 2.0), (0.1, 0.2), (True, False)]
    uniform, loguniform, normal = (p.space for p in block.drawn.values())
    assert (uniform.uniform, loguniform.loguniform) == ((0.5, 2.0), (1.0, 5.0))
    assert normal.normal == NormalDistribution(mean=1.0, deviation=0.1, low=0.5)
    assert [p.each for p in block.drawn.values()] == [True, False, False]
    assert block.listed["switches"].paths == ("controller.feed_forward.*",)
    assert plan.runs == 3 * 2 * 2 * 20


def test_hash_is_of_the_content(tmp_path: Path) -> None:
    """The hash stays when the files move, and changes with any number of the plan or of a file it names."""
    hashes = []
    for folder, text, more in (
        ("a", FULL, ""),
        ("b", FULL.replace("low: 0.5", "low: 0.5, note: mine").replace("2.0]}, each", "2.0], source: me}, each"), ""),
        ("c", FULL.replace("5", "6", 1), ""),
        ("d", FULL, "#"),
    ):
        (tmp_path / folder).mkdir()
        plan = written(tmp_path / folder, text)
        with (tmp_path / folder / "line.yaml").open("a", encoding="utf-8") as line:
            line.write(more)
        hashes.append(plan_hash(load_sweep_plan(plan).description()))
    assert hashes[0] == hashes[1]
    assert len(set(hashes)) == 3


def test_shipped_and_documented_plans_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every shipped plan is named in --help, found from any folder, and names what there is; so does the page's."""
    monkeypatch.chdir(tmp_path)
    assert run("rx90 sweep", ["run", "--help"]) == 0
    named = set(re.findall(r"sweep/\w+\.yaml", capsys.readouterr().out))
    assert named == {f"sweep/{path.name}" for path in config_path("sweep").glob("*.yaml")}
    assert all(len(rx.Sweep(load_sweep_plan(name))) > 0 for name in named)
    page = (ROOT / "docs/howto/sweep.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"^```yaml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    said = re.search(r"This plan has .* = (\d+) runs", page)
    assert len(rx.Sweep(load_sweep_plan(written(tmp_path, text)))) == int(said[1]) == 29


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ("{}", "blocks.a: has no parameters; accepted: one or both of grid, random"),
        ("{grid: {task.speed: {value: [0.1, 0.1]}}}", "0.1 stands twice"),
        ("{grid: {task.speed: {value: [1], factor: [1]}}}", "has value and factor of value, factor; accepted: one"),
        ("{grid: {task.speed: {value: [1], each: true}}}", "speed.each is True; accepted: False"),
        ("{grid: {task.speed: {value: {}}}}", "speed.value is {}; accepted: [v1, v2, ...], {linspace"),
        ("{grid: {task.speed: {value: {linspace: [-1e308, 1e308, 3]}}}}", "speed: a value is nan; accepted: finite"),
        ("{grid: {task.sped: {value: [1]}}}", "'sped' is unknown (did you mean speed?); accepted there: accel"),
        ("{grid: {friction.*.c0: {factor: [1]}, friction.joint_2.c0: {factor: [1]}}}", "both set friction.joint_2.c0"),
        ("{grid: {x: {paths: [task.speed, task.speed], value: [1]}}}", "set a value twice"),
        ("{grid: {seed: {paths: [task.speed], value: [1]}}}", "the name 'seed' of a result"),
        ("{grid: {controller.feed_forward.coulomb: {factor: [2]}}}", "accepted: value"),
        ("{grid: {x: {paths: [task.speed, 'task.end[0]'], value: [1]}}}", "different units"),
        ("{random: {task.speed: {value: {uniform: [2, 1]}}}, draws: 1}", "bounds are 2 and 1"),
        ("{grid: {task.speed: {value: [1]}}, draws: 4}", "without random parameters"),
        ("{grid: {task.speed: {value: {geomspace: [0, 1, 3]}}}}", "geomspace from 0 to 1; accepted: both > 0"),
        ("{random: {task.speed: {value: {loguniform: [0, 2]}}}, draws: 1}", "accepted: a lower bound > 0"),
        ("{random: {task.speed: {value: {normal: {mean: 1, deviation: 1e-308, low: 2}}}}, draws: 1}", "; accepted: at"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("error")
def test_bad_plans_get_one_line(tmp_path: Path, block: str, said: str) -> None:
    """A mistake in a plan is refused in one line that names the place, the value and what is accepted."""
    with pytest.raises(ConfigError) as error:
        rx.Sweep(load_sweep_plan(written(tmp_path, f"blocks:\n  a: {block}")))
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_plan_names_a_robot_and_an_option_another(tmp_path: Path) -> None:
    """`robot` sets all files and the task, single files win over it, and who runs the plan may take another robot."""
    blocks = "blocks: {one: {grid: {task.speed: {value: [0.1]}}}}\n"
    assert load_sweep_plan(written(tmp_path, f"base: {{tool: none}}\n{blocks}")).base.files == rx.RobotFiles(tool=None)
    plan = written(tmp_path, f"base: {{robot: tx40, friction: robots/rx90b/friction.yaml}}\n{blocks}")
    rough = rx.RobotFiles().friction
    assert load_sweep_plan(plan).base.files == replace(rx.RobotFiles.named("tx40"), friction=rough)
    assert load_sweep_plan(plan, robot="rx90b").base.files == rx.RobotFiles()
    outcome = rx.Sweep(load_sweep_plan(plan)).run(0)
    assert (outcome.error, outcome.metrics is not None) == (None, True)
    shutil.copytree(rx.RobotFiles.named("tx40").urdf.parent, tmp_path / "my_arm")
    own = load_sweep_plan(written(tmp_path, f"base: {{robot: my_arm}}\n{blocks}")).base.files
    assert own.urdf == tmp_path / "my_arm" / "robot.urdf"


DRAWN = {"factor": {"uniform": [1.0, 2.0]}}


def plan_of(seed: int = 0, **blocks: dict[str, Any]) -> SweepPlan:
    return SweepPlan.model_validate({"seed": seed, "blocks": blocks})


def all_runs(plan: SweepPlan, catalogue: Catalogue) -> list[RunDescription]:
    runs = RunList(plan, catalogue)
    return [runs.describe(index) for index in range(len(runs))]


def test_grid_is_the_full_product(catalogue: Catalogue) -> None:
    """A grid has every combination once, the last parameter varying fastest, and blocks follow each other."""
    first = {"grid": {"task.speed": {"factor": [1.0, 2.0]}, "friction.*.c0": {"factor": [3.0, 4.0, 5.0]}}}
    runs = all_runs(plan_of(a=first, b={"grid": {"task.speed": {"factor": [6.0]}}}), catalogue)
    assert [tuple(v for _, v in run.values) for run in runs] == [*product((1.0, 2.0), (3.0, 4.0, 5.0)), (6.0,)]
    assert [run.index for run in runs] == list(range(7))


def test_runs_do_not_depend_on_how_many_are_asked_for(catalogue: Catalogue) -> None:
    """More draws, blocks before it and parameters after it leave the values of a run as they are."""
    block = {"grid": {"task.speed": {"factor": [1.0, 2.0]}}, "random": {"friction.*.c0": DRAWN}, "draws": 3}
    other = {"grid": {"task.speed": {"factor": [3.0]}}, "random": {"friction.*.c1": DRAWN}, "draws": 4}
    wider = {**block, "random": {"friction.*.c0": DRAWN, "friction.*.c2": DRAWN}}
    few = all_runs(plan_of(1, a=block), catalogue)
    many = all_runs(plan_of(1, a={**block, "draws": 9}), catalogue)
    after = all_runs(plan_of(1, other=other, a=block), catalogue)[4:]
    more = all_runs(plan_of(1, a=wider), catalogue)
    assert many[:6] == few
    assert [(r.seed, r.values) for r in after] == [(r.seed, r.values) for r in few]
    assert [r.values[:2] for r in more] == [r.values for r in few]
    assert all_runs(plan_of(2, a=block), catalogue)[0].values != few[0].values
    values = [dict(run.values)["friction.*.c0"] for run in many]
    assert values[0::2] == values[1::2]
    assert len(set(values)) == 9


def test_the_seed_gives_the_draws(catalogue: Catalogue) -> None:
    """NumPy's default generator, seeded with a run's seed, gives the shares that its values stand for."""
    stiffness = {"factor": {"loguniform": [0.5, 2.0]}, "each": True}
    for one in all_runs(plan_of(3, a={"random": {"friction.*.c0": stiffness}, "draws": 3}), catalogue):
        expected = 0.5 * 4.0 ** np.random.default_rng(one.seed).random(7)
        np.testing.assert_allclose([v for _, v in one.values], expected, rtol=1e-12)
        assert [name for name, _ in one.values][-1] == "friction.joint_5_6.c0"


def test_factor_and_value(catalogue: Catalogue) -> None:
    """A factor multiplies each place's own number, a value replaces it; a column holds one of the two."""
    grid = {"friction.*.c0": {"factor": [2.0]}, "drives.gear[*]": {"value": [50.0]}}
    runs = RunList(plan_of(a={"grid": grid}), catalogue)
    changes = runs.changes(runs.describe(0))
    friction = [value for leaf, value in changes.items() if leaf.key[0] == "friction"]
    assert friction == [2.0e5, 2.2e5, 1.4e5, 3.0e4, 2.0e4, 1.0e4, 8.0e3]
    assert [v for t, v in changes.items() if t.key[0] == "drives"] == [50.0] * 6
    assert runs.columns[0].unit == "1"
    both = [{"grid": {"task.speed": {kind: [2.0]}}} for kind in ("factor", "value")]
    with pytest.raises(ConfigError, match="means something else"):
        RunList(plan_of(a=both[0], b=both[1]), catalogue)
    with pytest.raises(ConfigError, match="'note' names nothing"):
        SweepPlan.of_grid({"task.speed": [0.1], "note": [1.0]})
