"""The integrator's own error: the plant step against a stiff variable-step solver, in the same closed loop.

    python -m benchmarks.accuracy [--plot FILE]

The reference line is run with 1 to 16 plant steps in a tick and with the plant solved by LSODA between ticks.
Without the encoders' rounding this shows the order of the plant step. With it, a difference of any size, however
small, at last moves one encoder count to another tick, and from there on two runs differ by about a count.
That belongs to the robot and not to its integrator: the solver differs as much from itself when the start is
moved by 1e-11 rad. So the comparison is repeated from several such starts, and the solver against itself is a
row of the table.
"""

from __future__ import annotations

import dataclasses
import itertools
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from tqdm import tqdm

from benchmarks.hybrid_reference import TOLERANCE, ReferenceRun, StiffPlant, Work, hybrid_reference
from benchmarks.report import PLOT, WIDTH, arguments, merge, plain_decades, print_table
from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import forward
from rx90_common.friction import FrictionSet
from rx90_common.report.picture import picture
from rx90_common.report.style import COLOURS, GREY, INK
from rx90_emulator.loop.setup import Setup

SUBSTEPS = (1, 2, 4, 8, 16)
STARTS = 6
DISPLACEMENT = 1e-11
"""How far the starts lie apart, rad: far below everything the arm could notice."""
FINE_COUNTS = 2**40
"""Encoder counts per turn that are finer than the solver's tolerance."""
COAST = 0.02
"""How long the arm coasts from full speed, s."""


SMALL_WAY = 2e-4
"""Of a joint that hardly moves, rad: below 1 % of it, 2 µrad, differences do not count."""

STICKING_POSE = np.array([0.1, 0.4, 1.3, 0.2, 0.9, -0.1])
"""Where the arm sticks and breaks away, rad."""


class Miss(NamedTuple):
    """How far two runs are apart.

    Attributes:
        tip: worst distance of the tool centre points, m.
        tip_rms: its root mean square, m.
        joints: worst difference of each joint position, rad, shape (6,).
        bristles: worst difference of each bristle deflection, rad, shape (7,).
    """

    tip: float
    tip_rms: float
    joints: Array
    bristles: Array


class Convergence(NamedTuple):
    """What the comparison found.

    Attributes:
        exact: without the encoders' rounding: the miss of each number of substeps.
        solver: there, the difference of the solver to itself at a hundred times the tolerance: its own error.
        counts: with encoders as shipped: the misses of each number of substeps, over all pairs of starts.
        solver_counts: there, those of the solver to itself.
    """

    exact: dict[int, Miss]
    solver: Miss
    counts: dict[int, list[Miss]]
    solver_counts: list[Miss]


def compare(setup: Setup, a: ReferenceRun, b: ReferenceRun) -> Miss:
    """Return how far two runs are apart."""
    chain = setup.robot.chain
    distance = np.linalg.norm(forward(chain, a.q).position - forward(chain, b.q).position, axis=1)
    worst = (np.abs(x - y).max(axis=0) for x, y in ((a.q, b.q), (a.z, b.z)))
    return Miss(float(distance.max()), float(np.sqrt(np.mean(distance**2))), *worst)


def without_rounding(setup: Setup) -> Setup:
    """Return the setup with encoders so fine that they do not round."""
    drives = setup.drives.replaced(
        encoder=setup.drives.encoder.model_copy(update={"counts_per_revolution": FINE_COUNTS})
    )
    return dataclasses.replace(setup, drives=drives)


def run_plant(work: Work, start: Array, substeps: int) -> ReferenceRun:
    """Run the closed loop with the plant step."""
    slow = work._replace(start=start).run(substeps=substeps).slow
    return ReferenceRun(
        slow.joint_states[:, 0], slow.joint_states[:, 1], slow.friction_states[:, 0]
    )


