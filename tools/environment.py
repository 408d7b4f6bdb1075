"""Create the virtual environment that the Makefile's targets run in, and keep it up to date.

Runs on the user's own interpreter and needs nothing but the standard library. Does nothing when the
environment already holds what is asked for.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import hashlib
import importlib.util
import os
import platform
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# What `pip install -e .[...]` is asked for: to run the nodes, to test and measure them too, to build the site of the
# documentation, or to test them with the versions of Ubuntu 24.04, which ROS 2 Jazzy runs on.
EXTRAS = {
    "run": ("ros", "view"),
    "dev": ("ros", "dev"),
    "docs": ("ros", "docs"),
    "jazzy": ("ros", "test"),
}
FOLDERS = {"run": ".venv", "dev": ".venv", "docs": ".venv", "jazzy": ".venv-jazzy"}
CONSTRAINTS = {"jazzy": "tools/constraints-jazzy.txt"}
_NEWEST_FOR = {"jazzy": (3, 12)}
MINIMUM_GLIBC = (2, 28)
_STEP = re.compile(
    r"^\s*(Collecting|Downloading|Using cached|Building|Preparing|Installing)\b([^(<>=~]*)"
)


class UnsuitableError(Exception):
    """This machine or interpreter cannot hold the environment; the text is one line for the user."""


def check_machine() -> None:
    """Refuse interpreters and machines that the ROS wheels are not built for.

    Raises:
        UnsuitableError: naming what was found and what is accepted.
    """
    if platform.python_implementation() != "CPython":
        raise UnsuitableError(
            f"{sys.executable} is {platform.python_implementation()}; accepted: CPython"
        )
    if platform.system() != "Linux" or platform.machine() != "x86_64" or sys.maxsize < 2**32:
        raise UnsuitableError(
            f"this is {platform.system()} on {platform.machine()}; accepted: 64-bit Linux on x86_64"
        )
    name, version = platform.libc_ver()
    if name != "glibc" or tuple(int(part) for part in version.split(".")[:2]) < MINIMUM_GLIBC:
        raise UnsuitableError(
            f"the C library is {name or 'not glibc'} {version}; accepted: glibc >= 2.28"
        )
    if not all(importlib.util.find_spec(module) for module in ("venv", "ensurepip")):
        version = f"{sys.version_info[0]}.{sys.version_info[1]}"
        raise UnsuitableError(
            f"{sys.executable} has no venv module; install it: python{version}-venv"
        )


def check_version(purpose: str) -> None:
    """Refuse an interpreter for which the versions of Ubuntu 24.04 have no wheels.

    Raises:
        UnsuitableError: naming what was found and what is accepted.
    """
    newest = _NEWEST_FOR.get(purpose, sys.version_info[:2])
    if sys.version_info[:2] > newest:
        found = f"{sys.version_info[0]}.{sys.version_info[1]}"
        accepted = f"{newest[0]}.{newest[1]}"
        raise UnsuitableError(
            f"Python {found} is too new for the versions of {purpose}; accepted: 3.10 to {accepted}"
        )


@contextlib.contextmanager
def alone(path: Path) -> Iterator[None]:
    """Let one set-up of this tree run at a time: the one that holds this lock file."""
    with path.open("w", encoding="utf-8") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            _say("waiting for another set-up of this folder to end")
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


class Environment:
    """A virtual environment with the package installed in place.

    Attributes:
        folder: where it lies.
        root: the source tree that is installed into it.
        constraints: pip's file of versions, relative to the root, if they are not to be the newest.
    """

    def __init__(self, folder: Path, root: Path = ROOT, constraints: str | None = None) -> None:
        self.folder = folder
        self.root = root
        self.constraints = constraints
        self._stamp = folder / "rx90_emulator.stamp"
        self._log = root / "build" / "environment.log"

    @property
    def python(self) -> Path:
        """Return its interpreter."""
        return self.folder / "bin" / "python"

    def identity(self) -> str:
        """Return what the environment itself depends on: interpreter and place (it cannot be moved)."""
        return f"{sys.version_info[0]}.{sys.version_info[1]} {self.folder}"

    def inputs(self) -> str:
        """Return a hash of what the installation depends on: the build files and the list of rooms."""
        digest = hashlib.sha256()
        for name in ("setup.py", "setup.cfg", "pyproject.toml", *filter(None, [self.constraints])):
            digest.update((self.root / name).read_bytes())
        rooms = sorted(path.parent.name for path in self.root.glob("*/__init__.py"))
        digest.update(" ".join(rooms).encode())
        return digest.hexdigest()

    def installed(self) -> tuple[str, str, set[str]]:
        """Return identity, inputs and extras of the last complete installation; empty ones if none."""
        if not (self._stamp.is_file() and self.python.exists()):
            return "", "", set()
        identity, inputs, extras = self._stamp.read_text(encoding="utf-8").split("\n")
        return identity, inputs, set(extras.split())

    def update(self, extras: set[str]) -> None:
        """Create or complete the environment so that it holds `extras` beside what it held already.

        Raises:
            UnsuitableError: if pip fails, or the folder is a link: another tree's environment would be cleared.
        """
        if self.folder.is_symlink():
            raise UnsuitableError(
                f"{self.folder} is a link to {self.folder.readlink()}; accepted: a folder of this tree, or none yet"
            )
        self._log.parent.mkdir(exist_ok=True)
        with alone(self._log.with_suffix(".lock")):
            self._update(extras)

    def _update(self, extras: set[str]) -> None:
        identity, inputs, held = self.installed()
        if identity != self.identity():
            held = set()
            _say(f"creating {self.folder.name} with Python {platform.python_version()}")
            self._run([sys.executable, "-m", "venv", "--clear", str(self.folder)])
            # The one that comes with Python 3.10 tries versions of the packages against each other without an end.
            self._pip("pip>=25,<27")
        elif inputs == self.inputs() and extras <= held:
            return
        self._note("", held)  # a set-up that is cut short is completed by the next
        wanted = sorted(extras | held)
        _say(f"installing the pinned packages ({', '.join(wanted)}); the first time takes minutes")
        start = time.monotonic()
        target = f"{self.root}[{','.join(wanted)}]"
        chosen = () if self.constraints is None else ("-c", str(self.root / self.constraints))
        self._pip(*chosen, "-e", target)
        self._note(self.inputs(), set(wanted))
        _say(f"installed in {time.monotonic() - start:.0f} s")

    def _pip(self, *what: str) -> None:
        self._run([str(self.python), "-m", "pip", "install", "--progress-bar", "off", *what])

    def _note(self, inputs: str, extras: set[str]) -> None:
        text = f"{self.identity()}\n{inputs}\n{' '.join(sorted(extras))}"
        self._stamp.write_text(text, encoding="utf-8")

    def _run(self, command: list[str]) -> None:
        """Run a set-up command, its output in a log file, its present step on the terminal."""
        # A user's pip configuration may ask for --user, which an environment refuses.
        settings = {**os.environ, "PIP_USER": "0", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
        with self._log.open("w", encoding="utf-8") as stream:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                env=settings,
            )
            try:
                _watch(process, self._log)
            except KeyboardInterrupt:
                process.terminate()
                process.wait()
                raise
        if process.returncode:
            errors = [line.strip() for line in _lines(self._log) if "error" in line.lower()]
            raise UnsuitableError(
                f"{errors[-1] if errors else 'set-up failed'} (all of it in {self._log})"
            )


def _lines(log: Path) -> list[str]:
    return log.read_text(encoding="utf-8", errors="replace").splitlines()


def _watch(process: subprocess.Popen[bytes], log: Path) -> None:
    """Wait for the process; on a terminal show seconds and step in one line that keeps changing."""
    shown = sys.stderr.isatty()
    start = time.monotonic()
    while process.poll() is None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=0.25)
        if shown:
            steps = [match for match in map(_STEP.match, _lines(log)) if match]
            text = f"{steps[-1][1]}{steps[-1][2]}" if steps else ""
            sys.stderr.write(f"\r\033[K  {time.monotonic() - start:3.0f} s  {text[:64]}")
            sys.stderr.flush()
    if shown:
        sys.stderr.write("\r\033[K")


def _say(text: str) -> None:
    print(f"environment: {text}", file=sys.stderr, flush=True)


def main() -> int:
    """Bring the environment up to date; 1 with one line when that cannot be done."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("purpose", choices=sorted(EXTRAS), help="what the environment is for")
    parser.add_argument("--folder", type=Path, help="where it lies (.venv; for jazzy .venv-jazzy)")
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        check_machine()
        check_version(args.purpose)
        folder = (args.folder or ROOT / FOLDERS[args.purpose]).absolute()
        Environment(folder, constraints=CONSTRAINTS.get(args.purpose)).update(
            set(EXTRAS[args.purpose])
        )
    except UnsuitableError as error:
        _say(str(error))
        return 1
    except KeyboardInterrupt:
        _say("interrupted; the next run goes on from here")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
