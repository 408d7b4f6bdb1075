"""The rule of the house, read off its folders: arrows point down, and every folder says what others may use.

The roof is the package that bears the ROS package's name, the rooms are the packages with a folder `node/`, the ground
is what is left. The roof may import all of them, a room the ground, the ground itself alone.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from xml.etree import ElementTree

import pytest

from rx90_common.base.requirements import SOURCES, is_ros
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
FOLDERS = sorted(name for name, path in MODULES.items() if path.name == "__init__.py")
_ROS = re.compile(r"(rcl|rosidl|rosbag2|ament|launch|tf2|unique_identifier)\w*|\w+_(msgs|srvs|interfaces|ros|py)")
LONGEST = 500
MOST_POSITIONAL = 7
PLAIN = {
    "__future__",
    "abc",
    "collections",
    "copy",
    "dataclasses",
    "enum",
    "functools",
    "itertools",
    "math",
    "operator",
}
PLAIN |= {"pathlib", "types", "typing"}
_NAMED = rf"(?:{'|'.join(PACKAGES)})(?:\.\w+)+"
_DOTTED = re.compile(rf"({_NAMED})(?::\w+)?")  # as `-m` and entry points take it
_BEGUN = re.compile(rf"((?:{'|'.join(PACKAGES)})(?:\.\w+)*)\.")  # of an f-string that ends with a module's name
_BUILD_FILES = ["setup.py", "setup.cfg", "pyproject.toml", "Makefile", ".ci/run"]
_PAGES = [
    str(page.relative_to(ROOT))
    for page in (
        *ROOT.glob("*.md"),
        *ROOT.glob("*.rst"),
        *(p for d in ("docs", "firmware", "test") for p in (ROOT / d).rglob("*.md")),
    )
]
_FILES = (".launch.py", ".stamp")  # files' names that look like modules
_OUTSIDE = sorted(
    path for folder in ("benchmarks", "launch", "tools", "test") for path in (ROOT / folder).rglob("*.py")
)


@pytest.fixture(scope="module", autouse=True)
def _trees() -> Iterator[None]:
    """Let go of the syntax trees when the tests of this file are over: they are large."""
    yield
    tree_of.cache_clear()


@cache
def tree_of(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def parse(name: str) -> ast.Module:
    """Return the syntax tree of a module."""
    return tree_of(MODULES[name])


def owner(dotted: str) -> str | None:
    """Return the module that a dotted name stands for: the module itself, or the one that holds the name."""
    while dotted and dotted not in MODULES:
        dotted = dotted.rpartition(".")[0]
    return dotted or None


@cache
def imports(name: str, strings: bool = True) -> frozenset[str]:
    """Return the dotted names that a module imports anywhere, also inside functions, and those in its strings."""
    found = set()
    for node in ast.walk(parse(name)):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name} imports relatively"
            base = node.module or ""
            found.add(base)
            found.update(f"{base}.{alias.name}" for alias in node.names)
        elif strings and isinstance(node, ast.Constant) and (match := _DOTTED.fullmatch(str(node.value))):
            found.add(match[1])
        elif strings and isinstance(node, ast.JoinedStr) and isinstance(first := node.values[0], ast.Constant):
            found.update(match[1] for match in [_BEGUN.match(str(first.value))] if match)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("import_module", "__import__")):
            found.update(str(a.value) for a in node.args[:1] if isinstance(a, ast.Constant))
    return frozenset(found)


@cache
def arrows(name: str, strings: bool = True) -> set[str]:
    """Return the project's modules that a module imports or, by a string, has imported by another process."""
    return {target for dotted in imports(name, strings) if (target := owner(dotted)) is not None and target != name}


def reached(name: str) -> set[str]:
    """Return all modules of the project that importing `name` brings in, itself included."""
    seen: set[str] = set()
    todo = [name]
    while todo:
        module = todo.pop()
        if module not in seen:
            seen.add(module)
            todo.extend(arrows(module))
    return seen


def top_level(name: str) -> set[str]:
    """Return the top-level packages that a module imports."""
    return {imported.split(".")[0] for imported in imports(name)}


def ros(name: str) -> set[str]:
    """Return the packages of ROS that a module imports."""
    return {imported for imported in top_level(name) if _ROS.fullmatch(imported)}


def package(name: str) -> str:
    """Return the package of a module."""
    return name.split(".", maxsplit=1)[0]


