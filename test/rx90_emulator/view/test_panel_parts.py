"""The parts of the panel: jogged joints, a typed line, a friction element, against equations written otherwise."""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from lugre_oracle import LuGreOracle
from pinocchio_chain import tip_place

from rx90_common.base.errors import ConfigError, LineError
from rx90_common.friction import FrictionElement
from rx90_common.friction.element import FRICTION_PARAMETERS
from rx90_common.friction.friction_file import FrictionFile
from rx90_controller.lines.plan import Approach
from rx90_controller.lines.task import load_task
from rx90_controller.trajectory import TrajectoryGenerator, TrajectoryPoints
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view import panel as jog_sliders
from rx90_emulator.view.forms import (
    LineForm,
    changed,
    presliding_loop,
    read_values,
    stribeck_curve,
    typed_line,
    typed_values,
)
from rx90_emulator.view.page import Checker, Page
from rx90_emulator.view.panel import JogSliders, jog

ZERO = np.zeros(6)


def test_a_jog_is_as_short_as_speed_and_acceleration_allow(shipped: Setup) -> None:
    """From rest it lasts what a quintic needs, 15/8 d/v or sqrt(10/sqrt(3) d/a), and at most 16 % more."""
    limits = shipped.controller.limits(shipped.robot)
    for joint, way in ((0, 0.01), (1, -1.0), (5, 4.0)):
        target = ZERO.copy()
        target[joint] = way
        points = jog(ZERO, ZERO, target, limits)
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
        last = generator.accept(jog(position, velocity, target, limits), tick, None).end
        peak = max(peak, float(np.abs(generator.setpoints(tick, 200)[:, 2]).max()))
    # A move begins with the acceleration that the last one has there, which the page does not know.
    assert 0.9 * gentle.acceleration < peak < 1.3 * gentle.acceleration
    np.testing.assert_allclose(generator.setpoints(last, 1)[0, 0], target, atol=1e-12)


@pytest.mark.parametrize("burst", [[2, 3, 4], [2]])
def test_the_newest_overtakes_what_waits(burst: list[int]) -> None:
    """While one item is checked, of those that come only the last is checked next, and alone is shown."""
    begun, go_on = threading.Event(), threading.Event()
    checked: list[int] = []
    shown: list[int | None] = []
    page = Page("test", port=0)

    def check(item: int) -> int:
        checked.append(item)
        begun.set()
        assert go_on.wait(10.0)
        return item

    def show(item: int | None) -> str:
        shown.append(item)
        return ""

    checker = Checker(page, check, show, 0.0)
    checker.give(1)
    assert begun.wait(10.0)
    for item in burst:
        checker.give(item)
    go_on.set()
    page.run(until=lambda: bool(shown))
    checker.close()
    page.close()
    assert (checked, shown) == ([1, burst[-1]], [burst[-1]])


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
        self.sent: list[TrajectoryPoints] = []
        self.now = 100.0
        monkeypatch.setattr(jog_sliders, "time", SimpleNamespace(monotonic=lambda: self.now))

        def add_slider(_: str, low: float, high: float, __: float, value: float, **___: object) -> _Slider:
            self.sliders.append(_Slider(low, high, value))
            return self.sliders[-1]

        page: Any = SimpleNamespace(gui=SimpleNamespace(add_slider=add_slider), later=self.waiting.append)
        self.parts = JogSliders(page, setup.controller.limits(setup.robot), self.sent.append)

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
        self.now = max(self.now, self.parts._sent_at + 0.2)  # from one trajectory to the next
        self.follow(arm)
        return np.degrees(self.sent[-1].position[-1])


ARM = np.radians([0.0, 5.0, 10.0, 15.0, 20.0, 25.0])


@pytest.fixture
def jogs(shipped: Setup, monkeypatch: pytest.MonkeyPatch) -> _Jogs:
    """Give sliders of the shipped robot."""
    return _Jogs(shipped, monkeypatch)


