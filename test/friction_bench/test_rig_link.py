"""The line to a rig: lost reports, roll-overs, resets, unplugging, garbage, a second opener, stops."""

from __future__ import annotations

import contextlib
import math
import os
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from friction_bench.asymptote import fit_asymptote
from friction_bench.client import STOP_SEQUENCES, RigClient, Unwrapper
from friction_bench.codec import Frame, FrameDecoder, encode
from friction_bench.emulated import EmulatedRig, VirtualPort
from friction_bench.errors import RigError, RigFaultError, RigLostError, RigRefusedError, RigResetError
from friction_bench.link import RigLink
from friction_bench.messages import Command, Fault, ResetCause, State
from friction_bench.native import NativeBoard
from friction_bench.pty_rig import PtyRig
from friction_bench.ramp import run_ramp
from friction_bench.rig import Rig
from friction_bench.serial_port import WRITE_TIMEOUT, SerialPort


def wait_for(condition: Callable[[], bool], timeout: float = 20.0) -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "the condition never held"
        time.sleep(0.002)


@pytest.fixture
def emulated(rig: Rig) -> EmulatedRig:
    """Return an emulated rig in virtual time."""
    return EmulatedRig(rig, 1)


@pytest.fixture
def client(emulated: EmulatedRig, rig: Rig) -> RigClient:
    """Return a greeted client of the emulated rig."""
    greeted = RigClient(VirtualPort(emulated), rig)
    greeted.connect()
    return greeted


