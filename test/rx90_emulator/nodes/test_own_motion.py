"""The README's path of a newcomer, from a YAML file to two equal bags, with its commands as written."""

from __future__ import annotations

import re
import shlex
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from processes import TIMEOUT, Processes
from ros_client import Client, seconds
from sensor_msgs.msg import JointState

from rx90_common.process.children import executable

ROOT = Path(__file__).resolve().parents[3]
STAND_IN = Path(__file__).resolve().parents[2] / "support/ros2_stand_in.py"


def blocks() -> dict[str, list[str]]:
    """Return the code blocks of the README's section by their language."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    section = text.split("## Your own motion, recorded and compared\n")[1].split("\n## ")[0]
    found: dict[str, list[str]] = {}
    for language, block in re.findall(r"^```(\w+)\n(.*?)^```$", section, re.MULTILINE | re.DOTALL):
        found.setdefault(language, []).append(block)
    return found


def words(line: str) -> list[str]:
    """Return the command line to start for one of the README's, which bash reads as the user's shell does."""
    echoed = subprocess.run(
        ["bash", "-c", f"printf '%s\\0' {line}"], capture_output=True, text=True, check=True
    ).stdout.split("\0")[:-1]
    if echoed[:3] == ["ros2", "run", "rx90_emulator"]:
        return executable(echoed[3], *echoed[4:])
    assert echoed[0] == "ros2"
    return [sys.executable, str(STAND_IN), *echoed[1:]]


def stands(samples: list[JointState]) -> bool:
    """Return whether the newest sample has come again."""
    return [seconds(sample) for sample in samples].count(0.5) > 1


def test_the_newcomers_path_runs_as_written(
    processes: Processes, client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A motion published, recorded, and run again without ROS gives the same bits; the plot is drawn.

    Time stands still in the middle of the motion, too: the samples that come again meanwhile are not in the bag.
    """
    monkeypatch.chdir(tmp_path)
    found = blocks()
    Path("my_motion.yaml").write_text(found["yaml"][0], encoding="utf-8")
    cell, record, send, compare = (block.strip().splitlines() for block in found["sh"])
    # As fast as it goes, and to an end soon after the motion's: the bits do not depend on it.
    quick = {"real_time_factor": 0.0, "step_ticks": 2002, "duration": 4.5}
    faster = [word for name, value in quick.items() for word in ("-p", f"rx90_sim:{name}:={value}")]
    simulation = processes.start(*words(cell[0]), *faster)
    recorder = processes.start(*words(record[0]))
    recorder.wait_for("ready")
    for line in send:
        sent = processes.run(*words(line))
        assert (sent.returncode, sent.stderr) == (0, "")
        if line is send[0]:
            client.simulation.step()
            samples = client.listen("joint_states")
            client.spin_until(partial(stands, samples), "a sample again")
    simulation.wait_for("trajectory ended")
    recorder.signal(signal.SIGINT)
    assert recorder.wait() == 0
    assert re.search(r"; \d+ repetitions of the sample before are left out", recorder.output)
    for line in compare:
        done = processes.run(*words(line), timeout=TIMEOUT)
        assert done.returncode == 0, shlex.join(words(line)) + done.stdout + done.stderr
    assert done.stdout.splitlines()[-1] == "my_run against my_run_without_ros: same"
    plot = processes.run(sys.executable, "-c", "import matplotlib\nmatplotlib.use('Agg')\n" + found["python"][0])
    assert plot.returncode == 0, plot.stderr
    assert Path("my_run.png").stat().st_size > 10_000
