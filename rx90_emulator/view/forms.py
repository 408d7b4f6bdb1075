"""Forms whose input is checked before it has an effect: a straight line, and a friction element with its curves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, LineError
from rx90_common.base.quoting import quoted
from rx90_common.description.kinematics import tip_position
from rx90_common.description.robot import RobotModel
from rx90_common.friction import FrictionElement
from rx90_common.friction.compiled_elements import prescribed_torque
from rx90_common.friction.element import FRICTION_PARAMETERS, FRICTION_UNITS
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.process.files import write_text
from rx90_common.report.plot import COLOURS, GREY
from rx90_controller.lines.plan import Approach, ApproachedLine, LinePlan, approached, check_plan, plan_line
from rx90_controller.lines.task import LineTask
from rx90_controller.trajectory import JointLimits
from rx90_controller.trajectory.spline import interpolate
from rx90_emulator.view.page import Checker, FileFields, Page, from_user, numbers, on_change, put, sentence
from rx90_emulator.view.plots import Graph, curves_of
from rx90_emulator.view.scene import PLANNED, connect

SET_POINT = 1e-3
"""From one set-point of the controller to the next, s."""
_CHECK_PERIOD = 0.1  # s from one check to the next while somebody types
_AT_REST, _MOVED_AWAY = 1e-4, 1e-2  # rad, from one look to the next; from where it was checked
_WAY_POINTS = 60  # points of the approach
_LARGEST = 1e6  # of what is typed, in its unit; far beyond any arm, and far from what overflows
FIELDS = {"start": (3, "m"), "end": (3, "m"), "speed": (1, "m/s"), "acceleration": (1, "m/s²"), "tool rpy": (3, "deg")}
"""What is typed: how many numbers, and their unit."""


class LinePreview(NamedTuple):
    """A line that can be sent.

    Attributes:
        task: the line itself.
        plan: of it.
        line: with the move to its start.
        approach: the way of the tip to the start of the line, m, shape (n, 3); none where the arm stands there.
    """

    task: LineTask
    plan: LinePlan
    line: ApproachedLine
    approach: Array

    @property
    def share(self) -> Array:
        """Return the peak speeds of the joints along the line, as shares of their limits, shape (n,)."""
        return np.asarray(np.abs(self.plan.velocity).max(axis=0) / self.plan.path.robot.max_velocity)

    def text(self) -> str:
        """Return the line's length, duration and joint speeds in words, for a person who is about to send it."""
        task, name = self.task, self.plan.joint_names
        shares = ", ".join(f"{joint} {share:.0%}" for joint, share in zip(name, self.share, strict=True))
        said = f"{task.length:.3f} m in {task.profile().duration:.2f} s"
        if self.line.approach > 0.0:
            way = math.degrees(self.line.way)
            said += f", after an approach of {self.line.approach:.2f} s ({self.line.farthest} by {way:.0f} deg)"
        fastest = name[int(np.argmax(self.share))]
        return f"{said}. Fastest: {fastest}. Peak joint speeds, as shares of their limits: {shares}."


def typed_line(task: LineTask) -> list[str]:
    """Return a line as one would type it, in the order of FIELDS."""
    turn = [math.degrees(angle) for angle in task.start_rpy]
    lists = (task.start, task.end, [task.speed], [task.acceleration], turn)
    return [" ".join(f"{value:.6g}" for value in values) for values in lists]


