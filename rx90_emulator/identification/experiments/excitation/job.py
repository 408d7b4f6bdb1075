"""What `rx90_experiment --excitation` does, apart from its options: imported once these are understood."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from typing import Any

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
    with ExitStack() as shown:
        bars: list[tqdm[Any]] = []

        def step(name: str) -> None:
            if not bars:  # only now: what is refused before the first step needs no bar
                bars.append(shown.enter_context(tqdm(total=total, bar_format=_BAR, disable=None, file=sys.stderr)))
            if name not in names:  # the search before may have needed fewer steps
                names.append(name)
                bars[0].set_description_str(name, refresh=False)
                bars[0].update((len(names) - 1) * options.steps - bars[0].n)
            bars[0].update()

        return plan_excitation(setup, options, step)
