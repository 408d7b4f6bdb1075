"""The line to a rig: lost reports, roll-overs, resets, unplugging, garbage, a second opener, stops."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from friction_bench.asymptote import fit_asymptote
from friction_bench.client import RigClient, Unwrapper
from friction_bench.emulated import EmulatedRig, VirtualPort
from friction_bench.errors import RigError, RigFaultError, RigLostError, RigRefusedError, RigResetError
from friction_bench.link import RigLink
from friction_bench.messages import Fault, ResetCause, State
from friction_bench.native import NativeBoard
from friction_bench.pty_rig import PtyRig
from friction_bench.ramp import run_ramp
from friction_bench.rig import Rig
from friction_bench.serial_port import SerialPort


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
        """Arm the rig and wait until it says so."""
        self.link.submit(RigClient.arm).result(10.0)
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
    assert bench.state == State.ARMED


def test_stop_reaches_the_rig_within_100_ms(bench: Bench) -> None:
    """From any state of the link a stop's bytes leave at once: the fastest of five takes below 100 ms."""
    taken = []
    for _ in range(5):
        bench.arm()
        busy = bench.link.submit(lambda client: client.torque(30))
        start = time.monotonic()
        bench.link.stop_rig()
        wait_for(lambda: not bench.pty.emulated.board.stage_on)
        taken.append(time.monotonic() - start)
        busy.exception(10.0)
        wait_for(lambda: bench.state == State.DISARMED)
    assert min(taken) < 0.1


def test_dead_owner_loses_the_torque(bench: Bench) -> None:
    """When the owner of the link hangs, the heartbeats end and the firmware switches the rig off."""
    bench.arm()
    bench._alive.set()
    wait_for(lambda: bench.state == State.FAULT)
    assert not bench.pty.emulated.board.stage_on
    assert sum("silent" in text for text in bench.troubles) == 1
