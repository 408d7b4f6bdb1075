"""Tools whose standard output cannot be written."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rx90_common.process.children import executable

pytestmark = pytest.mark.slow

TOOLS = {"rx90 line": ["robots/rx90b/task.yaml", "--dry-run"], "rx90_sim": ["--help"]}
# Stands for a tool that prints more than a buffer holds, and has something to end in order.
LONG = """
import sys
from rx90_emulator.cli import frame, options
def add_arguments(parser):
    pass
def main(options):
    try:
        for k in range(100_000):
            print(k)
    finally:
        print("ended", file=sys.stderr)
frame.VERBS = ("tool",)
options.module_of = lambda name: sys.modules["__main__"]
sys.exit(frame.execute("rx90 tool"))
"""


@pytest.mark.usefixtures("warm")
@pytest.mark.parametrize("name", TOOLS)
def test_a_full_disk_is_one_line(name: str) -> None:
    """Output to a full device gives one line that says so and exit code 3."""
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = subprocess.run(
            executable(name, *TOOLS[name]), stdout=full, stderr=subprocess.PIPE, text=True, timeout=120, check=False
        )
    assert done.returncode == 3
    said = [line for line in done.stderr.splitlines() if "compiling" not in line]
    assert said == [f"{name}: standard output cannot be written: No space left on device"]


@pytest.mark.usefixtures("warm")
@pytest.mark.parametrize("name", TOOLS)
def test_a_reader_that_has_gone_is_a_quiet_end(name: str) -> None:
    """Output into a closed pipe gives nothing on standard error and the exit code of SIGPIPE."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        executable(name, *TOOLS[name]), stdout=writer, stderr=subprocess.PIPE, text=True, timeout=120, check=False
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")


def test_what_has_begun_ends_in_order() -> None:
    """A reader that goes in the middle, as head does, ends the tool through its own clean-up."""
    with subprocess.Popen(
        [sys.executable, "-c", LONG], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "0\n"
        process.stdout.close()
        assert process.stderr.read() == "ended\n"
    assert process.returncode == 141
