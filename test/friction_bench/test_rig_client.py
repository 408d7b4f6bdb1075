"""The host's side of the protocol: roll-overs, lost reports, resets, silence, refusals; a stop overtakes everything."""

import contextlib
import math
import os
import re
import time
import tty
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from rig_bench import greeted, read_some, rig_file_with, spoil

from friction_bench.experiment.identification import identify_ramps
from friction_bench.experiment.job import run_ramp
from friction_bench.rig.client import COMMAND_TIMEOUT, STOP_SEQUENCES, RigClient, unwrap
from friction_bench.rig.emulated import EmulatedRig, NativeBoard, VirtualPort, native_library
from friction_bench.rig.messages import (
    Answer,
    Command,
    Fault,
    Frame,
    FrameDecoder,
    ResetCause,
    RigError,
    RigInputError,
    RigLostError,
    RigRefusedError,
    RigResetError,
    encode,
)
from friction_bench.rig.rig_file import Rig, load_rig
from friction_bench.rig.serial_port import WRITE_TIMEOUT, SerialPort
from rx90_common.base.errors import ConfigError
from rx90_common.friction.parts.bristles import ElastoPlastic


@pytest.mark.parametrize("bits", [16, 24])
def test_counters_unwrap_across_roll_overs(bits: int) -> None:
    """A cumulative counter comes out of any roll-over, forwards and backwards, with readings missing."""
    values = [(1 << bits) - 5, (1 << bits) + 7, (1 << bits) + 3, 3 * (1 << bits) // 2]
    assert unwrap(values[0], None, bits) == values[0]
    for last, value in pairwise(values):
        assert unwrap(value % (1 << bits), last, bits) == value


def test_lost_reports_cost_no_position(client: RigClient, emulated: EmulatedRig) -> None:
    """Reports lost in the midst of a ramp are counted, and the angle at its end is the plant's own."""
    spoil(emulated.board, 60, lambda _: b"")
    record = run_ramp(client, 0.05, 0.1, False, "x")
    assert client.bad_frames > 5
    assert client.lost_reports > 5
    assert client.last.counts == pytest.approx(emulated.plant.angle * 504 / (2 * math.pi), abs=400)
    assert identify_ramps([record], 0.0).ramps[0].asymptote[0] == pytest.approx(0.05 / 6.4e-4, rel=0.03)


def test_reset_in_a_ramp_is_noticed(client: RigClient, emulated: EmulatedRig) -> None:
    """A rig that restarts during a ramp raises, its torque is away, and it runs again after a greeting."""

    def restart(_: object) -> None:
        if client.last is not None and client.last.report.dac > 40:
            emulated.board.reset(ResetCause.WATCHDOG)

    with pytest.raises(RigResetError, match="armed again"):
        run_ramp(client, 0.05, 0.15, False, "x", restart)
    assert not emulated.board.stage_on
    client.connect()
    assert run_ramp(client, 0.05, 0.1, False, "y").time.size > 50


def test_silent_rig_is_lost_not_waited_for(client: RigClient, emulated: EmulatedRig) -> None:
    """A rig that says nothing raises within a second."""
    emulated.board.read = bytes
    start = emulated.time
    with pytest.raises(RigLostError, match="not reported"):
        any(client.pump() is None for _ in range(1000))
    assert emulated.time - start < 1.0


def test_host_that_stood_still_does_not_take_the_rig_for_lost(client: RigClient) -> None:
    """Time in which the program did not run is not a rig's silence, neither between commands nor within one."""
    port = client.port
    now, read, stood_still = port.now, port.read, 0.0
    port.now = lambda: now() + stood_still

    def late(_: float) -> bytes:
        nonlocal stood_still
        stood_still += 2 * COMMAND_TIMEOUT
        port.read = read
        return b""

    for command in (client.pump, client.clear):
        port.read = late
        command()
    assert stood_still == 4 * COMMAND_TIMEOUT


@pytest.mark.parametrize(
    ("changes", "figures", "message"),
    [
        ({"counts_per_revolution": 500}, {}, "counts_per_revolution is 500, the rig's firmware has 504"),
        ({}, {"HOLD_TICKS": 50}, "ramps.hold, in ticks, is 0, the rig's firmware has 50"),
        ({}, {"PULSED": 1}, "emulation.amplifier.off_time > 0 is False, the rig's firmware has True"),
        (
            {"torque": {"dac_full_scale": 2.0}},
            {},
            "dac_full_scale is 2.0, the rig's firmware has 0.2",
        ),  # alike on the wire
    ],
)
def test_other_figures_are_refused(changes: dict[str, Any], figures: dict[str, int], message: str, rig: Rig) -> None:
    """What the greeting says is compared with the rig file; the first difference is named with both values."""
    emulated = EmulatedRig(rig, 0, NativeBoard(rig.baud, native_library(figures)))
    client = RigClient(VirtualPort(emulated), rig.replaced(**changes))
    with pytest.raises(RigInputError, match=rf"gm8224\.yaml: {re.escape(message)}$"):
        client.connect()
    assert client.hello is None
    assert not emulated.board.stage_on


def test_a_firmware_of_version_1_is_named(rig: Rig) -> None:
    """The shorter greeting of the protocol's first version is understood as far as its version, and refused."""
    old = bytes.fromhex("01 01 01 f801 204e 204e a861 e5 07")

    class Old(VirtualPort):
        def read(self, timeout: float) -> bytes:
            self.emulated.advance(timeout)
            return encode(Frame(Answer.HELLO_REPLY, 1, old))

    with pytest.raises(RigRefusedError, match="speaks protocol version 1; accepted: 2"):
        RigClient(Old(EmulatedRig(rig, 0)), rig).connect()


WARM = "{reference: 30, lowest: 0, highest: 90, start: 25, ambient: 25, capacity: 9, resistance: 1, viscous_scale: 20}"


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("source", "dac_full_scale: 2.0", "dac_full_scale: 7.0",
         "torque.dac_full_scale is 7.0; accepted: with limit_lifted at most 6.5535 Nm"),
        ("gm8224_lugre", "\nemulation:\n", "\nemulation:\n  joint_spread: 0.05\n",
         "emulation.joint_spread is 0.05; accepted: 0"),
        ("gm8224_lugre", "omega_d: 1.0}", f"omega_d: 1.0, temperature: {WARM}}}",
         "joint_friction: lugre.temperature: the emulated rig cannot hold this"),
    ],
)  # fmt: skip
def test_a_rig_file_of_no_rig_is_refused(file: str, old: str, new: str, message: str, tmp_path: Path) -> None:
    """What does not go together is one line with the key."""
    own = rig_file_with(tmp_path, f"rig/{file}.yaml", {old: new})
    with pytest.raises(ConfigError, match=re.escape(message)):
        load_rig(own)


