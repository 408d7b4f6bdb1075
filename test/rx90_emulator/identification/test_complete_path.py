"""The complete path: experiments on the real nodes, bags by the recorder, identification, verdict."""

from __future__ import annotations

import os
import re
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from processes import Processes, open_files, wait_until

from rx90_common.bags.reading import read_joint_states
from rx90_common.base.errors import DONE, INTERRUPTED
from rx90_common.description.coupling import RX_WRIST
from rx90_common.friction import load_friction
from rx90_controller.trajectory.motion import Motion
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.experiments import nodes
from rx90_emulator.identification.experiments import plan as plans
from rx90_emulator.identification.experiments.arms import PlannedArm
from rx90_emulator.identification.experiments.excitation import plan_excitation
from rx90_emulator.identification.experiments.options import ExcitationOptions
from rx90_emulator.identification.experiments.plan import Experiment, Kind, read_index
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup


def test_the_runs_of_one_joint_tell_that_joint_alone(
    series: Path, identified: tuple[Path, str], shipped: Setup, check_report: Callable[[Path], None]
) -> None:
    """From bags of joint 3 come a file that the simulation loads, with its values alone, a report and a verdict."""
    output, said = identified
    found, truth = (
        load_friction(output, RX_WRIST.element_names(shipped.robot.joint_names)).elements[2],
        shipped.friction.elements[2],
    )
    assert found.tau_c.positive == pytest.approx(truth.tau_c.positive, rel=0.1)
    assert "confirmed by a bag that the fit did not use; 54 of 63 values are assumed: " in said
    (share,) = re.findall(r"torque RMS of a joint, away from reversals ([\d.]+)%", said)
    assert float(share) < 0.3  # with c0 and c1 of joints 2, 5 and 6 from their reactions it was 0.6 %
    content = yaml.safe_load(output.read_text(encoding="utf-8"))
    parameters = content["identification"]["parameters"]
    told = {name for name, one in parameters.items() if any("interval" in each for each in one.values())}
    assert told == {"joint_3"}
    assert parameters["joint_4"]["c2"]["provenance"] == "assumed"
    true = yaml.safe_load((series / "emulated_friction.yaml").read_text(encoding="utf-8"))["elements"]["joint_3"]
    for name in ("c0", "c1"):
        low, high = parameters["joint_3"][name]["interval"]
        assert low < true[name] < high
    page = output.with_suffix(".html").read_text(encoding="utf-8")
    assert re.findall(r'class="fact *([a-z]*)"><b>confirmed', page) == [""]  # not green beside assumed values
    for value in ("18", "23", "0.05", "1", "7", "70000", "60"):
        assert f"true {value}<" in page
    check_report(output.with_suffix(".html"))


def short_series(setup: Setup) -> list[Experiment]:
    """Return sweeps of one joint, much less than --quick: joint 4, seven speeds, 18 s; and one that is too long."""
    names, fourth = setup.robot.joint_names, np.eye(6)[3]
    cycle, slide, long = (Motion(np.zeros(6)) for _ in range(3))
    cycle.sweep(fourth, 0.05, 0.3, 6.0)
    cycle.oscillate(fourth, [2e-3], [1.0], 2.0)
    cycle.oscillate(fourth, [1e-5] * 4, [3.0, 8.0, 14.0, 22.0], 2.0)
    cycle.move(np.zeros(6), np.ones(6), 5.0)
    for speed in np.geomspace(0.041, 1.6, 7):
        slide.sweep(fourth, speed, 0.7, 6.0)
        slide.sweep(fourth, -speed, 0.7, 6.0)
    long.sweep(fourth, 1e-3, 400.0, 6.0)
    return [
        Experiment("cycle", Kind.PRESLIDING, cycle.points(names), 2),
        Experiment("slide", Kind.SLIDING, slide.points(names), 10),
        Experiment("long", Kind.SLIDING, long.points(names), 1),
    ]


