"""A friction element to play with: its parameters as fields, its curves, and the friction file that comes of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from viser import GuiUplotHandle, uplot

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import quoted
from rx90_common.friction import FrictionElement
from rx90_common.friction.element import FRICTION_PARAMETERS, FRICTION_UNITS, FrictionParameter
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.tracing import prescribed_torque
from rx90_common.process.files import write_text
from rx90_common.report.plot import COLOURS, GREY, Curve, Panel
from rx90_emulator.view.page import FileFields, NewestOnly, Page, on_change, put, sentence
from rx90_emulator.view.plots import add_plot

_INTERVAL = 0.05
_TOP = 20.0  # Stribeck velocities, the reach of the curve
_FACTORS = (0.2, 5.0, 0.01)  # least, largest, step of the slider
_FILE = "friction_changed.yaml"
_MICRO = 1e6
_CURVE = 160  # points for each sign of the velocity
_LEG = 120  # steps from one reversal to the other
_PERIOD = 2.0  # s, of the motion to and fro: so slow that what is seen is the bristle, not c1 and c2


def stribeck_curve(element: FrictionElement, top: float) -> tuple[Array, Array]:
    """Return velocities up to `top` of either sign, rad/s, dense where it is small, and steady torque, Nm, (n,)."""
    speed = top * np.linspace(0.0, 1.0, _CURVE + 1)[1:] ** 3
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
    step = _PERIOD / 2.0 / _LEG
    sign = np.repeat((-1.0) ** np.arange(legs), _LEG)[_LEG // 2 :]
    velocity = sign * 2.0 * amplitude / (_LEG * step)
    torque = prescribed_torque((element,), velocity[:, None], np.full(velocity.size, step))[:, 0]
    back, forth = torque[-2 * _LEG : -_LEG], torque[-_LEG:]
    middle = amplitude * ((np.arange(_LEG) + 0.5) * 2.0 / _LEG - 1.0)
    return middle, forth, back[::-1]


def break_away(element: FrictionElement) -> float:
    """Return the displacement at which the linear bristle has the static torque, rad."""
    return max(element.tau_s_positive, element.tau_s_negative) / element.c0


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
    return FrictionFile({**file.elements, name: element}, "assumed", source)


def typed_values(element: FrictionElement, factor: float = 1.0) -> tuple[str, ...]:
    """Return what one would type for an element whose values are times a factor, in the order of the table."""
    texts = []
    for parameter in FRICTION_PARAMETERS:
        words = [f"{getattr(element, name) * factor:.6g}" for name in parameter.attributes]
        texts.append(" ".join(words if len(set(words)) > 1 else words[:1]))
    return tuple(texts)


def read_values(texts: Sequence[str]) -> dict[str, float]:
    """Return the attributes of FrictionElement that the fields say, in the order of the table.

    Raises:
        ConfigError: for what is no number, naming parameter, text and what is accepted.
    """
    values: dict[str, float] = {}
    for parameter, text in zip(FRICTION_PARAMETERS, texts, strict=True):
        try:
            numbers = [float(word) for word in text.replace(",", " ").split()]
        except ValueError:
            numbers = []
        if len(numbers) == 1:
            numbers *= len(parameter.attributes)
        if len(numbers) != len(parameter.attributes):
            pair = ", or two for the signs of the velocity" if parameter.signed else ""
            raise ConfigError(f"{parameter.name} is {quoted(text)}; accepted: {parameter.accepted}{pair}")
        values |= zip(parameter.attributes, numbers, strict=True)
    return values


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
        names = list(file.elements)
        self._element = page.gui.add_dropdown("element", names)
        self._slid_one = page.gui.add_dropdown("slide", [p.name for p in FRICTION_PARAMETERS])
        self._factor = page.gui.add_slider("times the file's", *_FACTORS, 1.0)
        self._factor_taken = 1.0  # another value is one that a user has just given, and is taken next
        self._curve = _plot(page, "steady torque [Nm]", "velocity [rad/s]", ("file", "changed"))
        labels = ("file, to", "file, fro", "changed, to", "changed, fro")
        self._loop = _plot(page, "presliding torque [Nm]", "displacement [µrad]", labels)
        self._way = page.gui.add_slider("way / break-away", 0.1, 5.0, 0.1, 1.0)
        self._verdict = page.gui.add_html("")
        self._fields = [page.gui.add_text(_label(p), "", hint=_hint(p)) for p in FRICTION_PARAMETERS]
        self._yaml = page.gui.add_markdown("")
        self._files = FileFields(
            page,
            "friction file",
            _FILE,
            {"Write the file": ("", self._save), "Start the simulation again with it": ("", self._save_and_start)},
            "A simulation reads its friction when it is configured: time begins again at 0.",
        )
        self._write, self._start = self._files.buttons.values()
        self._drawing: NewestOnly[tuple[str, tuple[str, ...], float]] = NewestOnly(page, self._compute, _INTERVAL)
        on_change(self._element, self._chosen, page)
        on_change(self._slid_one, self._slide_another, page)
        on_change(self._factor, self._slid, page)
        on_change(self._way, self._give, page)
        for field in self._fields:
            on_change(field, self._give, page)
        self._chosen()

    def close(self) -> None:
        """End the thread that computes."""
        self._drawing.close()

    def follow(self, missing: str) -> None:
        """Take what the simulation cannot be started again without, if anything."""
        self._missing = missing
        disabled = bool(missing) or self._write.disabled
        if self._start.disabled != disabled:
            self._start.disabled = disabled

    def tell(self, text: str, wrong: bool) -> None:
        """Say how a start of the simulation with the file has gone."""
        self._files.said.content = sentence(text, wrong=wrong)

    def _chosen(self) -> None:
        for field, text in zip(self._fields, typed_values(self._file.elements[self._element.value]), strict=True):
            put(field, text)
        self._slide_another()
        self._give()

    def _slide_another(self) -> None:
        if self._factor.value == self._factor_taken:
            self._factor_taken = 1.0
            put(self._factor, 1.0)

    def _slid(self) -> None:
        self._factor_taken = self._factor.value
        index = [p.name for p in FRICTION_PARAMETERS].index(self._slid_one.value)
        texts = typed_values(self._file.elements[self._element.value], self._factor.value)
        put(self._fields[index], texts[index])
        self._give()

    def _give(self) -> None:
        self._verdict.content = sentence("checking ...")
        self._write.disabled = self._start.disabled = True  # the file would be of other values
        self._files.withdraw()
        texts = tuple(field.value for field in self._fields)
        self._drawing.give((self._element.value, texts, self._way.value))

    def _compute(self, item: tuple[str, tuple[str, ...], float]) -> Callable[[], None]:
        """Compute on a thread of its own: the first time, kernels are compiled."""
        name, texts, way = item
        try:
            file = changed(self._file, name, read_values(texts))
        except ConfigError as error:
            return partial(self._refuse, str(error))
        before, after = self._file.elements[name], file.elements[name]
        top, amplitude = _TOP * before.omega_s, way * break_away(before)
        curves = [stribeck_curve(element, top) for element in (before, after)]
        loops = [presliding_loop(element, amplitude) for element in (before, after)]
        torques = (curves[0][0], *(torque for _, torque in curves))
        loop = (loops[0][0] * _MICRO, *(leg for _, *legs in loops for leg in legs))
        return partial(self._show, name, file, torques, loop)

    def _refuse(self, text: str) -> None:
        self._verdict.content = sentence(text, wrong=True)

    def _show(self, name: str, file: FrictionFile, curve: tuple[Array, ...], loop: tuple[Array, ...]) -> None:
        self._result = file
        self._write.disabled = False
        self.follow(self._missing)
        parts = ", ".join(file.elements[name].parts)
        without = f"; the plots are without {parts}" * bool(parts)
        self._verdict.content = sentence(f"{file.provenance or 'unknown'}: {file.source or 'no source'}{without}")
        self._curve.data, self._loop.data = curve, loop
        one = FrictionFile({name: file.elements[name]}, file.provenance, file.source).text()
        self._yaml.content = f"```yaml\n{_without_comments(one)}```"

    def _save(self, path: Path) -> str:
        write_text(path, self._result.text())
        return f"written; for the next start: -p friction:={path}"

    def _save_and_start(self, path: Path) -> str:
        self._save(path)
        self._start_with(str(path))
        return f"written; the simulation is started again ... -p friction:={path}"


def _hint(parameter: FrictionParameter) -> str:
    pair = "; one value, or two: positive and negative" if parameter.signed else ""
    return f"{parameter.meaning}; {parameter.accepted}{pair}"


def _label(parameter: FrictionParameter) -> str:
    return parameter.name if parameter.unit == "1" else f"{parameter.name}, {parameter.unit}"


def _plot(page: Page, title: str, x: str, labels: Sequence[str]) -> GuiUplotHandle:
    colours = [GREY if label.startswith("file") else COLOURS[0] for label in labels]
    pairs = list(zip(labels, colours, strict=True))
    series = [uplot.Series(label=label, stroke=colour, width=1.5) for label, colour in pairs]

    def panel() -> Panel:
        along, *curves = handle.data
        return Panel([Curve(along, *rest) for rest in zip(curves, labels, colours, strict=True)], "", x, title)

    handle = add_plot(page, title, panel, (uplot.Series(), *series), x=x, height=165)
    return handle


def _without_comments(text: str) -> str:
    return "".join(line for line in text.splitlines(keepends=True) if not line.startswith("#"))
