"""Let the rig follow torques that a law gives tick by tick, with the protocol's TORQUE command.

The host answers each report at once. A code that it sends reaches the DAC some 15 ms after the reading that it answers
(the report's 9 ms on the line at 19200 baud, the command's 4 ms, the firmware's loop), so it holds from there on: a
delay of less than a tick, and the next report says what is on the DAC.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TypeAlias

from friction_bench.experiment.session import armed, last_near_limits, refuse_fault
from friction_bench.presliding.trace import Trace, trace_of
from friction_bench.protocol.messages import Command, CommandResult, RigError, RigRefusedError, State, torque_payload
from friction_bench.rig.client import RigClient, Sample

Law: TypeAlias = Generator[int, Sample, None]
"""Yields the code to put on the DAC, and is sent the reading that follows."""


def follow(client: RigClient, law: Law, label: str, on_sample: Callable[[Sample], None] = lambda _: None) -> Trace:
    """Arm the rig, follow the law to its end, switch the rig off and return the readings.

    A motion that comes near the limits of travel or speed is ended there. The rig is stopped when this raises.

    Raises:
        RigError: refused, faulted, lost or reset.
    """
    with armed(client):
        samples = _followed(client, law, on_sample)
        client.request(Command.STOP)
    return trace_of(label, samples, client.rig)


def _followed(client: RigClient, law: Law, on_sample: Callable[[Sample], None]) -> list[Sample]:
    line = client.line
    samples: list[Sample] = []
    code = next(law)
    while True:
        # Not `client.torque`, which waits for the answer, a tick or two: the next report tells what is on the DAC.
        sent = line.number(Command.TORQUE, torque_payload(code))
        line.send_unless_stopped(sent, Command.TORQUE)
        came: list[Sample] = []
        while not came:
            came = client.pump()
        for sample in came:
            refuse_fault(sample)
            if sample.report.result != CommandResult.OK:
                raise RigRefusedError(f"TORQUE: {sample.report.result_text}")
            if sample.report.state != State.ARMED:
                raise RigError("the experiment was stopped before its end")
            samples.append(sample)
            on_sample(sample)
            try:
                code = law.send(sample)
            except StopIteration:
                return samples
        if last_near_limits(client.rig, samples):
            return samples
