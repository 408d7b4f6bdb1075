"""The self-test of a rig: what can be checked without a person and without a motion, as a table.

Stage and DAC are seen by the rig's own reports; what takes a meter or a hand is in docs/howto/rig_calibration.md. The
only torque is one DAC code, which turns no shaft. A rig that obeys a torque above its limit is stopped at once.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

from friction_bench.experiment.session import armed, opened
from friction_bench.rig.client import RigClient, Sample
from friction_bench.rig.messages import (
    Command,
    Fault,
    RigError,
    RigLostError,
    RigRefusedError,
)
from friction_bench.rig.rig_file import load_rig
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


def _equal(name: str, expected: str, found: str) -> Check:
    return Check(name, expected, found, found == expected)


def _at_most(name: str, most: float, found: float) -> Check:
    return Check(name, f"at most {most:g}", f"{found:.3g}", found <= most)


def _idle(client: RigClient) -> list[Check]:
    """Listen to a disarmed rig, which must drive and read nothing; it must accept the rig file's limits and torques."""
    client.request(Command.LIMITS, *client.rig.limit_codes())
    client.end_code(client.rig.ramps.end_torque)
    client.end_code(client.rig.ramps.end_torque_loaded)
    before = client.lost_reports + client.bad_frames
    samples: list[Sample] = []
    while len(samples) < LISTENED_TICKS:
        samples += client.pump()
    refused = (samples[-1].report.bad_frames - samples[0].report.bad_frames) % 256
    after = client.lost_reports + client.bad_frames
    counts = [sample.counts for sample in samples]
    adc = sum(sample.report.adc for sample in samples) / len(samples)
    return [
        _at_most("lost reports, damaged frames", 0, after - before + refused),
        _equal("state, stage and DAC code, idle", "DISARMED, off, 0", _outputs(client)),
        _at_most("ADC code, idle", HIGHEST_IDLE_ADC, adc),
        _at_most("encoder counts of a shaft at rest", 1, max(counts) - min(counts)),
    ]


def _outputs(client: RigClient) -> str:
    """Return the state, the stage and the DAC code that the rig reported last."""
    assert client.last is not None
    report = client.last.report
    return f"{report.state.name}, {'on' if report.stage_on else 'off'}, {report.dac}"


def _torque(client: RigClient) -> list[Check]:
    """Check that the rig obeys a small code and STOP, and refuses codes above its limit."""
    above = client.greeting.torque_limit_code + 1
    with armed(client):
        refused_ramp = _refused(client, Command.RAMP, 1, above)
        client.request(Command.TORQUE, SMALL_CODE)
        obeyed = _equal("the same after TORQUE", f"ARMED, on, {SMALL_CODE}", _outputs(client))
        refused_torque = _refused(client, Command.TORQUE, above)
        client.request(Command.STOP)
        stopped = _equal("the same after STOP", "DISARMED, off, 0", _outputs(client))
    return [refused_ramp, obeyed, refused_torque, stopped]


def _refused(client: RigClient, command: Command, *values: int) -> Check:
    """Check that a command is refused; the rig is stopped if it is not."""
    try:
        client.request(command, *values)
    except RigRefusedError:
        return _equal(f"{command.name} code {values[-1]}", "refused", "refused")
    raise RigError(f"{command.name} code {values[-1]} was obeyed")  # `armed` stops the rig


def _watchdog(client: RigClient) -> list[Check]:
    """Check that the torque goes off when the host falls silent, within the greeting's time and a tick.

    The last frame arrived within the tick before the report that answers it.
    """
    ticks = client.greeting.watchdog_ticks
    with armed(client):
        samples = client.request(Command.TORQUE, SMALL_CODE)
        answered = samples[-1].tick
        client.beating = False
        try:
            while not samples[-1].report.fault and samples[-1].tick < answered + 3 * ticks:
                samples += client.pump()
        finally:
            client.beating = True
        last = samples[-1]
        took = last.tick - answered + 1
        tripped = last.report.fault == Fault.WATCHDOG and last.report.dac == 0
        if not tripped:
            client.request(Command.STOP)
    return [
        Check(
            "ticks to torque off, without a host",
            f"{ticks} ± 1",
            str(took) if tripped else f"more than {3 * ticks}",
            tripped and abs(took - ticks) <= 1,  # a report may be lost
        )
    ]


def self_test(client: RigClient) -> list[Check]:
    """Test a rig, which is disarmed afterwards, with no fault latched.

    Raises:
        RigLostError: if the rig does not answer.
    """
    checks: list[Check] = []
    for test in (_idle, _torque, _watchdog):
        try:
            client.connect()  # which refuses other figures than the rig file's
            client.clear()
            checks += test(client)
        except RigLostError:
            raise
        except RigError as error:
            checks.append(Check(test.__name__[1:], "no error", str(error), False))
            if client.hello is None:
                return checks
    client.clear()
    return checks


def run(options: argparse.Namespace) -> int:
    """Test the rig at a port, real or emulated, and print the table.

    Returns:
        The exit code: 1 if a check fails.
    """
    rig = load_rig(resolve_config(options.rig))
    port, _ = opened(options.port, rig)
    try:
        checks = self_test(RigClient(port, rig))
    finally:
        port.close()
    print(f"{'check':36}{'expected':16}found")
    for check in checks:
        print(
            one_line(
                f"{check.name:36}{check.expected:16}{check.found}: {'ok' if check.good else 'WRONG'}"
            )
        )
    return DONE if all(check.good for check in checks) else VERDICT_NO
