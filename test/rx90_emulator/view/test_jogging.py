"""Jogged joints: moves within the limits, sliders that show the right thing, no flood."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rx90_controller.lines.plan import Approach
from rx90_controller.trajectory import TrajectoryGenerator, TrajectoryPoints
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view import panel as jog_sliders
from rx90_emulator.view.page import NewestOnly
from rx90_emulator.view.panel import JogSliders, jog, slider_range

ZERO = np.zeros(6)


def test_a_jog_is_as_short_as_speed_and_acceleration_allow(shipped: Setup) -> None:
    """From rest it lasts what a quintic needs, 15/8 d/v or sqrt(10/sqrt(3) d/a), and at most 16 % more."""
    limits, gentle = shipped.controller.limits(shipped.robot), Approach()
    for joint, way in ((0, 0.01), (1, -1.0), (5, 4.0)):
        target = ZERO.copy()
        target[joint] = way
        points = jog(ZERO, ZERO, target, limits, gentle)
        needed = max(15 / 8 * abs(way) / (0.25 * limits.velocity[joint]), np.sqrt(10 / np.sqrt(3) * abs(way) / 2.0))
        assert needed * 0.99 <= points.times[0] <= needed * 1.16
        np.testing.assert_array_equal(points.position, [target])


def test_a_jog_in_mid_motion_is_as_gentle(shipped: Setup) -> None:
    """Targets that are dragged to and fro, every 0.2 s, are taken, and accelerate the set-points like one move."""
    limits, gentle = shipped.controller.limits(shipped.robot), Approach()
    generator = TrajectoryGenerator(limits, 1e-3, ZERO)
    rng = np.random.default_rng(7)
    last, peak = 0, 0.0
    for tick in range(0, 6000, 200):
        # What the page knows is some time old.
        position, velocity, _ = generator.setpoints(max(tick - 1, 0), 1)[0]
        target = position + rng.choice([-1.0, 1.0], 6) * rng.uniform(0.02, 0.3, 6)
        last = generator.accept(jog(position, velocity, target, limits, gentle), tick, None).end
        peak = max(peak, float(np.abs(generator.setpoints(tick, 200)[:, 2]).max()))
    # A move begins with the acceleration that the last one has there, which the page does not know.
    assert 0.9 * gentle.acceleration < peak < 1.3 * gentle.acceleration
    np.testing.assert_allclose(generator.setpoints(last, 1)[0, 0], target, atol=1e-12)


def test_sliders_end_within_the_limits(shipped: Setup) -> None:
    """Both ends are within the joint's limits, less than a step away from them."""
    limits = shipped.controller.limits(shipped.robot)
    for joint in range(6):
        low, high = np.radians(slider_range(limits, joint, 0.1))
        step = np.radians(0.1)
        assert limits.lower[joint] - 1e-9 <= low < limits.lower[joint] + step
        assert limits.upper[joint] - step < high <= limits.upper[joint] + 1e-9


@pytest.mark.parametrize("burst", [[2, 3, 4], [2]])
def test_the_newest_overtakes_what_waits(burst: list[int]) -> None:
    """While one item is worked on, of those that come only the last is worked on next."""
    begun, go_on, done = threading.Event(), threading.Event(), threading.Event()
    worked: list[int] = []

    def work(item: int) -> None:
        worked.append(item)
        begun.set()
        assert go_on.wait(10.0)
        if item == burst[-1]:
            done.set()

    newest: NewestOnly[int] = NewestOnly(SimpleNamespace(), work, 0.0)  # type: ignore[arg-type]
    newest.give(1)
    assert begun.wait(10.0)
    for item in burst:
        newest.give(item)
    go_on.set()
    assert done.wait(10.0)
    newest.close()
    assert worked == [1, burst[-1]]


class _Slider:
    """Stands for viser's slider: a value, limits, and who is called when a user changes it."""

    def __init__(self, low: float, high: float, value: float) -> None:
        self.min, self.max, self.disabled = low, high, True
        self.sent = [value]  # to the page, or by it
        self.changed: Callable[[object], Any] = lambda _: None

    @property
    def value(self) -> float:
        """Return what was sent last."""
        return self.sent[-1]

    @value.setter
    def value(self, value: float) -> None:
        if value != self.value:
            self.sent.append(value)

    def on_update(self, callback: Callable[[object], Any]) -> None:
        """Keep who is called."""
        self.changed = callback

    def move(self, value: float) -> None:
        """Change it as a user does."""
        self.value = value
        with suppress(StopIteration):  # a coroutine that waits for nothing
            self.changed(SimpleNamespace(client_id=1)).send(None)