def test_sliders_end_within_the_limits(shipped: Setup, jogs: _Jogs) -> None:
    """Both ends are within the joint's limits, less than a step away from them."""
    limits, step = shipped.controller.limits(shipped.robot), np.radians(0.1)
    low, high = np.radians([[slider.min, slider.max] for slider in jogs.sliders]).T
    assert ((limits.lower - 1e-9 <= low) & (low < limits.lower + step)).all()
    assert ((limits.upper - step < high) & (high <= limits.upper + 1e-9)).all()


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
    jogs.follow(0.1)
    target = jogs.sent[-1].position[-1]
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
        assert slider.sent[sent:] == ([slider.min, 12.3] if again else [])


TYPED = {"start": "0.6 -0.1 0.2", "end": "0.6, 0.1, 0.2", "speed": "0.25", "acceleration": "2", "tool rpy": "0 180 0"}


@pytest.fixture(scope="module")
def form(shipped: Setup) -> Iterator[LineForm]:
    """Give the form of a line of the shipped robot."""
    page = Page("test", port=0)
    made = LineForm(page, shipped.robot, shipped.controller.limits(shipped.robot), load_task(), lambda _: None)
    yield made
    made.close()
    page.close()


def test_a_line_is_shown_with_what_it_comes_to(shipped: Setup, form: LineForm) -> None:
    """The approach leads the tip from where Pinocchio has it to the start; time and speeds are the motion's own."""
    here = np.array([0.4, 0.3, 1.2, 0.1, 0.5, 0.2])
    found, robot = form.preview([*TYPED.values()], here), shipped.robot
    tip = tip_place(robot, here)
    np.testing.assert_allclose(found.approach[[0, -1]], [tip, [0.6, -0.1, 0.2]], atol=1e-9)
    assert "0.200 m in 0.93 s" in found.text()  # 0.2 m / 0.25 m/s and 0.25 m/s / 2 m/s^2
    # The set-points as the controller makes them, against the speed limits.
    generator = TrajectoryGenerator(shipped.controller.limits(robot), 1e-3, here)
    end = generator.accept(found.line.points, 0, None).end
    speeds = np.abs(generator.setpoints(0, end)[:, 1])[int(found.line.approach * 1e3) :]
    np.testing.assert_allclose(found.share, speeds.max(axis=0) / robot.max_velocity, atol=1e-3)
    assert end * 1e-3 == pytest.approx(found.line.duration, abs=2e-3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"start": "0.6 -0.1"}, "start is '0.6 -0.1'; accepted: 3 numbers, m"),
        ({"speed": "-1"}, "the line's speed is -1 m/s; accepted: a number > 0"),
        ({"acceleration": "nan"}, "acceleration is 'nan'; accepted: a number, m/s²"),
        ({"start": "1e308 1e308 1e308"}, "start is '1e308 1e308 1e308'; accepted: 3 numbers, m, up to 1e+06"),
        ({"tool rpy": "0 180 -1e300"}, "tool rpy is '0 180 -1e300'; accepted: 3 numbers, deg, up to 1e+06"),
        ({"end": "2 0 0"}, "at 0.300 m from its start (21%): elbow singularity, margin 0.0232; accepted: >= 0.05"),
        ({"speed": "30", "acceleration": "900"}, "rad/s (a line speed of about"),
        ({"acceleration": "900"}, "the controller would refuse the line"),
    ],
)
def test_a_line_that_cannot_be_travelled_is_one_sentence(form: LineForm, change: dict[str, str], said: str) -> None:
    """The refusal names the value, or the place on the line, and what is accepted."""
    with pytest.raises(LineError, match=re.escape(said)) as refused:
        form.preview([*(TYPED | change).values()], None)
    assert "accepted" in str(refused.value)


def test_the_fields_begin_with_the_reference_task(form: LineForm) -> None:
    """What stands in the form at first is the robot's own line."""
    task = load_task()
    found = form.preview(typed_line(task), None)
    assert replace(found.plan.task, rest_before=task.rest_before, rest_after=task.rest_after) == task
    assert found.line.approach == 0.0


