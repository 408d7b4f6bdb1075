"""Run installed executables on a DDS domain of their own and end every one of them, also on failure."""

import contextlib
import fcntl
import itertools
import os
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from warm_start import WarmPopen

from rx90_common.process.children import TIMEOUT, ChildProcess, ProcessGroup, executable

END_TIMEOUT = 30.0
LAST_DOMAIN = 101  # the ports of higher ones reach into the range for outgoing connections
PORTS = 20  # that the first ten participants of a domain take, two each
_domains = itertools.count(os.getpid())


def pytest_configure() -> None:
    """Have SIGTERM end the tests as Ctrl-C does: with what their fixtures have started."""
    signal.signal(signal.SIGTERM, lambda *_: pytest.exit("SIGTERM", returncode=128 + signal.SIGTERM))


def script(name: str) -> str:
    path = Path(sys.executable).with_name(name)
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing; `make test` installs the package before it tests")
    return str(path)


def command(name: str, *arguments: object) -> list[str]:
    return [name, *map(str, arguments)] if os.sep in name else executable(name, *arguments)


@contextlib.contextmanager
def own_domain() -> Iterator[int]:
    """Give a DDS domain in which no participant is, and keep it from other tests on this machine."""
    for number in itertools.islice(_domains, LAST_DOMAIN):
        domain = number % LAST_DOMAIN + 1
        with contextlib.ExitStack() as held:
            try:
                lock = held.enter_context((Path(tempfile.gettempdir()) / f"rx90_domain_{domain}.lock").open("w"))
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            if all(_is_free(7410 + 250 * domain + port) for port in range(PORTS)):
                yield domain
                return
    raise RuntimeError(f"all DDS domains from 1 to {LAST_DOMAIN} are in use on this machine")


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", port))
        except OSError:
            return False
    return True


def wait_until(condition: Callable[[], bool], what: str, timeout: float = TIMEOUT) -> None:
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            pytest.fail(f"waited {timeout:g} s in vain for {what}")
        time.sleep(0.01)


@contextlib.contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """Let no file grow beyond so many bytes, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def open_files(pid: int | str = "[0-9]*") -> Iterator[str]:
    """Yield the path of every file and socket that a process has open, or any; some may be closed meanwhile."""
    for link in Path("/proc").glob(f"{pid}/fd/*"):
        with contextlib.suppress(OSError):
            yield str(link.readlink())


class Processes:
    def __init__(self, grace: float = END_TIMEOUT) -> None:
        self._group = ProcessGroup(grace=grace)
        self._started: list[ChildProcess] = []

    def start(self, name: str, *arguments: object) -> ChildProcess:
        process = self._group.start(Path(name).name, command(name, *arguments))
        self._started.append(process)
        return process

    def run(self, name: str, *arguments: object, timeout: float = TIMEOUT) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command(name, *arguments),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=timeout,
            check=False,
        )

    def end(self) -> list[str]:
        survivors = [process.name for process in self._group.end()]
        for process in self._started:
            print(f"--- {process.name} (exit code {process.returncode}):\n{process.output}")
        return survivors


@contextlib.contextmanager
def on_own_domain(monkeypatch: pytest.MonkeyPatch, folder: Path) -> Iterator[int]:
    for name in ("ROS_STATIC_PEERS", "RMW_IMPLEMENTATION", "FASTRTPS_DEFAULT_PROFILES_FILE"):
        monkeypatch.setenv(name, "")  # so that monkeypatch remembers each of them, whatever the test sets
        monkeypatch.delenv(name)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    monkeypatch.setenv("ROS_LOG_DIR", str(folder / "ros_log"))
    monkeypatch.setenv("RCUTILS_COLORIZED_OUTPUT", "0")
    monkeypatch.setenv("PYTHONUNBUFFERED", "1")
    with own_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        yield domain


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[int]:
    with on_own_domain(monkeypatch, tmp_path) as domain:
        yield domain


@pytest.fixture
def warm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "Popen", WarmPopen)


@contextlib.contextmanager
def running_processes() -> Iterator[Processes]:
    started = Processes()
    try:
        yield started
    finally:
        survivors = started.end()
    if survivors:
        pytest.fail(f"did not end within {END_TIMEOUT:g} s of Ctrl-C: {', '.join(survivors)}")


@contextlib.contextmanager
def own_processes(folder: Path) -> Iterator[Processes]:
    with pytest.MonkeyPatch.context() as patch, on_own_domain(patch, folder):
        patch.setattr(subprocess, "Popen", WarmPopen)
        with running_processes() as started:
            yield started


@pytest.fixture
def processes(ros_domain: int, warm: None) -> Iterator[Processes]:  # noqa: ARG001 - what they do is done
    with running_processes() as started:
        yield started


Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start_apart() -> Iterator[Start]:
    """Return a function that starts a command line, cold unless `warm`, in a session of its own, which is killed."""
    started: list[subprocess.Popen[str]] = []

    def start(*words: str, **options: Any) -> subprocess.Popen[str]:
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        started.append(subprocess.Popen(words, text=True, start_new_session=True, **pipes, **options))
        return started[-1]

    yield start
    for process in started:
        with contextlib.suppress(ProcessLookupError):  # nothing of its session is left
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate(timeout=TIMEOUT)
