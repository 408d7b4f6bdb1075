"""Start the demonstration's processes, wait for what they say, and leave none behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from rx90_common.base.errors import ProcessError
from rx90_common.process.interrupts import interrupts_later


class ManagedProcess:
    """A child process whose output goes to a log file and can be waited for."""

    def __init__(self, name: str, module: str, arguments: Sequence[str], log: Path) -> None:
        self.name = name
        self.log = log
        self._changed = threading.Condition()
        self._lines: list[str] = []
        # A session of its own: Ctrl-C reaches the parent alone, which ends the children in order.
        self.process = subprocess.Popen(
            [sys.executable, "-u", "-m", module, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
            env=os.environ,
        )
        self._reader = threading.Thread(target=self._read, name=f"log of {name}", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.log.open("w", encoding="utf-8") as file:
            for line in self.process.stdout:
                file.write(line)
                file.flush()
                with self._changed:
                    self._lines.append(line.rstrip("\n"))
                    self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()

    @property
    def lines(self) -> list[str]:
        """Return what the process has printed so far."""
        with self._changed:
            return list(self._lines)

    def wait_for(self, text: str, timeout: float) -> str:
        """Return the first line that contains `text`.

        Raises:
            ProcessError: if the process ends first, or says nothing like it within `timeout` seconds.
        """
        deadline = time.monotonic() + timeout
        seen = 0
        with self._changed:
            while True:
                for line in self._lines[seen:]:
                    if text in line:
                        return line
                seen = len(self._lines)
                if not self._reader.is_alive():
                    raise ProcessError(f"the {self.name} ended early: {self._last_line()} (see {self.log})")
                left = deadline - time.monotonic()
                if left <= 0:
                    raise ProcessError(
                        f"the {self.name} did not say '{text}' within {timeout:g} s: {self._last_line()} "
                        f"(see {self.log})"
                    )
                self._changed.wait(min(left, 0.5))

    def wait(self, timeout: float) -> int:
        """Return the exit code.

        Raises:
            ProcessError: if the process is still there after `timeout` seconds.
        """
        try:
            code = self.process.wait(timeout)
        except subprocess.TimeoutExpired as error:
            raise ProcessError(f"the {self.name} did not end within {timeout:g} s (see {self.log})") from error
        self._reader.join(timeout)
        return code

    def signal(self, number: signal.Signals) -> None:
        """Send a signal, if the process is still there."""
        if self.process.poll() is None:
            self.process.send_signal(number)

    def _last_line(self) -> str:
        return self._lines[-1] if self._lines else "it printed nothing"


class ProcessGroup:
    """Processes that end together: interrupted in reverse order, killed if that does not help."""

    def __init__(self, folder: Path, grace: float = 5.0) -> None:
        self._folder = folder
        self._grace = grace
        self._members: list[ManagedProcess] = []

    def start(self, name: str, module: str, *arguments: str) -> ManagedProcess:
        """Start `python -m module arguments`, its output in `<folder>/<name>.log`."""
        # A process that was started but is not known yet could not be ended.
        with interrupts_later():
            member = ManagedProcess(name, module, arguments, self._folder / f"{name}.log")
            self._members.append(member)
        return member

    def __enter__(self) -> ProcessGroup:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # A second Ctrl-C must not leave the children behind.
        previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            self._end_all()
        finally:
            signal.signal(signal.SIGINT, previous)

    def _end_all(self) -> None:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            left = [member for member in reversed(self._members) if member.process.poll() is None]
            for member in left:
                member.signal(number)
            deadline = time.monotonic() + self._grace
            for member in left:
                try:
                    member.process.wait(max(0.0, deadline - time.monotonic()))
                except subprocess.TimeoutExpired:
                    continue
