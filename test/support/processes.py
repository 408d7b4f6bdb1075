"""Run installed executables on a DDS domain of their own and end every one of them, also on failure."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

# Generous, because the suite must hold on a loaded machine with two cores and nothing compiled yet.
TIMEOUT = 120.0
END_TIMEOUT = 30.0
LAST_DOMAIN = 101  # the ports of higher ones reach into the range for outgoing connections
PORTS = 20  # that the first ten participants of a domain take, two each


def _own_domains() -> range:
    """Return the domains of this worker: those that run beside it have others."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    share = LAST_DOMAIN // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    return range(1 + worker * share, 1 + (worker + 1) * share)


_domains = itertools.count(os.getpid())


def executable(name: str) -> str:
    """Return the path of a console script of the environment that runs the tests."""
    path = Path(sys.executable).with_name(name)
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing; `make test` installs the package before it tests")
    return str(path)


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
    """Wait for a condition that nothing announces; fail the test when it does not come true."""
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            pytest.fail(f"waited {timeout:g} s in vain for {what}")
        time.sleep(0.01)


class Running:
    """A started process whose lines of output can be waited for (stdout and stderr in one stream)."""

    def __init__(self, command: Sequence[str]) -> None:
        self.name = Path(command[0]).name
        self.lines: list[str] = []
        self._news = threading.Condition()
        self._read = 0
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,  # a group of its own: what it starts itself can be ended too
        )
        self._reader = threading.Thread(target=self._collect, daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        """Return the process id, which is also the id of its group."""
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """Return the exit code, None while it runs."""
        return self._process.poll()

    @property
    def output(self) -> str:
        """Return all it has printed so far."""
        return "\n".join(self.lines)

    def wait_for(self, pattern: str, timeout: float = TIMEOUT) -> re.Match[str]:
        """Wait for a line, after those of earlier calls, in which the pattern is found."""
        deadline = time.monotonic() + timeout
        with self._news:
            while True:
                while self._read < len(self.lines):
                    match = re.search(pattern, self.lines[self._read])
                    self._read += 1
                    if match:
                        return match
                if not self._reader.is_alive():
                    pytest.fail(f"{self.name} ended without '{pattern}'; it said:\n{self.output}")
                if time.monotonic() > deadline:
                    pytest.fail(f"{self.name}: waited {timeout:g} s for '{pattern}'; it said:\n{self.output}")
                self._news.wait(timeout=0.2)

    def wait(self, timeout: float = TIMEOUT) -> int:
        """Wait for the end and return the exit code."""
        try:
            code = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            pytest.fail(f"{self.name} still runs after {timeout:g} s; it said:\n{self.output}")
        self._reader.join(1.0)  # a child that lives on may hold the stream open
        return code

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the process alone."""
        self._process.send_signal(number)

    def interrupt(self) -> None:
        """Send SIGINT to the whole group, as Ctrl-C in a terminal does."""
        os.killpg(self.pid, signal.SIGINT)

    def end(self) -> bool:
        """End the process and all it started; return whether it went on its own after Ctrl-C."""
        willing = True
        if self._process.poll() is None:
            self.signal(signal.SIGCONT)
            self.interrupt()
            try:
                self._process.wait(END_TIMEOUT)
            except subprocess.TimeoutExpired:
                willing = False
        try:
            os.killpg(self.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        else:
            self._process.wait()
        self._reader.join(5.0)
        return willing

    def _collect(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._news:
                self.lines.append(line.rstrip("\n"))
                self._news.notify_all()
        with self._news:
            self._news.notify_all()


class Processes:
    """Starts processes; the fixture of the same name ends them."""

    def __init__(self) -> None:
        self._running: list[Running] = []

    def start(self, name: str, *arguments: object) -> Running:
        """Start an executable: a console script by its name, anything else by its path."""
        command = name if os.sep in name else executable(name)
        running = Running([command, *map(str, arguments)])
        self._running.append(running)
        return running

    def run(self, name: str, *arguments: object, timeout: float = TIMEOUT) -> subprocess.CompletedProcess[str]:
        """Run an executable to its end, with stdout and stderr apart."""
        command = name if os.sep in name else executable(name)
        return subprocess.run(
            [command, *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=timeout,
            check=False,
        )

    def end(self) -> list[str]:
        """End all; return the names of those that had to be killed."""
        unwilling = [running.name for running in reversed(self._running) if not running.end()]
        for running in self._running:
            print(f"--- {running.name} (exit code {running.returncode}):\n{running.output}")
        return unwilling


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[int]:
    """Put the test and all it starts on a free DDS domain that does not leave the machine."""
    for name in ("ROS_STATIC_PEERS", "RMW_IMPLEMENTATION", "FASTRTPS_DEFAULT_PROFILES_FILE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))
    monkeypatch.setenv("RCUTILS_COLORIZED_OUTPUT", "0")
    monkeypatch.setenv("PYTHONUNBUFFERED", "1")
    with own_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        yield domain


@pytest.fixture
def processes(ros_domain: int) -> Iterator[Processes]:  # noqa: ARG001
    """Give a Processes on a free domain; afterwards end every process, and fail if one ignored Ctrl-C."""
    started = Processes()
    try:
        yield started
    finally:
        unwilling = started.end()
    if unwilling:
        pytest.fail(f"did not end within {END_TIMEOUT:g} s of Ctrl-C: {', '.join(unwilling)}")