@pytest.mark.parametrize("bits", [16, 24])
def test_counters_unwrap_across_roll_overs(bits: int) -> None:
    """A cumulative counter comes out of any roll-over, forwards and backwards, with readings missing."""
    unwrap = Unwrapper(bits)
    values = [0, 1000, (1 << bits) - 5, (1 << bits) + 7, (1 << bits) + 3, 3 * (1 << bits) // 2]
    assert [unwrap(value % (1 << bits)) for value in values[2:]] == values[2:3] + values[3:]


def test_lost_reports_cost_no_position(client: RigClient, emulated: EmulatedRig) -> None:
    """Reports lost in the midst of a ramp are counted, and the angle at its end is the plant's own."""
    read = emulated.board.read
    number = 0

    def lossy() -> bytes:
        nonlocal number
        data = read()
        number += bool(data)
        return b"" if number % 60 == 0 else data

    emulated.board.read = lossy  # type: ignore[method-assign]
    record = run_ramp(client, 0.05, 0.1, False, "x")
    assert client.bad_frames > 5
    assert client.lost_reports > 5
    assert client.last is not None
    assert client.last.counts == pytest.approx(emulated.plant.angle * 504 / (2 * math.pi), abs=400)
    assert fit_asymptote(record).a == pytest.approx(0.05 / 6.4e-4, rel=0.03)


def test_reset_in_a_ramp_is_noticed(client: RigClient, emulated: EmulatedRig) -> None:
    """A rig that restarts during a ramp raises, its torque is away, and it runs again after a greeting."""
    board = emulated.board
    assert isinstance(board, NativeBoard)

    def restart(_: object) -> None:
        if client.last is not None and client.last.report.dac > 40:
            board.reset(ResetCause.WATCHDOG)

    with pytest.raises(RigResetError, match="armed again"):
        run_ramp(client, 0.05, 0.15, False, "x", restart)
    assert not board.stage_on
    client.connect()
    assert run_ramp(client, 0.05, 0.1, False, "y").time.size > 50


def test_silent_rig_is_lost_not_waited_for(client: RigClient, emulated: EmulatedRig) -> None:
    """A rig that says nothing raises within a second."""
    emulated.board.read = bytes  # type: ignore[method-assign]
    start = emulated.time
    with pytest.raises(RigLostError, match="not reported"):
        any(client.pump() is None for _ in range(1000))
    assert emulated.time - start < 1.0


def test_host_that_stops_beating_loses_the_torque(client: RigClient, emulated: EmulatedRig) -> None:
    """Without heartbeats the firmware trips, and the ramp ends with that fault's words."""
    client.arm()
    client.torque(60)
    client.beating = False
    end = emulated.time + 0.3
    while emulated.time < end:
        client.pump()
    assert not emulated.board.stage_on
    assert client.last is not None
    assert client.last.report.fault == Fault.WATCHDOG
    client.beating = True
    with pytest.raises(RigFaultError, match="silent"):
        run_ramp(client, 0.05, 0.1, False, "x")
    client.clear()
    client.pump()
    assert run_ramp(client, 0.05, 0.1, False, "y").time.size > 50


def test_wrong_rig_file_is_refused(emulated: EmulatedRig, rig: Rig) -> None:
    """A rig whose firmware counts otherwise than the rig file is not greeted."""
    client = RigClient(VirtualPort(emulated), replace(rig, counts_per_revolution=500))
    with pytest.raises(RigError, match="counts_per_revolution is 500, the rig's firmware has 504"):
        client.connect()
    assert client.hello is None


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

        client.port.read = interrupted  # type: ignore[method-assign]
        with pytest.raises(KeyboardInterrupt):
            run_ramp(client, 0.05, 0.15, False, "x")
        client.port.read = read  # type: ignore[method-assign]
        emulated.advance(0.03)
        assert not emulated.board.stage_on
        client.connect()
        while client.last is None:
            client.pump()
        assert client.last.report.fault == Fault.NONE


@pytest.mark.parametrize("torque", [0.19, 1e-5, math.nan, math.inf, -0.1])
def test_end_torque_beyond_the_firmware_is_refused_before_arming(
    torque: float, client: RigClient, emulated: EmulatedRig
) -> None:
    """A ramp that the firmware would refuse is refused with its value and what is accepted, on a rig at rest."""
    with pytest.raises(RigError, match=r"end torque .* accepted by the firmware: 0.00078 to 0.18 Nm"):
        run_ramp(client, 0.05, torque, False, "x")
    assert not emulated.board.stage_on


@pytest.mark.parametrize("slope", [0.0, -1.0, 1.0, math.nan, math.inf])
def test_slope_beyond_the_firmware_is_refused(slope: float, rig: Rig) -> None:
    """A slope that is no number or outside the firmware's steps is refused in one line."""
    with pytest.raises(RigError, match=r"slope .* accepted: 0.00015 to 0.627 Nm/s"):
        rig.ramp_step(slope)


def test_stop_overtakes_a_command_under_way(client: RigClient, emulated: EmulatedRig) -> None:
    """A command under way is given up after a stop, so that its repetition does not undo the stop."""
    port = client.port
    write = port.write
    sent = []

    def stop_first(data: bytes) -> None:
        sent.append(data)
        write(data)

    port.write = stop_first  # type: ignore[method-assign]
    client.urgent_stop()
    with pytest.raises(RigRefusedError, match="overtaken by a stop"):
        client.arm()
    assert len(sent) == 1
    assert not emulated.board.stage_on


class Bench:
    """A link on a rig behind a pseudo-terminal, on threads."""

    def __init__(self, rig: Rig, link: Path) -> None:
        self.rig = rig
        self.path = link
        self.troubles: list[str] = []
        self.samples = 0
        self.plug()
        self.link = RigLink(lambda: SerialPort(str(link), rig.baud), rig, self._count, self.troubles.append)
        self._alive = threading.Event()
        self._threads = [threading.Thread(target=self.link.run), threading.Thread(target=self._live)]
        for thread in self._threads:
            thread.start()
        wait_for(lambda: self.link.connected and self.link.last is not None)

    def _count(self, _: object) -> None:
        self.samples += 1

    def _live(self) -> None:
        while not self._alive.wait(0.01):
            self.link.alive()

    def plug(self) -> None:
        """Plug a rig in."""
        self.pty = PtyRig(EmulatedRig(self.rig, 1), self.path)

    @property
    def state(self) -> State | None:
        """Return the rig's state as last reported."""
        report = self.link.last
        return None if report is None else report.state

    def arm(self) -> None:
        """Arm the rig and wait until it says so; a rig whose thread waits for a processor is asked again."""
        end = time.monotonic() + 20.0
        while True:
            try:
                self.link.submit(RigClient.arm).result(10.0)
                break
            except RigLostError:
                assert time.monotonic() < end, "the rig never answered"
        wait_for(lambda: self.state == State.ARMED)

    def close(self) -> None:
        """End everything."""
        self.link.close()
        self._alive.set()
        for thread in self._threads:
            thread.join(10.0)
        self.pty.close()


@pytest.fixture
def bench(rig: Rig, tmp_path: Path) -> Iterator[Bench]:
    """Return a link that is connected."""
    made = Bench(rig, tmp_path / "rig")
    try:
        yield made
    finally:
        made.close()


def test_unplugging_is_survived_and_needs_arming(bench: Bench) -> None:
    """A cable pulled and plugged in again: one report, a new connection, and a disarmed rig."""
    bench.arm()
    bench.pty.close()
    wait_for(lambda: not bench.link.connected)
    with pytest.raises(RigLostError):
        bench.link.submit(RigClient.arm).result(1.0)
    time.sleep(1.0)  # several attempts to open what is not there
    lost = len(bench.troubles)
    bench.plug()
    wait_for(lambda: bench.link.connected and bench.state is not None)
    assert bench.state == State.DISARMED
    assert lost <= 2  # lost, and then: cannot be opened
    bench.arm()


def test_garbage_disarms_once_and_is_survived(bench: Bench) -> None:
    """Noise from the rig's side disarms the rig, is reported once, and the link goes on."""
    bench.arm()
    for _ in range(40):
        os.write(bench.pty._master, bytes(range(1, 40)) + b"\0")
        time.sleep(0.005)
    wait_for(lambda: bench.state != State.ARMED)
    assert sum("garbage" in text for text in bench.troubles) == 1
    heard = bench.samples
    wait_for(lambda: bench.samples > heard + 20)
    if bench.state == State.FAULT:
        bench.link.submit(RigClient.clear).result(10.0)
    bench.arm()


def test_reset_is_reported_once_and_needs_arming(bench: Bench) -> None:
    """A rig that restarts by itself is greeted again, reported once, and stays disarmed."""
    bench.arm()
    board = bench.pty.emulated.board
    assert isinstance(board, NativeBoard)
    with bench.pty._lock:
        board.reset(ResetCause.WATCHDOG)
    wait_for(lambda: any("restarted" in text for text in bench.troubles))
    wait_for(lambda: bench.link.connected and bench.state == State.DISARMED)
    assert sum("restarted" in text for text in bench.troubles) == 1
    bench.arm()


def test_second_opener_is_turned_away(bench: Bench) -> None:
    """A second program gets one clear line, and the first keeps its rig."""
    bench.arm()
    with pytest.raises(RigLostError, match="another program has it open"):
        SerialPort(str(bench.path), bench.rig.baud)
    heard = bench.samples
    wait_for(lambda: bench.samples > heard + 10)
    assert not any("another program" in text for text in bench.troubles)
    assert bench.state == State.ARMED or bench.troubles  # a machine that stands still for 0.5 s costs the arming


@pytest.fixture
def load() -> Iterator[None]:
    """Keep twice as many processes busy as there are processors."""
    count = 2 * (os.cpu_count() or 1)
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


@pytest.mark.usefixtures("load")
def test_stop_reaches_the_rig_within_100_ms_of_its_time(bench: Bench) -> None:
    """On a loaded machine, with commands under way, each of ten stops takes the stage off within 100 ms of the rig."""
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
        busy = bench.link.submit(lambda client: client.torque(30))
        asked_at = emulated.time
        bench.link.stop_rig()
        wait_for(lambda: not emulated.board.stage_on)
        assert off_at[0] - asked_at < 0.1
        busy.exception(10.0)
        wait_for(lambda: bench.state == State.DISARMED)


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
        got = b""
        with contextlib.suppress(BlockingIOError):
            while True:
                got += os.read(master, 4096)
        assert len(got) < written
        assert [frame.type for frame in FrameDecoder().feed(got)] == [Command.STOP, Command.STOP]
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
    client.torque(60)
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
    client.permitted = client.stops
    for _ in range(300):
        client.clear()
        assert client.last.report.ack_sequence not in STOP_SEQUENCES


def test_job_is_not_run_after_a_reset_or_once_given_up(bench: Bench) -> None:
    """An arming that waits while the rig restarts, or that its caller has given up, is never carried out."""
    hold = threading.Event()
    blocking = bench.link.submit(lambda _: hold.wait(10.0) and None)
    given_up = bench.link.submit(RigClient.arm)
    late = bench.link.submit(RigClient.arm)
    assert given_up.cancel()
    board = bench.pty.emulated.board
    assert isinstance(board, NativeBoard)
    with bench.pty._lock:
        board.reset(ResetCause.WATCHDOG)
    wait_for(lambda: bench.pty.emulated.time > 0.1)
    hold.set()
    blocking.exception(10.0)
    wait_for(lambda: any("restarted" in text for text in bench.troubles))
    wait_for(lambda: bench.link.connected and bench.state == State.DISARMED)
    first = late.exception(10.0)
    if first is None:  # it was the job under way when the reset was noticed
        pytest.fail("armed after a reset")
    assert isinstance(first, RigLostError | RigResetError | RigRefusedError)
    assert not board.stage_on


def test_program_that_steals_bytes_is_survived_and_needs_arming(bench: Bench) -> None:
    """A reader that does not heed the lock costs the arming, is reported, and the link goes on when it has left."""
    bench.arm()
    thief = os.open(bench.path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        end = time.monotonic() + 20.0
        while not bench.troubles and time.monotonic() < end:
            with contextlib.suppress(BlockingIOError):
                os.read(thief, 8)
    finally:
        os.close(thief)
    assert bench.troubles
    wait_for(lambda: bench.link.connected and bench.state in {State.DISARMED, State.FAULT})
    assert len(bench.troubles) <= 3  # garbage, or silence and the watchdog's fault
    if bench.state == State.FAULT:
        bench.link.submit(RigClient.clear).result(10.0)
    bench.arm()


def test_dead_owner_loses_the_torque(bench: Bench) -> None:
    """When the owner of the link hangs, the heartbeats end and the firmware switches the rig off."""
    bench.arm()
    bench._alive.set()
    wait_for(lambda: bench.state == State.FAULT)
    assert not bench.pty.emulated.board.stage_on
    assert sum("silent" in text for text in bench.troubles) == 1
