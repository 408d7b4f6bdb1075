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
from rx90_emulator.identification.options import RobotOptions
from rx90_emulator.identification.robot import RecordedRobot
from rx90_emulator.loop.setup import Setup

PARTS = {name: full_friction.PARTS[name] for name in ("load", "temperature", "scatter")}


@pytest.fixture
def parted_file(shipped: Setup, tmp_path: Path) -> Path:
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
