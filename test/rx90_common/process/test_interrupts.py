"""Ctrl-C is neither lost nor raised where a program cannot take it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from processes import wait_until

from rx90_common.process.interrupts import StopRequest, deferred_interrupts, install_deferred_sigint, stop_request

pytestmark = pytest.mark.slow


def _interrupted_block(reached: list[str], *, check: bool) -> None:
    with deferred_interrupts() as check_interrupt:
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
        with deferred_interrupts() as check:
            signal.raise_signal(signal.SIGINT)
            check()
    finally:
        signal.signal(signal.SIGINT, before)


class _Interrupted:
    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


def _destruct() -> None:
    thing = _Interrupted()
    del thing


def test_an_interrupt_where_it_would_get_lost_comes_later() -> None:
    """Exceptions of destructors get lost; the interrupt is raised in what follows."""
    before = signal.getsignal(signal.SIGINT)
    install_deferred_sigint()

    def wait() -> None:
        _destruct()
        deadline = time.monotonic() + 30.0
        while time.monotonic() < deadline:
            time.sleep(0.01)

    try:
        with pytest.raises(KeyboardInterrupt):
            wait()
    finally:
        signal.signal(signal.SIGINT, before)


_BUSY = """
import hashlib, os, subprocess, sys, threading, time
from rx90_common.process.children import ChildProcess, kill_all
from rx90_common.process.interrupts import ends_within
def last():
    kill_all()
    print("gave up", flush=True)
def compute(iterations):
    hashlib.pbkdf2_hmac("sha256", b"", b"", iterations)  # in C, without the lock
stands_still = []
def stuck():
    while not stands_still:  # on a busy machine the main thread may be on its way there
        time.sleep(0.01)
    kill_all()
    print("cut off", flush=True)
def wait_for_ever(lock):
    stands_still.append(True)
    lock.acquire()
with ends_within(0.1, 0.1 if "stuck" in sys.argv else 60.0, last, stuck) as start:
    child = ChildProcess("child", ["sleep", "600"])
    if "over" in sys.argv:
        start.over()
    try:
        print(child.pid, flush=True)
        while True:
            compute(1000 if "over" in sys.argv else 10**9)
    except KeyboardInterrupt:
        if "stuck" in sys.argv:
            lock = threading.Lock()
            lock.acquire()
            wait_for_ever(lock)
        if "over" in sys.argv:
            raise
        compute(10**9)  # it came before the compiled code
"""


@pytest.mark.usefixtures("warm")
@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ([], 130, r"gave up\n"),
        (["over"], -signal.SIGINT, ""),
        (["over", "stuck"], 3, r"cut off\n"),
    ],
)
def test_it_ends_however_busy_it_is(words: list[str], code: int, said: str) -> None:
    """Ctrl-C ends a start in compiled code within its time, with 130 and its children; once it is over, as usual."""
    with subprocess.Popen(
        [sys.executable, "-c", _BUSY, *words], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        child = int(process.stdout.readline())
        process.send_signal(signal.SIGINT)
        rest = process.stdout.read()  # until the end
        assert process.wait() == code
        assert re.fullmatch(said, rest)
    if words == ["over"]:
        os.kill(child, signal.SIGKILL)
    else:
        wait_until(lambda: not Path(f"/proc/{child}").exists(), "the end of the child")


@pytest.fixture
def handlers() -> Iterator[None]:
    """Give the handlers back after the test, and end a test that stands still."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)
    before = [signal.getsignal(number) for number in numbers]

    def stands_still(_number: int, _frame: FrameType | None) -> None:
        raise TimeoutError("stands still")

    signal.signal(signal.SIGALRM, stands_still)
    signal.alarm(20)
    yield
    signal.alarm(0)
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


def _interrupted_at(step: int, call: Callable[[], object]) -> bool:
    """Call with a SIGINT before an instruction of its Python code; return whether it has as many."""
    left = step

    def trace(frame: FrameType, event: str, _argument: object) -> Any:
        nonlocal left
        frame.f_trace_opcodes = True
        if event == "opcode":
            if left == 0:
                signal.raise_signal(signal.SIGINT)
            left -= 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call()
    finally:
        sys.settrace(before)
    return left < 0


@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize("call", [lambda stop: stop.wait(1e-3), StopRequest.set])
def test_a_request_to_end_comes_at_any_step(call: Callable[[StopRequest], object]) -> None:
    """Between any two steps of a wait for it, or of another signal's handler, it is heard and nothing stands still."""
    step, interrupted = 0, True
    while interrupted:
        stop = stop_request()
        interrupted = _interrupted_at(step, partial(call, stop))
        assert not interrupted or (stop.is_set() and stop.wait())
        step += 1
    assert step > 10
