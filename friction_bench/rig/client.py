"""The host's side of the protocol: frames on a port, the greeting, commands with repetition, readings."""

from __future__ import annotations

import threading
from typing import NamedTuple, Protocol

from friction_bench.rig.messages import (
    PROTOCOL_VERSION,
    Command,
    CommandResult,
    Frame,
    FrameDecoder,
    HelloReply,
    Report,
    RigInputError,
    RigLostError,
    RigRefusedError,
    RigResetError,
    State,
    encode,
    parse_hello,
    parse_report,
    payload_of,
)
from friction_bench.rig.rig_file import CODES, Rig

HEARTBEAT = 0.02
"""Time between heartbeats, s; the firmware's watchdog trips after 120 ms."""
SILENCE = 0.5
"""Time without a report after which a rig counts as lost, s."""
_LONGEST_LISTENING = 2 * HEARTBEAT
"""The most that counts as listening between two reads, s: a program that was suspended did not listen."""
STOP_SEQUENCES = range(240, 256)
"""Sequence numbers of urgent stops; each has its own, so that its answer cannot be that to an earlier one."""
SWITCHED_ON = frozenset((State.ARMED, State.RAMPING))
HELLO_PERIOD = 0.25
"""Time between greetings, s: the rig may still be starting, and an Arduino resets when its port opens."""
RETRY_PERIOD = 0.06
"""A command whose report did not come is repeated after this time, s, with the same sequence number."""
COMMAND_TIMEOUT = 1.0
GREETING_TIMEOUT = 3.0
"""Time within which a rig answers a greeting, s: one that has just been switched on, too."""


class Port(Protocol):
    """What carries the bytes, to a real rig or an emulated one, with a clock of its own."""

    def now(self) -> float:
        """Return the port's time, s, monotonic."""

    def write(self, data: bytes, *, first: bool = False) -> None:
        """Send bytes; `first`: replaces bytes that have not been sent yet, which may be discarded in mid-frame."""

    def read(self, timeout: float) -> bytes:
        """Return the received bytes; wait up to `timeout` seconds for the first one."""

    def close(self) -> None:
        """Give the port back."""


def unwrap(value: int, last: int | None, bits: int) -> int:
    """Return the cumulative value of a counter that rolls over, at most half a roll-over from its last one."""
    if last is None:
        return value
    half = 1 << bits - 1
    return last + (value - last + half) % (2 * half) - half


class Sample(NamedTuple):
    """One reading: firmware tick (cumulative), time of that tick, s, and counts (cumulative)."""

    tick: int
    time: float
    counts: int
    report: Report


