"""The host's side of the protocol: greeting, commands until they are answered, cumulative readings."""

from __future__ import annotations

from dataclasses import dataclass

from friction_bench.protocol.errors import RigFaultError, RigInputError, RigLostError, RigRefusedError, RigResetError
from friction_bench.protocol.messages import (
    PROTOCOL_VERSION,
    Command,
    CommandResult,
    Fault,
    HelloReply,
    Report,
    State,
    fault_text,
    limits_payload,
    parse_hello,
    parse_report,
    ramp_payload,
    torque_payload,
)
from friction_bench.rig.line import HEARTBEAT, Port, RigLine
from friction_bench.rig.rig_file import CODES, Rig

HELLO_PERIOD = 0.25
"""Time between greetings, s: the rig may still be starting, and an Arduino resets when its port opens."""
RETRY_PERIOD = 0.06
"""A command whose report did not come is repeated after this time, s, with the same sequence number."""
COMMAND_TIMEOUT = 1.0


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
    """Commands one rig; not thread-safe but for its line's stop, and alive only while somebody calls `pump`.

    Args:
        port: what carries the bytes.
        rig: what is expected at its other end.

    Attributes:
        line: the frames on that port, and the urgent stop.
        hello: the firmware's greeting, None before `connect`.
        last: the latest reading.
        beating: heartbeats are sent; without them an armed rig switches itself off.
        lost_reports: ticks without a reading so far.
    """

    def __init__(self, port: Port, rig: Rig) -> None:
        self.port = port
        self.rig = rig
        self.line = RigLine(port)
        self.hello: HelloReply | None = None
        self.beating = True
        self.lost_reports = 0
        self._restart_counters()

    def _restart_counters(self) -> None:
        self._ticks = Unwrapper(16)
        self._counts = Unwrapper(24)
        self.last: Sample | None = None

    def connect(self, timeout: float = 3.0) -> HelloReply:
        """Greet the rig until it answers; afterwards it is disarmed, and faults stay latched.

        Raises:
            RigLostError: if it does not answer within `timeout` seconds.
            RigRefusedError: if it speaks another protocol version.
            RigInputError: if it was built for other figures than the rig file's.
        """
        line = self.line
        self.hello = None
        line.stopping = False  # HELLO takes the torque away too, and is repeated until it is answered
        self._restart_counters()
        end = line.listened + timeout
        greet_at = self.port.now()
        while line.listened < end:
            if self.port.now() >= greet_at:
                line.send(Command.HELLO, bytes([PROTOCOL_VERSION]))
                greet_at = self.port.now() + HELLO_PERIOD
            line.excuse_silence()
            for frame in line.frames(HEARTBEAT):
                hello = parse_hello(frame)
                if hello is not None and frame.sequence == line.sequence:
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
        self.line.keep_alive(self.beating)
        return self._samples(timeout)

    def _samples(self, timeout: float) -> list[Sample]:
        reports = map(parse_report, self.line.frames(timeout))
        return [self._sample(report) for report in reports if report is not None]

    def _sample(self, report: Report) -> Sample:
        tick = self._ticks(report.tick)
        if not report.greeted or (self.last is not None and tick <= self.last.tick):
            self.hello = None
            raise RigResetError("the rig restarted by itself; it has to be armed again")
        self.line.note_answer(report)
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
        line = self.line
        samples: list[Sample] = []
        message = line.number(command, payload)
        sequence = line.sequence
        line.send_unless_stopped(message, command)
        end = line.listened + COMMAND_TIMEOUT
        retry_at = self.port.now() + RETRY_PERIOD
        while line.listened < end:
            if self.port.now() >= retry_at or line.stops != line.known_stops:
                line.send_unless_stopped(message, command)
                retry_at = self.port.now() + RETRY_PERIOD
            came = self._samples(HEARTBEAT)
            samples += came  # all of them: what came behind the answer would count as lost
            answer = next((s.report for s in came if s.report.ack_sequence == sequence), None)
            if answer is not None:
                if answer.result != CommandResult.OK:
                    raise RigRefusedError(f"{command.name}: {answer.result_text}")
                return samples
        raise RigLostError(f"{command.name}: the rig does not answer")

    def arm(self) -> None:
        """Set the rig file's limits and switch the power stage on, at zero torque."""
        self.request(Command.LIMITS, limits_payload(*self.rig.limit_codes()))
        self.request(Command.ARM)

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
            RigInputError: if the firmware cannot run that slope or torque; else as `request`.
        """
        return self.request(Command.RAMP, ramp_payload(self.rig.ramp_step(slope), self.end_code(end_torque)))

    def end_code(self, torque: float) -> int:
        """Return the DAC code of a ramp's end.

        Raises:
            RigInputError: if the firmware does not go there.
        """
        limit = self.hello.torque_limit_code if self.hello is not None else CODES
        if not self.rig.torque(0.5) <= torque < self.rig.torque(limit + 0.5):
            accepted = f"{self.rig.torque(1):.2g} to {self.rig.torque(limit):.3g} Nm"
            raise RigInputError(f"end torque {torque:g} Nm; accepted by the firmware: {accepted}")
        return self.rig.end_code(torque)


def raise_fault(report: Report) -> None:
    """Raise what the report's fault bits say, if any.

    Raises:
        RigFaultError: naming the faults.
    """
    if report.fault != Fault.NONE or report.state == State.FAULT:
        raise RigFaultError(f"the rig switched itself off: {fault_text(report.fault)}; find out why, then clear it")
