"""The self-test of a rig: what can be checked without a person and without a motion, as a table.

Stage and DAC are seen by the rig's own reports; what takes a meter or a hand is in docs/howto/rig_build.md. The only
torque is one DAC code, which turns no shaft. A rig that obeys a torque above its limit is stopped at once.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import NamedTuple

from friction_bench.experiment.session import EMULATED, armed, check_line
from friction_bench.rig.client import Port, RigClient, Sample
from friction_bench.rig.emulated import EmulatedRig, VirtualPort
from friction_bench.rig.messages import (
    Command,
    CommandResult,
    Fault,
    RigError,
    RigLostError,
    RigRefusedError,
    State,
)
from friction_bench.rig.rig_file import CODES, load_rig
from friction_bench.rig.serial_port import SerialPort
from rx90_common.base.errors import DONE, VERDICT_NO
from rx90_common.base.quoting import one_line
from rx90_common.base.share import resolve_config

LISTENED_TICKS = 50
HIGHEST_IDLE_ADC = 2.0
"""Mean ADC code of a stage that is off: quantisation and offset."""
SMALL_CODE = 1


class Check(NamedTuple):
    """One line of the table."""

    name: str
    expected: str
    found: str
    good: bool


def _listen(client: RigClient, ticks: int) -> list[Sample]:
    samples: list[Sample] = []
    while len(samples) < ticks:
        samples += client.pump()
    return samples


def _line(client: RigClient) -> list[Check]:
    """Check the line, and that the firmware accepts the limits and end torques of the rig file."""
    client.request(Command.LIMITS, *client.rig.limit_codes())
    client.end_code(client.rig.ramps.end_torque)
    client.end_code(client.rig.ramps.end_torque_loaded)
    lost_before, bad_before = client.lost_reports, client.bad_frames
    first = _listen(client, 1)[0].report.bad_frames
    last = _listen(client, LISTENED_TICKS)[-1].report.bad_frames
    lost = client.lost_reports - lost_before
    damaged = client.bad_frames - bad_before + (last - first) % 256
    return [
        Check(f"lost of {LISTENED_TICKS} reports", "0", str(lost), lost == 0),
        Check("damaged frames", "0", str(damaged), damaged == 0),
    ]


def _idle(client: RigClient) -> list[Check]:
    """Check that a disarmed rig drives nothing, and reads no current and no motion."""
    samples = _listen(client, LISTENED_TICKS)
    report = samples[-1].report
    adc = sum(sample.report.adc for sample in samples) / len(samples)
    counts = [sample.counts for sample in samples]
    moved = max(counts) - min(counts)
    return [
        Check("state", State.DISARMED.name, report.state.name, report.state == State.DISARMED),
        Check("DAC code, disarmed", "0", str(report.dac), report.dac == 0),
        Check("ADC code, disarmed", f"at most {HIGHEST_IDLE_ADC:g}", f"{adc:.2f}", adc <= HIGHEST_IDLE_ADC),
        Check("encoder counts of a shaft at rest", "at most 1", str(moved), moved <= 1),
    ]


def _stop(client: RigClient) -> list[Check]:
    """Check that the rig reports the stage on with a small code, and off after STOP."""
    with armed(client):
        client.request(Command.TORQUE, SMALL_CODE)
        after_torque = _output(client)
        client.request(Command.STOP)
        after_stop = _output(client)
    on, off = f"on, {SMALL_CODE}", "off, 0"
    return [
        Check("stage and DAC code after TORQUE", on, after_torque, after_torque == on),
        Check("stage and DAC code after STOP", off, after_stop, after_stop == off),
    ]


def _output(client: RigClient) -> str:
    """Return the stage and the DAC code that the rig reported last."""
    assert client.last is not None
    report = client.last.report
    return f"{'on' if report.stage_on else 'off'}, {report.dac}"


def _torque_limit(client: RigClient) -> list[Check]:
    """Check that codes above the limit are refused."""
    limit = client.greeting.torque_limit_code
    expected = CommandResult.RANGE.text
    checks: list[Check] = []
    tried = ((Command.TORQUE, (limit + 1,)), (Command.TORQUE, (CODES,)), (Command.RAMP, (1, limit + 1)))
    with armed(client):
        for command, values in tried:
            try:
                client.request(command, *values)
                answer = "obeyed"
            except RigRefusedError as error:
                answer = str(error).removeprefix(f"{command.name}: ")
            checks.append(Check(f"{command.name} code {values[-1]}", expected, answer, answer == expected))
            if answer == "obeyed":
                break
        client.request(Command.STOP)
    return checks


def _watchdog(client: RigClient) -> list[Check]:
    """Check that the torque goes off when the host falls silent, within the greeting's time and a tick."""
    ticks = client.greeting.watchdog_ticks
    with armed(client):
        client.request(Command.TORQUE, SMALL_CODE)
        took = _silence(client, 3 * ticks)
        if took is None:
            client.request(Command.STOP)
    found = f"on for {3 * ticks} ticks" if took is None else f"{took} ticks"
    good = took is not None and abs(took - ticks) <= 1  # a report may be lost
    return [Check("torque off after the last frame", f"{ticks} ± 1 ticks", found, good)]


def _silence(client: RigClient, most: int) -> int | None:
    """Send a last frame; return after how many ticks at most the torque is off, None if it stays on.

    The frame arrived within the tick before the first report that answers it.
    """
    assert client.last is not None
    before = client.last.report.ack_sequence
    end = client.last.tick + most
    answered: int | None = None
    client.beating = False
    try:
        client.send_torque(SMALL_CODE)
        while client.last.tick < end:
            for sample in client.pump():
                if answered is None and sample.report.ack_sequence != before:
                    answered = sample.tick
                if Fault.WATCHDOG in sample.report.fault and sample.report.dac == 0:
                    if answered is None:
                        raise RigError("the last frame was lost on the line; test again")
                    return sample.tick - answered + 1
    finally:
        client.beating = True
    return None


TESTS: dict[str, Callable[[RigClient], list[Check]]] = {
    "line": _line,
    "idle": _idle,
    "stop": _stop,
    "torque limit": _torque_limit,
    "watchdog": _watchdog,
}


def self_test(client: RigClient) -> list[Check]:
    """Test a rig, which is disarmed afterwards, with no fault latched.

    Raises:
        RigLostError: if the rig does not answer.
    """
    checks: list[Check] = []
    for name, test in TESTS.items():
        try:
            client.connect()
            client.clear()
            if not checks:
                checks.append(Check("figures of the firmware", client.rig.file.name, client.greeting.text, True))
            checks += test(client)
        except RigLostError:
            raise
        except RigError as error:
            checks.append(Check(name, "no error", str(error), False))
            if client.hello is None:
                break
    if client.hello is not None:
        client.clear()
    return checks


def run(options: argparse.Namespace) -> int:
    """Test the rig at a port, real or emulated, and print the table.

    Returns:
        The exit code: 1 if a check fails.

    Raises:
        Rx90Error: for bad options or files, or a rig that does not answer.
    """
    rig = load_rig(resolve_config(options.rig))
    port: Port
    check_line(options.port, options.baud)
    if options.port == EMULATED:
        port = VirtualPort(EmulatedRig(rig))
    else:
        port = SerialPort(options.port, options.baud or rig.baud)
    try:
        checks = self_test(RigClient(port, rig))
    finally:
        port.close()
    print(f"{'check':36}{'expected':46}found")
    for check in checks:
        print(one_line(f"{check.name:36}{check.expected:46}{check.found}: {'ok' if check.good else 'WRONG'}"))
    return DONE if all(check.good for check in checks) else VERDICT_NO
