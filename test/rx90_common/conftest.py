"""Arms for the tests of this package."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest


def _inertial(rng: np.random.Generator) -> str:
    # Eight point masses: the moments keep the triangle inequality, and the products are not 0.
    points = rng.normal(size=(8, 3)) * 0.1
    spread = (points - points.mean(axis=0)).T @ (points - points.mean(axis=0)) * rng.uniform(1.0, 5.0)
    inertia = np.trace(spread) * np.eye(3) - spread
    tensor = " ".join(f'i{"xyz"[i]}{"xyz"[j]}="{inertia[i, j]}"' for i in range(3) for j in range(i, 3))
    return (
        f'<inertial><origin xyz="{_t(rng.normal(size=3) * 0.1)}" rpy="{_t(rng.uniform(-3, 3, 3))}"/>'
        f'<mass value="{rng.uniform(0.2, 30.0)}"/><inertia {tensor}/></inertial>'
    )


def _t(values: np.ndarray) -> str:
    return " ".join(repr(float(v)) for v in values)


@pytest.fixture
def random_arm(tmp_path: Path) -> Callable[[int], Path]:
    def write(seed: int) -> Path:
        rng = np.random.default_rng(seed)
        parts = ['<robot name="random"><link name="ground"/>']
        above = "ground"
        # The names descend, so that only the tree gives the order of the chain.
        for i in range(6):
            name = f"part_{9 - i}"
            axis = rng.normal(size=3)
            parts.append(
                f'<link name="{name}">{_inertial(rng)}</link><joint name="turn_{9 - i}" type="revolute">'
                f'<origin xyz="{_t(rng.normal(size=3) * 0.3)}" rpy="{_t(rng.uniform(-3, 3, 3))}"/>'
                f'<parent link="{above}"/><child link="{name}"/><axis xyz="{_t(axis)}"/>'
                f'<limit lower="-2" upper="{1.5 + 0.1 * i}" velocity="{2 + i}" effort="{10 + i}"/></joint>'
            )
            above = name
        for name, parent in (("cover", "part_7"), ("tool0", above)):
            parts.append(
                f'<link name="{name}">{_inertial(rng)}</link><joint name="{name}_fixed" type="fixed">'
                f'<origin xyz="{_t(rng.normal(size=3) * 0.1)}" rpy="{_t(rng.uniform(-3, 3, 3))}"/>'
                f'<parent link="{parent}"/><child link="{name}"/></joint>'
            )
        file = tmp_path / f"random_{seed}.urdf"
        file.write_text("\n".join([*parts, "</robot>"]), encoding="utf-8")
        return file

    return write
