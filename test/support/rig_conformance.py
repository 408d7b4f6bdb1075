"""Plays a conformance transcript on any board: one specification for every target of the firmware."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from friction_bench.rig.emulated import NativeBoard
from friction_bench.rig.messages import (
    PROTOCOL_VERSION,
    Command,
    CommandResult,
    Frame,
    FrameDecoder,
    HelloReply,
    Report,
    ResetCause,
    encode,
    parse_hello,
    parse_report,
    payload_of,
)

TRANSCRIPTS = sorted((Path(__file__).parents[1] / "friction_bench" / "transcripts").glob("*.yaml"))
TORQUE_LIMIT_CODE = 229


class MismatchError(AssertionError):
    """The board does not do what the transcript says."""


def command_of(command: dict[str, Any] | str) -> tuple[Command, bytes]:
    if isinstance(command, str):
        return Command[command.upper()], b""
    ((name, value),) = command.items()
    kind = Command[name.upper()]
    return kind, payload_of(kind, *(value if isinstance(value, list) else [value]))


def armed(board: Any) -> Player:
    player = Player(board)
    player.do_greet(None)
    player.do_send("arm")
    player.do_beat(60)
    return player


class Player:
    def __init__(self, board: Any) -> None:
        self.board = board
        self.decoder = FrameDecoder()
        self.sequence = 0
        self.message = b""
        self.adc = 0
        self.edges = 0
        self.clock = 0
        self.beat_at = 0
        self.reports: list[Report] = []
        self.hello: HelloReply | None = None
        self.forgotten = 0

    def play(self, path: Path) -> None:
        script = yaml.safe_load(path.read_text(encoding="utf-8"))
        for number, step in enumerate(script["steps"], 1):
            name, value = (step, None) if isinstance(step, str) else next(iter(step.items()))
            try:
                getattr(self, f"do_{name}")(value)
            except MismatchError as error:
                raise MismatchError(f"{path.name}, step {number} ({step}): {error}") from None

    def millisecond(self) -> None:
        """Let a millisecond pass, and hold the board to what must be true at every instant."""
        self.board.run(1000, self.edges, self.adc)
        self.clock += 1
        if self.board.stage_on and self.board.dac > TORQUE_LIMIT_CODE:
            raise MismatchError(f"the DAC shows {self.board.dac} with the stage on")
        for frame in self.decoder.feed(self.board.read()):
            report = parse_report(frame)
            if report is not None:
                self.reports.append(report)
            self.hello = parse_hello(frame) or self.hello

    def transmit(self, frame: Frame) -> bytes:
        self.message = encode(frame)
        self.board.write(self.message)
        return self.message

    def next_frame(self, command: dict[str, Any] | str) -> Frame:
        self.sequence = (self.sequence + 1) & 0xFF
        kind, payload = command_of(command)
        return Frame(kind, self.sequence, payload)

    def do_send(self, command: dict[str, Any] | str) -> None:
        self.transmit(self.next_frame(command))

    def do_raw(self, value: dict[str, Any]) -> None:
        self.transmit(Frame(value["type"], value["sequence"], bytes.fromhex(value.get("payload", ""))))

    def do_bytes(self, value: str) -> None:
        self.board.write(bytes.fromhex(value))

    def do_again(self, _: None) -> None:
        self.board.write(self.message)

    def do_damaged(self, value: dict[str, Any]) -> None:
        message = bytearray(encode(self.next_frame(value["command"])))
        self.sequence -= 1  # the rig must not have seen it
        middle = len(message) // 2
        if value["how"] == "flip":
            message[middle] ^= 0x10
        elif value["how"] == "lose":
            del message[middle]
        elif value["how"] == "double":
            message.insert(middle, message[middle])
        else:
            at = -3 if value["how"] == "checksum_low" else -2
            message[at] = message[at] ^ 1 or 2
        self.board.write(bytes(message))

    def do_greet(self, _: None) -> None:
        self.do_run(5)
        self.do_send({"hello": PROTOCOL_VERSION})
        self.do_run(60)
        self.do_expect({"greeted": True, "result": "OK"})

    def do_run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.millisecond()

    def do_beat(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            if self.clock - self.beat_at >= 20:
                self.beat_at = self.clock
                self.board.write(encode(Frame(Command.BEAT, 0, b"")))
            self.millisecond()

    def do_tick(self, _: None) -> None:
        known = len(self.reports)
        while len(self.reports) == known:
            self.do_beat(1)

    def do_adc(self, code: int) -> None:
        self.adc = code

    def do_edges(self, per_millisecond: int) -> None:
        self.edges = per_millisecond

    def do_reset(self, _: None) -> None:
        self.board.reset(*[ResetCause.EXTERNAL] * isinstance(self.board, NativeBoard))

    def do_forget(self, _: None) -> None:
        self.forgotten = len(self.reports)

    def do_silence(self, limits: list[int]) -> None:
        self.board.write(encode(Frame(Command.BEAT, 0, b"")))
        start = self.clock
        while self.board.stage_on and self.clock - start < 1000:
            self.millisecond()
        took = self.clock - start
        if not limits[0] <= took <= limits[1] or self.board.dac:
            raise MismatchError(f"the stage went off after {took} ms, DAC {self.board.dac}")

    def do_staircase(self, codes: list[int]) -> None:
        shown = [report.dac for report in self.reports[self.forgotten :]]
        for at in range(len(shown)):
            if shown[at : at + len(codes)] == codes:
                return
        raise MismatchError(f"reported {shown}")

    def do_pins(self, value: dict[str, Any]) -> None:
        found = {"dac": self.board.dac, "stage": self.board.stage_on}
        if found != value:
            raise MismatchError(f"pins {found}")

    def do_built(self, value: dict[str, Any]) -> None:
        found = {name: getattr(self.hello, name, None) for name in value}
        if found != value:
            raise MismatchError(f"built {found}")

    def do_expect(self, value: dict[str, Any]) -> None:
        if not self.reports:
            raise MismatchError("the board has not reported")
        found = self.observed(self.reports[-1])
        wrong = {key: found[key] for key, wanted in value.items() if found[key] != wanted}
        if wrong:
            raise MismatchError(f"found {wrong}")
        if found["state"] == "RAMPING":
            return  # the pins are ahead of the report
        if found["dac"] != self.board.dac or found["stage"] != self.board.stage_on:
            raise MismatchError(f"reported {found}, pins {self.board.dac} {self.board.stage_on}")

    def observed(self, report: Report) -> dict[str, Any]:
        hello = self.hello
        return {
            "state": report.state.name,
            "greeted": report.greeted,
            "stage": report.stage_on,
            "ramp_done": report.ramp_done,
            "dac": report.dac,
            "adc": report.adc,
            "tick": report.tick,
            "counts": report.counts,
            "fault": int(report.fault),
            "result": CommandResult(report.result).name,
            "ack": report.ack_sequence,
            "answered": report.ack_sequence == self.sequence,
            "bad_frames": report.bad_frames,
            "hello_version": hello and hello.version,
            "counts_per_revolution": hello and hello.counts_per_revolution,
            "tick_us": hello and hello.tick_us,
            "torque_limit_code": hello and hello.torque_limit_code,
            "watchdog_ticks": hello and hello.watchdog_ticks,
        }
