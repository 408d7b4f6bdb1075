"""A friction element to play with: its parameters as fields, its curves, and the friction file that comes of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import quoted
from rx90_common.friction import FrictionElement
from rx90_common.friction.element import FRICTION_PARAMETERS, FRICTION_UNITS
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.tracing import prescribed_torque
from rx90_common.process.files import write_text
from rx90_common.report.plot import COLOURS, GREY
from rx90_emulator.view.page import Checker, FileFields, Page, numbers, on_change, put, sentence
from rx90_emulator.view.plots import Graph, curves_of

_NAMES = [parameter.name for parameter in FRICTION_PARAMETERS]
_INTERVAL = 0.05  # s
_TOP = 20.0  # Stribeck velocities, the reach of the curve
_FACTORS = (0.2, 5.0, 0.01)  # least, largest, step of the slider
_FILE = "friction_changed.yaml"
_MICRO = 1e6
_CURVE = 160  # points for each sign of the velocity
_LEG = 120  # steps from one reversal to the other
_COLOURS = {"file": GREY, "changed": COLOURS[0]}
_Curves = tuple[Array, list[Array]]  # abscissa and ordinates
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
        self._factor = gui.add_slider("times the file's", *_FACTORS, 1.0)
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
        self._checker = Checker(page, self._compute, self._show, _INTERVAL)
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
        top, amplitude = _TOP * before.omega_s, way * break_away(before)
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