def test_a_rig_file_s_joint_may_have_other_bristles_than_lugre_s(tmp_path: Path) -> None:
    """The key `bristles` of its friction is the emulated joint's."""
    text = "omega_d: 1.0, bristles: {kind: elasto_plastic, break_away: 0.7}}"
    own = rig_file_with(tmp_path, "rig/gm8224_lugre.yaml", {"omega_d: 1.0}": text})
    assert load_rig(own).emulation.joint.bristles == ElastoPlastic(break_away=0.7)


def test_interrupted_ramp_is_stopped_by_the_host(client: RigClient, emulated: EmulatedRig) -> None:
    """Ctrl-C at any time after arming leaves the stage off, by a stop and not by the watchdog."""
    read = client.port.read
    for wanted in range(1, 40, 4):
        reads = 0

        def interrupted(timeout: float, wanted: int = wanted) -> bytes:
            nonlocal reads
            reads += emulated.board.stage_on
            if reads == wanted:
                raise KeyboardInterrupt
            return read(timeout)

        client.port.read = interrupted
        with pytest.raises(KeyboardInterrupt):
            run_ramp(client, 0.05, 0.15, False, "x")
        client.port.read = read
        emulated.advance(0.03)
        assert not emulated.board.stage_on
        client.connect()
        while client.last is None:
            client.pump()
        assert client.last.report.fault == Fault.NONE


@pytest.mark.parametrize("value", [0.19, 1e-5, math.nan, math.inf, -0.1])
def test_a_ramp_beyond_the_firmware_is_refused_before_arming(value: float, rig: Rig) -> None:
    """An end torque or slope that the firmware would refuse is refused with what is accepted, on a rig at rest."""
    client = greeted(rig)
    with pytest.raises(RigError, match=r"end torque .* accepted by the firmware: 0.00078 to 0.18 Nm"):
        run_ramp(client, 0.05, value, False, "x")
    with pytest.raises(RigError, match=r"slope .* accepted: 0.00015 to 0.627 Nm/s"):
        run_ramp(client, 5 * value if value > 0.1 else value, 0.15, False, "x")
    assert not client.port.emulated.board.stage_on


