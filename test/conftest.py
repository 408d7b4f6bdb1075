"""Fixtures that the rooms of the test folder share."""

import copy
import gc
import os
import signal
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, settings
from needs import give_up

# Small matrices: a second thread of the BLAS waits in a loop, and takes the core from the worker beside this one. NumPy
# reads this once, when it is imported, and so do the processes that tests start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from rx90_common.description.robot_files import RobotFiles
from rx90_common.process.requirements import missing_module
from rx90_emulator.loop.setup import Setup

# However slow the machine, and with the same examples in each run, so that a failure comes from a change.
# `--hypothesis-profile=new` searches for others.
settings.register_profile("new", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("same", settings.get_profile("new"), derandomize=True)
settings.load_profile("same")

pytest_plugins = ["browser", "report_pages", "processes", "lugre_oracle"]

# A background job or `nohup` ignores signals, and what it starts inherits that: tests of interrupts would wait in vain.
for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, handler)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Leave what the imports of all tests have made out of every later search for garbage: it stays to the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that look at a page in a browser, so that `make test-fast` can leave them out."""
    for item in items:
        if isinstance(item, pytest.Function) and "chromium" in item.fixturenames:
            item.add_marker("browser")


@pytest.fixture(autouse=True)
def _handlers_stay() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        if signal.getsignal(number) != handler:
            signal.signal(number, handler)


@pytest.fixture(scope="session")
def shipped() -> Setup:
    return Setup.load()


@pytest.fixture(scope="session")
def tx40() -> Setup:
    """Return the setup of the TX40: its motor 4 turns against its joint, and it carries no tool."""
    return Setup.load(RobotFiles.named("tx40"))


@pytest.fixture(scope="session")
def shipped_files() -> RobotFiles:
    return RobotFiles()


def _need_messages(package: str) -> None:
    from rx90_common.exchange.ros_start import missing_messages

    if line := missing_messages(package):
        give_up(line)


@pytest.fixture(scope="session")
def needs_action() -> None:
    _need_messages("control_msgs")


@pytest.fixture(scope="session")
def needs_manager() -> None:
    _need_messages("controller_manager_msgs")


@pytest.fixture(scope="session")
def needs_tf() -> None:
    try:
        import tf2_msgs.msg  # noqa: F401
    except ImportError as error:
        give_up(missing_module(error) or str(error))


@pytest.fixture
def edited_yaml(tmp_path: Path) -> Callable[..., Path]:
    def edit(source: Path, path: tuple[str | int, ...], value: Any, *, remove: bool = False) -> Path:
        data = copy.deepcopy(yaml.safe_load(source.read_text(encoding="utf-8")))
        holder = data
        for key in path[:-1]:
            holder = holder[key]
        if remove:
            del holder[path[-1]]
        else:
            holder[path[-1]] = value
        target = tmp_path / source.name
        target.write_text(yaml.safe_dump(data), encoding="utf-8")
        return target

    return edit
