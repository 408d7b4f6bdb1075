"""A short line, so that a run takes milliseconds."""

from __future__ import annotations

from pathlib import Path

import pytest

from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.loop.catalogue import Catalogue
from rx90_emulator.loop.setup import Setup

SHORT_TASK = """
line:
  start: [0.6, -0.3, 0.2]
  end: [0.6034, -0.2808, 0.1955]
  speed: 0.1
  acceleration: 2.0
  tool_rpy_degrees: [0.0, 180.0, 0.0]
  rest_before: 0.05
  rest_after: 0.05
"""


@pytest.fixture(scope="session")
def task_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of a line of 20 mm."""
    file = tmp_path_factory.mktemp("task") / "short.yaml"
    file.write_text(SHORT_TASK, encoding="utf-8")
    return file


@pytest.fixture(scope="session")
def task(task_file: Path) -> LineTask:
    """Return a line of 20 mm."""
    return load_task(task_file)


@pytest.fixture(scope="session")
def catalogue(shipped: Setup, task: LineTask) -> Catalogue:
    """Return the paths of the shipped setup and the short line."""
    return Catalogue(shipped, task)