EXCITATION = ExcitationOptions(harmonics=3, period=1.0, tempos=((1.0, 1),), steps=2)


@pytest.mark.ros
def test_experiments_run_on_the_real_nodes(
    processes: Processes,
    shipped: Setup,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The recorder's bag of a planned excitation run has the set-points and torques of the engine, to the bit."""
    cell = processes.start("rx90_cell", "--ros-args", "-p", "rx90_sim:real_time_factor:=1.0")
    run_of_plan = plan_excitation(PlannedArm.from_setup(shipped), EXCITATION)[0][0]
    series = short_series(shipped)
    monkeypatch.setattr(plans, "make_plan", lambda *_: [run_of_plan, *series])
    last_time, cut_off = nodes._last_time, [0.0]

    def too_early_once(bag: Path) -> float:
        return cut_off.pop() if bag.name == "cycle" and cut_off else last_time(bag)

    monkeypatch.setattr(nodes, "_last_time", too_early_once)
    folder = tmp_path / "bags"
    interrupt = threading.Thread(target=interrupt_once, args=[folder / "long"])
    interrupt.start()
    assert run("rx90 experiment sliding", ["nodes", "--output", str(folder)]) == INTERRUPTED
    interrupt.join()
    cell.signal(signal.SIGINT)
    said = capsys.readouterr().err
    assert said.splitlines()[-1] == "rx90 experiment: interrupted; complete bags stay"
    again = re.findall(r"(\w+): the bag ends at [\d.]+ s, before the motion does at [\d.]+ s; again", said)
    assert again.count("cycle") >= 1
    done = read_index(folder)
    bags = *done.excitation, *done.presliding, *done.sliding
    assert [bag.name for bag in bags] == ["excitation_1", "cycle", "slide"]
    assert not [file for file in open_files() if str(folder) in file]
    if run_of_plan.name not in again:  # on a busy machine: from where the first time ended
        check_against_the_engine(done.excitation[0], run_of_plan, shipped)
    output = tmp_path / "friction.yaml"
    words = ["sliding", folder / "slide", "--presliding", folder / "cycle", "--output", output]
    assert run("rx90 identify", [str(word) for word in words]) == DONE
    found, true = (
        load_friction(output, RX_WRIST.element_names(shipped.robot.joint_names)).elements[3],
        shipped.friction.elements[3],
    )
    assert abs(found.tau_c.positive / true.tau_c.positive - 1.0) < 0.02
    assert abs(found.c0 / true.c0 - 1.0) < 0.05


def check_against_the_engine(bag: Path, run: Experiment, setup: Setup) -> None:
    """Hold the first run on new nodes against the closed loop along the same plan, which begins when the bag's does."""
    names = ("motor_states", "rx90_controller/reference")
    _, reference = recorded = [read_joint_states(bag, name) for name in names]
    assert reference.position is not None
    still = int(np.flatnonzero((reference.position != run.points.position[0]).any(axis=1))[0]) - 1
    begin, end = (reference.stamp_ns[row] / 1e9 for row in (still, -1))
    assert end - begin > run.points.times[-1]
    engine = simulate(setup, run.points, duration=end + 1e-3, start_time=begin, record_fast=True).series
    for name, found in zip(names, recorded, strict=True):
        there = np.flatnonzero(found.stamp_ns <= reference.stamp_ns[-1])
        rows = np.searchsorted(engine[name].stamp_ns, found.stamp_ns[there])
        for quantity in ("stamp_ns", "position", "velocity", "effort"):
            expected = getattr(engine[name], quantity)
            assert np.array_equal(expected[rows], getattr(found, quantity)[there]), (name, quantity)


def interrupt_once(bag: Path) -> None:
    """Send this process a Ctrl-C as soon as a bag is there."""
    wait_until(bag.exists, "the last bag")
    os.kill(os.getpid(), signal.SIGINT)
