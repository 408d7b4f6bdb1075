"""Equations 17 to 19 once more, independent of the product, and elements for the tests of friction."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pytest

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.compiled_elements import Elements, element_arrays, lane_of, load_elements
from rx90_common.friction.element import FRICTION_UNITS
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import size


@kernel
def one_element(arrays: Any, index: int) -> Elements:
    """Return one element of a record, in plain numbers."""
    return lane_of(load_elements(arrays, size(arrays.c0)), index)


@dataclass(frozen=True)
class LuGreOracle:
    """Equations 17 to 19, written down from the paper for n elements, for a stiff solver."""

    elements: Sequence[FrictionElement]

    @cached_property
    def _table(self) -> dict[str, Array]:
        """Return the elements' values by name, each shape (n,): a solver asks for them a hundred thousand times."""
        return {name: np.array([element.parameters[name] for element in self.elements]) for name in FRICTION_UNITS}

    def _values(self, name: str) -> Array:
        return self._table[name]

    def stribeck(self, v: Array) -> Array:
        """Return c0 g(v), equation 19."""
        side = [
            np.where(v >= 0, self._values(f"{n}_positive"), self._values(f"{n}_negative")) for n in ("tau_c", "tau_s")
        ]
        coulomb, static = side
        return np.asarray(
            coulomb + (static - coulomb) * np.exp(-((np.abs(v) / self._values("omega_s")) ** self._values("delta")))
        )

    def rates(self, z: Array, v: Array) -> tuple[Array, Array]:
        """Return dz/dt (equation 17) and the friction torque (equation 18)."""
        c0 = self._values("c0")
        z_dot = v - np.abs(v) * c0 / self.stribeck(v) * z
        c1 = self._values("c1") * np.exp(-((v / self._values("omega_d")) ** 2))
        slow = np.maximum(np.abs(v), 1e-3)  # linear below 1 mrad/s
        viscous = self._values("c2") * v / slow * slow ** self._values("alpha")
        return z_dot, c0 * z + c1 * z_dot + viscous


@pytest.fixture(scope="session")
def lugre_oracle() -> type[LuGreOracle]:
    return LuGreOracle


@pytest.fixture(scope="session")
def paper_element() -> FrictionElement:
    """Return the values of Canudas de Wit, Olsson, Astrom, Lischinsky (1995), table 1: N, m, kg, s."""
    return FrictionElement(tau_c=1.0, tau_s=1.5, omega_s=0.001, delta=2.0, c0=1e5, c1=math.sqrt(1e5), c2=0.4)


@pytest.fixture
def record() -> Callable[[FrictionElement], Any]:
    def make(element: FrictionElement) -> Any:
        return one_element(element_arrays((element,))[0], 0)

    return make
