"""The run of `friction_presliding`, apart from its options: they are checked first, as the import takes seconds."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from friction_bench.experiment.job import BAR, new_measurement, open_rig
from friction_bench.experiment.ramp import Readings, wait_for_rest
from friction_bench.presliding.campaign import Campaign
from friction_bench.presliding.evaluation import evaluate
from friction_bench.presliding.follow import follow
from friction_bench.presliding.kinds import KINDS
from friction_bench.presliding.planning import CampaignPlan, runs
from friction_bench.presliding.report import result_text, write_estimates, write_html
from friction_bench.presliding.trace import Trace, write_trace
from friction_bench.rig.client import RigClient, Sample
from friction_bench.rig.rig_file import Rig, load_rig
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.errors import DONE, VERDICT_NO, ConfigError, IdentificationError, Rx90Error
from rx90_common.base.quoting import one_line
from rx90_common.base.share import resolve_config
from rx90_common.process.interrupts import interrupts_later


def run(options: argparse.Namespace) -> int:
    """Run the experiments on a rig, evaluate them and write the report.

    Returns:
        The exit code: 1 where no law of friction could be chosen though loops were run.

    Raises:
        Rx90Error: for what is refused; what has been measured until then stands in the folder.
    """
    rig = load_rig(resolve_config(options.rig))
    plan = _plan(options, rig)
    out: Path = options.output
    campaign = _measure(options, rig, plan, out)
    with tqdm(total=campaign.fits, desc="laws", disable=None, leave=False) as bar:
        result = evaluate(campaign, rig, bar.update)
    write_html(out / "report.html", result, rig)
    write_estimates(out / "estimates.yaml", result, rig)
    print(result_text(result))
    print(one_line(f"report: {out / 'report.html'}"))
    undecided = "loops" in plan.kinds and (result.choice is None or result.choice.law is None)
    return VERDICT_NO if undecided or result.failures else DONE


def _plan(options: argparse.Namespace, rig: Rig) -> CampaignPlan:
    """Refuse now what would otherwise be noticed after minutes."""
    for name, low, high in (
        ("seed", 0, 2**31 - 1), ("blocks", 6, 100), ("cycles", 100, 1_000_000), ("baud", 1200, 1_000_000)
    ):  # fmt: skip
        value = getattr(options, name)
        if value is not None and not low <= value <= high:
            raise ConfigError(f"--{name} is {value}; accepted: {low} to {high}")
    if not rig.counts_down:
        raise ConfigError(
            f"{rig.file}: counts_down is false, and its encoder counts up in both directions; accepted: a rig whose "
            "counts go down when the motor turns back, such as rig/presliding.yaml"
        )
    kinds = tuple(kind for kind in KINDS if kind in (options.kinds or KINDS))
    return CampaignPlan(rig, kinds, options.blocks, options.cycles)


@dataclass
class _Kept:
    """What a measurement leaves in its folder."""

    out: Path
    readings: Readings
    traces: int = 0
    bar: Any = None

    def keep(self, sample: Sample) -> None:
        self.readings.samples.append(sample)
        self.bar.update(self.readings.rig.tick)

    def write(self, trace: Trace) -> None:
        self.traces += 1
        write_trace(trace, self.out / f"{self.traces:03d}_{trace.label.split(',')[0].replace(' ', '_')}.csv")


def _measure(options: argparse.Namespace, rig: Rig, plan: CampaignPlan, out: Path) -> Campaign:
    new_measurement(out)
    try:
        port, couple, close = open_rig(options, rig)
    except Rx90Error:
        out.rmdir()  # nothing was measured, and the next try may take the same name
        raise
    kept = _Kept(out, Readings(rig))
    campaign = Campaign(origin="emulated rig" if options.port == "emulated" else f"rig at {options.port}")
    try:
        with tqdm(total=round(plan.duration(), 1), unit="s", desc="rig", disable=None, bar_format=BAR) as kept.bar:
            client = RigClient(port, rig)
            client.connect()
            if options.clear:
                client.clear()
            couple(True, client)
            _run_all(client, plan, campaign, kept)
    finally:
        with interrupts_later():  # a second Ctrl-C does not cost the readings
            port.close()
            close()
            if kept.readings.samples:
                write_joint_states(out / "bag", kept.readings.series())
            elif not kept.traces:
                out.rmdir()
    return campaign


def _run_all(client: RigClient, plan: CampaignPlan, campaign: Campaign, kept: _Kept) -> None:
    """Run what is planned; a later experiment is planned by what earlier ones showed."""
    assert client.hello is not None  # it has been greeted
    try:
        for what in runs(plan, campaign, client.hello.torque_limit_code):
            kept.bar.total = round(kept.bar.n + plan.left(campaign), 1)
            kept.bar.set_postfix_str(what.label, refresh=False)
            wait_for_rest(client)
            trace = follow(client, what.law, what.label, kept.keep)
            campaign.add(what, trace)
            kept.write(trace)
    except IdentificationError as error:  # what was measured before stands, and is evaluated
        kept.bar.write(f"{error}; no more experiments", sys.stderr)
        campaign.failures.append(str(error))
