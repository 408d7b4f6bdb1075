"""Ctrl-C and requests to end that come only where a program can take them; docs/explanation/processes.md tells why."""

from __future__ import annotations

import _weakrefset
import atexit
import os
import signal
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.machinery import ExtensionFileLoader
from queue import Empty, SimpleQueue
from types import FrameType
from typing import NamedTuple

from rx90_common.base.errors import FAILED, INTERRUPTED
from rx90_common.process.exit_code import end_with

_INTERRUPTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_RETRY = 0.02
_WEAK = {  # functions that are called back by a weak reference, by their files
    "<frozen importlib._bootstrap>": {"cb"},
    _weakrefset.__file__: {"_remove"},
    weakref.__file__: {"remove", "__call__"},
}


def install_deferred_sigint() -> None:
    """From now on let Ctrl-C wait while Python is where an exception gets lost or becomes another one.

    That is in the compiler's callbacks, which come whenever it loads a kernel from its cache, in destructors, in
    callbacks of weak references, as where the import system forgets the lock of a module, and while an extension module
    initialises itself, where numpy makes an ImportError of it: likely in the first seconds.
    """
    signal.signal(signal.SIGINT, _interrupt_where_safe)


def _interrupt_where_safe(_number: int, frame: FrameType | None) -> None:
    while frame is not None:
        code = frame.f_code
        if (
            "llvmlite" in code.co_filename
            or code.co_name == "__del__"
            or code.co_name in _WEAK.get(code.co_filename, ())
            or (code.co_name.endswith("_module") and isinstance(frame.f_locals.get("self"), ExtensionFileLoader))
        ):
            again = threading.Timer(_RETRY, os.kill, [os.getpid(), signal.SIGINT])
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
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) == signal.SIG_DFL]
    for number in numbers:
        signal.signal(number, _interrupt_where_safe)
    try:
        yield
    finally:
        for number in numbers:
            if signal.getsignal(number) == _interrupt_where_safe:
                signal.signal(number, signal.SIG_DFL)


class StopRequest:
    """Whether a program was asked to end; signal handlers may set it, one thread may wait for it.

    A handler runs on the main thread between two steps of what that does, so it must not want a lock of the wait that
    it interrupts: with a threading.Event, both would then stand still for ever.
    """

    def __init__(self) -> None:
        self._is_set = False
        self._woken: SimpleQueue[None] = SimpleQueue()  # its `put` may interrupt its own `get` and `put`

    def set(self) -> None:
        """Ask; a second time changes nothing."""
        self._is_set = True
        self._woken.put(None)

    def is_set(self) -> bool:
        """Return whether it was asked."""
        return self._is_set

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it is asked, at most `timeout` seconds; return whether it was."""
        if not self._is_set:
            with suppress(Empty):
                self._woken.get(timeout=timeout)
        return self._is_set


def stop_request() -> StopRequest:
    """Return a request that Ctrl-C, SIGTERM and SIGHUP make from now on; a second signal changes nothing."""
    stopped = StopRequest()
    _take_over(lambda _number, _frame: stopped.set())
    return stopped


def leave_when_asked() -> None:
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
def interrupts_later() -> Iterator[Callable[[], None]]:
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
    held = False

    def hold(_number: int, _frame: FrameType | None) -> None:
        nonlocal held
        held = True

    def check() -> None:
        nonlocal held
        if held:
            held = False
            raise KeyboardInterrupt

    # Only what Python handles: an ignored signal stays ignored, and what ends the process at once still does. A
    # handler, not a mask or SIG_IGN, because a child would inherit those.
    before = {number: handler for number in _INTERRUPTS if callable(handler := signal.getsignal(number))}
    for number in before:
        signal.signal(number, hold)
    try:
        yield check
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    check()


class Start:
    """A start that may take long, and whether it is over.

    Attributes:
        is_over: whether `over` was called.
        interrupted: whether the start was asked to end.
    """

    def __init__(self) -> None:
        self.is_over = self.interrupted = False

    def over(self) -> None:
        """From now on the program takes interrupts by itself."""
        self.is_over = True


class EndLimits(NamedTuple):
    """How long a process may take to end once it is asked to, s, and what is done when it takes longer.

    Both functions are the last that is called, and must return at once.

    Attributes:
        start: while it starts.
        end: after `Start.over`.
        started: called before a process that was starting is ended with 130.
        stuck: called before one that was running is ended with 3.
    """

    start: float
    end: float
    started: Callable[[], None]
    stuck: Callable[[], None]


@contextmanager
def ends_within(limits: EndLimits) -> Iterator[Start]:
    """Have Ctrl-C, SIGTERM or SIGHUP end this process within a time, whatever it waits for.

    KeyboardInterrupt is raised as ever, and cleans up; but where kernels are compiled, or something is waited for on
    the way out, the main thread may be away for long. A thread hears of the signal at once, and waits no longer. After
    `Start.over` its time counts to the end of the process, not of the block: libraries wait for threads there, too.
    """
    start = Start()
    if threading.current_thread() is not threading.main_thread():
        yield start
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)

    def listen() -> None:
        while number := os.read(reader, 1):
            if number[0] not in _INTERRUPTS:
                continue
            if start.is_over:
                time.sleep(limits.end)
                limits.stuck()
                os._exit(FAILED)
            start.interrupted = True
            time.sleep(limits.start)
            limits.started()
            os._exit(INTERRUPTED)
        os.close(reader)

    threading.Thread(target=listen, name="interrupts", daemon=True).start()
    before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    try:
        yield start
    finally:
        if start.interrupted:
            end_with(INTERRUPTED)  # a compiler in another thread may crash when the interpreter ends in order
        else:
            signal.set_wakeup_fd(before)
            os.close(writer)  # the thread reads the end
