"""Experiments that have been run, with their readings."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from friction_bench.presliding.break_away import break_away_code
from friction_bench.presliding.choice import fits
from friction_bench.presliding.follow import Law
from friction_bench.presliding.trace import Trace
from rx90_common.base.errors import IdentificationError


@dataclass(frozen=True)
class Run:
    """One experiment to run.

    Attributes:
        kind: ramps, or one of KINDS.
        label: in messages, files and plots.
        law: of the torque.
        rate: of a ramp in codes a tick, of a pull its speed in rad/s.
        stiffness: of a pull, Nm/rad.
        wanted: speeds of a sweep, counts per tick.
    """

    kind: str
    label: str
    law: Law
    rate: float = 0.0
    stiffness: float = 0.0
    wanted: tuple[float, ...] = ()


@dataclass
class Campaign:
    """Experiments that have been run, with their readings, in order; failures in words."""

    runs: list[Run] = field(default_factory=list)
    traces: list[Trace] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    origin: str = ""

    def add(self, run: Run, trace: Trace) -> None:
        """Keep the readings of an experiment."""
        self.runs.append(run)
        self.traces.append(trace)

    def of(self, kind: str) -> list[tuple[Run, Trace]]:
        """Return the experiments of a kind."""
        return [(run, trace) for run, trace in zip(self.runs, self.traces, strict=True) if run.kind == kind]

    @property
    def seconds(self) -> float:
        """Return how long they took, s."""
        return float(sum(trace.time[-1] for trace in self.traces))

    @property
    def fits(self) -> int:
        """Return how many fits the choice of a law takes."""
        return fits() if self.of("loops") and self.of("sweep") else 0

    def break_away_code(self, slid: float) -> float:
        """Return the code at which the joint breaks away on the slowest of the ramps on which it does.

        Raises:
            IdentificationError: if there are none.
        """
        ramps = [(run, trace) for run, trace in self.of("ramps") if trace.counts.max() >= slid]
        if not ramps:
            raise IdentificationError("the joint breaks away on no ramp")
        slowest = min(run.rate for run, _ in ramps)
        return float(np.median([break_away_code(trace, slid) for run, trace in ramps if run.rate == slowest]))
