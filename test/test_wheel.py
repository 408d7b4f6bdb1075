"""The package as a wheel: complete, and at work in an empty environment without the source tree."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import venv
import zipfile
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pytest
from processes import TIMEOUT
from short_task import SHORT_TASK

import rx90_emulator as rx

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "rx90_emulator"
PACKAGES = sorted(path.parent.name for path in ROOT.glob("*/py.typed"))
EXECUTABLES = {e.name for e in distribution(PACKAGE).entry_points if e.group == "console_scripts"}
DATA = ("config", "launch", "firmware")
NOT_SOURCES = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "install", "log", "out", "test")


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


def pip(*arguments: object, folder: Path) -> None:
    """Run the test environment's pip without a network."""
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
    """Install the wheel into a new environment that borrows the libraries alone; return its folder of executables."""
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
    assert {path.name for path in binaries.iterdir()} >= EXECUTABLES
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
    words = ("run", "task.yaml", "--output", "bag", "--arrays", "run.npz")
    assert "path error: worst 0.2" in run(binaries / "rx90", *words, folder=tmp_path)
    here = rx.run_line(rx.load_setup(), rx.load_task(tmp_path / "task.yaml"), record_fast=True)
    rx.write_bag(here, tmp_path / "here")
    comparison = rx.compare_bags(tmp_path / "bag", tmp_path / "here")
    assert comparison.verdict is rx.Verdict.SAME, rx.comparison_text(comparison)
    with np.load(tmp_path / "run.npz") as arrays:
        assert arrays["joint_states position [rad]"].tobytes() == here.series["joint_states"].position.tobytes()
