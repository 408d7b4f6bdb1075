"""Install the system's packages that the tests need.

Where it may not, name what is missing and which tests are skipped.

    python -m tools.packages               # installs what it may, says what stays missing, and ends with 0
    python -m tools.packages --required    # ends with 1 where something stays missing, as CI asks for

This table is the only list of these packages. Needs nothing but the standard library.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
REQUIRED = "TESTS_REQUIRE_PACKAGES"
"""Environment variable: where it is set, tests whose packages are missing fail; else they are skipped."""
CHROMIUM_NAMES = ("chromium", "chromium-browser", "google-chrome")
"""What Debian's Chromium, and its like, are called on the path."""
_PYTHON = f"python{sys.version_info[0]}.{sys.version_info[1]}"


@dataclass(frozen=True)
class Need:
    """What some tests need of the system.

    Attributes:
        title: what it is, for a line to the user.
        packages: Debian's names of the packages that bring it.
        tests: which tests are skipped without it, for that line.
        is_there: whether it is there.
        elsewhere: how to get it where that is no package, for that line.
    """

    title: str
    packages: tuple[str, ...]
    tests: str
    is_there: Callable[[], bool]
    elsewhere: str = ""


def _any_of(*names: str) -> Callable[[], bool]:
    return lambda: any(shutil.which(name) for name in names)


def _all_of(*names: str) -> Callable[[], bool]:
    return lambda: all(shutil.which(name) for name in names)


def _has_venv() -> bool:
    return all(importlib.util.find_spec(module) for module in ("venv", "ensurepip"))


def _has_avr_compiler() -> bool:
    return _all_of("avr-gcc", "avr-objcopy")() and Path("/usr/lib/avr/include/avr/io.h").exists()


def _has_python_headers() -> bool:
    return Path(sysconfig.get_path("include"), "Python.h").exists()


NEEDS = {
    "make": Need("make", ("make",), "all of them", _any_of("make")),
    "venv": Need("Python's venv", (f"{_PYTHON}-venv",), "all of them", _has_venv),
    "native": Need(
        "a C compiler", ("gcc", "libc6-dev"), "the rig's firmware, lossy networks", _any_of("cc")
    ),
    "mcs51": Need("sdcc", ("sdcc",), "the rig's firmware on the 8051", _any_of("sdcc")),
    "ucsim": Need(
        "uCsim", ("sdcc-ucsim",), "the rig's firmware on the 8051", _any_of("s51", "ucsim_51")
    ),
    "avr": Need(
        "avr-gcc",
        ("gcc-avr", "avr-libc"),
        "the rig's firmware on the ATmega328P",
        _has_avr_compiler,
    ),
    "simavr": Need(
        "simavr",
        ("libsimavr-dev",),
        "the rig's firmware on the ATmega328P",
        lambda: Path("/usr/include/simavr/sim_avr.h").exists(),
    ),
    "chromium": Need(
        "Chromium",
        ("chromium",),
        "pages in a browser",
        _any_of(*CHROMIUM_NAMES),
        "; on Ubuntu, where that is a snap, which does not see files in /tmp: Google Chrome's .deb",
    ),
    "c++": Need(
        "a C++ compiler", ("g++",), "the action, controller_manager's services, /tf", _any_of("c++")
    ),
    "headers": Need(
        "Python's headers",
        (f"lib{_PYTHON}-dev",),
        "the action, controller_manager's services, /tf",
        _has_python_headers,
    ),
    "zsh": Need("zsh", ("zsh",), "completion in zsh", _any_of("zsh")),
    "fish": Need("fish", ("fish",), "completion in fish", _any_of("fish")),
}


def missing() -> list[Need]:
    """Return what is not there."""
    return [need for need in NEEDS.values() if not need.is_there()]


def install(needs: Sequence[Need]) -> None:
    """Install what is needed with apt-get, as root or by a sudo that asks for no password; nothing where neither is."""
    prefix = _root()
    if prefix is None or shutil.which("apt-get") is None:
        return
    packages = [package for need in needs for package in need.packages]
    _say(f"installing {' '.join(packages)}")
    arguments = ("install", "-y", "-qq", "--no-install-recommends")
    if not _apt_get(prefix, "update", "-qq") or _apt_get(prefix, *arguments, *packages):
        return
    # A single package that the system does not know keeps the others out.
    for need in needs:
        _apt_get(prefix, *arguments, *need.packages)


def _apt_get(prefix: Sequence[str], *arguments: str) -> bool:
    # By env: sudo does not hand variables on. Without a network it shall not wait for minutes.
    patience = (
        "-o",
        "Acquire::Retries=0",
        "-o",
        "Acquire::http::Timeout=20",
        "-o",
        "Acquire::https::Timeout=20",
    )
    command = [
        *prefix,
        "/usr/bin/env",
        "DEBIAN_FRONTEND=noninteractive",
        "apt-get",
        *arguments,
        *patience,
    ]
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if done.returncode:
        errors = [line for line in done.stderr.splitlines() if line.strip()]
        _say(
            f"apt-get {arguments[0]} ended with {done.returncode}: {errors[-1] if errors else 'without a word'}"
        )
    return done.returncode == 0


def _root() -> list[str] | None:
    """Return the words before a command that make it root's; None where this user may not run one."""
    if os.geteuid() == 0:
        return []
    if shutil.which("sudo") is None:
        return None
    allowed = (
        subprocess.run(["sudo", "-n", "true"], capture_output=True, check=False).returncode == 0
    )
    return ["sudo", "-n"] if allowed else None


def _say(text: str) -> None:
    print(f"packages: {text}", file=sys.stderr, flush=True)


def main() -> int:
    """Install what is missing; say in one line each what stays so."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--required", action="store_true", help="end with 1 where something stays missing"
    )
    options = parser.parse_args()
    needs = missing()
    if not needs:
        return 0
    install(needs)
    still_missing = missing()
    for need in still_missing:
        consequence = "required here" if options.required else f"skipped: {need.tests}"
        way = f"apt-get install {' '.join(need.packages)}{need.elsewhere}"
        _say(f"{need.title} is missing ({consequence}); to get it: {way}")
    return int(options.required and bool(still_missing))


if __name__ == "__main__":
    sys.exit(main())
