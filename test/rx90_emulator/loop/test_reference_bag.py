"""The reference task gives the numbers that the reference bag holds."""

from __future__ import annotations

from pathlib import Path

import pytest

from rx90_common.bags.comparison import Verdict, compare_bags
from rx90_common.bags.tables import comparison_text
from rx90_common.base.share import config_path
from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.loop.line import run_line
from rx90_emulator.loop.result import write_bag
from rx90_emulator.loop.setup import Setup
from tools.digests import committed, digests

REFERENCE = Path(__file__).parents[2] / "reference" / "reference_task"
"""Written by `rx90_run --slow-only --decimation 20`; see the README beside it."""


@pytest.fixture(scope="module")
def task() -> LineTask:
    """Return the reference task."""
    return load_task(config_path("robots/rx90b/task.yaml"))


def test_a_new_run_equals_the_reference_bag(shipped: Setup, task: LineTask, tmp_path: Path) -> None:
    """Joint, friction, reference and error series are those of the reference bag to the last bit."""
    write_bag(run_line(shipped, task), tmp_path / "new", decimation=20)
    comparison = compare_bags(tmp_path / "new", REFERENCE)
    assert comparison.verdict is Verdict.SAME, comparison_text(comparison)
    assert len(comparison.topics) == 7


def test_constants_set_points_and_runs_have_the_committed_digests() -> None:
    """Constants, planned lines, set-points and runs are, bit for bit, those of every machine and library version."""
    assert digests() == committed()
