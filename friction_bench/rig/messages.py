"""The rig's protocol (docs/reference/rig_protocol.md): frames on the line, their meanings, and errors.

A frame on the line is COBS(type, sequence, payload, CRC-16/CCITT-FALSE), closed by 0x00.
"""

from __future__ import annotations

import binascii
import struct
from enum import IntEnum, IntFlag
from typing import NamedTuple

from rx90_common.base.errors import REFUSED, FailureError

PROTOCOL_VERSION = 2
MAX_DECODED = 32
"""Longest frame before COBS, in bytes; a longer one is noise."""

_HELLO = struct.Struct("<BBBHHHHBBBB")
_PULSED = 4
_COARSE = 8
"""Bits of the greeting that say how the firmware was built; the others are 0."""
_REPORT = struct.Struct("<HHBBBBBBBB")


class RigError(FailureError):
    """The rig or the line to it fails; the text is one line meant for the user."""


class RigLostError(RigError):
    """The line is broken: unplugged, in use by another program, or silent."""


class RigResetError(RigError):
    """The rig restarted by itself; it has to be greeted and armed again."""


class RigRefusedError(RigError):
    """The firmware refused a command."""


class RigFaultError(RigError):
    """The firmware latched a fault and took the torque away."""


class RigInputError(RigError):
    """A setting or a file requires something that this rig cannot do."""

    exit_code = REFUSED


class Frame(NamedTuple):
    """One intact frame: type and sequence in 0..255, payload without CRC."""

    type: int
    sequence: int
    payload: bytes