class RigClient:
    """Commands one rig, which stays armed only while `pump` is called.

    Only `urgent_stop` may be called by other threads than the one that owns the client.

    Args:
        port: carries the bytes.
        rig: the expected rig.

    Attributes:
        hello: the firmware's greeting, None before `connect`.
        last: the latest reading.
        beating: heartbeats are sent; without them an armed rig switches itself off.
        lost_reports: ticks without a reading so far.
        stops: urgent stops so far.
        known_stops: number of them that the owner knew when it sent the current command.
        stopping: an urgent stop has been sent and not yet answered; it is repeated in place of heartbeats.
    """

    def __init__(self, port: Port, rig: Rig) -> None:
        self.port = port
        self.rig = rig
        self.hello: HelloReply | None = None
        self.last: Sample | None = None
        self.beating = True
        self.lost_reports = self.stops = self.known_stops = 0
        self.stopping = False
        self._stop_lock = threading.Lock()
        self._decoder = FrameDecoder()
        self._sequence = 0
        self._sent_at = -1.0
        self._read_at = port.now()
        # time spent listening, s, the clock of the answers' timeouts
        self._listened = self._last_report_at = 0.0

    @property
    def greeting(self) -> HelloReply:
        """Return the answer to the greeting, for what begins with one."""
        assert self.hello is not None
        return self.hello

    @property
    def bad_frames(self) -> int:
        """Return how many damaged frames have come from the rig."""
        return self._decoder.bad

    def _number(self, command: Command, *values: int) -> bytes:
        """Return the bytes of a command with the next sequence number."""
        self._sequence = self._sequence % (STOP_SEQUENCES.start - 1) + 1
        return encode(Frame(command, self._sequence, payload_of(command, *values)))

    def _send(self, command: Command, *values: int) -> None:
        """Send a command whatever stops there have been: a greeting or a heartbeat."""
        self.port.write(self._number(command, *values))
        self._sent_at = self.port.now()

    def _send_unless_stopped(self, message: bytes, command: Command) -> None:
        with self._stop_lock:
            if self.stops != self.known_stops:
                self.known_stops = self.stops
                raise RigRefusedError(f"{command.name}: overtaken by a stop")
            self.port.write(message)

    def send_torque(self, code: int) -> None:
        """Send a DAC code to hold, without waiting for the answer: the next report has it.

        Raises:
            RigRefusedError: if there has been a stop that the caller did not know of; it is known from then on.
        """
        self._send_unless_stopped(self._number(Command.TORQUE, code), Command.TORQUE)

    def urgent_stop(self) -> None:
        """Take the torque away now.

        A command that is under way is given up: its repetition after the stop would undo it. The stop itself is
        repeated by `pump` until the rig answers it, with no heartbeat in between: if the line accepts it no more,
        the firmware's watchdog switches the rig off.

        It waits for one write of another thread and for its own, each at most the port's write timeout, and never
        for a read, a queue or an answer.
        """
        with self._stop_lock:
            self.stops += 1
            self.stopping = True
        self._write_stop()

    def _write_stop(self) -> None:
        # A delimiter first: the frame before it on the line may have lost its own. Twice: one may be hit.
        self.port.write(
            b"\0" + 2 * encode(Frame(Command.STOP, self._stop_sequence, b"")), first=True
        )
        self._sent_at = self.port.now()

    @property
    def _stop_sequence(self) -> int:
        return STOP_SEQUENCES[self.stops % len(STOP_SEQUENCES)]

    def _frames(self) -> list[Frame]:
        """Return the frames that came within a heartbeat's time; raise RigLostError after a silence."""
        frames = self._decoder.feed(self.port.read(HEARTBEAT))
        before = self._read_at
        self._read_at = self.port.now()
        self._listened += min(self._read_at - before, _LONGEST_LISTENING)
        if frames:
            self._last_report_at = self._listened
        elif self._listened - self._last_report_at > SILENCE:
            raise RigLostError(f"the rig has not reported for {SILENCE} s")
        return frames

    def connect(self) -> HelloReply:
        """Greet the rig until it answers; afterwards it is disarmed, and faults stay latched.

        Raises:
            RigLostError: if it does not answer.
            RigRefusedError: if it speaks another protocol version.
        """
        self.hello = self.last = None
        # HELLO takes the torque away too, and is repeated until it is answered
        self.stopping = False
        end = self._listened + GREETING_TIMEOUT
        greet_at = self.port.now()
        while self._listened < end:
            if self.port.now() >= greet_at:
                self._send(Command.HELLO, PROTOCOL_VERSION)
                greet_at = self.port.now() + HELLO_PERIOD
            self._last_report_at = self._listened
            for frame in self._frames():
                hello = parse_hello(frame)
                if hello is not None and frame.sequence == self._sequence:
                    if hello.version != PROTOCOL_VERSION:
                        spoken = f"the rig speaks protocol version {hello.version}"
                        raise RigRefusedError(f"{spoken}; accepted: {PROTOCOL_VERSION}")
                    self.rig.check(hello)
                    self.hello = hello
                    return hello
        raise RigLostError(f"no rig answers within {GREETING_TIMEOUT:g} s")

    def pump(self) -> list[Sample]:
        """Send the heartbeat or stop that is due and return the readings that came within a heartbeat's time.

        Raises:
            RigLostError: if the rig has been silent for too long.
            RigResetError: if it restarted; greet and arm it again.
        """
        if self.port.now() - self._sent_at >= HEARTBEAT:
            if self.stopping:
                self._write_stop()
            elif self.beating:
                self._send(Command.BEAT)
        return self._samples()

    def _samples(self) -> list[Sample]:
        reports = map(parse_report, self._frames())
        return [self._sample(report) for report in reports if report is not None]

    def _sample(self, report: Report) -> Sample:
        last = self.last
        tick = unwrap(report.tick, None if last is None else last.tick, 16)
        if not report.greeted or (last is not None and tick <= last.tick):
            self.hello = None
            raise RigResetError("the rig restarted by itself; it has to be armed again")
        if report.state not in SWITCHED_ON and report.ack_sequence == self._stop_sequence:
            self.stopping = False
        if last is not None:
            self.lost_reports += tick - last.tick - 1
        counts = unwrap(report.counts, None if last is None else last.counts, 24)
        self.last = Sample(tick, tick * self.rig.tick, counts, report)
        return self.last

    def request(self, command: Command, *values: int) -> list[Sample]:
        """Send a command until a report answers it; return the readings received meanwhile.

        Args:
            command: the command.
            values: of its payload, as for `payload_of`.

        Raises:
            RigRefusedError: with the firmware's reason.
            RigLostError, RigResetError: as `pump`.
        """
        samples: list[Sample] = []
        message = self._number(command, *values)
        sequence = self._sequence
        self._send_unless_stopped(message, command)
        end = self._listened + COMMAND_TIMEOUT
        retry_at = self.port.now() + RETRY_PERIOD
        while self._listened < end:
            if self.port.now() >= retry_at or self.stops != self.known_stops:
                self._send_unless_stopped(message, command)
                retry_at = self.port.now() + RETRY_PERIOD
            received = self._samples()
            samples += received  # all of them: those after the answer would count as lost
            answer = next((s.report for s in received if s.report.ack_sequence == sequence), None)
            if answer is not None:
                if answer.result != CommandResult.OK:
                    raise RigRefusedError(f"{command.name}: {answer.result_text}")
                return samples
        raise RigLostError(f"{command.name}: the rig does not answer")

    def arm(self) -> None:
        """Set the rig file's limits and switch the power stage on, at zero torque."""
        self.request(Command.LIMITS, *self.rig.limit_codes())
        self.request(Command.ARM)

    def clear(self) -> None:
        """Clear the latched faults; the rig is disarmed then."""
        self.request(Command.CLEAR)

    def start_ramp(self, slope: float, end_torque: float) -> list[Sample]:
        """Start the firmware's ramp of `slope` Nm/s up to `end_torque` Nm on an armed rig.

        Returns:
            The readings up to the ramp's first report.
        """
        end = self.end_code(end_torque)
        return self.request(Command.RAMP, self.rig.ramp_step(slope), end)

    def end_code(self, torque: float) -> int:
        """Return the DAC code of a ramp's end."""
        limit = self.hello.torque_limit_code if self.hello is not None else CODES
        if not self.rig.commanded_torque(0.5) <= torque < self.rig.commanded_torque(limit + 0.5):
            accepted = (
                f"{self.rig.commanded_torque(1):.2g} to {self.rig.commanded_torque(limit):.3g} Nm"
            )
            raise RigInputError(f"end torque {torque:g} Nm; accepted by the firmware: {accepted}")
        return self.rig.end_code(torque)