def converge(work: Work, starts: int = STARTS, quiet: bool = False) -> Convergence:
    """Run everything; some 10 s for each start."""
    fine = work._replace(setup=without_rounding(work.setup))
    rng = np.random.default_rng(1)
    moved = [work.start + DISPLACEMENT * rng.uniform(-1.0, 1.0, 6) * (k > 0) for k in range(starts)]
    rows = round(work.duration * work.setup.rates.position_hz)
    # None: shown on a terminal only.
    bar = tqdm(
        total=(starts + 2) * rows,
        desc="stiff solver",
        unit="ms",
        disable=True if quiet else None,
        leave=False,
    )

    def solve(work: Work, start: Array, tolerance: float = TOLERANCE) -> ReferenceRun:
        return hybrid_reference(
            work.setup, work.points, start, work.duration, tolerance=tolerance, bar=bar
        )

    with bar:
        exact = solve(fine, work.start)
        solver = compare(work.setup, solve(fine, work.start, 100.0 * TOLERANCE), exact)
        references = [solve(work, start) for start in moved]
    return Convergence(
        {n: compare(work.setup, run_plant(fine, work.start, n), exact) for n in SUBSTEPS},
        solver,
        {
            n: _all_pairs(work.setup, [run_plant(work, start, n) for start in moved], references)
            for n in SUBSTEPS
        },
        [compare(work.setup, a, b) for a, b in itertools.combinations(references, 2)],
    )


def _all_pairs(
    setup: Setup, ours: list[ReferenceRun], references: list[ReferenceRun]
) -> list[Miss]:
    return [compare(setup, a, b) for a, b in itertools.product(ours, references)]


class FullSpeed(NamedTuple):
    """The plant step where the bristles are far faster than the tick.

    Attributes:
        rate: the largest bristle rate |v| / g times the tick.
        joints: worst difference to the solver, rad.
        torque: worst difference of a friction torque to the solver's, after the first two ticks, over its value.
    """

    rate: float
    joints: float
    torque: float


def scaled(setup: Setup, **factors: float) -> Setup:
    """Return a setup with parameters of all elements multiplied."""
    elements = tuple(
        one.with_parameters(
            {name: factor * one.parameters[name] for name, factor in factors.items()}
        )
        for one in setup.friction.elements
    )
    return dataclasses.replace(setup, friction=FrictionSet(setup.friction.names, elements))


def full_speed(setup: Setup) -> FullSpeed:
    """Let the arm coast from its full joint speeds beside the solver."""
    elements = setup.friction.elements
    plant, twin = setup.plant(), setup.plant()
    for one in (plant, twin):
        one.reset(np.array([0.0, 0.5, 1.2, 0.0, 0.9, 0.0]))
        # Motor 6 turns with joints 5 and 6 together, so at full speed these two run against each other.
        one.state["v"][0] = setup.robot.max_velocity * [1, -1, 1, 1, -1, 1]
    stiff = StiffPlant(setup, twin, 1e-9)
    sliding = [
        e.sliding_torque(s) for e, s in zip(elements, setup.robot.max_velocity, strict=False)
    ]
    rate = max(
        e.c0 * s / g for e, s, g in zip(elements, setup.robot.max_velocity, sliding, strict=False)
    )
    joints, torque = 0.0, 0.0
    for tick in range(round(COAST * setup.rates.base_hz)):
        plant.step(np.zeros(6))
        stiff.step(np.zeros(6))
        twin.state["q"][0], twin.state["v"][0], twin.state["z"][0] = (
            stiff.y[:6],
            stiff.y[6:12],
            stiff.y[12:],
        )
        joints = max(joints, float(np.abs(plant.state["q"][0] - stiff.y[:6]).max()))
        own, other = plant.friction_states()[2], twin.friction_states()[2]
        if tick >= 2:
            torque = max(torque, float(np.max(np.abs(own - other) / np.abs(other))))
    return FullSpeed(float(rate * setup.rates.period), joints, torque)


def with_rotors(setup: Setup, factor: float) -> Setup:
    """Return a setup with lighter or heavier rotors."""
    drives = setup.drives.replaced(
        transmission={"rotor_inertia": factor * setup.drives.rotor_inertia}
    )
    return dataclasses.replace(setup, drives=drives)