class _Jogs:
    """Sliders, what they hand to the page's thread, and what they send; the clock stands unless it is moved."""

    def __init__(self, setup: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
        self.sliders: list[_Slider] = []
        self.waiting: list[Callable[[], None]] = []
        self.sent: queue.Queue[TrajectoryPoints] = queue.Queue()
        self.now = 100.0
        monkeypatch.setattr(jog_sliders, "time", SimpleNamespace(monotonic=lambda: self.now))

        def add_slider(_: str, low: float, high: float, __: float, value: float, **___: object) -> _Slider:
            self.sliders.append(_Slider(low, high, value))
            return self.sliders[-1]

        page: Any = SimpleNamespace(gui=SimpleNamespace(add_slider=add_slider), later=self.waiting.append)
        self.parts = JogSliders(page, setup.controller.limits(setup.robot), self.sent.put)

    def follow(self, position: float | np.ndarray) -> Any:
        """Have them follow an arm with its joints at an angle, or angles, rad; return it."""
        arm: Any = SimpleNamespace(position=np.broadcast_to(position, 6), velocity=ZERO)
        self.parts.follow(arm, ready=True)
        return arm

    def shown(self, position: np.ndarray, now: float) -> list[float]:
        """Return what they show of an arm at a time, s, deg."""
        self.now = 100.0 + now
        self.follow(position)
        return [slider.value for slider in self.sliders]

    def drag(self, joint: int, angle: float, arm: np.ndarray, now: float) -> np.ndarray:
        """Return where all joints are sent when a user moves one to an angle, deg, while the arm is there, deg."""
        self.shown(arm, now)
        self.sliders[joint].move(angle)
        self.waiting.pop()()
        return np.degrees(self.sent.get(timeout=60.0).position[-1])


ARM = np.radians([0.0, 5.0, 10.0, 15.0, 20.0, 25.0])


@pytest.fixture
def jogs(shipped: Setup, monkeypatch: pytest.MonkeyPatch) -> Iterator[_Jogs]:
    """Give sliders of the shipped robot."""
    made = _Jogs(shipped, monkeypatch)
    yield made
    made.parts.close()


def test_the_sliders_show_where_the_arm_goes_and_then_where_it_is(jogs: _Jogs) -> None:
    """A second joint that is dragged leaves the first one's target; arrived, stuck or told so, the arm is shown."""
    there = np.degrees(ARM).round(1).tolist()
    assert jogs.shown(ARM, 0.0) == there
    first = jogs.drag(1, 40.0, ARM, 0.0)
    both = jogs.drag(4, -30.0, ARM + 0.01, 0.1)
    np.testing.assert_allclose([first[1], both[1], both[4], both[0]], [40.0, 40.0, -30.0, 0.0], atol=1e-9)
    assert jogs.shown(ARM + 0.02, 0.2) == both.round(1).tolist()
    jogs.shown(np.radians(both) + 1e-4, 0.3)  # arrived
    assert jogs.shown(ARM, 0.4) == there
    both = jogs.drag(0, 60.0, ARM, 1.0)
    assert jogs.shown(ARM, 2.5) == both.round(1).tolist()
    assert jogs.shown(ARM, 4.0) == there  # it does not move
    jogs.drag(0, 60.0, ARM, 5.0)
    jogs.parts.forget()
    assert jogs.shown(ARM, 5.1) == there


@pytest.mark.parametrize("meanwhile", ["nothing", "moved by others", "told to forget"])
def test_a_joint_that_rests_where_it_was_sent_is_not_moved_by_the_next_jog(jogs: _Jogs, meanwhile: str) -> None:
    """Friction holds the arm 1 mrad beside: another joint's jog leaves each sent to where it was sent.

    After a trajectory of others, or one that makes the page forget, it leaves the other joints where they are.
    """
    sent = jogs.drag(1, 40.0, ARM, 0.0)
    held = np.radians(sent) + 1e-3
    jogs.shown(held, 1.0)
    if meanwhile == "moved by others":
        jogs.shown(held + 0.1, 2.0)
        jogs.shown(held, 3.0)
    elif meanwhile == "told to forget":
        jogs.parts.forget()
    expected = sent if meanwhile == "nothing" else np.degrees(held)
    np.testing.assert_allclose(jogs.drag(0, 12.0, held, 4.0), [12.0, *expected[1:]], atol=1e-9)


@pytest.mark.parametrize("overwritten", [False, True])
@pytest.mark.parametrize("joint", [0, 1, 4])
def test_a_slider_that_a_user_has_moved_is_not_put_back(
    shipped: Setup, monkeypatch: pytest.MonkeyPatch, joint: int, overwritten: bool
) -> None:
    """The arm's state that comes between a user's change and its taking does not overwrite it: the joint goes there.

    Nor does one that was on its way to the slider when the change came.
    """
    jogs = _Jogs(shipped, monkeypatch)
    arm = jogs.follow(0.1)
    slider = jogs.sliders[joint]
    assert slider.value == 5.7  # 0.1 rad in tenths of a degree
    slider.move(12.3)
    if overwritten:
        slider.value = 5.8
    jogs.follow(0.1)
    jogs.waiting.pop()()
    target = jogs.sent.get(timeout=60.0).position[-1]
    jogs.follow(0.1)
    jogs.parts.close()
    np.testing.assert_allclose(np.degrees(target[joint]), 12.3)
    np.testing.assert_array_equal(np.delete(target, joint), arm.position[1:])
    assert slider.value == 12.3


def test_a_page_that_may_show_something_older_is_told_again(shipped: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a user gives while the slider is on the move is sent again half a second after, and only then."""
    for waited, again in ((0.5, True), (10.0, False)):
        jogs = _Jogs(shipped, monkeypatch)
        jogs.follow(0.1)
        jogs.now += waited
        slider = jogs.sliders[2]
        slider.move(12.3)
        jogs.waiting.pop()()
        sent = len(slider.sent)
        for _ in range(4):
            jogs.now += 0.1
            jogs.follow(0.1)
        assert len(slider.sent) == sent
        for _ in range(4):
            jogs.now += 0.1
            jogs.follow(0.1)
        jogs.parts.close()
        assert slider.sent[sent:] == ([slider.min, 12.3] if again else [])
