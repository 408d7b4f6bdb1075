"""Requests to the ticking thread are carried out however they fall between its steps."""

from __future__ import annotations

import random
import threading

from processes import TIMEOUT, wait_until

from rx90_sim.node.ticks import NextAction, RunControl


class Ticking:
    """A thread that counts ticks as the node's does."""

    def __init__(self, last_tick: int | None = None) -> None:
        self.control = RunControl(paused=True, wake=lambda: None, last_tick=last_tick)
        self.tick = 0
        self.waits = 0
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        while (turn := self.control.next_action(self.tick, 0.01)) is not NextAction.STOP:
            if turn is NextAction.RESET:
                self.tick = 0
                self.control.reset_done()
            elif turn is NextAction.STEP:
                self.tick += 1
                self.control.step_done()
            else:
                self.waits += 1

    def still(self) -> int:
        """Return the tick at which time stands, once the one that was under way is done."""
        seen = self.waits
        wait_until(lambda: self.waits > seen, "a tick that is not due")
        return self.tick


def test_steps_are_exact_and_a_pause_holds_in_whatever_order_requests_come() -> None:
    """After random requests time stands when paused, goes on by as many steps as asked for, and runs when resumed."""
    ticking, dice = Ticking(), random.Random(1)
    control = ticking.control
    try:
        for _ in range(40):
            for _ in range(dice.randrange(6)):
                request = dice.choice(("pause", "resume", "step", "reset"))
                if request == "step":
                    assert control.step(dice.randint(1, 50), TIMEOUT)
                elif request == "reset":
                    assert control.reset(TIMEOUT)
                else:
                    getattr(control, request)()
            control.pause()
            before = ticking.still()
            steps = dice.randint(1, 200)
            assert control.step(steps, TIMEOUT)
            assert ticking.still() == before + steps
            assert control.paused
        control.resume()
        before = ticking.tick
        wait_until(lambda: ticking.tick > before, "ticks")
    finally:
        control.stop()
        ticking.thread.join(TIMEOUT)
    assert not ticking.thread.is_alive()


def test_steps_beyond_the_last_tick_do_not_wait_for_their_timeout() -> None:
    """Who asks for more steps than the run has is answered when the run ends, not after the timeout."""
    ticking = Ticking(last_tick=100)
    answers: list[bool] = []
    asking = threading.Thread(target=lambda: answers.append(ticking.control.step(1000, 3600.0)), daemon=True)
    asking.start()
    ticking.thread.join(TIMEOUT)
    asking.join(TIMEOUT)
    assert answers == [False]
    assert ticking.tick == 100