ELEMENT = FrictionElement(25.0, 24.0, 32.0, 36.0, 0.05, 1.3, 1e5, 100.0, 14.0, alpha=0.7)


def test_the_curve_is_that_of_the_equations() -> None:
    """At every velocity the curve is equation 18 with the deflection at which equation 17 stands still."""
    velocity, torque = stribeck_curve(ELEMENT, 1.0)
    moving = velocity != 0.0
    assert (velocity[0], velocity[-1], np.diff(velocity).min() > 0.0) == (-1.0, 1.0, True)
    oracle = LuGreOracle([ELEMENT])
    for v, expected in zip(velocity[moving][::20], torque[moving][::20], strict=True):
        speed = np.array([v])
        at_rest = np.sign(speed) * oracle.stribeck(speed) / ELEMENT.c0
        assert oracle.rates(at_rest, speed)[1][0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("share", [0.3, 1.0, 4.0])
def test_the_loop_is_the_periodic_solution_of_equation_17(share: float) -> None:
    """Between two reversals at +-a the deflection is s - (s + s tanh(a/s)) exp(-x/s), s that of steady sliding."""
    element = replace(ELEMENT, tau_c_negative=25.0, tau_s_negative=32.0, c1=40.0)
    way = share * element.tau_s_positive / element.c0
    displacement, forth, back = presliding_loop(element, way)
    speed = 2.0 * way  # to and fro in 2 s
    oracle = LuGreOracle([element])
    sliding = float(oracle.stribeck(np.array([speed]))[0]) / element.c0
    start = sliding * math.tanh(way / sliding)
    z = sliding - (sliding + start) * np.exp(-(displacement + way) / sliding)
    expected = [float(oracle.rates(np.array([each]), np.array([speed]))[1][0]) for each in z]
    np.testing.assert_allclose(forth, expected, atol=1e-3 * abs(element.tau_s_positive))
    np.testing.assert_allclose(back, -np.array(forth[::-1]), rtol=1e-6, atol=1e-6)


def test_a_changed_element_is_marked_and_read_back(tmp_path: Path, shipped: Setup) -> None:
    """The file with a change says which values were changed by hand, is assumed, and gives the element back."""
    assert shipped.friction.file is not None
    file = replace(FrictionFile.read(shipped.friction.file), provenance="identified", identification={"bags": 3})
    after = changed(file, "joint_2", {"tau_s_negative": 41.5, "c1": 100.0})
    assert after.elements["joint_2"] == replace(file.elements["joint_2"], tau_s_negative=41.5)
    assert (after.provenance, after.identification) == ("assumed", None)
    assert str(after.source).startswith(
        "changed by hand: joint_2.tau_s_negative from 36 to 41.5 Nm; the other values identified"
    )
    path = tmp_path / "friction.yaml"
    path.write_text(after.text(), encoding="utf-8")
    assert FrictionFile.read(path) == after
    assert changed(file, "joint_2", {"c1": 100.0}) is file


def test_typed_values_come_back_and_others_are_refused() -> None:
    """What the fields show is what they are read as, also per sign and infinite; the rest names value and range."""
    element = replace(ELEMENT, omega_d=math.inf)
    texts = list(typed_values(element))
    assert FrictionElement(**read_values(texts)) == element
    assert texts[:2] == ["25 24", "32 36"]
    assert [p.name for p in FRICTION_PARAMETERS][4] == "c0"
    texts[4] = "1e5 x"
    with pytest.raises(ConfigError, match="c0 is '1e5 x'; accepted: a number > 0"):
        read_values(texts)
    texts[4], texts[0] = "1e5", "33 24"
    with pytest.raises(ConfigError, match=r"tau_s_positive is 32.0; accepted: a number >= tau_c_positive = 33.0 Nm"):
        replace(element, **read_values(texts))
