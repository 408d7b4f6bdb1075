"""Lock-step: one state out, one command back, tick by tick; none missed, none reordered.

The simulation publishes the states of tick k and waits for the command with the same stamp. No other message is ever
outstanding, so after an interruption of either side it is enough to repeat that one message: the simulation does so
when the set of matched endpoints changes, and once a second while there is a subscriber. A controller that receives the
same states again sends the same bytes again. Both are idempotent.

Of two simulations or two controllers on the same topics the second is refused when it starts (`lock_publisher`).
Beyond the reach of that lock they are recognised by their messages, and time stands still until one remains.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr_stamps import cdr_stamp_ns
from rx90_common.exchange.channel import TickChannel

_SLICE = 0.05  # s, the longest blind wait: between slices requests and the graph are looked at
# s of silence before it is announced and, with a peer there, the message is sent again
_PATIENCE = 1.0
_OTHER_CLOCK_NS = 3600 * NANOSECONDS
# commands with other stamps in one wait that are no repetitions, nor from before a reset
_FOREIGN_COUNT = 3
_CONFLICTS = 3  # different commands for a stamp that make two controllers; a restart in mid-tick makes one at most


def stamped(stamp_ns: int, now_ns: int) -> str:
    """Return the message about a stamp that is not the simulation's."""
    if stamp_ns == 0:
        return f"header.stamp is 0, not set, at {now_ns / NANOSECONDS:.6g} s"
    of = ", of another clock," if abs(stamp_ns - now_ns) > _OTHER_CLOCK_NS else ""
    return f"the stamp is {stamp_ns / NANOSECONDS:.10g} s{of} at {now_ns / NANOSECONDS:.6g} s"


class Wait:
    """Announces a wait once, whatever it waits for in between, and its end once, by `over` and the time."""

    def __init__(self, announce: Callable[[str], None], over: str) -> None:
        self._announce = announce
        self._over = over
        self._announced = False

    def begin(self, text: str) -> None:
        """Announce the wait."""
        if not self._announced:
            self._announced = True
            self._announce(text)

    def explained(self) -> None:
        """Suppress the announcement of the wait: another line reports it."""
        self._announced = True

    def end(self, stamp_ns: int) -> None:
        """Announce that the wait is over."""
        if self._announced:
            self._announced = False
            self._announce(f"{self._over} {stamp_ns / NANOSECONDS:.6g} s")


