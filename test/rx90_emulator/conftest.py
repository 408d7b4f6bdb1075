"""A short line, so that a run takes milliseconds."""

from pathlib import Path

import pytest
from short_task import SHORT_TASK

from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.loop.parameters import Catalogue
from rx90_emulator.loop.setup import Setup


@pytest.fixture(scope="session")
def task_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("task") / "short.yaml"
    file.write_text(SHORT_TASK, encoding="utf-8")
    return file


@pytest.fixture(scope="session")
def task(task_file: Path) -> LineTask:
    return load_task(task_file)


@pytest.fixture(scope="session")
def catalogue(shipped: Setup, task: LineTask) -> Catalogue:
    return Catalogue(shipped, task)