class Sticking(NamedTuple):
    """The plant step where joints stick, break away, turn round and stick again.

    Attributes:
        substeps: plant steps in a tick, as many as the arm needs.
        joints: worst difference to the solver, rad.
        share: worst difference over the way of that joint, or over SMALL_WAY where that is more.
    """

    substeps: int
    joints: float
    share: float


def sticking(setup: Setup) -> Sticking:
    """Push the arm below break-away, beyond it, back and below again, 40 ms in all, beside the solver."""
    plant, twin = setup.plant(), setup.plant()
    for one in (plant, twin):
        one.reset(STICKING_POSE)
        one.state["brakes_closed"], one.state["brake_z"] = 0, 0.0
    stiff = StiffPlant(setup, twin, 1e-8)
    apart, way, start = np.zeros(6), np.zeros(6), stiff.y[:6].copy()
    for motor in _pushes(setup):
        plant.step(motor)
        stiff.step(motor)
        apart = np.maximum(apart, np.abs(plant.state["q"][0] - stiff.y[:6]))
        way = np.maximum(way, np.abs(stiff.y[:6] - start))
    return Sticking(
        plant.substeps, float(apart.max()), float((apart / np.maximum(way, SMALL_WAY)).max())
    )


def _pushes(setup: Setup) -> list[Array]:
    """Return the motor torques of each tick: the arm's weight and a share of its static friction."""
    model = setup.robot.model
    static = np.array([max(e.tau_s.positive, e.tau_s.negative) for e in setup.friction.elements])
    weight = np.array(pin.computeGeneralizedGravity(model, model.createData(), STICKING_POSE))
    weight += setup.drives.spring_torque * np.sin(STICKING_POSE)
    needed = static[:6] + static[6] * np.array([0, 0, 0, 0, 1, 1])
    joints = [
        weight + share * needed for share in np.repeat([0.6, 1.8, -1.8, 0.3], [24, 32, 48, 56])
    ]
    return [(joint - joint[5] * (np.arange(6) == 4)) / setup.drives.gear for joint in joints]


def draw(found: Convergence, file: Path) -> None:
    """Draw the convergence as a picture."""
    steps = np.array(SUBSTEPS, dtype=np.float64)
    spread = np.array([m.tip for m in found.solver_counts]) * 1e6
    shipped = np.array([[m.tip for m in found.counts[n]] for n in SUBSTEPS]) * 1e6
    exact = [found.exact[n] for n in SUBSTEPS]
    tips, joints, bristles = (
        np.array(values) * 1e6
        for values in zip(*((m.tip, m.joints.max(), m.bristles.max()) for m in exact), strict=True)
    )
    ends = steps[[0, -1]]
    slope = 2.0 / steps**2.0
    with picture(file) as figure:
        figure.set_size_inches(WIDTH, 6.4)
        tip, states = figure.subplots(2)
        tip.fill_between(
            ends, *np.percentile(spread, [0, 100]), color=GREY, alpha=0.35, linewidth=0.0
        )
        tip.loglog(
            ends,
            np.full(2, np.median(spread)),
            color=COLOURS[6],
            label="encoders as shipped: solver against itself",
        )
        tip.fill_between(
            steps,
            shipped.min(axis=1),
            shipped.max(axis=1),
            color=COLOURS[1],
            alpha=0.35,
            linewidth=0.0,
        )
        tip.loglog(
            steps,
            np.median(shipped, axis=1),
            ".-",
            color=COLOURS[1],
            label="encoders as shipped: plant step",
        )
        tip.loglog(steps, tips, ".-", color=COLOURS[0], label="without rounding: plant step")
        tip.loglog(steps, tips[0] * slope, ":", color=INK, label="order 2")
        tip.set_ylabel("worst tip difference, µm")
        states.loglog(steps, joints, ".-", color=COLOURS[0], label="joint positions")
        states.loglog(steps, bristles, ".-", color=COLOURS[2], label="bristle deflections")
        states.loglog(steps, joints[0] * slope, ":", color=INK, label="order 2")
        states.set(xlabel="plant steps in a tick of 250 µs", ylabel="worst difference, µrad")
        for panel in (tip, states):
            plain_decades(panel)
            panel.legend()


