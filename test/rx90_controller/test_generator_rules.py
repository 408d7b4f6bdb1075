"""Any requests in any order and any blocks: the set-points of the rules, written down a second time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_moves import HOME, LIMITS, NAMES, PERIOD, ZERO, points

from rx90_common.base.arrays import Array
from rx90_controller.trajectory import TrajectoryGenerator, TrajectoryPoints


class Reference:
    """The generator's rules tick by tick, each set-point sampled from a generator that has one trajectory only."""

    def __init__(self) -> None:
        self.begin(HOME)

    def begin(self, hold: Array) -> None:
        """Hold a position, with nothing to follow."""
        self.running, self.start = TrajectoryGenerator(LIMITS, PERIOD, hold), 0
        self.length = 0
        self.waiting: tuple[int, int, TrajectoryGenerator] | None = None

    def setpoint(self, tick: int) -> Array:
        """Return the set-point of a tick, the trajectory that waits begun if it is its time."""
        if self.waiting is not None and tick >= self.waiting[0]:
            (self.start, self.length, self.running), self.waiting = self.waiting, None
        return self.running.setpoints(tick - self.start)[0]

    def accept(self, to: Array, seconds: float, now: int, begin: int) -> None:
        """Let a joint move to a point at rest begin at a tick."""
        if self.waiting is not None and self.waiting[0] < now:
            self.setpoint(now)
        position, velocity, acceleration = self.running.setpoints(begin - self.start)[0]
        both = TrajectoryPoints.create(
            NAMES, NAMES, [0.0, seconds], [position, to], [velocity, ZERO], [acceleration, ZERO]
        )
        alone = TrajectoryGenerator(replace(LIMITS, acceleration=np.full(6, np.inf)), PERIOD, position)
        alone.accept(both, 0, 0)
        self.waiting = begin, round(seconds / PERIOD), alone

    def delay(self, count: int, tick: int) -> None:
        """Let ticks from `tick` on pass."""
        if self.waiting is not None and self.waiting[0] < tick:
            self.setpoint(tick)
        resting = tick - self.start >= self.length
        self.start += count
        if self.waiting is not None:
            begin, length, alone = self.waiting
            self.waiting = max(begin, tick + count) if resting else begin + count, length, alone


@settings(max_examples=80)
@given(st.data())
def test_random_requests_give_what_the_rules_say(data: st.DataObject) -> None:
    """However trajectories, delays, resets and blocks follow each other, set-points are those of the rules."""
    generator, reference, tick = TrajectoryGenerator(LIMITS, PERIOD, HOME), Reference(), 0
    for _ in range(data.draw(st.integers(1, 12))):
        what = data.draw(st.sampled_from(["run", "run", "accept", "accept", "delay", "reset"]))
        count = data.draw(st.integers(1, 150))
        if what == "run":
            revision = generator.revision
            ahead = generator.setpoints(tick, count)
            wanted = np.array([reference.setpoint(tick + k) for k in range(count)])
            assert ahead == pytest.approx(wanted, abs=1e-9)
            assert generator.revision == revision
            tick += count
        elif what == "accept":
            to, seconds = HOME + 0.001 * data.draw(st.integers(-50, 50)), 0.001 * data.draw(st.integers(150, 400))
            begin = tick + data.draw(st.integers(0, 200))
            target = TrajectoryPoints.create(NAMES, NAMES, [seconds], [to], [ZERO], [ZERO])
            revision = generator.revision
            assert generator.accept(target, tick, begin).begin == begin
            assert generator.revision != revision
            reference.accept(to, seconds, tick, begin)
        elif what == "delay":
            tick += count
            generator.delay(count, tick)
            reference.delay(count, tick - count)
        else:
            hold = generator.setpoints(tick)[0, 0]
            tick = data.draw(st.integers(0, 1000))
            generator.reset(hold)
            reference.begin(hold)


@given(
    blocks=st.lists(st.integers(1, 400), min_size=1, max_size=12),
    start=st.integers(0, 900),
    seconds=st.floats(0.3, 1.2),
)
@settings(max_examples=60)
def test_a_block_equals_the_same_ticks_one_by_one(blocks: list[int], start: int, seconds: float) -> None:
    """However the ticks are grouped, the set-points are the same to the last bit."""

    def fresh() -> TrajectoryGenerator:
        generator = TrajectoryGenerator(LIMITS, PERIOD, HOME)
        generator.accept(points([seconds / 2, seconds], [HOME + 0.2, HOME + 0.1], [ZERO + 0.1, ZERO]), 0, start)
        return generator

    single, grouped, tick = fresh(), fresh(), 0
    for count in blocks:
        block = grouped.setpoints(tick, count)
        assert block.shape == (count, 3, 6)
        assert np.array_equal(block, np.concatenate([single.setpoints(tick + k) for k in range(count)]))
        tick += count
