"""The line to a rig: numbered frames out, frames in, the rig's silence, and a stop that overtakes all of it."""

from __future__ import annotations

import threading
from typing import Protocol

from friction_bench.protocol.codec import Frame, FrameDecoder, encode
from friction_bench.protocol.errors import RigLostError, RigRefusedError
from friction_bench.protocol.messages import Command, Report, State

HEARTBEAT = 0.02
"""Time between heartbeats, s; the firmware's watchdog trips after 120 ms."""
SILENCE = 0.5
"""A rig that reports nothing for so long, s, is lost."""
_LONGEST_LISTENING = 2 * HEARTBEAT
"""The most that counts as listening between two reads, s: a program that was suspended did not listen."""
STOP_SEQUENCES = range(240, 256)
"""Sequence numbers of urgent stops; each has its own, so that its answer cannot be that to an earlier one."""
SWITCHED_ON = frozenset((State.ARMED, State.RAMPING))


class Port(Protocol):
    """What carries the bytes, to a real rig or an emulated one, with a clock of its own."""

    def now(self) -> float:
        """Return the port's time, s, monotonic."""

    def write(self, data: bytes) -> None:
        """Send bytes."""

    def write_first(self, data: bytes) -> None:
        """Send bytes ahead of what has not left yet, which may be thrown away in the middle of a frame."""

    def read(self, timeout: float) -> bytes:
        """Return what has come; wait up to `timeout` seconds for the first byte."""

    def close(self) -> None:
        """Give the port back."""


class RigLine:
    """Frames on a port; only `urgent_stop` may be called by other threads than the one that owns the line.

    Attributes:
        sequence: number of the last command.
        listened: time spent listening, s: what timeouts of the rig's answers count.
        stops: urgent stops so far.
        known_stops: how many of them the owner knew of when it gave the command under way.
        stopping: an urgent stop has been sent and not been answered; `keep_alive` repeats it in place of heartbeats.
    """

    def __init__(self, port: Port) -> None:
        self.port = port
        self.sequence = 0
        self.listened = 0.0
        self.stops = 0
        self.known_stops = 0
        self.stopping = False
        self._stop_lock = threading.Lock()
        self._decoder = FrameDecoder()
        self._sent_at = -1.0
        self._read_at = port.now()
        self._heard_at = 0.0  # of the time listened

    @property
    def bad_frames(self) -> int:
        """Return how many damaged frames have come from the rig."""
        return self._decoder.bad

    def number(self, command: Command, payload: bytes) -> bytes:
        """Return the bytes of a command with the next sequence number."""
        self.sequence = self.sequence % (STOP_SEQUENCES.start - 1) + 1
        return encode(Frame(command, self.sequence, payload))

    def send(self, command: Command, payload: bytes = b"") -> None:
        """Send a command whatever stops there have been: a greeting or a heartbeat."""
        self.port.write(self.number(command, payload))
        self._sent_at = self.port.now()

    def send_unless_stopped(self, message: bytes, command: Command) -> None:
        """Send a numbered command, unless there has been a stop that its giver did not know of.

        Raises:
            RigRefusedError: if there has; the stop is known from then on.
        """
        with self._stop_lock:
            if self.stops != self.known_stops:
                self.known_stops = self.stops
                raise RigRefusedError(f"{command.name}: overtaken by a stop")
            self.port.write(message)

    def urgent_stop(self) -> None:
        """Take the torque away now.

        A command that is under way is given up: its repetition after the stop would undo it. The stop itself is
        repeated by `keep_alive` until the rig answers it, with no heartbeat in between: if the line accepts it no more,
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
        self.port.write_first(b"\0" + 2 * encode(Frame(Command.STOP, self._stop_sequence, b"")))
        self._sent_at = self.port.now()

    @property
    def _stop_sequence(self) -> int:
        return STOP_SEQUENCES[self.stops % len(STOP_SEQUENCES)]

    def keep_alive(self, beating: bool) -> None:
        """Send what is due: a stop that has not been answered, else the heartbeat if `beating`."""
        if self.port.now() - self._sent_at >= HEARTBEAT:
            if self.stopping:
                self._write_stop()
            elif beating:
                self.send(Command.BEAT)

    def note_answer(self, report: Report) -> None:
        """End the stop's repetition when `report` answers it."""
        if report.state not in SWITCHED_ON and report.ack_sequence == self._stop_sequence:
            self.stopping = False

    def excuse_silence(self) -> None:
        """Count the rig's silence from now on."""
        self._heard_at = self.listened

    def frames(self, timeout: float) -> list[Frame]:
        """Return the frames that came within `timeout` seconds.

        Raises:
            RigLostError: if the rig has been silent for too long.
        """
        frames = self._decoder.feed(self.port.read(timeout))
        before, self._read_at = self._read_at, self.port.now()
        self.listened += min(self._read_at - before, _LONGEST_LISTENING)
        if frames:
            self.excuse_silence()
        elif self.listened - self._heard_at > SILENCE:
            raise RigLostError(f"the rig has not reported for {SILENCE} s")
        return frames
