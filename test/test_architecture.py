"""The arrows between the rooms, and what keeps a room readable, read from the source itself."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ROOMS = sorted(
    path.parent.name for path in ROOT.glob("*/__init__.py") if path.parent.name.startswith(("rx90_", "friction_"))
)
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for room in ROOMS
    for path in sorted((ROOT / room).rglob("*.py"))
}
ROS = {
    "rclpy",
    "ament_index_python",
    "builtin_interfaces",
    "diagnostic_msgs",
    "rcl_interfaces",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "trajectory_msgs",
}
LONGEST = 450

FRAME = {"rx90_common.executables", "rx90_common.interrupts", "rx90_common.output"}
"""The frame of the command-line tools: signals, standard output."""
MODELS = sorted(
    name
    for name in MODULES
    if (
        name.startswith(("rx90_common", "rx90_description", "rx90_sim.friction", "rx90_controller.trajectory."))
        and name not in FRAME
    )
    or name in {"rx90_sim.manipulator", "rx90_controller.trajectory"}
    or name.startswith(("rx90_sim.plant", "rx90_controller.cs7b"))
)
"""What computes: models, control laws and what they stand on."""
WITHOUT_ROS = sorted({*MODELS, *(name for name in MODULES if name.startswith(("rx90_loop", "rx90_perturbation")))})
PURE = {"abc", "collections", "dataclasses", "enum", "functools", "itertools", "math", "operator", "pathlib", "typing"}
LIBRARIES_OF_MODELS = PURE | {
    "__future__",
    "ctypes",
    "hashlib",
    "importlib",
    "llvmlite",
    "numba",
    "numpy",
    "os",
    "pinocchio",
    "re",
    "sys",
    "xml",
    "yaml",
}
"""Nothing in this list opens a window, a socket or a thread."""


@cache
def imports(name: str) -> frozenset[str]:
    """Return the dotted names that a module imports anywhere, also inside functions."""
    found = set()
    tree = ast.parse(MODULES[name].read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name} imports relatively"
            base = node.module or ""
            found.add(base)
            found.update(f"{base}.{alias.name}" for alias in node.names if f"{base}.{alias.name}" in MODULES)
    return frozenset(found)


def reached(name: str) -> set[str]:
    """Return all modules of the project that importing `name` brings in, itself included."""
    seen, todo = set(), [name]
    while todo:
        module = todo.pop()
        if module in seen or module not in MODULES:
            continue
        seen.add(module)
        parts = module.split(".")
        todo.extend(".".join(parts[:n]) for n in range(1, len(parts)))
        todo.extend(imports(module))
    return seen


def packages(name: str) -> set[str]:
    """Return the top-level packages that a module imports."""
    return {imported.split(".")[0] for imported in imports(name)}


def rooms_reached(name: str) -> set[str]:
    """Return the rooms that importing `name` brings in."""
    return {module.split(".")[0] for module in reached(name)}


def test_the_lists_are_not_empty() -> None:
    """The rooms of the models are found, so that the tests below test something."""
    assert {"rx90_common", "rx90_controller", "rx90_description", "rx90_loop", "rx90_sim"} <= set(ROOMS)
    assert {"rx90_sim.plant_step", "rx90_controller.cs7b_law", "rx90_common.config"} <= set(MODELS)
    assert "rx90_sim.friction.bristle" in reached("rx90_loop.closed_loop")


@pytest.mark.parametrize("name", WITHOUT_ROS)
def test_models_and_the_closed_loop_know_no_ros(name: str) -> None:
    """Importing a model, a control law or the closed loop brings in no ROS package, however indirectly."""
    users = {module: packages(module) & ROS for module in reached(name)}
    # The share folder looks for the ament index where there is one, and works without.
    users.pop("rx90_common.share", None)
    assert {module: used for module, used in users.items() if used} == {}


@pytest.mark.parametrize("name", MODELS)
def test_models_stand_on_numerical_libraries_only(name: str) -> None:
    """A model imports numpy, numba, Pinocchio and the plain standard library, and rooms below it."""
    allowed = LIBRARIES_OF_MODELS | set(ROOMS)
    if name == "rx90_common.share":
        allowed = allowed | {"ament_index_python"}
    assert packages(name) <= allowed


@pytest.mark.parametrize("name", sorted(MODULES))
def test_simulation_and_controller_do_not_know_each_other(name: str) -> None:
    """Nothing in rx90_sim reaches rx90_controller, nor the other way round."""
    room = name.partition(".")[0]
    other = {"rx90_sim": "rx90_controller", "rx90_controller": "rx90_sim"}.get(room)
    if other is not None:
        assert other not in rooms_reached(name)


BELOW: dict[str, set[str]] = {
    "rx90_common": set(),
    "rx90_description": {"rx90_common"},
    "rx90_sim": {"rx90_common", "rx90_description", "rx90_exchange"},
    "rx90_controller": {"rx90_common", "rx90_description", "rx90_exchange"},
}
"""Which rooms a room may import; the rooms above these may import all of them."""


@pytest.mark.parametrize("room", BELOW)
def test_arrows_point_one_way(room: str) -> None:
    """The lower rooms import only what lies below them: never the closed loop, a tool or the demonstration."""
    for name in MODULES:
        if name.partition(".")[0] == room:
            assert packages(name) & set(ROOMS) <= BELOW[room] | {room}, name


def test_models_do_not_import_nodes() -> None:
    """What computes never imports what exchanges messages."""
    for name in MODELS:
        assert "rx90_exchange" not in rooms_reached(name), name


def test_no_modules_import_each_other_in_a_circle() -> None:
    """The modules can be put in an order in which each imports only earlier ones."""
    plain = {name for name, path in MODULES.items() if path.name != "__init__.py"}
    order = TopologicalSorter({name: imports(name) & plain for name in plain})
    assert len(list(order.static_order())) == len(plain)


@pytest.mark.parametrize("name", sorted(MODULES))
def test_a_module_can_be_read_at_one_sitting(name: str) -> None:
    """No module is longer than 450 lines, and each says in its first line what it holds."""
    text = MODULES[name].read_text(encoding="utf-8")
    assert text.count("\n") <= LONGEST
    assert ast.get_docstring(ast.parse(text))


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef]:
    """Yield all functions of a module."""
    yield from (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))


@pytest.mark.parametrize("name", sorted(MODULES))
def test_parameters_are_frozen(name: str) -> None:
    """Dataclasses that are checked where they are built are frozen, so that they stay as checked."""
    for node in ast.walk(ast.parse(MODULES[name].read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ClassDef):
            continue
        checked = any(function.name == "__post_init__" for function in functions(node))
        for decorator in node.decorator_list:
            if isinstance(decorator, ast.Name) and decorator.id == "dataclass":
                assert not checked, f"{name}.{node.name}"
            if isinstance(decorator, ast.Call) and getattr(decorator.func, "id", "") == "dataclass" and checked:
                frozen = {k.arg: k.value for k in decorator.keywords}.get("frozen")
                assert isinstance(frozen, ast.Constant), f"{name}.{node.name}"
                assert frozen.value is True, f"{name}.{node.name}"


def test_there_is_one_plant_step_and_one_law() -> None:
    """Each kernel of the plant and of the law is defined once in the whole project."""
    owners: dict[str, list[str]] = {}
    for name, path in MODULES.items():
        for function in functions(ast.parse(path.read_text(encoding="utf-8"))):
            if function.name in {"plant_step", "bristle_step", "mass_and_bias", "position_loop", "velocity_loop"}:
                owners.setdefault(function.name, []).append(name)
    assert owners == {
        "plant_step": ["rx90_sim.plant_step"],
        "bristle_step": ["rx90_sim.friction.bristle"],
        "mass_and_bias": ["rx90_sim.manipulator"],
        "position_loop": ["rx90_controller.cs7b_law"],
        "velocity_loop": ["rx90_controller.cs7b_law"],
    }


def test_compiled_code_keeps_its_bits() -> None:
    """No kernel uses fastmath or threads: the same numbers must come out wherever it is inlined."""
    for name, path in MODULES.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.keyword):
                assert node.arg not in {"fastmath", "parallel"}, name


@pytest.mark.parametrize("path", sorted((ROOT / "test").rglob("test_*.py")), ids=lambda p: p.stem)
def test_every_test_says_what_it_proves(path: Path) -> None:
    """Every test's docstring is one sentence naming a property."""
    for function in functions(ast.parse(path.read_text(encoding="utf-8"))):
        if function.name.startswith("test_"):
            text = ast.get_docstring(function)
            assert text, f"{path.name}: {function.name}"
            assert text.splitlines()[0].endswith("."), f"{path.name}: {function.name}"
