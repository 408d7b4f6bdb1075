"""Child processes: start them, wait for their output, leave none behind.

A child has a session of its own, so that Ctrl-C in the terminal reaches the parent alone, and a pipe as standard input,
which closes when the parent ends, even by `kill -9`: then the child interrupts itself.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from rx90_common.base.errors import ProcessError
from rx90_common.base.share import PACKAGE, ROOT
from rx90_common.process.interrupts import deferred_interrupts

TIMEOUT = 120.0
"""Longest wait for a line or an end, s: generous, for a loaded machine with nothing compiled yet."""

_LAST_LINES_S = 10.0  # the longest wait for remaining output after the end: its own children may keep the stream open
_WATCHES_STDIN = "RX90_CHILD_WATCHES_STDIN"  # in the environment of a child
_ORPHAN_GRACE_S = 20.0  # from the interrupt of a child without a parent until it is killed


def executable(name: str, *arguments: object) -> list[str]:
    """Return the command that runs an executable, or `rx90 VERB`, with this Python, its output unbuffered.

    By the path of the entry: with -m, modules of the working folder would come before all others, also before Python's.
    """
    return [
        sys.executable,
        "-u",
        str(ROOT / PACKAGE / "__main__.py"),
        *name.split(),
        *map(str, arguments),
    ]


class ChildProcess:
    """A process whose lines of output, stdout and stderr in one stream, can be waited for.

    Args:
        name: for messages.
        command: with its arguments.
        log: file that the output goes to as well.
    """

    def __init__(self, name: str, command: Sequence[str], log: Path | None = None) -> None:
        self.name = name
        self.log = log
        self._changed = threading.Condition()
        self._lines: list[str] = []
        self._looked_at = 0
        # A session of its own: Ctrl-C reaches the parent alone, which ends the children in order.
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,  # never written to; it ends with this process, however that ends
            env={**os.environ, _WATCHES_STDIN: "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, name=f"output of {name}", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with (self.log or Path(os.devnull)).open("w", encoding="utf-8") as file:
            for line in self._process.stdout:
                file.write(line)
                file.flush()
                with self._changed:
                    self._lines.append(line.rstrip("\n"))
                    self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()

    @property
    def pid(self) -> int:
        """Return the process id, which is also that of its group."""
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """Return the exit code, None while it runs."""
        return self._process.poll()

    @property
    def lines(self) -> list[str]:
        """Return the lines printed so far."""
        with self._changed:
            return list(self._lines)

    @property
    def output(self) -> str:
        """Return the output printed so far as one text."""
        return "\n".join(self.lines)

    def wait_for(self, pattern: str, timeout: float = TIMEOUT) -> re.Match[str]:
        """Return the match of the first line with `pattern` in it, after those checked by earlier calls.

        Raises:
            ProcessError: if the process ends first, or prints no such line within `timeout` seconds.
        """
        deadline = time.monotonic() + timeout
        with self._changed:
            while True:
                while self._looked_at < len(self._lines):
                    match = re.search(pattern, self._lines[self._looked_at])
                    self._looked_at += 1
                    if match:
                        return match
                if not self._reader.is_alive():
                    raise ProcessError(f"the {self.name} ended early: {self._last_line()}")
                remaining = deadline - time.monotonic()
                if remaining <= 0:
                    reason = f"did not say '{pattern}' within {timeout:g} s"
                    raise ProcessError(f"the {self.name} {reason}: {self._last_line()}")
                self._changed.wait(min(remaining, 0.2))

    def wait(self, timeout: float = TIMEOUT) -> int:
        """Return the exit code.

        Raises:
            ProcessError: if the process is still there after `timeout` seconds.
        """
        try:
            code = self._process.wait(timeout)
        except subprocess.TimeoutExpired as error:
            raise ProcessError(
                f"the {self.name} did not end within {timeout:g} s: {self._last_line()}"
            ) from error
        self._reader.join(_LAST_LINES_S)
        assert self._process.stdin is not None
        self._process.stdin.close()
        return code

    def expect_success(self, timeout: float = TIMEOUT) -> None:
        """Wait for the end.

        Raises:
            ProcessError: if there is none within `timeout` seconds, or its exit code is not 0.
        """
        code = self.wait(timeout)
        if code != 0:
            raise ProcessError(f"the {self.name} ended with exit code {code}: {self._last_line()}")

    def signal(self, number: signal.Signals) -> None:
        """Send a signal, if the process is still there."""
        self._process.send_signal(number)

    def _last_line(self) -> str:
        last = self._lines[-1] if self._lines else "it printed nothing"
        return last if self.log is None else f"{last} (see {self.log})"


class ProcessGroup:
    """Processes that end together, last started first: interrupted, and killed if that does not help.

    Args:
        folder: for a log of each, `<name>.log`; None for no logs.
        grace: how long to wait after each signal, s.
    """

    def __init__(self, folder: Path | None = None, grace: float = 5.0) -> None:
        self._folder = folder
        self._grace = grace
        self._members: list[ChildProcess] = []

    def start(self, name: str, command: Sequence[str]) -> ChildProcess:
        """Start a command as a member of the group."""
        log = None if self._folder is None else self._folder / f"{name}.log"
        # A process that was started but is not known yet could not be ended.
        with deferred_interrupts():
            member = ChildProcess(name, command, log)
            self._members.append(member)
        return member

    def __enter__(self) -> ProcessGroup:
        return self

    def __exit__(self, *_: object) -> None:
        # A second Ctrl-C must not leave the children behind.
        with deferred_interrupts():
            self.end()

    def end(self) -> list[ChildProcess]:
        """End all, with their own children; return those that did not end on SIGINT."""
        survivors: list[ChildProcess] = []
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            running = [member for member in reversed(self._members) if member.returncode is None]
            for member in running:
                # Not waited for yet: the id still is this group's. A stopped process is continued, so that it can end.
                os.killpg(member.pid, number)
                os.killpg(member.pid, signal.SIGCONT)
            deadline = time.monotonic() + self._grace
            for member in running:
                with suppress(ProcessError):
                    member.wait(max(0.0, deadline - time.monotonic()))
            survivors += [
                member
                for member in running
                if member.returncode is None and member not in survivors
            ]
        return survivors


def end_with_parent() -> None:
    """In a child process: be interrupted when the parent ends, even by a kill, and killed if that does not help."""
    if os.environ.pop(_WATCHES_STDIN, ""):
        threading.Thread(target=_end_with_stdin, name="parent", daemon=True).start()


def _end_with_stdin() -> None:
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(_ORPHAN_GRACE_S)
    os.killpg(0, signal.SIGKILL)  # a session of its own: this process and its children
