"""Sweeps by the perturbation method: the closed loop's results, faster, as far as the method holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rx90_common.base.errors import REFUSED, ConfigError, FailureError
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.cli.frame import run
from rx90_emulator.sweep.plan import Block, LogUniform, SweepBase, SweepPlan, SweptParameter, Values
from rx90_emulator.sweep.store import read_sweep
from rx90_emulator.sweep.sweep import DEVIATION, RunOutcome, Sweep

SHIFTS = {"path_error_worst": 0.01, "path_error_rms": 0.005, "tracking_error_rms_joint_3": 0.005}
"""Largest relative differences: of worst errors on a short line, a count of the encoders."""


@pytest.fixture(scope="module")
def plan(task_file: Path) -> SweepPlan:
    """Return 12 runs over friction, gains and speed; soft gains carry the arm no more."""
    stiffness = SweptParameter("friction.*.c0", factor=True, space=LogUniform(0.5, 2.0))
    gain = SweptParameter("controller.kp[*]", factor=True, space=Values((0.7, 1.0)))
    speed = SweptParameter("task.speed", factor=True, space=Values((0.5, 1.0)))
    soft = SweptParameter(
        "soft", paths=("controller.kp[*]", "controller.kv[*]"), factor=True, space=Values((0.06, 1.0))
    )
    parts = ("velocity", "acceleration", "coulomb", "viscous")
    bare = SweptParameter(
        "bare", paths=tuple(f"controller.feed_forward.{name}" for name in parts), space=Values((False,))
    )
    limits = tuple(
        SweptParameter(path, space=Values((value,)))
        for path, value in (
            ("controller.ki[*]", 0.0), ("controller.following_error[*]", 1e3), ("controller.over_speed", 1e3)
        )
    )  # fmt: skip
    blocks = (
        Block("gains", (speed, gain), (stiffness,), draws=2),
        Block("soft", (soft, bare, *limits), (stiffness,), draws=2),
    )
    return SweepPlan(blocks, base=SweepBase(RobotFiles(task=task_file), method="perturbation"))


@pytest.fixture(scope="module")
def sweep(plan: SweepPlan) -> Sweep:
    """Return the sweep."""
    return Sweep(plan)


@pytest.fixture(scope="module")
def outcomes(sweep: Sweep) -> list[RunOutcome]:
    """Return what comes of its runs, computed together."""
    return sweep.run_together(range(len(sweep)))


def test_runs_are_those_of_the_closed_loop(plan: SweepPlan, sweep: Sweep, outcomes: list[RunOutcome]) -> None:
    """Path and tracking errors of each run are the closed loop's; each is the same alone to the bit."""
    loop = Sweep(replace(plan, base=replace(plan.base, method="closed_loop")))
    columns, full = ([metric.name for metric in one.metrics] for one in (sweep, loop))
    for index in (0, 3, 4, 7):
        found, expected = outcomes[index].metrics, loop.run(index).metrics
        assert found is not None
        assert expected is not None
        for name, shift in SHIFTS.items():
            one, other = found[columns.index(name)], expected[full.index(name)]
            assert abs(one / other - 1.0) < shift, (index, name)
        assert found == sweep.run_together([index])[0].metrics
    speeds = [dict(outcome.run.values)["task.speed"] for outcome in outcomes[:8]]
    assert speeds == [0.5, 0.5, 1.0, 1.0] * 2


def test_a_tip_that_is_far_away_ends_a_run(sweep: Sweep, outcomes: list[RunOutcome]) -> None:
    """Beyond 40 mm the method is not valid, and says so; its other runs stay."""
    far = [outcome for outcome in outcomes if outcome.error is not None]
    assert [dict(outcome.run.values).get("soft") for outcome in far] == [0.06, 0.06]
    for outcome in far:
        assert outcome.error is not None
        assert " mm from its set-points; accepted by the perturbation method: 40 mm" in outcome.error
        assert outcome.metrics is None
    deviations = [None if one.metrics is None else float(one.metrics[-1]) for one in outcomes]
    assert sweep.metrics[-1].name == DEVIATION
    largest = int(np.argmax([away or 0.0 for away in deviations]))
    assert sweep.check_method(deviations).startswith(f"run {largest}, whose tip deviates most (")
    with pytest.raises(FailureError, match=r"accepted: up to 5 % of the deviation apart, or method: closed_loop"):
        sweep.check_method([1e-9, *[None] * (len(sweep) - 1)])  # as if so small a deviation had such a difference


def test_the_command_says_how_far_the_method_holds(
    task_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`rx90_sweep run` ends with both path errors of a run; the file is not taken up by the other method."""
    plan, output = tmp_path / "plan.yaml", tmp_path / "runs.parquet"
    text = (
        "base: {{task: {}, method: {}}}\nblocks: {{one: {{grid: {{friction.joint_2.c0: {{factor: [0.5, 1.0]}}}}}}}}\n"
    )
    plan.write_text(text.format(task_file, "perturbation"), encoding="utf-8")
    arguments = ["run", str(plan), "--output", str(output), "--workers", "1"]
    assert run("rx90_sweep", arguments) == 0
    said = capsys.readouterr().out
    assert "2 of 2 runs in " in said
    assert " um by the perturbation method, " in said
    assert read_sweep(output)[DEVIATION].null_count == 0
    plan.write_text(text.format(task_file, "closed_loop"), encoding="utf-8")
    assert run("rx90_sweep", [*arguments, "--resume"]) == REFUSED
    plan.write_text(text.format(task_file, "quick"), encoding="utf-8")
    assert run("rx90_sweep", arguments) == REFUSED
    assert "base.method is 'quick'; accepted: one of closed_loop, perturbation" in capsys.readouterr().err


def test_what_the_method_cannot_hold_is_refused() -> None:
    """More plant steps in a tick, and other methods, end in one line."""
    with pytest.raises(ConfigError, match="substeps is 4; accepted by the perturbation method: 1, or left out"):
        SweepBase(substeps=4, method="perturbation")
    with pytest.raises(ConfigError, match="method is 'both'; accepted: closed_loop or perturbation"):
        SweepBase(method="both")
