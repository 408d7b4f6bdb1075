"""The controller's ticks: it answers the simulation in the mode that this one tells."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from rx90_common.base.errors import ExchangeError
from rx90_common.exchange.channel import TickChannel
from rx90_common.exchange.lockstep import LockstepController
from rx90_common.exchange.motor_messages import MotorMessages, ServoLoops
from rx90_common.exchange.pacing import Pacer
from rx90_common.exchange.topics import FREE_RUNNING, LOCK_STEP, TimeMode
from rx90_controller.node.free_running import FreeRunningController

_WAIT_SLICE = 0.1
_MODE_PATIENCE = 5.0  # s with a simulation that does not tell its mode


class Serving:
    """Runs the loops tick by tick: on a thread of its own, or in lock-step on that of a simulation in this process.

    Args:
        channel: publishes commands, receives states.
        messages: decodes and encodes them.
        loops: what runs in each tick.
        pacer: the clock of free-running time.
        announce: prints a line for the user.

    Attributes:
        mode: how the simulation keeps time, one of TIME_MODES; None until it is known.
    """

    def __init__(
        self,
        channel: TickChannel,
        messages: MotorMessages,
        loops: ServoLoops,
        pacer: Pacer,
        announce: Callable[[str], None],
        robot: str,
    ) -> None:
        self._channel, self._messages, self._robot = channel, messages, robot
        self._lockstep = LockstepController(channel, messages, loops, announce)
        self._free = FreeRunningController(channel, messages, loops, pacer, announce)
        self.mode: str | None = None
        self._changed = threading.Event()  # the mode is known, or the end is near
        self._stopped = threading.Event()
        self._refused: ExchangeError | None = None
        self._handed_over = False

    def hand_over(self) -> Callable[[], None]:
        """Return what answers one tick in lock-step, to be called by the thread that ticks; `run` then rests."""
        self._handed_over = True
        return self._answer

    def _answer(self) -> None:
        if self.mode == LOCK_STEP:
            self._lockstep.serve(0.0)

    # The ticking thread.

    def run(self) -> None:
        """Answer the simulation until `stop`.

        Raises:
            ExchangeError: if the simulation's rates are not this one's.
        """
        self._wait_for_mode()
        mode = self.mode
        while not self._stopped.is_set():
            if mode != self.mode:
                mode = self.mode
                self._free.begin_anew()
            if mode == FREE_RUNNING:
                self._free.serve()
            elif self._handed_over:
                self._stopped.wait(_WAIT_SLICE)
            else:
                self._lockstep.serve(_WAIT_SLICE)
        if self._refused is not None:
            raise self._refused

    def _wait_for_mode(self) -> None:
        """Wait until the simulation has told the mode; one that tells none within some seconds is taken for lock-step.

        Loops that began in the wrong mode would begin again in the right one, and drop the trajectory that they follow.
        """
        deadline = time.monotonic() + _MODE_PATIENCE
        while not self._stopped.is_set() and self.mode is None and time.monotonic() < deadline:
            if self._channel.matches().publishers == 0:
                deadline = time.monotonic() + _MODE_PATIENCE
                self._lockstep.announce_silence()
            self._changed.wait(_WAIT_SLICE)

    # Any thread.

    def follow(self, time_mode: TimeMode) -> None:
        """Answer in this mode.

        Raises:
            ExchangeError: if the simulation's rates or robot are not this one's; then `run` ends with the same error.
        """
        try:
            time_mode.check(self._messages.rates, self._robot)
        except ExchangeError as error:
            self._refused = error
            self.stop()
            raise
        # In this order: the ticking thread acts on the mode as soon as it is there.
        self._messages.same_rates = True
        self.mode = time_mode.mode
        self._changed.set()
        self._channel.wake()

    def stop(self) -> None:
        """End `run` soon."""
        self._stopped.set()
        self._changed.set()
        self._channel.wake()
