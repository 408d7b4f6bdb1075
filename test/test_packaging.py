"""The package as colcon and pip install it, and as a wheel: found, complete, and at work without the source tree."""

import os
import re
import shutil
import subprocess
import sys
import venv
import zipfile
from importlib.metadata import distribution, requires
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from catkin_pkg.package import parse_package
from processes import Processes, script
from short_task import SHORT_TASK
from warm_start import COLD

import rx90_emulator as rx
from rx90_common.process.children import TIMEOUT
from rx90_emulator.cli.frame import EXECUTABLES as TABLE

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "rx90_emulator"
EXECUTABLES = sorted(e.name for e in distribution(PACKAGE).entry_points if e.group == "console_scripts")
NODES = ("rx90_sim", "rx90_controller")
STARTED = (*NODES, "rx90")
"""A node of each kind, and the command; the generated scripts differ by their names alone."""

# Keys that rosdep resolves by apt on Ubuntu 24.04 (noble): rosdistro at 8468e88 of 2026-08-22, `ubuntu:` of
# rosdep/python.yaml without a pip entry, and packages released for noble in jazzy/distribution.yaml. rosdep knows
# python3-numba there too, but noble has no package of that name.
RESOLVED_ON_NOBLE = """
    ament_index_python builtin_interfaces control_msgs controller_manager_msgs diagnostic_msgs launch launch_ros
    lifecycle_msgs pinocchio rclpy rcl_interfaces robot_state_publisher rosgraph_msgs rviz2 sensor_msgs std_msgs
    std_srvs trajectory_msgs
    type_description_interfaces
    python3-hypothesis python3-jinja2 python3-lark-parser python3-matplotlib python3-numpy python3-pytest
    python3-scipy python3-serial python3-tqdm python3-yaml tf2_msgs xacro
"""


def run(*command: object, folder: Path) -> str:
    """Run a command in a folder, in an environment that names no Python path and no ROS, and return what it printed."""
    hidden = ("PYTHONPATH", "PYTHONHOME", "AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH", "LD_LIBRARY_PATH")
    environment = {key: value for key, value in os.environ.items() if key not in hidden}
    done = subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=5 * TIMEOUT,  # a build or a first compilation on a machine that is four times slower; more is a hang
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def sourced(prefix: Path) -> dict[str, str]:
    """Return the environment that `source setup.bash` of a colcon workspace makes."""
    clean = {key: value for key, value in os.environ.items() if not key.endswith(("PYTHONPATH", "PREFIX_PATH"))}
    script = f'. "{prefix}/setup.bash" && env -0'
    done = subprocess.run(["bash", "-c", script], env=clean, capture_output=True, text=True, check=True)
    return dict(pair.split("=", 1) for pair in done.stdout.split("\0") if "=" in pair)


@pytest.fixture(scope="module")
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the source tree with colcon and return the package's prefix in the install space."""
    folder = tmp_path_factory.mktemp("workspace")
    run(
        *(script("colcon"), "--log-base", folder / "log", "build", "--base-paths", ROOT, "--packages-select", PACKAGE),
        *("--build-base", folder / "build", "--install-base", folder / "install"),
        folder=folder,
    )
    return folder / "install" / PACKAGE


