"""What `rx90_experiment --excitation` does, apart from its options: imported once these are understood."""

from __future__ import annotations

import sys

from tqdm import tqdm

from rx90_emulator.identification.experiments.excitation.design import ExcitationPlan, plan_excitation
from rx90_emulator.identification.experiments.excitation.options import ExcitationOptions
from rx90_emulator.identification.experiments.excitation.table import describe_excitation
from rx90_emulator.loop.setup import Setup

__all__ = ["describe_excitation", "plan_with_progress"]

_BAR = "{desc:<16}{bar}| {n_fmt}/{total_fmt} steps [{elapsed}<{remaining}]"


def plan_with_progress(setup: Setup, options: ExcitationOptions) -> ExcitationPlan:
    """Plan with a progress bar.

    Raises:
        Rx90Error: as `plan_excitation`.
    """
    total = (options.runs + options.validation) * options.steps
    names: list[str] = []
    with tqdm(total=total, bar_format=_BAR, file=sys.stderr) as bar:

        def step(name: str) -> None:
            if name not in names:  # the search before may have needed fewer steps
                names.append(name)
                bar.set_description_str(name, refresh=False)
                bar.update((len(names) - 1) * options.steps - bar.n)
            bar.update()

        plan = plan_excitation(setup, options, step)
        bar.update(total - bar.n)
    return plan
