"""Ctrl-C is neither lost nor raised where a program cannot take it."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Callable
from importlib.machinery import ExtensionFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from processes import wait_until

from rx90_common.process.interrupts import interrupts_later, raise_where_heard


def _interrupted_block(reached: list[str], *, check: bool) -> None:
    with interrupts_later() as check_interrupt:
        signal.raise_signal(signal.SIGINT)
        reached.append("after the signal")
        if check:
            check_interrupt()
            reached.append("after the check")


@pytest.mark.parametrize("check", [True, False])
def test_an_interrupt_waits(check: bool) -> None:
    """Within the block Ctrl-C does nothing until the yielded function is called or the block ends."""
    before = signal.getsignal(signal.SIGINT)
    reached: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        _interrupted_block(reached, check=check)
    assert reached == ["after the signal"]
    assert signal.getsignal(signal.SIGINT) is before


def test_an_ignored_signal_stays_ignored() -> None:
    """Where a parent told the process to ignore Ctrl-C, the block does not take it up."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interrupts_later() as check:
            signal.raise_signal(signal.SIGINT)
            check()
    finally:
        signal.signal(signal.SIGINT, before)


class _Interrupted:
    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


class _Extension(ExtensionFileLoader):
    def exec_module(self, _module: ModuleType) -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:  # as numpy's own extension does
            raise ImportError from None


def _destruct() -> None:
    thing = _Interrupted()
    del thing


def _load_extension() -> None:
    _Extension("name", "path").exec_module(ModuleType("name"))


def _forget_lock() -> None:
    # As the import system has it in a function of its own: the lock of a module is gone once the module is imported.
    space: dict[str, Any] = {"signal": signal}
    source = "def cb(ref): signal.raise_signal(signal.SIGINT)"
    exec(compile(source, importlib._bootstrap._get_module_lock.__code__.co_filename, "exec"), space)  # type: ignore[attr-defined]
    lock = _Extension("name", "path")
    reference = weakref.ref(lock, space["cb"])
    del lock
    assert reference() is None


@pytest.mark.parametrize("interrupted", [_destruct, _load_extension, _forget_lock])
def test_an_interrupt_where_it_would_get_lost_comes_later(interrupted: Callable[[], None]) -> None:
    """Exceptions of destructors and callbacks get lost, those of extensions change; it is raised in what follows."""
    before = signal.getsignal(signal.SIGINT)
    raise_where_heard()

    def wait() -> None:
        interrupted()
        deadline = time.monotonic() + 30.0
        while time.monotonic() < deadline:
            time.sleep(0.01)

    try:
        with pytest.raises(KeyboardInterrupt):
            wait()
    finally:
        signal.signal(signal.SIGINT, before)


_BUSY = """
import hashlib, os, subprocess, sys
from rx90_common.process.children import ChildProcess, kill_all
from rx90_common.process.interrupts import start_that_ends_within
def last():
    kill_all()
    print("gave up", flush=True)
with start_that_ends_within(0.1, last) as start:
    child = ChildProcess("child", ["sleep", "600"])
    if "over" in sys.argv:
        start.over()
    try:
        print(child.pid, flush=True)
        while True:
            hashlib.pbkdf2_hmac("sha256", b"", b"", 1000 if "over" in sys.argv else 10**9)  # in C, without the lock
    except KeyboardInterrupt:  # it came before the compiled code
        if "over" in sys.argv:
            raise
        last()
        sys.exit(130)
"""


@pytest.mark.usefixtures("warm")
@pytest.mark.parametrize(("words", "code", "said"), [([], 130, "gave up\n"), (["over"], -signal.SIGINT, "")])
def test_a_start_ends_however_busy_it_is(words: list[str], code: int, said: str) -> None:
    """Ctrl-C ends a start in compiled code within its time, with 130 and its children; once it is over, as usual."""
    with subprocess.Popen(
        [sys.executable, "-c", _BUSY, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        assert process.stdout is not None
        child = int(process.stdout.readline())
        process.send_signal(signal.SIGINT)
        rest = process.stdout.read()  # until the end
        assert (process.wait(), rest) == (code, said)
    if words:
        os.kill(child, signal.SIGKILL)
    else:
        wait_until(lambda: not Path(f"/proc/{child}").exists(), "the end of the child")