class LineForm:
    """Fields for start, end, speed, acceleration and tool; a line that says what comes of them; a button to send it.

    Args:
        page: to build in, within a tab.
        robot: the arm with its tool.
        limits: the controller's.
        task: what stands in the fields at first, and the solution of the inverse kinematics that is taken.
        send: takes a line that was checked, when the button is pressed.
    """

    def __init__(
        self, page: Page, robot: RobotModel, limits: JointLimits, task: LineTask, send: Callable[[LinePreview], None]
    ) -> None:
        self._robot, self._limits, self._branch, self._send = robot, limits, task.branch, send
        self._here: Array | None = None
        self._checked_from: Array | None = None
        self._missing = ""
        self._wanted = False
        self._preview: LinePreview | None = None
        labels = (f"{what}, {unit}" for what, (_, unit) in FIELDS.items())
        self._fields = [page.gui.add_text(*given) for given in zip(labels, typed_line(task), strict=True)]
        self._checker: Checker[tuple[list[str], Array | None], LinePreview] = Checker(
            page, lambda given: self.preview(*given), self._show, _CHECK_PERIOD
        )
        self.close = self._checker.close
        self._button = page.gui.add_button("Send the line", disabled=True)
        self._reason = page.gui.add_html("")
        nowhere = np.zeros((1, 2, 3), dtype=np.float32)
        self._line, self._approach = (
            page.add_lines(f"/panel/{name}", nowhere, PLANNED, thickness=thickness, visible=False)
            for name, thickness in (("line", 3.0), ("approach", 1.5))
        )
        for field in self._fields:
            on_change(field, self._give, page)
        # Checked again before it is sent: the arm may have moved since.
        self._button.on_click(from_user(partial(self._give, wanted=True), page))
        self._give()

    def follow(self, here: Array | None, missing: str) -> None:
        """Take the arm's position, rad, shape (n,), None if unknown, and what is missing to send a line, if anything.

        Where the arm has come to rest elsewhere, the approach is planned anew.
        """
        stands = here is not None and self._here is not None and np.abs(here - self._here).max() < _AT_REST
        self._here, self._missing = here, missing
        before = self._checked_from
        if stands and here is not None and (before is None or np.abs(here - before).max() > _MOVED_AWAY):
            self._give(wanted=self._wanted)
        self._enable()

    def preview(self, typed: Sequence[str], here: Array | None) -> LinePreview:
        """Plan and check a typed line, with the move to it.

        Args:
            typed: the line, in the order of FIELDS.
            here: where the arm stands, rad, shape (n,); None: nobody knows, it is at the line's start.

        Raises:
            LineError: naming a value and what is accepted, or where on the line the arm cannot go and why.
        """
        found = []
        for (what, (count, unit)), text in zip(FIELDS.items(), typed, strict=True):
            values = numbers(text)
            if len(values) != count or not all(abs(value) <= _LARGEST for value in values):
                accepted = "a number" if count == 1 else f"{count} numbers"
                raise LineError(f"{what} is {quoted(text)}; accepted: {accepted}, {unit}, up to {_LARGEST:g}")
            found.append(tuple(values))
        start, end, (speed,), (acceleration,), turn = found
        turn = tuple(map(math.radians, turn))
        task = LineTask(start, end, speed, acceleration, turn, turn, branch=self._branch)
        plan = plan_line(self._robot, task, SET_POINT)
        check_plan(plan, self._limits, SET_POINT, plan.start_pose)
        line = approached(plan, plan.start_pose if here is None else here, self._limits, SET_POINT, Approach())
        way = np.empty((0, 3))
        if here is not None and line.approach > 0.0:
            rest = np.zeros((2, len(here)))
            motion = interpolate(np.array([0.0, line.approach]), np.stack([here, plan.start_pose]), rest, rest)
            way = tip_position(self._robot.chain, motion.sample(np.linspace(0.0, line.approach, _WAY_POINTS))[:, 0])
        return LinePreview(task, plan, line, way)

    def _give(self, *, wanted: bool = False) -> None:
        self._wanted, self._preview, self._checked_from = wanted, None, self._here
        self._enable()
        self._checker.give(([field.value for field in self._fields], self._here))

    def _show(self, found: LinePreview | None) -> str:
        wanted, self._wanted = self._wanted, False
        self._preview = found
        self._line.visible, self._approach.visible = found is not None, found is not None and len(found.approach) > 0
        self._enable()
        if found is None:
            return ""
        connect(self._line, np.array([found.task.start, found.task.end]))
        if len(found.approach):
            connect(self._approach, found.approach)
        if wanted and not self._missing:
            self._send(found)
        return found.text()

    def _enable(self) -> None:
        self._reason.content = sentence(f"cannot be sent: {self._missing}") if self._missing else ""
        self._button.disabled = self._preview is None or bool(self._missing)


_NAMES = [parameter.name for parameter in FRICTION_PARAMETERS]
_CURVE_PERIOD = 0.05  # s
_STRIBECK_SPAN = 20.0  # Stribeck velocities, the reach of the curve
_FACTOR_RANGE = (0.2, 5.0, 0.01)  # least, largest, step of the slider
_FILE = "friction_changed.yaml"
_MICRO = 1e6
_CURVE_POINTS = 160  # points for each sign of the velocity
_STEPS_PER_LEG = 120  # steps from one reversal to the other
_COLOURS = {"file": GREY, "changed": COLOURS[0]}
_Curves = tuple[Array, list[Array]]  # abscissa and ordinates
_PERIOD = 2.0  # s, of the motion to and fro: so slow that what is seen is the bristle, not c1 and c2