@pytest.fixture
def workspace(prefix: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put this process and all it starts into the sourced workspace; return the folder of executables."""
    monkeypatch.chdir(tmp_path)  # Python would find the source tree in the working directory
    environment = sourced(prefix.parent)
    for name in ("PYTHONPATH", "AMENT_PREFIX_PATH"):
        monkeypatch.setenv(name, environment[name])
    return prefix / "lib" / PACKAGE


def test_package_xml_is_valid_for_ros_tools() -> None:
    warnings: list[str] = []
    package = parse_package(str(ROOT / "package.xml"), warnings=warnings)
    package.validate(warnings=warnings)
    assert (warnings, package.get_build_type()) == ([], "ament_python")


def test_an_installed_jazzy_gets_every_package() -> None:
    """Rosdep finds each key of package.xml in apt; what a run needs is among them, or in install.md's line of pip."""
    keys = {element.text for element in ElementTree.parse(ROOT / "package.xml").iter() if "depend" in element.tag}
    assert keys <= set(RESOLVED_ON_NOBLE.split())
    page = (ROOT / "docs/start/install.md").read_text("utf-8")
    (by_pip,) = re.findall(r"-m pip install -c \S+constraints-jazzy\.txt (.*)", page)
    others = {"jinja2": "Jinja2", "serial": "pyserial", "yaml": "PyYAML"}
    names = [key.removeprefix("python3-") for key in keys if key.startswith("python3-")]
    from_apt = {others.get(name, name) for name in names} | {"pin"} & {key.replace("pinocchio", "pin") for key in keys}
    needed = {re.split("[<>=]", line)[0] for line in requires(PACKAGE) or [] if "extra ==" not in line}
    assert needed == needed & from_apt | set(by_pip.split())


def test_the_version_is_the_same_everywhere() -> None:
    version = ElementTree.parse(ROOT / "package.xml").findtext("version")
    newest = re.search(r"^(\d+\.\d+\.\d+)\b", (ROOT / "CHANGELOG.rst").read_text(), re.MULTILINE)
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {version, distribution(PACKAGE).version, citation["version"], newest[1]} == {version}


def test_the_install_space_is_whole_and_needs_no_source_tree(
    prefix: Path, workspace: Path, processes: Processes
) -> None:
    """Modules, templates, config/ and launch/ are installed as they are, and the ament index names the package."""
    site = next((prefix / "lib").glob("python*/site-packages"))
    rooms = [path.parent for path in ROOT.glob("*/__init__.py") if path.parent.name not in {"test", "benchmarks"}]
    assert {path.name for path in rooms} >= {"rx90_sim", "rx90_controller", "rx90_emulator"}
    kept = {".py", ".j2"}
    for folder, target in [(ROOT / room, prefix / "share" / PACKAGE) for room in ("config", "launch")] + [
        (room, site) for room in rooms
    ]:
        for source in (path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts):
            if target is not site or source.suffix in kept or source.name == "py.typed":
                assert (target / source.relative_to(ROOT)).read_bytes() == source.read_bytes(), source
    assert (prefix / "share/ament_index/resource_index/packages" / PACKAGE).is_file()
    assert sorted(path.name for path in workspace.iterdir()) == sorted(TABLE) == EXECUTABLES
    assert all(callable(e.load()) for e in distribution(PACKAGE).entry_points if e.group == "console_scripts")
    for name in STARTED:
        done = processes.run(str(workspace / name), "--help")
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith(f"usage: {name}")
    code = "import rx90_sim, rx90_common.base.share as s; print(rx90_sim.__file__); print(s.share_directory())"
    with COLD([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as cold:  # a warm one has imported
        found = [Path(line).resolve() for line in cold.communicate(timeout=TIMEOUT)[0].splitlines()]
    assert len(found) == 2
    assert all(prefix in path.parents for path in found), found


PACKAGES = sorted(path.parent.name for path in ROOT.glob("*/py.typed"))
DATA = ("config", "launch", "firmware")
NOT_SOURCES = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "install", "log", "out", "test")


def pip(*arguments: object, folder: Path) -> None:
    run(sys.executable, "-m", "pip", "--disable-pip-version-check", *arguments, folder=folder)


@pytest.fixture
def wheel(tmp_path: Path) -> Path:
    """Build the wheel from a copy of the source tree: an old build/ would leave its modules in the wheel."""
    (folder := tmp_path / "wheel").mkdir()
    shutil.copytree(ROOT, folder / "source", ignore=NOT_SOURCES)
    pip("wheel", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", folder, "./source", folder=folder)
    (built,) = folder.glob("*.whl")
    return built


def installed(wheel: Path, prefix: Path) -> Path:
    venv.create(prefix, symlinks=True)
    python = prefix / "bin/python"
    pip("--python", python, "install", "--no-deps", "--no-index", "--no-compile", wheel, folder=prefix)
    site = next((prefix / "lib").glob("python*/site-packages"))
    # These folders come last, and .pth files in them, such as that of an editable install, do not count.
    libraries = [path for path in sys.path if path.endswith("site-packages")]
    (site / "libraries.pth").write_text("\n".join(libraries) + "\n", encoding="utf-8")
    return prefix / "bin"


def test_the_wheel_is_whole_and_works_without_the_source_tree(wheel: Path, tmp_path: Path) -> None:
    """Modules, type markers, templates, config/, launch/, firmware/ and the ament marker are in it; tests are not."""
    share = f"{PACKAGE}-{distribution(PACKAGE).version}.data/data/share"
    modules = [path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.is_file()]
    wanted = {
        str(path.relative_to(ROOT))
        for path in modules
        if path.suffix in {".py", ".j2", ".lark"} or path.name == "py.typed" or path.parent.name == "templates"
    }
    for folder in DATA:
        files = (path for path in (ROOT / folder).rglob("*") if path.is_file() and "__pycache__" not in path.parts)
        wanted |= {f"{share}/{PACKAGE}/{path.relative_to(ROOT)}" for path in files if "build" not in path.parts}
    wanted.add(f"{share}/{PACKAGE}/docs/reference/glossary_and_works.md")  # reports quote it
    wanted |= {f"{share}/{PACKAGE}/package.xml", f"{share}/ament_index/resource_index/packages/{PACKAGE}"}
    held = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert held == wanted

    binaries = installed(wheel, tmp_path / "environment")
    assert {path.name for path in binaries.iterdir()} >= set(EXECUTABLES)
    for verb in ("sweep", "identify"):
        assert run(binaries / "rx90", verb, "--help", folder=binaries.parent).startswith("usage:")
    code = (
        f"import importlib\nfor name in {PACKAGES}:\n    print(importlib.import_module(name).__file__)\n"
        "import rx90_emulator as rx\nfrom rx90_common.base.share import config_path\n"
        "print(config_path('robots/rx90b/friction.yaml'))\nprint(rx.load_setup().friction.file)"
    )
    found = [Path(line) for line in run(binaries / "python", "-c", code, folder=binaries.parent).splitlines()]
    assert len(found) == len(PACKAGES) + 2
    assert all(path.is_file() and path.is_relative_to(binaries.parent) for path in found), found

    (tmp_path / "task.yaml").write_text(SHORT_TASK, encoding="utf-8")
    words = ("run", "task.yaml", "--output", "bag")
    assert "path error: worst 0.2" in run(binaries / "rx90", *words, folder=tmp_path)
    here = rx.run_line(rx.load_setup(), rx.load_task(tmp_path / "task.yaml"), record_fast=True)
    rx.write_bag(here, tmp_path / "here")
    comparison = rx.compare_bags(tmp_path / "bag", tmp_path / "here")
    assert comparison.verdict is rx.Verdict.SAME, rx.comparison_text(comparison)
