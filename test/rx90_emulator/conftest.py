"""A short line, so that a run takes milliseconds."""

from pathlib import Path

import pytest
from short_task import SHORT_TASK

import rx90_emulator as rx
from rx90_emulator.loop.parameters import Catalogue


@pytest.fixture(scope="session")
def task_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("task") / "short.yaml"
    file.write_text(SHORT_TASK, encoding="utf-8")
    return file


@pytest.fixture(scope="session")
def task(task_file: Path) -> rx.LineTask:
    return rx.load_task(task_file)


@pytest.fixture(scope="session")
def catalogue(shipped: rx.Setup, task: rx.LineTask) -> Catalogue:
    return Catalogue(shipped, task)
