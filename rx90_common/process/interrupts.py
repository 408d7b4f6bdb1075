"""Ctrl-C, requests to end and exit codes, handled at safe points.

SIGTERM, and SIGHUP unless it is ignored, have the same effect as Ctrl-C. In a command all three raise
KeyboardInterrupt: it removes incomplete files, ends its children and switches the rig off. Nodes, recorder and
emulated rig only set a `StopRequest`, which needs no lock. Workers of a sweep are forked with the signals blocked;
their parent ends them.
"""

from __future__ import annotations

import atexit
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from types import FrameType

_INTERRUPTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_RETRY_S = 0.02
_codes: list[int] = []


def install_deferred_sigint() -> None:
    """From now on let Ctrl-C wait while Python is in a destructor or a callback of the compiler, which lose exceptions.

    The compiler calls back whenever it loads a kernel from its cache: likely in the first seconds.
    """
    signal.signal(signal.SIGINT, _interrupt_where_safe)


def _interrupt_where_safe(_number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if "llvmlite" in frame.f_code.co_filename or frame.f_code.co_name == "__del__":
            again = threading.Timer(_RETRY_S, os.kill, [os.getpid(), signal.SIGINT])
            again.daemon = True
            again.start()
            return
        frame = frame.f_back
    raise KeyboardInterrupt


@contextmanager
def terminations_as_interrupts() -> Iterator[None]:
    """Within the block, SIGTERM and SIGHUP (the terminal closes) raise KeyboardInterrupt, as Ctrl-C does.

    Handlers that the block itself sets stay. Outside the main thread nothing changes: Python takes no signals there.
    """
    takes_signals = threading.current_thread() is threading.main_thread()
    numbers = [
        number
        for number in _INTERRUPTS[1:]
        if takes_signals and signal.getsignal(number) == signal.SIG_DFL
    ]
    for number in numbers:
        signal.signal(number, _interrupt_where_safe)
    try:
        yield
    finally:
        for number in numbers:
            if signal.getsignal(number) == _interrupt_where_safe:
                signal.signal(number, signal.SIG_DFL)


class StopRequest:
    """Whether the program is requested to end; signal handlers may set it, one thread may wait for it.

    A handler runs on the main thread between two of its steps, so it must not need a lock of the wait that
    it interrupts: with a threading.Event, both would then wait for ever.
    """

    def __init__(self) -> None:
        self._is_set = False
        # its `put` may interrupt its own `get` and `put`
        self._woken: SimpleQueue[None] = SimpleQueue()

    def set(self) -> None:
        """Ask; a second time changes nothing."""
        self._is_set = True
        self._woken.put(None)

    def is_set(self) -> bool:
        """Return whether it is set."""
        return self._is_set

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it is set, at most `timeout` seconds; return whether it is."""
        if not self._is_set:
            with suppress(Empty):
                self._woken.get(timeout=timeout)
        return self._is_set


def stop_request() -> StopRequest:
    """Return a request that Ctrl-C, SIGTERM and SIGHUP make from now on; a second signal changes nothing."""
    stopped = StopRequest()
    _take_over(lambda _number, _frame: stopped.set())
    return stopped


def exit_on_signal() -> None:
    """From now on Ctrl-C, SIGTERM and SIGHUP end the process at once with 0, without any clean-up."""
    _take_over(lambda _number, _frame: os._exit(0))


def keep_exit_code() -> None:
    """Ignore signals at the very end of the process, so that an impatient second Ctrl-C does not change the exit code.

    Before it ends, Python removes its handlers, but leaves ignored signals ignored. Call this early: exit functions run
    in reverse order, so Ctrl-C still ends those that are registered later, and the wait for threads.
    """
    atexit.register(_take_over, signal.SIG_IGN)


def _take_over(handler: Callable[[int, FrameType | None], object] | signal.Handlers) -> None:
    # Also where the parent ignores Ctrl-C, as rclpy does; but not the SIGHUP that nohup has ignored.
    for number in _INTERRUPTS:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


@contextmanager
def deferred_interrupts() -> Iterator[Callable[[], None]]:
    """Hold interrupts back within the block; they are raised when the yielded function is called, or after the block.

    Raised in the middle of a constructor, KeyboardInterrupt leaves half an object behind: a child process that nobody
    knows, or an rclpy executor whose destructor complains. Outside the main thread, where Python takes no signals,
    nothing needs to be held back.

    Raises:
        KeyboardInterrupt: from the yielded function, or after the block if nothing else is raised in it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    pending: list[int] = []

    def check() -> None:
        if pending:
            pending.clear()
            raise KeyboardInterrupt

    # Only signals that Python handles: an ignored signal stays ignored, and one that ends the process at once still
    # does.
    # A handler, not a mask or SIG_IGN, because a child would inherit those.
    before = {
        number: handler for number in _INTERRUPTS if callable(handler := signal.getsignal(number))
    }
    for number in before:
        signal.signal(number, lambda number, _frame: pending.append(number))
    try:
        yield check
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    check()


def end_with(code: int) -> None:
    """Let this process end with `code`, whatever it returns later; for code -n, of signal n, with 128 + n.

    For programs that start others, and for libraries that keep the process from ending in order. The first code that is
    not 0 counts: processes that end later are ended by the launcher itself.
    """
    if code and not _codes:
        _codes.append(code if code > 0 else 128 - code)
        atexit.register(_leave)


def _leave() -> None:
    # At the end of the process this is the only way to another exit code; functions registered earlier do not run.
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(_codes[0])
