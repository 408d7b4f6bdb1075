"""What tells the kinds of bristles apart: drift under an oscillating load, memory of inner loops, order of the step.

    python -m benchmarks.bristles [--plot FILE]

One element, three kinds. Drift: a mass under a load that oscillates below break-away (the experiment of Dupont and
others 2002). Memory: a position that makes an inner loop. Order: a mass that sticks, slips and reverses, against steps
of a hundredth. Merges the figures into out/bench.json.
"""

from __future__ import annotations

import math
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.report import PLOT, WIDTH, arguments, in_turns, merge, print_table, timed
from rx90_common.base.arrays import Array, record_type
from rx90_common.friction import FrictionElement
from rx90_common.friction.compiled_elements import (
    bristles_dtype,
    bristles_energy,
    bristles_step,
    element_arrays,
    load_elements,
)
from rx90_common.friction.parts.bristles import (
    BristlesPart,
    ElastoPlastic,
    MaxwellSlip,
    bristles_state_dtype,
    fill_bristles,
)
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import lane, load
from rx90_common.report.picture import picture
from rx90_common.report.style import COLOURS, GREY

_STATE = record_type(bristles=bristles_state_dtype(1), z=1)
"""Deflection, rad, of one element, and the further state of its bristles."""


class Motion(NamedTuple):
    """Of a mass, after each step: rad, rad/s, mean friction torque of the step, Nm, deflection, rad."""

    position: Array
    velocity: Array
    friction: Array
    deflection: Array


def _records(element: FrictionElement) -> tuple[Any, Any, Any]:
    constants = np.zeros(1, bristles_dtype(1))
    state = np.zeros(1, _STATE)
    if element.bristles is not None:
        fill_bristles(constants[0], 0, element.bristles)
    return element_arrays((element,)), constants, state


def driven_mass(
    element: FrictionElement, inertia: float, force: Array, step: float, start: float = 0.0
) -> Motion:
    """Return the motion of a mass under forces that are each held over a step, from position 0.

    Args:
        element: its friction.
        inertia: kg m^2.
        force: in the middle of each step, Nm, shape (m,).
        step: s.
        start: velocity at the beginning, rad/s.
    """
    motion = Motion(*np.empty((4, force.size)))
    _drive(*_records(element), inertia, force, step, start, motion)
    return motion


def led(element: FrictionElement, velocity: Array, step: float) -> tuple[Array, Array]:
    """Return the mean friction torque over each step of a given motion, Nm, and the energy stored after it, J.

    Args:
        element: the friction.
        velocity: held over each step, rad/s, shape (m,).
        step: s.
    """
    torque, stored = np.empty((2, velocity.size))
    _lead(*_records(element), velocity, step, torque, stored)
    return torque, stored


@kernel
def _drive(
    elements: Any,
    constants: Any,
    states: Any,
    inertia: float,
    force: Array,
    step: float,
    start: float,
    motion: Motion,
) -> None:
    element, kinds, state = load_elements(elements[0], 1), constants[0], states[0].bristles
    x, v, a = 0.0, start, 0.0
    nothing = load(states[0].z, 1)
    z = nothing
    for k in range(force.size):
        # As in the plant: the last step's acceleration and the jump of the force predict the middle of the step.
        a += (force[k] - force[max(0, k - 1)]) / inertia
        middle = nothing + (v + 0.5 * step * a)
        z, friction = bristles_step(element, kinds, state, z, middle, step, 1)
        a = (force[k] - lane(friction, 0)) / inertia
        x += step * (v + 0.5 * step * a)
        v += step * a
        motion.position[k], motion.velocity[k] = x, v
        motion.friction[k], motion.deflection[k] = lane(friction, 0), lane(z, 0)


@kernel
def _lead(
    elements: Any,
    constants: Any,
    states: Any,
    velocity: Array,
    step: float,
    torque: Array,
    stored: Array,
) -> None:
    element, kinds, state = load_elements(elements[0], 1), constants[0], states[0].bristles
    nothing = load(states[0].z, 1)
    z = nothing
    for k in range(velocity.size):
        z, mean = bristles_step(element, kinds, state, z, nothing + velocity[k], step, 1)
        torque[k] = lane(mean, 0)
        stored[k] = lane(bristles_energy(element.c0, kinds, state, z, 1), 0)


ELEMENT = FrictionElement(
    tau_c=25.0, tau_s=32.0, omega_s=0.05, delta=1.0, c0=1e5, c1=100.0, c2=14.0, omega_d=1.0
)
FLAT = ELEMENT.replaced(tau_s=25.0, c2=0.0)
KINDS: dict[str, BristlesPart | None] = {
    "LuGre": None,
    "elasto-plastic": ElastoPlastic(break_away=0.7),
    "Maxwell slip": MaxwellSlip(
        stiffness=(0.5, 0.3, 0.2), share=(0.2, 0.3, 0.5), attraction=2000.0
    ),
}
LOW, HIGH = 0.2, 0.6
"""Of the Coulomb torque, between which the load oscillates."""
CYCLES, PER_CYCLE, STEP = 60, 2000, 2e-4
_TURNS = (0.0, 4e-4, -0.8e-4, 2.4e-4, -0.8e-4, -4e-4)  # rad
_POINTS = 400  # of a branch
_SUBSTEPS = (1, 2, 4, 8)


