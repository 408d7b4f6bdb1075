"""The complete path: experiments on the real nodes, bags by the recorder, identification, verdict."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from processes import Processes

from rx90_identification import command as identify_command
from rx90_identification.experiments import command as experiment_command
from rx90_identification.experiments.folder import read_index
from rx90_loop.setup import Setup
from rx90_sim.friction import load_friction


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bags of a short series for joint 4 on the engine."""
    folder = tmp_path_factory.mktemp("engine") / "series"
    assert experiment_command.main(["run", "--engine", "--quick", "--group", "joint_4", "--output", str(folder)]) == 0
    return folder


def test_bags_become_a_friction_file_that_loads(
    series: Path, shipped: Setup, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From bags comes a file that the simulation loads, a report, and a verdict on the bag that was not used."""
    output = tmp_path / "friction.yaml"
    code = identify_command.main([str(series), "--output", str(output)])
    # One joint's sweeps correct the weights of one joint, so this series need not be confirmed for the others.
    assert code in {identify_command.CONFIRMED, identify_command.NOT_CONFIRMED}, capsys.readouterr()
    assert "validation " in capsys.readouterr().out
    found = load_friction(output, shipped.robot.joint_names).elements[3]
    truth = shipped.friction.elements[3]
    assert abs(found.tau_c_positive / truth.tau_c_positive - 1.0) < 0.1
    assert abs(found.c0 / truth.c0 - 1.0) < 0.05
    assert abs(found.c1 / truth.c1 - 1.0) < 0.15
    text = output.read_text(encoding="utf-8")
    assert "sha256" in text
    assert "provenance: assumed" in text  # the other joints did not move
    assert "<svg" in output.with_suffix(".html").read_text(encoding="utf-8")


def test_nothing_is_replaced_on_refusal(series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An output that exists is refused without --force, and a refusal of the data leaves it as it was with --force."""
    output = tmp_path / "friction.yaml"
    output.write_text("mine", encoding="utf-8")
    assert identify_command.main([str(series), "--output", str(output)]) == identify_command.REFUSED
    assert "exists; accepted: another name, or --force" in capsys.readouterr().err
    bag = str(read_index(series).presliding[0])
    arguments = ["--sliding", str(tmp_path / "nowhere"), "--presliding", bag, "--output", str(output), "--force"]
    assert identify_command.main(arguments) == identify_command.REFUSED
    assert output.read_text(encoding="utf-8") == "mine"
    assert [file.name for file in tmp_path.iterdir()] == ["friction.yaml"]


def test_a_bag_is_not_validated_by_itself(series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A bag that was used for the identification is refused as validation."""
    bag = str(read_index(series).sliding[0])
    arguments = ["--sliding", bag, "--validation", bag, "--output", str(tmp_path / "f.yaml")]
    assert identify_command.main(arguments) == identify_command.REFUSED
    assert "also used for the identification" in capsys.readouterr().err


@pytest.mark.ros
def test_experiments_run_on_the_real_nodes(processes: Processes, shipped: Setup, tmp_path: Path) -> None:
    """On the real nodes the recorder's bags of a presliding experiment hold what the engine's do, and c0 comes out."""
    processes.start("rx90_sim", "--ros-args", "-p", "real_time_factor:=0.0")
    processes.start("rx90_controller")
    folder = tmp_path / "series"
    arguments = ["run", "--nodes", "--quick", "--group", "joint_4", "--output", folder]
    run = processes.start(sys.executable, "-m", "rx90_identification.experiments.command", *arguments)
    assert run.wait(timeout=300.0) == 0
    output = tmp_path / "friction.yaml"
    code = identify_command.main([str(folder), "--output", str(output)])
    assert code in {identify_command.CONFIRMED, identify_command.NOT_CONFIRMED}
    found = load_friction(output, shipped.robot.joint_names).elements[3]
    assert abs(found.c0 / shipped.friction.elements[3].c0 - 1.0) < 0.05