def test_stop_overtakes_a_command_under_way(client: RigClient, emulated: EmulatedRig) -> None:
    """A command under way is given up after a stop, so that its repetition does not undo the stop."""
    write, sent = client.port.write, []

    def stop_first(data: bytes, **first: bool) -> None:
        sent.append(data)
        write(data, **first)

    client.port.write = stop_first
    client.urgent_stop()
    with pytest.raises(RigRefusedError, match="overtaken by a stop"):
        client.arm()
    assert len(sent) == 1
    assert not emulated.board.stage_on


@pytest.fixture
def line(rig: Rig) -> Iterator[tuple[int, SerialPort]]:
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        os.set_blocking(master, False)
        port = SerialPort(os.ttyname(slave), rig.baud)
        yield master, port
        port.close()
    finally:
        os.close(master)
        os.close(slave)


def test_stop_does_not_wait_for_a_line_that_takes_nothing(rig: Rig, line: tuple[int, SerialPort]) -> None:
    """With the line's buffer full, a stop is put on it all the same, in place of what had not left yet."""
    master, port = line
    written = 0
    with contextlib.suppress(RigLostError):
        while True:
            port.write(bytes([7]) * 100)
            written += 100
    assert written > 4096
    RigClient(port, rig).urgent_stop()
    stops, decoder, got = [], FrameDecoder(), 0
    while len(stops) < 2:
        data = read_some(master)
        got += len(data)
        stops += [frame.type for frame in decoder.feed(data)]
    assert got < written
    assert stops == [Command.STOP, Command.STOP]


def test_a_write_is_not_lost_however_late(line: tuple[int, SerialPort], monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that stands still in the middle of a write longer than its timeout costs nothing."""
    master, port = line
    write = os.write

    def write_and_stand_still(descriptor: int, data: bytes) -> int:
        written = write(descriptor, data[:5])
        time.sleep(2 * WRITE_TIMEOUT)
        return written

    monkeypatch.setattr(os, "write", write_and_stand_still)
    port.write(b"twelve bytes")
    got = b""
    while len(got) < 12:
        got += read_some(master)
    assert got == b"twelve bytes"


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_stop_that_the_line_damages_is_repeated(lost: int, client: RigClient, emulated: EmulatedRig) -> None:
    """A stop whose first transmissions are damaged still takes the stage off within 100 ms, without heartbeats."""
    client.arm()
    client.request(Command.TORQUE, 60)
    write, damaged = emulated.board.write, 0

    def damage(data: bytes) -> None:
        nonlocal damaged
        assert not any(frame.type == Command.BEAT for frame in FrameDecoder().feed(data))
        damaged += 1
        write(data.replace(b"\0", b"\1") if damaged <= lost else data)

    emulated.board.write = damage
    start = emulated.time
    client.urgent_stop()
    while emulated.board.stage_on:
        client.pump()
    assert emulated.time - start < 0.1
    assert client.stopping
    emulated.board.write = write
    while client.stopping:
        client.pump()
    assert client.last.report.fault == Fault.NONE


def test_stop_is_understood_after_a_frame_that_lost_its_end(client: RigClient, emulated: EmulatedRig) -> None:
    """The rest of a damaged frame in front of a stop does not swallow it."""
    client.arm()
    write, sent = emulated.board.write, []
    write(encode(Frame(Command.BEAT, 1, b""))[:-2])
    emulated.board.write = lambda data: sent.append(data) or write(data)
    client.urgent_stop()
    emulated.advance(0.02)
    assert len(sent) == 1
    assert not emulated.board.stage_on


def test_answer_to_an_earlier_stop_is_not_taken_for_this_ones(client: RigClient) -> None:
    """Two stops in a row carry different numbers, and no command shares them."""
    numbers = set()
    for _ in range(2):
        client.urgent_stop()
        while client.stopping:
            client.pump()
        numbers.add(client.last.report.ack_sequence)
    assert len(numbers) == 2
    client.known_stops = client.stops
    for _ in range(300):
        client.clear()
        assert client.last.report.ack_sequence not in STOP_SEQUENCES