def drift(kind: BristlesPart | None) -> tuple[Array, float]:
    """Return the position of a mass under the load, rad, and what the last cycle adds to it, rad."""
    phase = (np.arange(CYCLES * PER_CYCLE) + 0.5) / PER_CYCLE
    load = 0.5 * (HIGH + LOW) - 0.5 * (HIGH - LOW) * np.cos(2.0 * math.pi * phase)
    force = 25.0 * np.concatenate([LOW * np.linspace(0.0, 1.0, PER_CYCLE), load])
    position = driven_mass(FLAT.replaced(bristles=kind), 0.2, force, STEP).position
    return position, float(position[-1] - position[-1 - PER_CYCLE])


def inner_loop(kind: BristlesPart | None) -> tuple[Array, Array]:
    """Return position, rad, and torque, Nm, of a slow motion with an inner loop, at rest after each step."""
    velocity = np.concatenate(
        [np.full(_POINTS, (b - a) / _POINTS / STEP) for a, b in pairwise(_TURNS)]
    )
    with_rests = np.column_stack([velocity, np.zeros_like(velocity)]).ravel()
    torque = led(FLAT.replaced(c1=0.0, bristles=kind), with_rests, STEP)[0][1::2]
    return np.cumsum(velocity) * STEP, torque


def left_open(torque: Array) -> float:
    """Return by how much the torque misses the point where the inner loop left, Nm: at the same place, after it."""
    return float(abs(torque[4 * _POINTS - 1] - torque[2 * _POINTS - 1]))


def step_errors(kind: BristlesPart | None) -> list[float]:
    """Return the error of the position, rad, for each of _SUBSTEPS in a tick of 250 us, worst of many end times."""

    def position(substeps: int) -> Array:
        h = 2.5e-4 / substeps
        t = (np.arange(round(0.25 / h)) + 0.5) * h
        force = 45.0 * np.sin(60.0 * t) + 6.0 * np.sin(171.0 * t)
        return driven_mass(ELEMENT.replaced(bristles=kind), 1.5, force, h, 0.2).position[
            substeps - 1 :: substeps
        ]

    exact = position(800)
    return [float(np.max(np.abs(position(n) - exact))) for n in _SUBSTEPS]


def costs() -> dict[str, float]:
    """Return the CPU time of one step of one element, s, of each kind, taking turns; slow motion with reversals."""
    velocity = 0.05 * np.sin(np.arange(200_000) * 0.01)
    runs = {
        name: timed(
            lambda one=one: led(ELEMENT.replaced(bristles=one), velocity, 2.5e-4), velocity.size
        )  # type: ignore[misc]
        for name, one in KINDS.items()
    }
    return {name: min(times) for name, times in in_turns(runs, 7).items()}


def draw(file: Path) -> None:
    """Draw drift and inner loops as a picture."""
    reach = 25.0 / 1e5
    half = _POINTS * 2
    with picture(file) as figure:
        rows = 1 + len(KINDS) // 2
        figure.set_size_inches(WIDTH, 3.2 * rows)
        drifts, *loops = figure.subplots(rows, 2).ravel()
        for panel, (name, kind), colour in zip(loops, KINDS.items(), COLOURS, strict=False):
            position, _ = drift(kind)
            cycles = np.arange(position.size) / PER_CYCLE - 1.0
            drifts.plot(cycles, position / reach, color=colour, label=name)
            way, torque = inner_loop(kind)
            panel.plot(way * 1e3, torque, color=GREY, label="outer loop")
            inner = slice(half - 1, 2 * half)
            panel.plot(
                way[inner] * 1e3, torque[inner], color=colour, linewidth=1.8, label="inner loop"
            )
            title = f"{name}: inner loop open by {left_open(torque):.1f} Nm"
            panel.set(title=title, xlabel="position, mrad", ylabel="friction torque, Nm")
            panel.legend()
        title = f"Load from {LOW:g} to {HIGH:g} of the Coulomb torque"
        drifts.set(title=title, xlabel="cycles", ylabel="position / g")
        drifts.legend()
        for panel in loops[len(KINDS) :]:
            panel.set_axis_off()


def main() -> int:
    """Print the figures, merge them and draw the plot if asked for."""
    options = arguments(__doc__, PLOT)
    reach = 25.0 / 1e5
    expected = math.log((1.0 - LOW**2) / (1.0 - HIGH**2))
    cost, rows, figures = costs(), [], {"bristles_drift_closed_form": expected}
    for name, kind in KINDS.items():
        key = name.replace(" ", "_").replace("-", "_").lower()
        walked, open_by, errors = (
            drift(kind)[1] / reach,
            left_open(inner_loop(kind)[1]),
            step_errors(kind),
        )
        rows.append(
            (
                name,
                f"{walked:.3g}",
                f"{open_by:.2g}",
                *(f"{e:.2g}" for e in errors),
                f"{cost[name] * 1e9:.0f}",
            )
        )
        figures |= {f"bristles_drift_{key}": walked, f"bristles_open_{key}": open_by}
        figures |= {f"bristles_error_{n}_{key}": e for n, e in zip(_SUBSTEPS, errors, strict=True)}
        figures[f"bristles_cost_{key}"] = cost[name] / cost["LuGre"]
    print(f"LuGre's drift in closed form: {expected:.4f} g a cycle")
    print_table(
        (
            "kind",
            "drift, g a cycle",
            "inner loop open, Nm",
            *(f"rad, {n} steps" for n in _SUBSTEPS),
            "ns a step",
        ),
        rows,
    )
    merge(figures)
    if options.plot:
        draw(options.plot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
