"""Friction elements in compiled code: a record of their parameters, and tuples that formulas read.

`load_elements`, `one_element`, `lane_of` and `with_present` name every parameter once each; they are written here from
the declarations in FrictionElement, so that a new parameter needs no line of its own.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from rx90_common.friction.element import FRICTION_PARAMETERS, SIGNS, FrictionElement
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import lane, load

_SIGNED = {f"{'inverse_' * one.inverse}{one.name}": one.signed for one in FRICTION_PARAMETERS}

Elements: Any = namedtuple("Elements", list(_SIGNED))  # type: ignore[misc]  # declared in FrictionElement
"""One or more elements: numbers of one, or lanes of several; torques as (positive, negative), omega_s and omega_d as
`inverse_omega_s` and `inverse_omega_d`, the others by the names of FrictionElement."""


def elements_dtype(width: int) -> np.dtype[np.void]:
    """Return the type of `width` elements as compiled code reads them: a struct of arrays, the element the last index.

    The fields are those of `Elements`. The torques have a row for each of SIGNS; v = 0 counts as positive.
    """
    shapes = {name: (len(SIGNS), width) if signed else (width,) for name, signed in _SIGNED.items()}
    return np.dtype([(name, np.float64, shape) for name, shape in shapes.items()], align=True)


def element_arrays(elements: Sequence[FrictionElement]) -> np.ndarray[Any, Any]:
    """Return elements as compiled code reads them, shape (1,), dtype `elements_dtype(len(elements))`."""
    arrays = np.zeros(1, elements_dtype(len(elements)))
    for name, parameter in zip(_SIGNED, FRICTION_PARAMETERS, strict=True):
        values = np.array([[getattr(element, name) for element in elements] for name in parameter.attributes])
        arrays[name] = 1.0 / values if parameter.inverse else values
    return arrays


def _written(decorate: Callable[[Any], Any], head: str, value: Callable[[str], str]) -> Any:
    """Return a compiled function with this head that gives Elements of `value` of each of their fields.

    Args:
        decorate: `kernel` or `inlined`.
        head: name and arguments.
        value: text of the value, for the name of a field, of torques with the index of the sign.
    """
    given = [
        f"({value(f'{name}[0]')}, {value(f'{name}[1]')})" if signed else value(name) for name, signed in _SIGNED.items()
    ]
    source = compile(f"def {head}:\n    return Elements({', '.join(given)})\n", __file__, "exec")
    scope = {"Elements": Elements, "load": load, "lane": lane, "__name__": __name__}
    exec(source, scope)
    return decorate(scope[head.partition("(")[0]])


def _place(name: str) -> str:
    """Return the text of one element's place in a record, for the name of a field."""
    return f"arrays.{name.replace(']', ', index]')}" if name.endswith("]") else f"arrays.{name}[index]"


load_elements = _written(inlined, "load_elements(arrays, width)", lambda name: f"load(arrays.{name}, width)")
"""Return all elements of a record of `elements_dtype(width)`, a lane for each; `width` is a literal."""

one_element = _written(kernel, "one_element(arrays, index)", _place)
"""Return one element of such a record, in plain numbers."""

lane_of = _written(inlined, "lane_of(element, index)", lambda name: f"lane(element.{name}, index)")
"""Return one of several elements that are lanes, in plain numbers."""

_PRESENT = ("tau_c", "tau_s", "inverse_omega_s", "c2")
with_present = _written(
    inlined,
    f"with_present(element, {', '.join(_PRESENT)})",
    lambda name: name if name.partition("[")[0] in _PRESENT else f"element.{name}",
)
"""Return elements with others in place of those that the parts change from step to step."""
