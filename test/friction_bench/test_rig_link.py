"""The line to a rig on a pseudo-terminal: unplugging, garbage, resets, a second opener, a dead owner."""

import math
import threading
import time

import pytest
from processes import TIMEOUT, wait_until
from rig_bench import Bench

from friction_bench.rig import link
from friction_bench.rig.client import RigClient
from friction_bench.rig.messages import Command, RigLostError, RigRefusedError, RigResetError, State
from friction_bench.rig.serial_port import SerialPort


def test_unplugging_is_survived_and_needs_arming(bench: Bench) -> None:
    """A cable pulled and plugged in again: one report, a new connection, and a disarmed rig."""
    bench.arm()
    bench.pty.close()
    wait_until(lambda: not bench.link.connected, "the loss")
    with pytest.raises(RigLostError):
        bench.link.submit(RigClient.arm).result(1.0)
    time.sleep(1.0)  # several attempts to open what is not there
    lost = len(bench.troubles)
    bench.plug()
    wait_until(lambda: bench.link.connected and bench.state is not None, "the new connection")
    assert bench.state == State.DISARMED
    assert lost <= 2  # lost, and then: cannot be opened
    bench.arm()


def test_garbage_disarms_once_and_is_survived(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise from the rig's side disarms the rig, is reported once, and the link goes on."""
    monkeypatch.setattr(link, "CALM", math.inf)  # trouble after a pause, which a busy machine may make, is the same
    bench.arm()
    client = bench.link.client
    for _ in range(40):
        bench.say(bytes(range(1, 40)) + b"\0")
        time.sleep(0.005)
    wait_until(lambda: bench.state != State.ARMED, "the torque to go")

    def heard_no_more() -> bool:
        before = client.bad_frames
        bench.listen(3)
        return client.bad_frames == before

    wait_until(heard_no_more, "the end of the noise")
    assert len(bench.troubles) == 1
    assert client.stops == 1  # repeated until it is answered, not piled up
    bench.arm()  # what disarmed the rig does not do so again
    bench.listen(10)
    assert bench.state == State.ARMED


def test_second_opener_is_turned_away(bench: Bench) -> None:
    """A second program gets one clear line, and the first keeps its rig."""
    bench.arm()
    with pytest.raises(RigLostError, match="another program has it open"):
        SerialPort(str(bench.path), bench.rig.baud)
    bench.listen(10)
    assert bench.troubles == []
    assert bench.state == State.ARMED


def test_job_is_not_run_after_a_reset_or_once_given_up(bench: Bench) -> None:
    """An arming that waits while the rig restarts, or that its caller has given up, is never carried out."""
    hold = threading.Event()
    blocking = bench.link.submit(lambda _: hold.wait(10.0) and None)
    given_up = bench.link.submit(RigClient.arm)
    late = bench.link.submit(RigClient.arm)
    assert given_up.cancel()
    bench.reset()
    wait_until(lambda: bench.pty.emulated.time > 0.1, "the rig's time")
    hold.set()
    blocking.exception(10.0)
    wait_until(lambda: any("restarted" in text for text in bench.troubles), "the report")
    wait_until(lambda: bench.link.connected and bench.state == State.DISARMED, "the greeting")
    first = late.exception(10.0)
    if first is None:  # it was the job under way when the reset was noticed
        pytest.fail("armed after a reset")
    assert isinstance(first, RigLostError | RigResetError | RigRefusedError)
    assert not bench.board.stage_on


def test_dead_owner_loses_the_torque(bench: Bench) -> None:
    """When the owner of the link hangs, the heartbeats end and the firmware switches the rig off."""
    bench.arm()
    bench.abandon()
    wait_until(lambda: bench.state == State.FAULT, "the watchdog")
    assert not bench.board.stage_on
    assert sum("silent" in text for text in bench.troubles) == 1


def test_stop_reaches_the_rig_within_100_ms_of_its_time(bench: Bench) -> None:
    """With commands under way, each of ten stops takes the stage off within 100 ms of the rig."""
    emulated = bench.pty.emulated
    run, off_at = emulated.board.run, [0.0]

    def watched(*arguments: int) -> None:
        on = emulated.board.stage_on
        run(*arguments)
        if on and not emulated.board.stage_on:
            off_at[0] = emulated.time

    emulated.board.run = watched
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
