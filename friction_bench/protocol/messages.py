"""What frames mean: the commands of the host and the answers of the rig (docs/reference/rig_protocol.md)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from friction_bench.protocol.codec import Frame

PROTOCOL_VERSION = 1

_HELLO = struct.Struct("<BBBHHHHBB")
_REPORT = struct.Struct("<HHBBBBBBBB")


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


RESULT_TEXTS: dict[int, str] = {
    CommandResult.OK: "done",
    CommandResult.UNKNOWN: "the rig does not know this command",
    CommandResult.LENGTH: "the command has a wrong length",
    CommandResult.VERSION: "the rig speaks another protocol version",
    CommandResult.NO_HELLO: "the rig has not been greeted since its last reset",
    CommandResult.FAULT: "a fault is latched; clear it first",
    CommandResult.STATE: "not possible in the rig's present state",
    CommandResult.RANGE: "a value is outside the firmware's limits",
}


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


class Processor(IntEnum):
    """What the firmware runs on."""

    NATIVE = 0
    MCS51 = 1
    AVR = 2


@dataclass(frozen=True)
class HelloReply:
    """What the firmware was built for.

    Attributes:
        tick_us: period of the reports, µs.
        dac_full_scale: motor torque at DAC code 255, Nm.
        adc_full_scale: motor torque at ADC code 255, Nm.
        torque_limit_code: the highest DAC code the firmware accepts.
        watchdog_ticks: ticks of silence after which the stage goes off.
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

    @property
    def text(self) -> str:
        """Return the processor and the reset's cause in words."""
        return f"processor {_name(Processor, self.processor)}, reset cause {_name(ResetCause, self.reset_cause)}"


def _name(kind: type[IntEnum], value: int) -> str:
    return next((one.name.lower().replace("_", "-") for one in kind if one == value), f"number {value}")


@dataclass(frozen=True)
class Report:
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
        """Return what became of the last command, in words."""
        return RESULT_TEXTS.get(self.result, f"unknown result {self.result}")


def parse_hello(frame: Frame) -> HelloReply | None:
    """Return the greeting in `frame`, None if it is something else."""
    if frame.type != Answer.HELLO_REPLY or len(frame.payload) != _HELLO.size:
        return None
    version, processor, cause, cpr, tick_us, dac, adc, limit, watchdog = _HELLO.unpack(frame.payload)
    return HelloReply(version, processor, cause, cpr, tick_us, dac * 1e-5, adc * 1e-5, limit, watchdog)


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


def torque_payload(code: int) -> bytes:
    """Return the payload of TORQUE: a DAC code."""
    return struct.pack("<B", code)


def ramp_payload(slope: int, end_code: int) -> bytes:
    """Return the payload of RAMP: slope in 1/256 DAC code per tick, and the code at which it ends."""
    return struct.pack("<HB", slope, end_code)


def limits_payload(travel: int, speed: int) -> bytes:
    """Return the payload of LIMITS: travel in units of 256 counts, speed in counts per tick."""
    return struct.pack("<HH", travel, speed)