def folder(name: str) -> str:
    """Return the folder of a module: the package or sub-package it lies in."""
    return name if name in FOLDERS else name.rpartition(".")[0]


def speaks_ros(name: str) -> bool:
    """Return whether a module lies where ROS may be imported: a room's node/, the ground's exchange/, the recorder."""
    parts = name.split(".")
    return (parts[0] in ROOMS and parts[1:2] == ["node"]) or f"{name}.".startswith(
        (f"{GROUND}.exchange.", f"{GROUND}.bags.recorder.")
    )


def test_the_house_is_found() -> None:
    """Ground, rooms and roof are read off the folders, and arrows are seen, so that the tests below test something."""
    assert (GROUND, ROOMS, ROOF) == ("rx90_common", ["friction_bench", "rx90_controller", "rx90_sim"], "rx90_emulator")
    assert {path.parent.name for path in ROOT.glob("*/__init__.py")} == {*PACKAGES, "benchmarks"}
    assert "rx90_common.friction.bristle" in reached("rx90_emulator.loop.closed_loop")
    assert "rx90_emulator.cli.line" in arrows("rx90_emulator.cli.frame")
    assert ros("rx90_common.exchange.node_tools") == {
        "rclpy",
        "diagnostic_msgs",
        "rcl_interfaces",
        "type_description_interfaces",
    }


def test_arrows_point_down() -> None:
    """The ground imports only itself, a room itself and the ground; rooms do not import each other."""
    for name in MODULES:
        own = package(name)
        below = {GROUND, own} if own != ROOF else set(PACKAGES)
        assert {target for target in arrows(name) if package(target) not in below} == set(), name
        assert top_level(name) & {"benchmarks", "launch", "support", "test", "tools"} == set(), name


def test_ros_is_imported_in_few_places() -> None:
    """Only a room's node/, the ground's exchange/ and the recorder import ROS, and no model reaches it."""
    # The share folder looks for the ament index where there is one, and works without.
    index = {"ament_index_python"}
    for name in MODULES:
        if not speaks_ros(name):
            assert ros(name) - (index if name == f"{GROUND}.base.share" else set()) == set(), name
        if package(name) in ROOMS and not speaks_ros(name):
            assert {target for target in reached(name) if ros(target) - index} == set(), name


def test_every_folder_says_what_others_may_use() -> None:
    """A folder's docstring says what lives there, and what others import from it stands in its `__all__`."""
    for name in FOLDERS:
        assert ast.get_docstring(parse(name)), name
        used = set()
        for module in MODULES:
            if module != name and folder(module) != name:
                for dotted in imports(module):
                    if dotted.startswith(f"{name}."):
                        used.add(dotted.removeprefix(f"{name}.").split(".")[0])
        assert {item for item in used if f"{name}.{item}" not in FOLDERS} <= exported(name), name


@cache
def exported(name: str) -> set[str]:
    """Return the names in a folder's `__all__`."""
    for node in parse(name).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return set(ast.literal_eval(node.value))
    return set()


