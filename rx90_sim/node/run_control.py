"""Pause, single steps, reset and stop, handed from services to the thread that ticks."""

from __future__ import annotations

import threading
from collections.abc import Callable
from enum import Enum, auto


class Turn(Enum):
    """What the ticking thread does next."""

    STEP = auto()
    RESET = auto()
    WAIT = auto()
    STOP = auto()


class RunControl:
    """Requests to the ticking thread; every request returns once it has been carried out.

    The ticking thread calls `next_turn` before each tick; services call the others from their own thread.
    """

    def __init__(self, paused: bool, wake: Callable[[], None], last_tick: int | None = None) -> None:
        """`wake` interrupts whatever the ticking thread waits for; the run ends before `last_tick`."""
        self._changed = threading.Condition()
        self._wake = wake
        self._paused = paused
        self._held = False
        self._steps = 0
        self._reset = False
        self._stopped = False
        self._last_tick = last_tick
        self._undisturbed = not paused

    @property
    def paused(self) -> bool:
        """Return whether time stands still on request."""
        with self._changed:
            return self._paused and self._steps == 0

    @property
    def held(self) -> bool:
        """Return whether time stands still by `hold`."""
        return self._held

    @property
    def stopped(self) -> bool:
        """Return whether the run is over."""
        return self._stopped

    def interrupting(self) -> bool:
        """Return whether the ticking thread should come back from a wait: for a reset or the end."""
        return self._stopped or self._reset

    def next_turn(self, tick: int, timeout: float) -> Turn:
        """Return what to do before tick `tick`; waits up to `timeout` seconds while paused."""
        last = self._last_tick is not None and tick >= self._last_tick
        # Without the lock, which costs the tick as much as the law: a request that comes now counts before the next.
        if self._undisturbed and not last:
            return Turn.STEP
        with self._changed:
            if last:
                self._stopped = True
                self._undisturbed = False
                # Who waits for ticks beyond the last one waits in vain.
                self._changed.notify_all()
            if self._runnable():
                return self._take_turn()
            self._changed.wait(timeout)
            return self._take_turn() if self._runnable() else Turn.WAIT

    def pause(self) -> None:
        """Stop time before the next tick."""

        def end() -> None:
            self._paused = True
            self._steps = 0

        self._request(end)

    def resume(self) -> None:
        """Let time run again."""
        self._request(lambda: setattr(self, "_paused", False))

    def hold(self) -> None:
        """Stop time before the next tick, whatever else is asked for, until `release`."""
        self._request(lambda: setattr(self, "_held", True))

    def release(self) -> None:
        """End what `hold` began: time runs, unless it is paused."""
        self._request(lambda: setattr(self, "_held", False))

    def step(self, ticks: int, timeout: float) -> bool:
        """Pause, then run `ticks` ticks; return whether they were done within `timeout` seconds."""

        def begin() -> None:
            self._paused = True
            self._steps = ticks

        self._request(begin)
        done = self._wait_until(lambda: self._steps == 0, timeout)
        if not done:
            # What was not done in time must not happen later, unasked.
            self.pause()
        return done

    def reset(self, timeout: float) -> bool:
        """Begin again at tick 0; return whether that was done within `timeout` seconds."""
        self._request(lambda: setattr(self, "_reset", True))
        return self._wait_until(lambda: not self._reset, timeout)

    def reset_done(self) -> None:
        """Say that the reset that `next_turn` asked for has been carried out."""
        with self._changed:
            self._reset = False
            self._steps = 0
            self._look()
            self._changed.notify_all()

    def step_done(self) -> None:
        """Say that the tick that `next_turn` asked for has been carried out."""
        if self._undisturbed:
            return
        with self._changed:
            if self._steps > 0:
                self._steps -= 1
                if self._steps == 0:
                    self._changed.notify_all()

    def stop(self) -> None:
        """End the run."""
        self._request(lambda: setattr(self, "_stopped", True))

    def _runnable(self) -> bool:
        return self._stopped or self._reset or not (self._held or (self._paused and self._steps == 0))

    def _take_turn(self) -> Turn:
        if self._stopped:
            return Turn.STOP
        return Turn.RESET if self._reset else Turn.STEP

    def _request(self, change: Callable[[], None]) -> None:
        with self._changed:
            change()
            self._look()
            self._changed.notify_all()
        self._wake()

    def _look(self) -> None:
        """Note whether ticks follow each other without anybody's asking for anything."""
        self._undisturbed = not (self._held or self._paused or self._reset or self._stopped or self._steps)

    def _wait_until(self, done: Callable[[], bool], timeout: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: done() or self._stopped, timeout) and not self._stopped
