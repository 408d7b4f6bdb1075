"""A stop reaches the rig within 100 ms, whatever else is on the line."""

from __future__ import annotations

import contextlib
import os
import time
import tty

import pytest
from processes import TIMEOUT, wait_until
from rig_bench import Bench, read_some

from friction_bench.rig.client import STOP_SEQUENCES, RigClient
from friction_bench.rig.emulated import EmulatedRig
from friction_bench.rig.messages import (
    Command,
    Fault,
    Frame,
    FrameDecoder,
    RigLostError,
    RigRefusedError,
    State,
    encode,
)
from friction_bench.rig.rig_file import Rig
from friction_bench.rig.serial_port import WRITE_TIMEOUT, SerialPort


def test_stop_overtakes_a_command_under_way(client: RigClient, emulated: EmulatedRig) -> None:
    """A command under way is given up after a stop, so that its repetition does not undo the stop."""
    port = client.port
    write = port.write
    sent = []

    def stop_first(data: bytes, **first: bool) -> None:
        sent.append(data)
        write(data, **first)

    port.write = stop_first  # type: ignore[method-assign]
    client.urgent_stop()
    with pytest.raises(RigRefusedError, match="overtaken by a stop"):
        client.arm()
    assert len(sent) == 1
    assert not emulated.board.stage_on


def test_stop_reaches_the_rig_within_100_ms_of_its_time(bench: Bench) -> None:
    """With commands under way, each of ten stops takes the stage off within 100 ms of the rig.

    The rig's time stands still until the stop is on its line, however busy this computer is: a stop that waited for
    the rig, for its answer to the command under way or for its reading of the line, would never come.
    """
    emulated = bench.pty.emulated
    run, off_at = emulated.board.run, [0.0]

    def watched(*arguments: int) -> None:
        on = emulated.board.stage_on
        run(*arguments)
        if on and not emulated.board.stage_on:
            off_at[0] = emulated.time

    emulated.board.run = watched  # type: ignore[method-assign]
    for _ in range(10):
        bench.arm()
        busy = bench.link.submit(lambda client: client.request(Command.TORQUE, 30))
        with bench.pty.standing_still():
            asked_at = emulated.time
            bench.link.stop_rig()
            bench.pty.hear(Command.STOP)
        wait_until(lambda: not emulated.board.stage_on, "the stage to go off")
        assert asked_at <= off_at[0] < asked_at + 0.1
        busy.exception(TIMEOUT)
        wait_until(lambda: bench.state == State.DISARMED, "a rig that is off, and not by its watchdog")


def test_stop_does_not_wait_for_a_line_that_takes_nothing(rig: Rig) -> None:
    """With the line's buffer full, a stop is put on it all the same, in place of what had not left yet."""
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        os.set_blocking(master, False)
        port = SerialPort(os.ttyname(slave), rig.baud)
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
        port.close()
    finally:
        os.close(master)
        os.close(slave)


def test_write_that_has_succeeded_is_not_lost_however_late(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that stands still in the middle of a write longer than its timeout costs nothing."""
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        port = SerialPort(os.ttyname(slave), rig.baud)
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
        port.close()
    finally:
        os.close(master)
        os.close(slave)


def test_no_wait_of_the_stop_adds_up_to_100_ms() -> None:
    """A write of another thread, the stop's own, and what is between system and firmware leave room within 100 ms."""
    on_the_line = len(b"\0" + 2 * encode(Frame(Command.STOP, STOP_SEQUENCES[0], b""))) * 10 / 19200
    adapter, main_loop = 16e-3, 2e-3  # an FTDI's own timer, and the 8051 at its busiest
    assert 2 * WRITE_TIMEOUT + adapter + on_the_line + main_loop < 0.1


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_stop_that_the_line_damages_is_repeated(lost: int, client: RigClient, emulated: EmulatedRig) -> None:
    """A stop whose first transmissions are damaged still takes the stage off within 100 ms, without heartbeats."""
    client.arm()
    client.request(Command.TORQUE, 60)
    write, damaged = emulated.board.write, 0

    def damage(data: bytes) -> None:
        nonlocal damaged
        frames = FrameDecoder().feed(data)
        assert not any(frame.type == Command.BEAT for frame in frames)
        damaged += 1
        write(data.replace(b"\0", b"\1") if damaged <= lost else data)

    emulated.board.write = damage  # type: ignore[method-assign]
    start = emulated.time
    client.urgent_stop()
    while emulated.board.stage_on:
        client.pump()
    assert emulated.time - start < 0.1
    assert client.stopping
    emulated.board.write = write  # type: ignore[method-assign]
    while client.stopping:
        client.pump()
    assert client.last is not None
    assert client.last.report.fault == Fault.NONE


def test_stop_is_understood_after_a_frame_that_lost_its_end(client: RigClient, emulated: EmulatedRig) -> None:
    """The rest of a damaged frame in front of a stop does not swallow it."""
    client.arm()
    emulated.board.write(encode(Frame(Command.BEAT, 1, b""))[:-2])
    sent = []
    write = emulated.board.write
    emulated.board.write = lambda data: sent.append(data) or write(data)  # type: ignore[method-assign, func-returns-value]
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
        assert client.last is not None
        numbers.add(client.last.report.ack_sequence)
    assert len(numbers) == 2
    client.known_stops = client.stops
    for _ in range(300):
        client.clear()
        assert client.last.report.ack_sequence not in STOP_SEQUENCES
