"""The packages that this project requires, and the message for a missing one."""

from __future__ import annotations

import os
import sys
import sysconfig
from pathlib import Path
from types import TracebackType
from typing import NamedTuple


class Source(NamedTuple):
    """Where a module comes from: its distribution for pip, and its package for Ubuntu 24.04's apt, if it has one."""

    pip: str
    apt: str = ""


SOURCES = {
    "backports": Source("rosbags"),  # backports.zstd
    "bokeh": Source("bokeh"),
    "distributed": Source("distributed"),
    "ezdxf": Source("ezdxf"),
    "jinja2": Source("Jinja2", "python3-jinja2"),
    "lark": Source("lark"),
    "llvmlite": Source("numba"),
    "lz4": Source("rosbags"),
    "markdown_it": Source("markdown-it-py"),
    "markupsafe": Source("Jinja2", "python3-jinja2"),
    "matplotlib": Source("matplotlib", "python3-matplotlib"),
    "mcap": Source("mcap"),
    "mujoco": Source("mujoco"),
    "numba": Source("numba"),
    "numpy": Source("numpy", "python3-numpy"),
    "pinocchio": Source("pin", "ros-jazzy-pinocchio"),
    "pyarrow": Source("pyarrow"),
    "pydantic": Source("pydantic"),  # Ubuntu's python3-pydantic is 1.10
    "pydantic_core": Source("pydantic"),
    "rosbags": Source("rosbags"),
    "rich": Source("viser"),
    "scipy": Source("scipy", "python3-scipy"),
    "serial": Source("pyserial", "python3-serial"),
    "shtab": Source("shtab"),
    "tqdm": Source("tqdm", "python3-tqdm"),
    "viser": Source("viser"),
    "yaml": Source("PyYAML", "python3-yaml"),
}
"""Of each module outside the standard library and ROS that the project imports."""

_ROS_FROM_PIP = "'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces"
_APT_FOLDER = "/usr/lib/python3/dist-packages"


def missing_module(error: ImportError) -> str | None:
    """Return a line with the package that is missing, or cannot be loaded, and the command that installs it.

    None if the error concerns no required package: then it is an error of the project's own.
    """
    module = _outside(error)
    if module is None:
        return None
    if isinstance(error, ModuleNotFoundError) and error.name == module:
        return f"needs {module}, which is not installed; accepted: {_accepted(module)}"
    reason = " ".join(str(error).split())
    return f"{module} cannot be loaded ({reason}); accepted: a version that fits Python and the other packages"


def _outside(error: ImportError) -> str | None:
    """Return the package of SOURCES or of ROS that an error is of: by its name, or by where it was raised."""
    modules = [str(error.name or "")]
    trace: TracebackType | None = error.__traceback__
    while trace is not None:
        modules.insert(1, str(trace.tb_frame.f_globals.get("__name__", "")))
        trace = trace.tb_next
    packages = (module.partition(".")[0] for module in modules)
    return next((package for package in packages if package in SOURCES or is_ros(package)), None)


def is_ros(module: str) -> bool:
    """Tell whether a package comes with ROS."""
    return module in {"rclpy", "ament_index_python"} or module.endswith(("_msgs", "_srvs", "_interfaces"))


def _accepted(module: str) -> str:
    # A system's own Python that is managed by its packages refuses pip; a virtual environment does not.
    folder = Path(sysconfig.get_path("stdlib"))
    managed = sys.prefix == sys.base_prefix and (folder / "EXTERNALLY-MANAGED").is_file()
    if module in {"control_msgs", "controller_manager_msgs", "tf2_msgs"}:  # in no registry of pip
        sourced = os.environ.get("ROS_DISTRO") == "jazzy"
        package = f"ros-jazzy-{module.replace('_', '-')}"
        return f"sudo apt install {package}" if sourced else "make action, in the project's folder"
    if is_ros(module):
        return "a sourced ROS 2 Jazzy" + ("" if managed else f", or {_pip(_ROS_FROM_PIP)}")
    source = SOURCES[module]
    if source.apt and _APT_FOLDER in sys.path and os.environ.get("ROS_DISTRO") == "jazzy":
        return f"sudo apt install {source.apt}"
    if managed:
        return f"a virtual environment with {source.pip} in it, as in docs/start/install.md"
    return _pip(source.pip)


def _pip(what: str) -> str:
    return f"{sys.executable} -m pip install {what}"