class LockstepSimulation:
    """The simulation's side; owned by the ticking thread.

    Args:
        channel: publishes states, receives commands.
        announce: prints a line.
        complain: prints a line about a controller whose stamps are wrong; called once for each wait.
        usable: returns whether a command with the pending stamp is valid; if not, it has reported the reason.

    Attributes:
        ignored: commands whose stamp was not the pending one.
    """

    def __init__(
        self,
        channel: TickChannel,
        announce: Callable[[str], None],
        complain: Callable[[str], None],
        usable: Callable[[bytes], bool],
    ) -> None:
        self._channel = channel
        self._complain = complain
        self._usable = usable
        self._wait = Wait(announce, "the controller answers: time runs on from")
        self._accepted = b""
        self._conflicts = 0
        self._two_controllers = False
        self._foreign = 0  # commands with other stamps since one came at once, but repetitions
        self.ignored = 0

    def exchange(
        self,
        stamp_ns: int,
        state: bytes,
        interrupted: Callable[[], bool],
        meanwhile: Callable[[], None] = lambda: None,
    ) -> bytes | None:
        """Publish the states stamped `stamp_ns` and return a usable command with that stamp, None if interrupted.

        `meanwhile` is called after the states are sent: it costs no time while the controller computes.
        `interrupted` is called 20 times a second and after each `Channel.wake`, and only while there is no command.
        """
        self._channel.publish(state)
        meanwhile()
        raw = self._channel.receive(_SLICE)
        if raw is not None and self._answers(raw, stamp_ns):
            self._foreign = 0
        else:
            raw = self._wait_for(stamp_ns, state, interrupted, raw)
        if raw is not None:
            self._wait.end(stamp_ns)
        return raw

    def _answers(self, raw: bytes, stamp_ns: int) -> bool:
        """Return whether this is the command that is waited for; keep it, or note why not."""
        if cdr_stamp_ns(raw) != stamp_ns or self._two_controllers:
            self._ignore(raw)
            return False
        if not self._usable(raw):
            return False
        self._accepted = raw
        return True

    def _wait_for(
        self, stamp_ns: int, state: bytes, interrupted: Callable[[], bool], raw: bytes | None
    ) -> bytes | None:
        """Return a command for the tick of the last `exchange`, for which `raw` was of no use."""
        channel = self._channel
        matches = channel.matches()
        began = sent = looked = time.monotonic()
        # commands with other stamps; whether that was reported
        foreign = 0
        wrong_ns = 0
        complained = False
        unusable = False  # whether there were commands that `usable` has reported
        while True:
            if raw is not None and not self._two_controllers:
                if cdr_stamp_ns(raw) != stamp_ns:
                    foreign = foreign + 1
                    wrong_ns = cdr_stamp_ns(raw)
                else:
                    unusable = True
            now = time.monotonic()
            # Looked at by the clock: a stream of foreign commands must not keep it from being looked at.
            if raw is None or now - looked >= _SLICE:
                if interrupted():
                    return None
                looked = now
                current = channel.matches()
                there = current.publishers > 0 and current.subscriptions > 0
                # Who always answers with the stamp before is right when the states come again, once a second.
                if (
                    foreign
                    and max(foreign, self._foreign) >= _FOREIGN_COUNT
                    and now - began > _PATIENCE
                ):
                    if not complained:
                        complained = True
                        if foreign >= _FOREIGN_COUNT:
                            self._wait.explained()
                        self._complain(
                            f"{channel.subscribe_topic}: {stamped(wrong_ns, stamp_ns)}; accepted in lock_step: that of "
                            "the states that a command answers; time stands still"
                        )
                elif (
                    now - began > (_PATIENCE if foreign == 0 else _FOREIGN_COUNT * _PATIENCE)
                    or current.publishers == 0
                ):
                    self._announce_wait(stamp_ns, current.publishers > 0, unusable)
                if there and (current != matches or now - sent > _PATIENCE):
                    self._two_controllers = self._two_controllers and current.publishers > 1
                    channel.publish(state)
                    sent = now
                matches = current
            raw = channel.receive(_SLICE)
            if raw is not None and self._answers(raw, stamp_ns):
                return raw

    def _announce_wait(self, stamp_ns: int, there: bool, unusable: bool) -> None:
        # Not at the first: where a usable one follows at once, in each tick, each would end in a line.
        if unusable:
            self._wait.explained()
        topic = self._channel.subscribe_topic
        still = f"time stands still at {stamp_ns / NANOSECONDS:.6g} s"
        if there:
            self._wait.begin(f"the controller on {topic} is silent: {still}")
        elif stamp_ns == 0:
            self._wait.begin(f"waiting for a controller on {topic}: the brakes hold the arm")
        else:
            self._wait.begin(f"no controller on {topic}: {still}")

    def _ignore(self, raw: bytes) -> None:
        """Count a command that nobody waits for; a repetition of the accepted one is usual, another one is not."""
        self.ignored += 1
        self._foreign += raw != self._accepted
        if (
            raw == self._accepted
            or cdr_stamp_ns(raw) != cdr_stamp_ns(self._accepted)
            or self._two_controllers
        ):
            return
        self._conflicts += 1
        if self._conflicts >= _CONFLICTS and self._channel.matches().publishers > 1:
            self._conflicts = 0
            self._two_controllers = True
            self._wait.begin(
                f"two controllers answer differently on {self._channel.subscribe_topic}: time stands still until one "
                "is left"
            )
