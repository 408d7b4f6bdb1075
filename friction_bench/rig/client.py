"""The host's side of the protocol over any port: greeting, heartbeat, commands, cumulative readings."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Protocol

from friction_bench.protocol.codec import Frame, FrameDecoder, encode
from friction_bench.protocol.errors import RigError, RigFaultError, RigLostError, RigRefusedError, RigResetError
from friction_bench.protocol.messages import (
    PROTOCOL_VERSION,
    Command,
    Fault,
    HelloReply,
    Report,
    Result,
    State,
    fault_text,
    limits_payload,
    parse_hello,
    parse_report,
    ramp_payload,
    torque_payload,
)
from friction_bench.rig.rig_file import CODES, Rig

HEARTBEAT = 0.02
"""Time between heartbeats, s; the firmware forgives 120 ms."""
SILENCE = 0.5
"""A rig that reports nothing for so long, s, is lost."""
_LONGEST_LOOK = 2 * HEARTBEAT
"""What may count as listening between two looks at the line, s: a program that stood still did not listen."""
HELLO_PERIOD = 0.25
"""Time between greetings, s: the rig may still be starting, and an Arduino resets when its port opens."""
RETRY_PERIOD = 0.06
"""A command whose report did not come is repeated after this time, s, with the same sequence number."""
COMMAND_TIMEOUT = 1.0
STOP_SEQUENCES = range(240, 256)
"""Sequence numbers of urgent stops; each has its own, so that its answer cannot be that to an earlier one."""
_SWITCHED_ON = frozenset((State.ARMED, State.RAMPING))


class Port(Protocol):
    """A line to a rig, real or emulated, with a clock of its own."""

    def now(self) -> float:
        """Return the line's time, s, monotonic."""

    def write(self, data: bytes) -> None:
        """Send bytes."""

    def write_first(self, data: bytes) -> None:
        """Send bytes ahead of what has not left yet, which may be thrown away in the middle of a frame."""

    def read(self, timeout: float) -> bytes:
        """Return what has come; wait up to `timeout` seconds for the first byte."""

    def close(self) -> None:
        """Give the line back."""


class Unwrapper:
    """Makes a counter that rolls over cumulative."""

    def __init__(self, bits: int) -> None:
        self._modulus = 1 << bits
        self._last: int | None = None
        self._total = 0

    def __call__(self, value: int) -> int:
        """Return the cumulative value of a reading, at most half a roll-over from the last one."""
        if self._last is None:
            self._total = value
        else:
            half = self._modulus // 2
            self._total += (value - self._last + half) % self._modulus - half
        self._last = value
        return self._total


@dataclass(frozen=True)
class Sample:
    """One reading: firmware tick (cumulative), time of that tick, s, and counts (cumulative)."""

    tick: int
    time: float
    counts: int
    report: Report


