"""The system's packages: installed where that may be, else said in one line each, and required only where CI asks."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.packages import NEEDS, ROOT

FAILING = "#!/bin/sh\necho 'E: no network' >&2\nexit 100\n"
INSTALLING = """#!/bin/sh
[ "$1" = install ] || exit 0
shift
case "$*" in *sdcc*UNKNOWN*) echo "E: Unable to locate package UNKNOWN" >&2; exit 100 ;; esac
for word in "$@"; do
  case $word in
    sdcc) programs="$programs sdcc" ;;
    chromium) programs="$programs chromium" ;;
  esac
done
for program in $programs; do printf '#!/bin/sh\\n' > FOLDER/$program; /bin/chmod +x FOLDER/$program; done
"""


def run(folder: Path, apt_get: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the tool on a machine whose path holds nothing but this apt-get and a sudo that lets it through."""
    for name, text in (("apt-get", apt_get), ("sudo", '#!/bin/sh\n[ "$1" = -n ] && shift\n"$@"\n')):
        program = folder / name
        program.write_text(text.replace("FOLDER", str(folder)))
        program.chmod(0o755)
    command = [sys.executable, "-m", "tools.packages", *words]
    path = {**os.environ, "PATH": str(folder)}
    return subprocess.run(command, cwd=ROOT, env=path, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(("words", "code"), [((), 0), (("--required",), 1)])
def test_what_cannot_be_installed_is_a_line_each(tmp_path: Path, words: tuple[str, ...], code: int) -> None:
    """Each missing program has one line with the packages that bring it; that is a failure only where CI asks."""
    done = run(tmp_path, FAILING, *words)
    assert done.returncode == code
    lines = done.stderr.splitlines()
    for name in ("make", "native", "mcs51", "ucsim", "avr", "chromium", "c++"):
        title, wanted = f" {NEEDS[name].title} is missing", " ".join(NEEDS[name].packages) + NEEDS[name].elsewhere
        assert sum(title in line and line.endswith(f" {wanted}") for line in lines) == 1
    assert any("no network" in line for line in lines)


@pytest.mark.parametrize("unknown", ["none", "g++"])
def test_what_can_be_installed_is(tmp_path: Path, unknown: str) -> None:
    """What apt-get brings is missing no more; what it does not bring, or does not know, still is."""
    done = run(tmp_path, INSTALLING.replace("UNKNOWN", unknown))
    assert done.returncode == 0
    assert (tmp_path / "sdcc").exists()
    assert "sdcc is missing" not in done.stderr
    assert "Chromium is missing" not in done.stderr
    assert "avr-gcc is missing" in done.stderr
