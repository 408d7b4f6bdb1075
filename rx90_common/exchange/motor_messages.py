"""What a controller reads and writes in a tick: motor states in, motor commands out, and the loops in between."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError, MessageError
from rx90_common.base.rates import Rates
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.pacing import ThrottledLog


class MotorStates(NamedTuple):
    """The motor states of one tick; the arrays are valid until the next ones have been decoded.

    Attributes:
        stamp_ns: sample time, ns.
        position: rad, shape (n,).
        velocity: rad/s, shape (n,).
        torque: reported by the drives, Nm, shape (n,), if it is.
    """

    stamp_ns: int
    position: Array
    velocity: Array
    torque: Array | None = None


class ServoLoops(Protocol):
    """Loops that turn motor states into motor torques; called by the thread that ticks.

    Attributes:
        command: motor torques of the last step, Nm, shape (n,); always the same array.
    """

    command: Array

    def begin(self) -> None:
        """Get ready to run; may take a while."""

    def hold(self, states: MotorStates) -> None:
        """Hold the arm where it is, from the tick of these states on."""

    def step(self, stamp_ns: int, states: MotorStates) -> bool:
        """Run the tick at `stamp_ns`; return whether `command` is to be applied, else the brakes close."""

    def after_command(self, stamp_ns: int) -> None:
        """Publish what the last step has left; called after each, in lock-step when its command is on its way."""

    def skip(self, count: int) -> None:
        """Let `count` ticks of the position loop pass without set-points."""


class MotorMessages:
    """Decodes motor states and encodes motor commands, for one thread.

    Args:
        topic: of the states, for messages to the user.
        names: of the motors.
        rates: of the loops; states are stamped with multiples of the base tick.
        command: torques to send, Nm, shape (n,); stays where it is in memory.
        complain: prints a line about a message that is ignored; called now and then only.

    Attributes:
        same_rates: whether the simulation is known to have these rates. A stamp between two ticks is then somebody
            else's; until then it is an error of the simulation's.
    """

    def __init__(
        self, topic: str, names: Sequence[str], rates: Rates, command: Array, complain: Callable[[str], None]
    ) -> None:
        self._topic, self.rates, self._period_ns = topic, rates, rates.period_ns
        self.same_rates = False
        # Two, in turns: a message that is refused half-way leaves the states before it as they are.
        self._codec, self._spare = JointStateCodec(names), JointStateCodec(names)
        commands = JointStateCodec(names)
        self._encode, self._encode_no_torque = commands.encoder(effort=command), commands.encoder()
        self._log = ThrottledLog(complain)

    def decode(self, raw: bytes) -> MotorStates:
        """Return the states in a message.

        Raises:
            MessageError: if it holds none; a line says why.
            ExchangeError: for a stamp between two ticks, unless the rates are known to be the same.
        """
        try:
            stamp_ns, position, velocity, torque = self._spare.decode(raw)
            if position is None or velocity is None:
                raise ExchangeError("no positions or no velocities; accepted: both")
        except ExchangeError as error:
            raise self._refused("states", str(error)) from error
        if stamp_ns < 0 or stamp_ns % self._period_ns:
            text = (
                f"the stamp is {stamp_ns} ns; accepted: multiples of {self._period_ns} ns (base_rate "
                f"{self.rates.base_hz} Hz, as the simulation's)"
            )
            raise self._refused("stamp", text) if self.same_rates else ExchangeError(f"{self._topic}: {text}")
        self._codec, self._spare = self._spare, self._codec
        return MotorStates(stamp_ns, position, velocity, torque)

    def _refused(self, kind: str, text: str) -> MessageError:
        self._log.say(kind, f"{self._topic}: {text}; the message is ignored")
        return MessageError(text)

    def encode(self, stamp_ns: int, torque: bool) -> bytes:
        """Return the command as a message, or one without torques, which closes the brakes."""
        return self._encode(stamp_ns) if torque else self._encode_no_torque(stamp_ns)