def test_what_a_folder_offers_is_there_and_is_used() -> None:
    """Each name in `__all__` is a module of the folder or a name its `__init__` imports, and another folder uses it."""
    for name in FOLDERS:
        bound = {
            alias.asname or alias.name
            for node in ast.walk(parse(name))
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        offered = exported(name)
        assert {item for item in offered if f"{name}.{item}" not in MODULES and item not in bound} == set(), name
        if name != ROOF:  # whose names are for users
            used = {dotted for module in MODULES if folder(module) != name for dotted in imports(module)}
            begun = {".".join(dotted.split(".")[: name.count(".") + 2]) for dotted in used}
            assert {item for item in offered if f"{name}.{item}" not in begun} == set(), name


def test_folders_do_not_import_each_other_in_a_circle() -> None:
    """The folders can be put in an order in which each imports only earlier ones."""
    graph: dict[str, set[str]] = {name: set() for name in FOLDERS}
    for module in MODULES:
        graph[folder(module)] |= {folder(target) for target in arrows(module)} - {folder(module)}
    graph = {
        name: {target for target in targets if not name.startswith(f"{target}.")} for name, targets in graph.items()
    }
    assert len(list(TopologicalSorter(graph).static_order())) == len(FOLDERS)


def test_modules_and_files_named_in_pages_exist() -> None:
    """Every module that an entry point, a setting or a document names is there, and so is every file."""
    places = (
        rf"(?<![\w/.*<-])((?:{'|'.join(PACKAGES)}|config|docs|firmware|launch|benchmarks|tools|test)/[a-z][\w./-]*)"
    )
    for file in (*_BUILD_FILES, *_PAGES):
        text = (ROOT / file).read_text(encoding="utf-8")
        named = set(re.findall(rf"(?<![\w/.])({_NAMED})", text))
        assert {name for name in named if not known(name)} == set(), file
        assert set(re.findall(r"(?<![\w./-])rx90_[a-z_]+", text)) <= {*PACKAGES, *EXECUTABLES}, file
        paths = {
            path
            for path in re.findall(places, text)
            if "NAME" not in path and path.endswith(("/", ".c", ".h", ".md", ".py", ".yaml", ".svg"))
        }
        missing = {path for path in paths if not (ROOT / path).exists() and not path.startswith("firmware/build")}
        assert missing == set(), file


def known(dotted: str) -> bool:
    """Return whether a dotted name is a module, or a name in one."""
    return (
        owner(dotted) not in FOLDERS or dotted in MODULES or dotted.rpartition(".")[2] in exported(owner(dotted) or "")
    )


def test_modules_named_outside_the_packages_exist() -> None:
    """What benchmarks, launch files, tools and tests import or name in a string is there."""
    for path in _OUTSIDE:
        named = set()
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Import):
                named.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                named.add(node.module or "")
            elif isinstance(node, ast.Constant) and (match := _DOTTED.fullmatch(str(node.value))):
                named.add(match[1])
        own = {name for name in named if package(name) in PACKAGES and not name.endswith(_FILES)}
        assert {name for name in own if not known(name)} == set(), path


def test_modules_named_by_a_string_exist() -> None:
    """Every string that looks like a module's name, as entry points and `-m` take it, is one."""
    for name in MODULES:
        nodes = list(ast.walk(parse(name)))
        parts = {id(value) for node in nodes if isinstance(node, ast.JoinedStr) for value in node.values}
        strings = {str(node.value) for node in nodes if isinstance(node, ast.Constant) and id(node) not in parts}
        named = {match[1] for match in map(_DOTTED.fullmatch, strings) if match}
        assert named <= set(MODULES), name


def test_models_stand_on_numerical_libraries_only() -> None:
    """Plant and law import numpy, numba and the plain standard library: nothing opens a socket or a thread."""
    allowed = PLAIN | {"numpy", "numba", "scipy", *PACKAGES}
    for module in MODULES:
        if package(module) in {"rx90_sim", "rx90_controller"} and not speaks_ros(module):
            assert top_level(module) <= allowed, module


def test_every_package_that_is_imported_has_a_source() -> None:
    """What users are told where a package is missing covers each that is imported, and no other."""
    # Dask's is imported by its name in a string: most sweeps do without it.
    imported = {"distributed"}.union(*map(top_level, MODULES))
    own = {*PACKAGES, *sys.stdlib_module_names, "compression"}  # the last of Python 3.14
    assert {name for name in imported - own if not is_ros(name)} == set(SOURCES)


def test_no_modules_import_each_other_in_a_circle() -> None:
    """The modules can be put in an order in which each imports only earlier ones."""
    plain = {name for name, path in MODULES.items() if path.name != "__init__.py"}
    order = TopologicalSorter({name: arrows(name) & plain for name in plain})
    assert len(list(order.static_order())) == len(plain)


def test_a_module_can_be_read_at_one_sitting() -> None:
    """No module exceeds 500 lines, no function seven positional arguments; each says what it holds."""
    for name, path in MODULES.items():
        tree = parse(name)
        assert path.read_text(encoding="utf-8").count("\n") <= LONGEST, name
        assert ast.get_docstring(tree), name
        for function in functions(tree):
            arguments = (*function.args.posonlyargs, *function.args.args)
            given = [argument.arg for argument in arguments if argument.arg not in {"self", "cls"}]
            assert len(given) <= MOST_POSITIONAL or compiled(function), f"{name}.{function.name}"


