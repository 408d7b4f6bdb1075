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
    State,
)
from friction_bench.rig.rig_file import CODES, load_rig
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
    lost = client.lost_reports
    bad = client.bad_frames
    samples: list[Sample] = []
    while len(samples) < LISTENED_TICKS:
        samples += client.pump()
    report = samples[-1].report
    refused = (report.bad_frames - samples[0].report.bad_frames) % 256
    counts = [sample.counts for sample in samples]
    return [
        _at_most("lost reports", 0, client.lost_reports - lost),
        _at_most("damaged frames", 0, client.bad_frames - bad + refused),
        _equal("state", State.DISARMED.name, report.state.name),
        _equal("stage and DAC code, disarmed", "off, 0", _stage_and_code(client)),
        _at_most(
            "ADC code, disarmed",
            HIGHEST_IDLE_ADC,
            sum(sample.report.adc for sample in samples) / len(samples),
        ),
        _at_most("encoder counts of a shaft at rest", 1, max(counts) - min(counts)),
    ]


def _stage_and_code(client: RigClient) -> str:
    """Return the stage and the DAC code that the rig reported last."""
    assert client.last is not None
    report = client.last.report
    return f"{'on' if report.stage_on else 'off'}, {report.dac}"


def _torque(client: RigClient) -> list[Check]:
    """Check that the rig obeys a small code and STOP, and refuses codes above its limit."""
    above = client.greeting.torque_limit_code + 1
    with armed(client):
        checks = [_refused(client, Command.RAMP, 1, above)]
        client.request(Command.TORQUE, SMALL_CODE)
        checks.append(
            _equal("stage and DAC code after TORQUE", f"on, {SMALL_CODE}", _stage_and_code(client))
        )
        checks += [_refused(client, Command.TORQUE, above), _refused(client, Command.TORQUE, CODES)]
        client.request(Command.STOP)
        checks.append(_equal("stage and DAC code after STOP", "off, 0", _stage_and_code(client)))
    return checks


def _refused(client: RigClient, command: Command, *values: int) -> Check:
    """Check that a command is refused; the rig is stopped if it is not."""
    try:
        client.request(command, *values)
    except RigRefusedError:
        return _equal(f"{command.name} code {values[-1]}", "refused", "refused")
    raise RigError(f"{command.name} code {values[-1]} was obeyed")  # `armed` stops the rig


def _watchdog(client: RigClient) -> list[Check]:
    """Check that the torque goes off when the host falls silent, within the greeting's time and a tick.

    The last frame arrived within the tick before the first report that answers it.
    """
    name = "ticks to torque off, without a host"
    ticks = client.greeting.watchdog_ticks
    with armed(client):
        client.request(Command.TORQUE, SMALL_CODE)
        assert client.last is not None
        before = client.last.report.ack_sequence
        end = client.last.tick + 3 * ticks
        answered: int | None = None
        client.beating = False
        try:
            client.send_torque(SMALL_CODE)
            while client.last.tick < end:
                for sample in client.pump():
                    if answered is None and sample.report.ack_sequence != before:
                        answered = sample.tick
                    if (
                        Fault.WATCHDOG in sample.report.fault
                        and sample.report.dac == 0
                        and answered is not None
                    ):
                        took = sample.tick - answered + 1
                        # a report may be lost
                        return [Check(name, f"{ticks} ± 1", str(took), abs(took - ticks) <= 1)]
        finally:
            client.beating = True
        client.request(Command.STOP)
    return [Check(name, f"{ticks} ± 1", f"more than {3 * ticks}", False)]


def self_test(client: RigClient) -> list[Check]:
    """Test a rig, which is disarmed afterwards, with no fault latched.

    Raises:
        RigLostError: if the rig does not answer.
    """
    checks: list[Check] = []
    for name, test in (("idle", _idle), ("torque", _torque), ("watchdog", _watchdog)):
        try:
            client.connect()
            client.clear()
            if not checks:
                # A greeting with other figures than the rig file's is refused by `connect`.
                checks.append(
                    Check(
                        "figures of the firmware", client.rig.file.name, client.greeting.text, True
                    )
                )
            checks += test(client)
        except RigLostError:
            raise
        except RigError as error:
            checks.append(Check(name, "no error", str(error), False))
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
