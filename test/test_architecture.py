"""The rule of the house, read off its folders: arrows point down, and ROS stays where it belongs.

The roof bears the ROS package's name, rooms have a folder `node/`, the rest is the ground.
"""

import ast
import re
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from xml.etree import ElementTree

from rx90_common.process.requirements import SOURCES, is_ros
from rx90_emulator.cli.frame import EXECUTABLES

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = sorted(path.parent.name for path in ROOT.glob("*/py.typed"))
ROOF = str(ElementTree.parse(ROOT / "package.xml").findtext("name"))
ROOMS = [name for name in PACKAGES if (ROOT / name / "node").is_dir()]
GROUND = next(name for name in PACKAGES if name != ROOF and name not in ROOMS)
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for package in PACKAGES
    for path in sorted((ROOT / package).rglob("*.py"))
}
_ROS = re.compile(r"(rcl|rosidl|rosbag2|ament|launch|tf2|unique_identifier)\w*|\w+_(msgs|srvs|interfaces|ros|py)")
_NAMED = rf"(?:{'|'.join(PACKAGES)})(?:\.\w+)+"
_DOTTED = re.compile(rf"({_NAMED})(?::\w+)?")  # as `-m` and entry points take it
_PLAIN = {"__future__", "abc", "bisect", "collections", "copy", "dataclasses", "enum", "functools", "itertools", "math"}
_NUMERICAL = {*_PLAIN, "operator", "pathlib", "types", "typing", "numpy", "numba", "pydantic", "scipy", *PACKAGES}
_PLANNING = "rx90_controller.lines.postures"  # inverse kinematics of any arm: before the motion, by Pinocchio
_KERNELS = {"plant_step", "bristle_step", "mass_and_bias", "position_loop", "velocity_loop"}


@cache
def nodes(name: str) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(ast.parse(MODULES[name].read_text(encoding="utf-8"))))


@cache
def imports(name: str) -> frozenset[str]:
    """Return the dotted names that a module imports anywhere, and those that stand whole in its strings."""
    found = set()
    for node in nodes(name):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name} imports relatively"
            found.update({str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)})
        elif isinstance(node, ast.Constant) and (match := _DOTTED.fullmatch(str(node.value))):
            found.add(match[1])
    return frozenset(found)


def owner(dotted: str) -> str | None:
    """Return the module that a dotted name stands for: the module itself, or the one that holds the name."""
    parts = dotted.split(".")
    return next((name for n in range(len(parts), 0, -1) if (name := ".".join(parts[:n])) in MODULES), None)


def arrows(name: str) -> set[str]:
    return {target for dotted in imports(name) if (target := owner(dotted)) is not None and target != name}


def reached(name: str) -> set[str]:
    seen, todo = set(), [name]
    while todo:
        if (module := todo.pop()) not in seen:
            seen.add(module)
            todo.extend(arrows(module))
    return seen


def top_level(name: str) -> set[str]:
    return {imported.split(".")[0] for imported in imports(name)}


def ros(name: str) -> set[str]:
    return {imported for imported in top_level(name) if _ROS.fullmatch(imported)} - {"ament_index_python"}


def speaks_ros(name: str) -> bool:
    """Return whether a module lies where ROS may be imported: a room's node/, the ground's exchange/, the recorder."""
    places = (*(f"{room}.node" for room in ROOMS), f"{GROUND}.exchange", f"{GROUND}.bags.recorder")
    return f"{name}.".startswith(tuple(f"{place}." for place in places))


def test_the_house_is_found() -> None:
    """Ground, rooms and roof are read off the folders, and arrows are seen, so that the tests below test something."""
    assert (GROUND, ROOMS, ROOF) == ("rx90_common", ["friction_bench", "rx90_controller", "rx90_sim"], "rx90_emulator")
    assert "rx90_common.friction.bristle" in reached("rx90_emulator.loop.closed_loop")
    assert "rclpy" in ros("rx90_common.exchange.lifecycle")


def test_arrows_point_down() -> None:
    """The ground imports only itself, a room itself and the ground; no module reaches itself."""
    for name in MODULES:
        own = name.split(".")[0]
        below = {*PACKAGES} if own == ROOF else {GROUND, own}
        assert {target for target in arrows(name) if target.split(".")[0] not in below} == set(), name
    plain = {name for name, path in MODULES.items() if path.name != "__init__.py"}
    assert len(list(TopologicalSorter({name: arrows(name) & plain for name in plain}).static_order())) == len(plain)


def test_ros_is_imported_in_few_places() -> None:
    """Only a room's node/, the ground's exchange/ and the recorder import ROS; models stand on numerical libraries."""
    for name in MODULES:
        if not speaks_ros(name):
            assert ros(name) == set(), name
            if name.split(".")[0] in ROOMS:
                assert {target for target in reached(name) if ros(target)} == set(), name
            if name.split(".")[0] in {"rx90_sim", "rx90_controller"}:
                assert top_level(name) <= _NUMERICAL | ({"pinocchio"} if name == _PLANNING else set()), name


def test_every_package_that_is_imported_has_a_source() -> None:
    """What users are told where a package is missing covers each that is imported, and no other."""
    imported = {"distributed"}.union(*map(top_level, MODULES))  # by its name in a string: most sweeps do without it
    own = {*PACKAGES, *sys.stdlib_module_names, "compression"}  # the last of Python 3.14
    assert {name for name in imported - own if not is_ros(name)} == set(SOURCES)


def test_there_is_one_plant_step_and_one_law() -> None:
    """Each kernel of plant and law is defined once, one module reads YAML, and no kernel uses fastmath or threads."""
    functions = [node.name for name in MODULES for node in nodes(name) if isinstance(node, ast.FunctionDef)]
    assert sorted(name for name in functions if name in _KERNELS) == sorted(_KERNELS)
    assert [name for name in MODULES if "yaml" in top_level(name)] == [f"{GROUND}.base.config"]
    options = {node.arg for name in MODULES for node in nodes(name) if isinstance(node, ast.keyword)}
    assert options & {"fastmath", "parallel"} == set()


def test_what_pages_name_is_there() -> None:
    """Every module and file that a build file or a document names exists; every command that it names is installed."""
    folders = rf"(?:{'|'.join(PACKAGES)}|config|docs|firmware|launch|benchmarks|tools|test)"
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    for file in (*pages, *(ROOT / name for name in ("setup.py", "pyproject.toml", "Makefile", ".ci/run"))):
        text = file.read_text(encoding="utf-8")
        dotted = set(re.findall(rf"(?<![\w/.])({_NAMED})", text))
        assert {name for name in dotted if owner(name) in {None, *PACKAGES} - {ROOF}} == set(), file
        assert set(re.findall(r"(?<![\w./-])rx90_[a-z_]+(?![\w/])", text)) <= {*PACKAGES, *EXECUTABLES}, file
        paths = re.findall(rf"(?<![\w/.*<-])({folders}/[a-z][\w./-]*(?:\.(?:c|h|md|py|yaml|svg)|/))", text)
        missing = {path for path in paths if "NAME" not in path and not (ROOT / path).exists()}
        assert {path for path in missing if not path.startswith("firmware/build")} == set(), file
