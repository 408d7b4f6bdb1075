"""Who takes friction elements with parts, and who refuses them in one line."""

from collections.abc import Callable
from pathlib import Path
from shutil import copytree

import full_friction
import pytest

import rx90_emulator as rx
from rx90_common.base.errors import REFUSED, Rx90Error
from rx90_common.base.share import config_path
from rx90_emulator.cli.frame import run
from rx90_emulator.configuration.origins import OF_CODE, file_values
from rx90_emulator.identification.options import RobotOptions
from rx90_emulator.identification.robot import RecordedRobot
from rx90_emulator.loop.setup import Setup

PARTS = {name: full_friction.PARTS[name] for name in ("load", "temperature", "scatter")}


@pytest.fixture
def parted_file(shipped: Setup, tmp_path: Path) -> Path:
    assert shipped.friction.file is not None
    file = rx.FrictionFile.read(shipped.friction.file)
    element = file.elements["joint_2"].replaced(**PARTS)
    path = tmp_path / "parted.yaml"
    path.write_text(file.replaced(elements={**file.elements.entries, "joint_2": element}).text(), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("refuse", "words"),
    [
        (lambda path: RecordedRobot.load(RobotOptions(fallback=str(path))), "an identification with it as --fallback"),
        (lambda path: rx.check_friction(path, ["no_bag"]), "a validation by recorded torques"),
    ],
    ids=["fallback", "validation"],
)
def test_identification_refuses_parts(parted_file: Path, refuse: Callable[[Path], object], words: str) -> None:
    """A friction file with parts is refused as fallback and in a validation, by file, element and part."""
    with pytest.raises(Rx90Error) as caught:
        refuse(parted_file)
    assert str(caught.value) == (
        f"{parted_file}: elements.joint_2.load: {words} cannot hold this part; accepted: left out"
    )


def test_a_ramp_test_does_not_replace_an_element_with_parts(
    parted_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before any ramp, `rx90 rig ramp --element` refuses an element whose parts it would drop; others are no matter."""
    robot = tmp_path / "robot"
    copytree(config_path("robots/rx90b"), robot)
    (robot / "friction.yaml").write_bytes(parted_file.read_bytes())
    words = ["--robot", str(robot), "--output", str(tmp_path / "out"), "--element", "joint_2"]
    assert run("rx90 rig ramp", words) == REFUSED
    told = "elements.joint_2.load: the element that a ramp test replaces cannot hold this part"
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_config_shows_where_each_value_of_a_part_comes_from(parted_file: Path) -> None:
    """`rx90 config show` lists values of parts with unit, line and provenance, and what the code adds."""
    found = {one.name: one for one in file_values("friction", parted_file)}
    given = found["friction.elements.joint_2.scatter.correlation_time"]
    line = int(given.origin.rpartition(":")[2])
    assert "joint_2" in "".join(parted_file.read_text(encoding="utf-8").splitlines()[line - 16 : line])
    assert (given.value, given.unit, given.provenance) == (0.2, "s", "assumed")
    added = found["friction.elements.joint_2.load.relax_time"]
    assert (added.value, added.unit, added.origin) == (1e-3, "s", OF_CODE)
    assert "friction.elements.joint_1.load.driving" not in found


def test_a_sweep_varies_parts_and_the_seed(parted_file: Path, tmp_path: Path) -> None:
    """Values of parts and whole seeds reach the runs; the same seed gives the same run, another one another."""
    plan = tmp_path / "plan.yaml"
    plan.write_text(
        f"""
base: {{friction: {parted_file.name}}}
blocks:
  seeds:
    grid:
      arm.seed: {{value: {{linspace: [3, 5, 3]}}}}
      friction.joint_2.load.driving: {{value: [0.0, 0.3]}}
""",
        encoding="utf-8",
    )
    sweep = rx.Sweep(rx.load_sweep_plan(plan))
    runs = [sweep.simulate(index) for index in (0, 1, 2)]
    assert [(r.setup.seed, r.setup.friction["joint_2"].load.driving) for r in runs] == [(3, 0.0), (3, 0.3), (4, 0.0)]
    worst = [run.slow.joint_states[:, 0].tobytes() for run in runs]
    assert len(set(worst)) == 3
    assert sweep.simulate(0).slow.joint_states[:, 0].tobytes() == worst[0]


def test_rx90_run_takes_a_seed(parted_file: Path, tmp_path: Path) -> None:
    """Two runs with one seed are the same to the last bit, with another they differ."""
    drawn = []
    for k, seed in enumerate((4, 4, 5)):
        words = ["--friction", str(parted_file), "--seed", str(seed), "--output", str(tmp_path / f"{k}")]
        assert run("rx90 run", [*words, "--slow-only"]) == 0
        series = rx.read_bag(tmp_path / f"{k}").values()
        drawn.append([values.tobytes() for one in series for values in one.fields.values()])
    assert drawn[0] == drawn[1]
    assert drawn[0] != drawn[2]