class RigClient:
    """Talks to one rig; not thread-safe, and alive only while somebody calls `pump`.

    Args:
        port: the line.
        rig: what is expected at its other end.

    Attributes:
        hello: what the firmware says of itself, None before `connect`.
        last: the latest reading.
        stops: urgent stops so far.
        permitted: how many of them the command under way has been told of.
        beating: heartbeats are sent; without them an armed rig switches itself off.
        stopping: an urgent stop has been sent and not been answered; `pump` repeats it in place of heartbeats.
    """

    def __init__(self, port: Port, rig: Rig) -> None:
        self.port = port
        self.rig = rig
        self.hello: HelloReply | None = None
        self.last: Sample | None = None
        self.beating = True
        self.lost_reports = 0
        self.stops = 0
        self.permitted = 0
        self.stopping = False
        self._stop_lock = threading.Lock()
        self._decoder = FrameDecoder()
        self._sequence = 0
        self._beat_at = -1.0
        self._looked_at = port.now()
        self._listened = 0.0  # s, so far
        self._heard_at = 0.0  # of the time listened
        self._restart_counters()

    @property
    def bad_frames(self) -> int:
        """Return how many damaged frames have come from the rig."""
        return self._decoder.bad

    def _restart_counters(self) -> None:
        self._ticks = Unwrapper(16)
        self._counts = Unwrapper(24)
        self.last = None

    def _next_sequence(self) -> int:
        return self._sequence % (STOP_SEQUENCES.start - 1) + 1

    def _send(self, command: Command, payload: bytes = b"") -> int:
        self._sequence = self._next_sequence()
        self.port.write(encode(Frame(command, self._sequence, payload)))
        self._beat_at = self.port.now()
        return self._sequence

    def urgent_stop(self) -> None:
        """Take the torque away now; the only method for other threads than the one that owns the client.

        A command that is under way is given up: its repetition after the stop would undo it. The stop itself is
        repeated by `pump` until the rig answers it, with no heartbeat in between: if the line takes it no more,
        the firmware's watchdog switches the rig off.

        It waits for one write of another thread and for its own, each at most the port's write timeout, and never
        for a read, a queue or an answer.
        """
        with self._stop_lock:
            self.stops += 1
            self.stopping = True
        self._write_stop()

    def _write_stop(self) -> None:
        # A delimiter first: what stands before it on the line may have lost its own. Twice: one may be hit.
        sequence = STOP_SEQUENCES[self.stops % len(STOP_SEQUENCES)]
        self.port.write_first(b"\0" + 2 * encode(Frame(Command.STOP, sequence, b"")))
        self._beat_at = self.port.now()

    def _write_unless_stopped(self, message: bytes, name: str) -> None:
        with self._stop_lock:
            if self.stops != self.permitted:
                self.permitted = self.stops
                raise RigRefusedError(f"{name}: overtaken by a stop")
            self.port.write(message)

    def _frames(self, timeout: float) -> list[Frame]:
        frames = self._decoder.feed(self.port.read(timeout))
        before, self._looked_at = self._looked_at, self.port.now()
        self._listened += min(self._looked_at - before, _LONGEST_LOOK)
        if frames:
            self._heard_at = self._listened
        elif self._listened - self._heard_at > SILENCE:
            raise RigLostError(f"the rig has not reported for {SILENCE} s")
        return frames

    def connect(self, timeout: float = 3.0) -> HelloReply:
        """Greet the rig until it answers; afterwards it is disarmed, and faults stay latched.

        Raises:
            RigLostError: if it does not answer within `timeout` seconds.
            RigRefusedError: if it speaks another protocol version.
            RigError: if it was built for other figures than the rig file's.
        """
        self.hello = None
        self.stopping = False  # HELLO takes the torque away too, and is repeated until it is answered
        self._restart_counters()
        end = self._listened + timeout
        greet_at = self.port.now()
        while self._listened < end:
            if self.port.now() >= greet_at:
                self._send(Command.HELLO, bytes([PROTOCOL_VERSION]))
                greet_at = self.port.now() + HELLO_PERIOD
            self._heard_at = self._listened
            for frame in self._frames(HEARTBEAT):
                hello = parse_hello(frame)
                if hello is not None and frame.sequence == self._sequence:
                    self._accept(hello)
                    return hello
        raise RigLostError(f"no rig answers within {timeout:g} s")

    def _accept(self, hello: HelloReply) -> None:
        if hello.version != PROTOCOL_VERSION:
            raise RigRefusedError(f"the rig speaks protocol version {hello.version}; accepted: {PROTOCOL_VERSION}")
        self.rig.check(hello)
        self.hello = hello

    def pump(self, timeout: float = HEARTBEAT) -> list[Sample]:
        """Send the heartbeat when it is due and return the readings that came within `timeout` seconds.

        Raises:
            RigLostError: if the rig has been silent for too long.
            RigResetError: if it restarted; greet and arm it again.
        """
        if self.port.now() - self._beat_at >= HEARTBEAT:
            if self.stopping:
                self._write_stop()
            elif self.beating:
                self._send(Command.BEAT)
        samples = []
        for frame in self._frames(timeout):
            report = parse_report(frame)
            if report is not None:
                samples.append(self._sample(report))
        return samples

    def _sample(self, report: Report) -> Sample:
        tick = self._ticks(report.tick)
        if not report.greeted or (self.last is not None and tick <= self.last.tick):
            self.hello = None
            raise RigResetError("the rig restarted by itself; it has to be armed again")
        if report.state not in _SWITCHED_ON and report.ack_sequence == STOP_SEQUENCES[self.stops % len(STOP_SEQUENCES)]:
            self.stopping = False
        if self.last is not None:
            self.lost_reports += tick - self.last.tick - 1
        self.last = Sample(tick, tick * self.rig.tick, self._counts(report.counts), report)
        return self.last

    def request(self, command: Command, payload: bytes = b"") -> list[Sample]:
        """Send a command until a report answers it; return the readings that came meanwhile.

        Raises:
            RigRefusedError: with the firmware's reason.
            RigLostError, RigResetError: as `pump`.
        """
        samples: list[Sample] = []
        sequence = self._sequence = self._next_sequence()
        message = encode(Frame(command, sequence, payload))
        self._write_unless_stopped(message, command.name)
        end = self._listened + COMMAND_TIMEOUT
        retry_at = self.port.now() + RETRY_PERIOD
        while self._listened < end:
            if self.port.now() >= retry_at or self.stops != self.permitted:
                self._write_unless_stopped(message, command.name)
                retry_at = self.port.now() + RETRY_PERIOD
            frames = self._frames(HEARTBEAT)
            came = [self._sample(report) for report in filter(None, map(parse_report, frames))]
            samples += came  # all of them: what came behind the answer would count as lost
            answer = next((s.report for s in came if s.report.ack_sequence == sequence), None)
            if answer is not None:
                if answer.result != Result.OK:
                    raise RigRefusedError(f"{command.name}: {answer.result_text}")
                return samples
        raise RigLostError(f"{command.name}: the rig does not answer")

    def arm(self) -> None:
        """Set the rig file's limits and switch the power stage on, at zero torque."""
        self.request(Command.LIMITS, limits_payload(*self.rig.limit_codes()))
        self.request(Command.ARM)

    def stop(self) -> None:
        """Take the torque away; the request leaves at once, its answer is waited for afterwards."""
        self.request(Command.STOP)

    def clear(self) -> None:
        """Clear the latched faults; the rig is disarmed then."""
        self.request(Command.CLEAR)

    def torque(self, code: int) -> None:
        """Hold a DAC code on an armed rig."""
        self.request(Command.TORQUE, torque_payload(code))

    def start_ramp(self, slope: float, end_torque: float) -> list[Sample]:
        """Start the firmware's ramp of `slope` Nm/s up to `end_torque` Nm on an armed rig.

        Returns:
            The readings up to the ramp's first report.

        Raises:
            RigError: if the firmware cannot run that slope or torque; else as `request`.
        """
        return self.request(Command.RAMP, ramp_payload(self.rig.ramp_step(slope), self.end_code(end_torque)))

    def end_code(self, torque: float) -> int:
        """Return the DAC code of a ramp's end.

        Raises:
            RigError: if the firmware does not go there.
        """
        limit = self.hello.torque_limit_code if self.hello is not None else CODES
        if not self.rig.torque(0.5) <= torque < self.rig.torque(limit + 0.5):
            accepted = f"{self.rig.torque(1):.2g} to {self.rig.torque(limit):.3g} Nm"
            raise RigError(f"end torque {torque:g} Nm; accepted by the firmware: {accepted}")
        return self.rig.end_code(torque)


def raise_fault(report: Report) -> None:
    """Raise what the report's fault bits say, if any.

    Raises:
        RigFaultError: naming the faults.
    """
    if report.fault != Fault.NONE or report.state == State.FAULT:
        raise RigFaultError(f"the rig switched itself off: {fault_text(report.fault)}; find out why, then clear it")