def crc16(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE of `data` (polynomial 0x1021, start 0xFFFF, not reflected)."""
    return binascii.crc_hqx(data, 0xFFFF)


def cobs_encode(data: bytes) -> bytes:
    """Replace the zeros of `data` (shorter than 254 bytes), so that 0x00 can delimit frames."""
    return b"".join(bytes([len(block) + 1]) + block for block in data.split(b"\0"))


def cobs_decode(data: bytes) -> bytes | None:
    """Invert `cobs_encode`; None where `data`, which holds no zero, cannot come from it."""
    blocks = []
    at = 0
    while at < len(data):
        blocks.append(data[at + 1 : at + data[at]])
        at += data[at]
    return b"\0".join(blocks) if blocks and at == len(data) else None


def encode(frame: Frame) -> bytes:
    """Return the bytes of `frame`, whose payload is no longer than MAX_DECODED - 4, on the line, delimiter included."""
    body = bytes([frame.type, frame.sequence]) + frame.payload
    return cobs_encode(body + crc16(body).to_bytes(2, "little")) + b"\0"


def decode(encoded: bytes) -> Frame | None:
    """Return the frame between two delimiters, None unless it is intact."""
    data = cobs_decode(encoded)
    if data is None or not 4 <= len(data) <= MAX_DECODED:
        return None
    intact = crc16(data[:-2]) == int.from_bytes(data[-2:], "little")
    return Frame(data[0], data[1], data[2:-2]) if intact else None


class FrameDecoder:
    """Cuts a byte stream into frames; damage costs the frames it hit and nothing else.

    Attributes:
        bad: refused frames so far.
    """

    def __init__(self) -> None:
        self.bad = 0
        self._rest = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that `data` completes, in order."""
        *parts, rest = (self._rest + data).split(b"\0")
        # Noise without a zero must not fill the memory: one byte more than COBS can need marks it as damaged.
        self._rest = rest[: MAX_DECODED + 2]
        decoded = [decode(part) for part in parts if part]
        frames = [frame for frame in decoded if frame is not None]
        self.bad += len(decoded) - len(frames)
        return frames


class Command(IntEnum):
    """Frame types that the host sends."""

    HELLO = 0x01
    BEAT = 0x02
    TORQUE = 0x03
    ARM = 0x04
    STOP = 0x05
    CLEAR = 0x06
    RAMP = 0x07
    LIMITS = 0x08


_PAYLOADS = {Command.HELLO: "<B", Command.TORQUE: "<B", Command.RAMP: "<HB", Command.LIMITS: "<HH"}


def payload_of(command: Command, *values: int) -> bytes:
    """Return a command's payload.

    Args:
        command: the command.
        values: HELLO: protocol version. TORQUE: DAC code. RAMP: slope in 1/256 DAC code per tick, and the code at which
            it ends. LIMITS: travel in units of 256 counts, speed in counts per tick.
    """
    return struct.pack(_PAYLOADS.get(command, "<"), *values)


class Answer(IntEnum):
    """Frame types that the rig sends."""

    HELLO_REPLY = 0x81
    REPORT = 0x82


class State(IntEnum):
    """The firmware's states; only ARMED and RAMPING have the power stage on."""

    DISARMED = 0
    ARMED = 1
    RAMPING = 2
    FAULT = 3


class CommandResult(IntEnum):
    """What became of the last command."""

    OK = 0
    UNKNOWN = 1
    LENGTH = 2
    VERSION = 3
    NO_HELLO = 4
    FAULT = 5
    STATE = 6
    RANGE = 7


_RESULT_TEXTS = (
    "done",
    "the rig does not know this command",
    "the command has a wrong length",
    "the rig speaks another protocol version",
    "the rig has not been greeted since its last reset",
    "a fault is latched; clear it first",
    "not possible in the rig's present state",
    "a value is outside the firmware's limits",
)
"""By the number of a CommandResult."""


class Fault(IntFlag):
    """Latched faults."""

    NONE = 0
    WATCHDOG = 1
    CURRENT = 2
    TRAVEL = 4
    SPEED = 8


FAULT_TEXTS = {
    Fault.WATCHDOG: "the host was silent for more than 120 ms",
    Fault.CURRENT: "measured current above the limit",
    Fault.TRAVEL: "travel limit exceeded",
    Fault.SPEED: "speed limit exceeded",
}


def fault_text(fault: Fault) -> str:
    """Return the latched faults in words, 'none' without one."""
    return "; ".join(text for bit, text in FAULT_TEXTS.items() if bit in fault) or "none"


class ResetCause(IntEnum):
    """Why the board last started."""

    UNKNOWN = 0
    POWER = 1
    EXTERNAL = 2
    WATCHDOG = 3
    BROWN_OUT = 4


PROCESSORS = ("native", "mcs51", "avr")
"""What the firmware runs on, by its number."""


class HelloReply(NamedTuple):
    """The configuration that the firmware was built with.

    Attributes:
        tick_us: period of the reports, µs.
        dac_full_scale: motor torque at DAC code 255, Nm.
        adc_full_scale: motor torque at ADC code 255, Nm.
        torque_limit_code: the highest DAC code the firmware accepts.
        watchdog_ticks: ticks of silence after which the stage goes off.
        built: further options of the build, as bits.
        hold_ticks: time for which it holds the end torque of a ramp.
    """

    version: int
    processor: int
    reset_cause: int
    counts_per_revolution: int
    tick_us: int
    dac_full_scale: float
    adc_full_scale: float
    torque_limit_code: int
    watchdog_ticks: int
    built: int
    hold_ticks: int

    @property
    def pulsed(self) -> bool:
        """Return whether the stage switches off for a moment in each tick of a ramp."""
        return bool(self.built & _PULSED)

    @property
    def text(self) -> str:
        """Return the processor and the reset's cause in words."""
        causes = tuple(cause.name.lower().replace("_", "-") for cause in ResetCause)
        pairs = ((PROCESSORS, self.processor), (causes, self.reset_cause))
        processor, cause = (
            names[value] if value < len(names) else f"number {value}" for names, value in pairs
        )
        return f"processor {processor}, reset cause {cause}"


class Report(NamedTuple):
    """The rig's state at one tick; tick (16 bits) and counts (24 bits) roll over."""

    sequence: int
    tick: int
    counts: int
    dac: int
    adc: int
    state: State
    greeted: bool
    stage_on: bool
    ramp_done: bool
    fault: Fault
    ack_sequence: int
    result: int
    bad_frames: int

    @property
    def result_text(self) -> str:
        """Return the result of the last command, in words."""
        known = self.result < len(_RESULT_TEXTS)
        return _RESULT_TEXTS[self.result] if known else f"unknown result {self.result}"


def parse_hello(frame: Frame) -> HelloReply | None:
    """Return the greeting in `frame`, None if it is something else."""
    if frame.type != Answer.HELLO_REPLY or not frame.payload:
        return None
    if frame.payload[0] == PROTOCOL_VERSION and len(frame.payload) != _HELLO.size:
        return None
    # Of another version only the first byte is known, which is the version.
    hello = HelloReply(*_HELLO.unpack(frame.payload[: _HELLO.size].ljust(_HELLO.size, b"\0")))
    unit = 1e-4 if hello.built & _COARSE else 1e-5
    return hello._replace(
        dac_full_scale=hello.dac_full_scale * unit, adc_full_scale=hello.adc_full_scale * unit
    )


def parse_report(frame: Frame) -> Report | None:
    """Return the report in `frame`, None if it is something else."""
    if frame.type != Answer.REPORT or len(frame.payload) != _REPORT.size:
        return None
    tick, low, high, dac, adc, status, fault, ack, result, bad = _REPORT.unpack(frame.payload)
    return Report(
        sequence=frame.sequence,
        tick=tick,
        counts=low | high << 16,
        dac=dac,
        adc=adc,
        state=State(status & 3),
        greeted=bool(status & 4),
        stage_on=bool(status & 8),
        ramp_done=bool(status & 16),
        fault=Fault(fault & 15),
        ack_sequence=ack,
        result=result,
        bad_frames=bad,
    )