def _exact_table(found: Convergence) -> None:
    rows, last = [], None
    for name, miss in (
        *((f"{n} steps in a tick", m) for n, m in found.exact.items()),
        ("solver itself", found.solver),
    ):
        order = (
            "" if last is None or name.startswith("solver") else f"{np.log2(last / miss.tip):.2f}"
        )
        rows.append(
            (name, *_micro(miss.tip, miss.tip_rms, miss.joints.max(), miss.bristles.max()), order)
        )
        last = miss.tip
    print_table(
        (
            "without the encoders' rounding",
            "tip µm",
            "RMS µm",
            "joints µrad",
            "bristles µrad",
            "order",
        ),
        rows,
    )


def _micro(*values: float) -> list[str]:
    return [f"{value * 1e6:.2g}" if value < 1e-10 else f"{value * 1e6:.4f}" for value in values]


def _counts_table(found: Convergence) -> None:
    rows = []
    runs = [(f"{n} steps in a tick", misses) for n, misses in found.counts.items()]
    for name, misses in (*runs, ("solver against itself", found.solver_counts)):
        tip = np.array([m.tip for m in misses])
        others = np.median([(m.tip_rms, m.joints.max(), m.bristles.max()) for m in misses], axis=0)
        rows.append(
            (name, *(f"{v * 1e6:.2f}" for v in (np.median(tip), tip.min(), tip.max(), *others)))
        )
    headers = (
        "encoders as shipped",
        "tip µm",
        "least",
        "most",
        "RMS µm",
        "joints µrad",
        "bristles µrad",
    )
    print_table(headers, rows)


def _by_element(work: Work, miss: Miss) -> None:
    names = (*work.setup.robot.joint_names, work.setup.friction.names[-1])
    joints = (*(f"{v * 1e6:.3f}" for v in miss.joints), "")
    bristles = (f"{v * 1e6:.3f}" for v in miss.bristles)
    print_table(
        ("one step in a tick, no rounding", "joint µrad", "bristle µrad"),
        list(zip(names, joints, bristles, strict=True)),
    )


def main() -> int:
    """Compare, print the tables, merge the figures and draw the plot if it is asked for."""
    options = arguments(__doc__, PLOT)
    work = Work.load()
    found = converge(work)
    _exact_table(found)
    print()
    _by_element(work, found.exact[1])
    print()
    _counts_table(found)
    print()
    coasts = [(factor, full_speed(scaled(work.setup, c0=factor))) for factor in (1.0, 100.0)]
    print_table(
        ("coasting from full joint speed", "bristle rate x tick", "joints µrad", "friction torque"),
        [
            (f"c0 x {f:g}", f"{c.rate:.1f}", f"{c.joints * 1e6:.3f}", f"{c.torque:.1e}")
            for f, c in coasts
        ],
    )
    print()
    cases = {
        "as shipped": work.setup,
        **{f"c0 x {factor:g}": scaled(work.setup, c0=factor) for factor in (50.0, 100.0, 1000.0)},
        "c1 x 3, rotors x 0.03": with_rotors(scaled(work.setup, c1=3.0), 0.03),
        "alpha 0.3, c2 x 5": scaled(work.setup, c2=5.0, alpha=0.3),
        "c0 x 3, c1 = c2 = 0": scaled(work.setup, c0=3.0, c1=0.0, c2=0.0),
    }
    rows = [(name, sticking(setup)) for name, setup in cases.items()]
    print_table(
        ("sticking, break-away, reversal", "steps in a tick", "joints µrad", "of the way"),
        [(name, str(s.substeps), f"{s.joints * 1e6:.2f}", f"{s.share:.2%}") for name, s in rows],
    )
    merge(
        {
            "integrator_tip_error_um": 1e6 * float(np.median([m.tip for m in found.counts[1]])),
            "integrator_tip_error_unrounded_um": 1e6 * found.exact[1].tip,
        }
    )
    if options.plot is not None:
        draw(found, options.plot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
