"""The run of `friction_presliding`, apart from its options: they are checked first, as the import takes seconds."""

from __future__ import annotations

import argparse
import contextlib
import sys
from pathlib import Path

from tqdm import tqdm

from friction_bench.experiment.ramp import wait_for_rest
from friction_bench.experiment.session import Session, check_port, check_ranges, measuring, origin_of
from friction_bench.presliding.campaign import Campaign, Run
from friction_bench.presliding.evaluation import PreslidingResult, evaluate
from friction_bench.presliding.follow import follow
from friction_bench.presliding.kinds import KINDS, USUAL_BLOCKS, USUAL_CYCLES
from friction_bench.presliding.planning import CampaignPlan, runs
from friction_bench.presliding.report import result_text, write_estimates, write_html
from friction_bench.presliding.trace import trace_of, write_trace
from friction_bench.rig.client import Sample
from friction_bench.rig.rig_file import Rig, load_rig
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
    campaign = Campaign(origin=origin_of(options))
    try:
        _measure(options, rig, plan, out, campaign)
    except (KeyboardInterrupt, Rx90Error):
        if campaign.traces:
            print("evaluating what has been measured; Ctrl-C leaves that out", file=sys.stderr)
            with contextlib.suppress(Rx90Error):  # the first reason is the one to tell
                _evaluate(campaign, rig, out)
        raise
    result = _evaluate(campaign, rig, out)
    undecided = "loops" in plan.kinds and (result.choice is None or result.choice.law is None)
    return VERDICT_NO if undecided or result.failures else DONE


def _evaluate(campaign: Campaign, rig: Rig, out: Path) -> PreslidingResult:
    """Evaluate what was measured, write the report and print the results."""
    with tqdm(total=campaign.fits, desc="laws", disable=None, leave=False) as bar:
        result = evaluate(campaign, rig, bar.update)
    print(result_text(result))  # first: a disk that is full takes no report
    write_html(out / "report.html", result, rig)
    write_estimates(out / "estimates.yaml", result, rig)
    print(one_line(f"report: {out / 'report.html'}"))
    return result


def _plan(options: argparse.Namespace, rig: Rig) -> CampaignPlan:
    """Refuse now what would otherwise be noticed after minutes."""
    check_ranges(
        options, (("seed", 0, 2**31 - 1), ("blocks", 6, 100), ("cycles", 100, 100_000), ("baud", 1200, 1_000_000))
    )
    if not rig.counts_down:
        raise ConfigError(
            f"{rig.file}: counts_down is false, and its encoder counts up in both directions; accepted: a rig whose "
            "counts go down when the motor turns back, such as rig/presliding.yaml"
        )
    kinds = tuple(kind for kind in KINDS if kind in (options.kinds or KINDS))
    for name, kind in (("blocks", "loops"), ("cycles", "drift")):
        value = getattr(options, name)
        if value is not None and kind not in kinds:
            raise ConfigError(f"--{name} {value} without {kind}; accepted: with --kinds {kind}, or without --kinds")
    check_port(options)
    return CampaignPlan(rig, kinds, options.blocks or USUAL_BLOCKS, options.cycles or USUAL_CYCLES)


def _measure(options: argparse.Namespace, rig: Rig, plan: CampaignPlan, out: Path, campaign: Campaign) -> None:
    with measuring(options, rig, out, plan.duration(), "rig") as session:
        session.couple(True, session.client)
        _run_all(session, plan, campaign, out)


def _run_all(session: Session, plan: CampaignPlan, campaign: Campaign, out: Path) -> None:
    """Run what is planned; a later experiment is planned by what earlier ones showed."""
    client, bar = session.client, session.bar
    assert client.hello is not None  # it has been greeted
    try:
        for what in runs(plan, campaign, client.hello.torque_limit_code):
            bar.total = round(bar.n + plan.left(campaign), 1)
            bar.set_postfix_str(what.label, refresh=False)
            wait_for_rest(client)
            _run_one(session, what, campaign, out)
    except IdentificationError as error:  # what was measured before stands, and is evaluated
        bar.write(f"{error}; no more experiments", sys.stderr)
        campaign.failures.append(str(error))


def _run_one(session: Session, what: Run, campaign: Campaign, out: Path) -> None:
    """Run an experiment; its readings stand as a CSV file, however it ends.

    One that is cut short counts where it is a drift, whose cycles so far are as good as those that are missing.
    """
    client = session.client
    samples: list[Sample] = []

    def keep(sample: Sample) -> None:
        samples.append(sample)
        session.keep(sample)

    name = f"{len(campaign.traces) + 1:03d}_{what.label.split(',')[0].replace(' ', '_')}"
    try:
        trace = follow(client, what.law, what.label, keep)
    except (KeyboardInterrupt, Rx90Error):
        if len(samples) > 1:
            with interrupts_later(), contextlib.suppress(Rx90Error):  # the first reason is the one to tell
                unfinished = trace_of(f"{what.label}, unfinished", samples, client.rig)
                if what.kind == "drift":
                    campaign.add(what, unfinished)
                write_trace(unfinished, out / f"{name}_unfinished.csv")
        raise
    campaign.add(what, trace)
    write_trace(trace, out / f"{name}.csv")
