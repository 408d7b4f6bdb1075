"""The host's side of the protocol in virtual time: roll-overs, lost reports, resets, silence, refusals."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from friction_bench.experiment.asymptote import fit_asymptote
from friction_bench.experiment.job import run_ramp
from friction_bench.rig.client import COMMAND_TIMEOUT, RigClient, unwrap
from friction_bench.rig.emulated import EmulatedRig, NativeBoard, VirtualPort
from friction_bench.rig.messages import (
    Command,
    Fault,
    ResetCause,
    RigError,
    RigFaultError,
    RigLostError,
    RigResetError,
)
from friction_bench.rig.rig_file import Rig


@pytest.mark.parametrize("bits", [16, 24])
def test_counters_unwrap_across_roll_overs(bits: int) -> None:
    """A cumulative counter comes out of any roll-over, forwards and backwards, with readings missing."""
    values = [0, 1000, (1 << bits) - 5, (1 << bits) + 7, (1 << bits) + 3, 3 * (1 << bits) // 2]
    assert unwrap(values[2], None, bits) == values[2]
    for last, value in pairwise(values[2:]):
        assert unwrap(value % (1 << bits), last, bits) == value


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


def test_reports_behind_an_answer_are_not_lost(client: RigClient, emulated: EmulatedRig) -> None:
    """Reports that a late program reads in one go with the answer to its command are readings like all others."""
    read = client.port.read

    def late(timeout: float) -> bytes:
        emulated.advance(0.1)
        return read(timeout)

    client.port.read = late  # type: ignore[method-assign]
    client.clear()
    client.port.read = read  # type: ignore[method-assign]
    while not client.pump():
        pass
    assert client.last is not None
    assert client.last.tick > 5
    assert client.lost_reports == 0


def test_host_that_stood_still_does_not_take_the_rig_for_lost(client: RigClient) -> None:
    """Time in which the program did not run is not a rig's silence, neither between commands nor within one."""
    port = client.port
    now, read, stood_still = port.now, port.read, 0.0
    port.now = lambda: now() + stood_still  # type: ignore[method-assign]

    def late(_: float) -> bytes:
        nonlocal stood_still
        stood_still += 2 * COMMAND_TIMEOUT
        port.read = read  # type: ignore[method-assign]
        return b""

    port.read = late  # type: ignore[method-assign]
    client.pump()
    port.read = late  # type: ignore[method-assign]
    client.clear()
    assert stood_still == 4 * COMMAND_TIMEOUT


def test_host_that_stops_beating_loses_the_torque(client: RigClient, emulated: EmulatedRig) -> None:
    """Without heartbeats the firmware trips, and the ramp ends with that fault's words."""
    client.arm()
    client.request(Command.TORQUE, 60)
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
