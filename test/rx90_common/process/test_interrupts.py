"""Ctrl-C is neither lost nor raised where a program cannot take it."""

import signal
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from types import FrameType
from typing import Any

import pytest

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
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with deferred_interrupts() as check:
        signal.raise_signal(signal.SIGINT)
        check()


class _Interrupted:
    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


def test_an_interrupt_where_it_would_get_lost_comes_later() -> None:
    """Exceptions of destructors get lost; the interrupt is raised in what follows."""
    install_deferred_sigint()

    def wait() -> None:
        _Interrupted()
        deadline = time.monotonic() + 30.0
        while time.monotonic() < deadline:
            time.sleep(0.01)

    with pytest.raises(KeyboardInterrupt):
        wait()


@pytest.fixture
def alarmed() -> Iterator[None]:
    def stands_still(_number: int, _frame: FrameType | None) -> None:
        raise TimeoutError("stands still")

    before = signal.signal(signal.SIGALRM, stands_still)
    signal.alarm(20)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


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


@pytest.mark.usefixtures("alarmed")
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
