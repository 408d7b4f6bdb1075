"""The packages that this project requires, and the message for a missing one."""

from __future__ import annotations

import os
import sys
from types import TracebackType

_NAMED_ALIKE = (
    "bokeh",
    "distributed",
    "ezdxf",
    "matplotlib",
    "numba",
    "numpy",
    "pyarrow",
    "pydantic",
    "rosbags",
    "scipy",
    "shtab",
    "tqdm",
    "viser",
)
SOURCES = {name: name for name in _NAMED_ALIKE} | {
    "backports": "rosbags",  # backports.zstd
    "jinja2": "Jinja2",
    "lark": "lark-parser",
    "llvmlite": "numba",
    "markdown_it": "markdown-it-py",
    "markupsafe": "Jinja2",
    "pinocchio": "pin",
    "pydantic_core": "pydantic",
    "rich": "viser",
    "serial": "pyserial",
    "yaml": "PyYAML",
}
"""The distribution for pip of each module outside the standard library and ROS that the project imports."""

_ROS_FROM_PIP = "'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces"


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
    return module in {"rclpy", "ament_index_python"} or module.endswith(
        ("_msgs", "_srvs", "_interfaces")
    )


def _accepted(module: str) -> str:
    if module in {"control_msgs", "controller_manager_msgs", "tf2_msgs"}:  # in no registry of pip
        sourced = os.environ.get("ROS_DISTRO") == "jazzy"
        package = f"ros-jazzy-{module.replace('_', '-')}"
        return f"sudo apt install {package}" if sourced else "make action, in the project's folder"
    if is_ros(module):
        return f"a sourced ROS 2 Jazzy, or {sys.executable} -m pip install {_ROS_FROM_PIP}"
    return f"{sys.executable} -m pip install {SOURCES[module]}, in a virtual environment"