def compiled(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Return whether a function is compiled: kernels take what they work on as plain arrays and numbers."""
    return any(ast.unparse(d).partition("(")[0] in {"kernel", "inlined", "c_function"} for d in function.decorator_list)


def test_classes_of_different_folders_have_different_names() -> None:
    """No two public classes of the project bear the same name, nor two of the functions that a user calls."""
    homes: dict[str, list[str]] = {}
    for name in MODULES:
        for node in parse(name).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(name)
            if isinstance(node, ast.FunctionDef) and node.name in {"identify", "estimate", "simulate"}:
                homes.setdefault(node.name, []).append(name)
    assert {name: where for name, where in homes.items() if len(where) > 1} == {}


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Yield all functions of a module."""
    yield from (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def test_parameters_are_frozen() -> None:
    """Dataclasses that are checked where they are built are frozen, so that they stay as checked."""
    for name, node in ((module, part) for module in MODULES for part in ast.walk(parse(module))):
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
    for name in MODULES:
        for function in functions(parse(name)):
            if function.name in {"plant_step", "bristle_step", "mass_and_bias", "position_loop", "velocity_loop"}:
                owners.setdefault(function.name, []).append(name)
    assert owners == {
        "plant_step": ["rx90_sim.plant_step"],
        "bristle_step": ["rx90_common.friction.bristle"],
        "mass_and_bias": ["rx90_common.dynamics.manipulator"],
        "position_loop": ["rx90_controller.law.loops"],
        "velocity_loop": ["rx90_controller.law.loops"],
    }


def test_each_shipped_file_is_named_in_one_place() -> None:
    """No two strings are the name of the same file in config/, and one module alone names a robot: the default."""
    files = {str(path.relative_to(ROOT / "config")) for path in (ROOT / "config").rglob("*") if path.is_file()}
    robots = {path.name for path in (ROOT / "config" / "robots").iterdir()}
    named = [
        (node.value, name)
        for name in MODULES
        for node in ast.walk(parse(name))
        if isinstance(node, ast.Constant) and node.value in files | robots
    ]
    assert [name for file, name in named if file in robots] == [f"{GROUND}.description.robot_files"]
    assert {file for file, _ in named} >= {"rig/gm8224.yaml", "dds/profiles.xml"}
    assert len({file for file, _ in named}) == len(named), sorted(named)


def test_one_module_reads_and_writes_yaml() -> None:
    """Only the module of configuration files imports yaml, so that every file is read by the same rules."""
    assert [name for name in MODULES if "yaml" in top_level(name)] == [f"{GROUND}.base.config"]


def test_compiled_code_keeps_its_bits() -> None:
    """No kernel uses fastmath or threads: the same numbers must come out wherever it is inlined."""
    for name in MODULES:
        for node in ast.walk(parse(name)):
            if isinstance(node, ast.keyword):
                assert node.arg not in {"fastmath", "parallel"}, name


def test_every_test_says_what_it_proves() -> None:
    """Every test's docstring is one sentence naming a property."""
    tests = sorted((ROOT / "test").rglob("test_*.py"))
    for path, function in ((file, part) for file in tests for part in functions(tree_of(file))):
        if function.name.startswith("test_"):
            text = ast.get_docstring(function)
            assert text, f"{path.name}: {function.name}"
            assert text.splitlines()[0].endswith("."), f"{path.name}: {function.name}"


def test_the_walks_name_files_and_functions_that_are_there() -> None:
    """Each step of the walks in architecture.md names a file of the repository and functions defined in it."""
    rows = re.findall(r"^\| `([\w/.]+\.(?:py|yaml))` \| ([^|]*) \|", page("explanation/architecture.md"), re.MULTILINE)
    assert len(rows) > 25
    for file, functions_named in rows:
        assert (ROOT / file).is_file(), file
        for dotted in re.findall(r"`([\w.]+)`", functions_named):
            assert dotted in defined(tree_of(ROOT / file)), f"{file}: {dotted}"


def page(name: str) -> str:
    """Return the text of a page of docs/."""
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def defined(tree: ast.Module) -> set[str]:
    """Return the functions, classes and assigned names of a module, methods as Class.method."""
    found = set()
    for node in tree.body:
        if isinstance(node, ast.Assign):
            found.update(target.id for target in node.targets if isinstance(target, ast.Name))
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found.update(f"{node.name}.{method.name}" for method in functions(node))
    return found


def test_the_picture_and_the_table_show_every_folder() -> None:
    """Each package and each folder directly below one stands in the picture and the table of architecture.md."""
    picture, text = page("images/house.svg"), page("explanation/architecture.md")
    for name in FOLDERS:
        parts = name.split(".")
        if len(parts) <= 2:
            assert parts[-1] in picture, name
            assert "/".join(parts) in text or f"`{parts[-1]}/`" in text, name