def stribeck_curve(element: FrictionElement, top: float) -> tuple[Array, Array]:
    """Return velocities up to `top` of either sign, rad/s, dense where it is small, and steady torque, Nm, (n,)."""
    speed = top * np.linspace(0.0, 1.0, _CURVE_POINTS + 1)[1:] ** 3
    velocity = np.concatenate([-speed[::-1], [0.0], speed])
    return velocity, np.asarray(element.steady_torque(velocity))


def presliding_loop(element: FrictionElement, amplitude: float) -> tuple[Array, Array, Array]:
    """Return the closed loop between two reversals, by the steps of the simulation.

    It is the displacement, rad, and the torques forth and back, Nm, each of shape (n,).

    Args:
        element: the element.
        amplitude: half the way from one reversal to the other, rad.
    """
    legs = 41  # of which the first is half a way, and the last two have forgotten it
    step = _PERIOD / 2.0 / _STEPS_PER_LEG
    sign = np.repeat((-1.0) ** np.arange(legs), _STEPS_PER_LEG)[_STEPS_PER_LEG // 2 :]
    velocity = sign * 2.0 * amplitude / (_STEPS_PER_LEG * step)
    torque = prescribed_torque((element,), velocity[:, None], np.full(velocity.size, step))[:, 0]
    back, forth = torque[-2 * _STEPS_PER_LEG : -_STEPS_PER_LEG], torque[-_STEPS_PER_LEG:]
    middle = amplitude * ((np.arange(_STEPS_PER_LEG) + 0.5) * 2.0 / _STEPS_PER_LEG - 1.0)
    return middle, forth, back[::-1]


def changed(file: FrictionFile, name: str, values: Mapping[str, float]) -> FrictionFile:
    """Return a friction file with attributes of one element changed by hand, which its head says.

    Raises:
        ConfigError: for a value that the element refuses, with what is accepted.
    """
    before = file.elements[name]
    element = replace(before, **values)  # type: ignore[arg-type]  # of the parameters that are numbers
    edits = [
        f"{name}.{key} from {getattr(before, key):g} to {getattr(element, key):g} {unit}"
        for key, unit in FRICTION_UNITS.items()
        if getattr(element, key) != getattr(before, key)
    ]
    if not edits:
        return file
    of_file = f"the other values {file.provenance or 'of unknown provenance'}"
    source = f"changed by hand: {', '.join(edits)}; {of_file}: {file.source or 'no source'}"
    return FrictionFile({**file.elements, name: element}, "assumed", source, joints=file.joints)


def typed_values(element: FrictionElement, factor: float = 1.0) -> list[str]:
    """Return what one would type for an element whose values are times a factor, in the order of the table."""
    lists = ([getattr(element, name) for name in parameter.attributes] for parameter in FRICTION_PARAMETERS)
    texts = ([f"{value * factor:.6g}" for value in values] for values in lists)
    return [" ".join(dict.fromkeys(words)) for words in texts]


def read_values(texts: Sequence[str]) -> dict[str, float]:
    """Return the attributes of FrictionElement that the fields say, in the order of the table.

    Raises:
        ConfigError: for what is no number, naming parameter, text and what is accepted.
    """
    found: dict[str, float] = {}
    for parameter, text in zip(FRICTION_PARAMETERS, texts, strict=True):
        values = numbers(text)
        if len(values) == 1:
            values *= len(parameter.attributes)
        if len(values) != len(parameter.attributes):
            pair = ", or two for the signs of the velocity" if parameter.signed else ""
            raise ConfigError(f"{parameter.name} is {quoted(text)}; accepted: {parameter.accepted}{pair}")
        found |= zip(parameter.attributes, values, strict=True)
    return found


class ElementForm:
    """Fields, a slider, two plots and the file of one element at a time.

    Args:
        page: to build in, within a tab.
        file: the robot's friction file.
        start_with: has the simulation started again with a friction file; takes its path.
    """

    def __init__(self, page: Page, file: FrictionFile, start_with: Callable[[str], None]) -> None:
        self._file, self._start_with = file, start_with
        self._result, self._missing = file, ""
        gui = page.gui
        self._element = gui.add_dropdown("element", list(file.elements))
        self._slid_one = gui.add_dropdown("slide", _NAMES)
        self._factor = gui.add_slider("times the file's", *_FACTOR_RANGE, 1.0)
        self._factor_taken = 1.0  # another value is one that a user has just given, and is taken next
        self._graphs = []
        for title, x, ways in (
            ("steady torque [Nm]", "velocity [rad/s]", ("",)),
            ("presliding torque [Nm]", "displacement [µrad]", (", to", ", fro")),
        ):
            labels = [(f"{of}{way}", colour) for of, colour in _COLOURS.items() for way in ways]
            curves = [replace(curves_of([label])[0], colour=colour) for label, colour in labels]
            self._graphs.append(Graph(page, title, curves, x=x))
        self._way = gui.add_slider("way / break-away", 0.1, 5.0, 0.1, 1.0)
        self._checker = Checker(page, self._compute, self._show, _CURVE_PERIOD)
        self.close = self._checker.close
        self._fields = []
        for one in FRICTION_PARAMETERS:
            pair = "; one value, or two: positive and negative" if one.signed else ""
            label = one.name if one.unit == "1" else f"{one.name}, {one.unit}"
            self._fields.append(gui.add_text(label, "", hint=f"{one.meaning}; {one.accepted}{pair}"))
        self._yaml = gui.add_markdown("")
        self._files = FileFields(
            page,
            "friction file",
            _FILE,
            {"Write the file": ("", self._save), "Start the simulation again with it": ("", self._save_and_start)},
            "A simulation reads its friction when it is configured: time begins again at 0.",
        )
        self._write, self._start = self._files.buttons
        on_change(self._element, self._choose, page)
        on_change(self._slid_one, self._slide_another, page)
        on_change(self._factor, self._slide, page)
        on_change(self._way, self._give, page)
        for field in self._fields:
            on_change(field, self._give, page)
        self._choose()

    def follow(self, missing: str) -> None:
        """Take what the simulation cannot be started again without, if anything."""
        self._missing = missing
        self._start.disabled = bool(missing) or self._write.disabled

    def tell(self, text: str, wrong: bool) -> None:
        """Say how a start of the simulation with the file has gone."""
        self._files.said.content = sentence(text, wrong=wrong)

    def _choose(self) -> None:
        for field, text in zip(self._fields, typed_values(self._file.elements[self._element.value]), strict=True):
            put(field, text)
        self._slide_another()
        self._give()

    def _slide_another(self) -> None:
        if self._factor.value == self._factor_taken:
            self._factor_taken = 1.0
            put(self._factor, 1.0)

    def _slide(self) -> None:
        self._factor_taken = self._factor.value
        index = _NAMES.index(self._slid_one.value)
        put(self._fields[index], typed_values(self._file.elements[self._element.value], self._factor.value)[index])
        self._give()

    def _give(self) -> None:
        self._write.disabled = self._start.disabled = True  # the file would be of other values
        self._files.withdraw()
        self._checker.give((self._element.value, [field.value for field in self._fields], self._way.value))

    def _compute(self, given: tuple[str, list[str], float]) -> tuple[str, FrictionFile, list[_Curves]]:
        """Compute on a thread of its own: the first time, kernels are compiled."""
        name, texts, way = given
        file = changed(self._file, name, read_values(texts))
        before, after = self._file.elements[name], file.elements[name]
        top = _STRIBECK_SPAN * before.omega_s
        amplitude = way * max(before.tau_s_positive, before.tau_s_negative) / before.c0  # of the linear bristle
        curves = [stribeck_curve(element, top) for element in (before, after)]
        loops = [presliding_loop(element, amplitude) for element in (before, after)]
        loop = loops[0][0] * _MICRO, [leg for _, *legs in loops for leg in legs]
        return name, file, [(curves[0][0], [torque for _, torque in curves]), loop]

    def _show(self, found: tuple[str, FrictionFile, list[_Curves]] | None) -> str:
        if found is None:
            return ""
        self._write.disabled = False
        self.follow(self._missing)
        name, file, curves = found
        element, self._result = file.elements[name], file
        for graph, curve in zip(self._graphs, curves, strict=True):
            graph.show(*curve)
        lines = FrictionFile({name: element}, file.provenance, file.source).text().splitlines(keepends=True)
        self._yaml.content = f"```yaml\n{''.join(line for line in lines if not line.startswith('#'))}```"
        without = f"; the plots are without {', '.join(element.parts)}" * bool(element.parts)
        return f"{file.provenance or 'unknown'}: {file.source or 'no source'}{without}"

    def _save(self, path: Path) -> str:
        write_text(path, self._result.text())
        return f"written; for the next start: -p friction:={path}"

    def _save_and_start(self, path: Path) -> str:
        self._save(path)
        self._start_with(str(path))
        return f"written; the simulation is started again ... -p friction:={path}"
