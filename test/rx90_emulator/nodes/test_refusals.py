"""Bad parameters and a diverging state: one line, a non-zero exit, no traceback."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from processes import Processes


def the_line(stderr: str) -> str:
    """Return the only line, but for the one that says on a machine without compiled kernels that they are compiled."""
    (line,) = (line for line in stderr.strip().splitlines() if "compiling the numerical kernels" not in line)
    return line


@pytest.mark.ros
@pytest.mark.parametrize(
    ("name", "arguments", "accepted"),
    [
        ("rx90_sim", ["joint_state_rate:=333"], ["333", "4000"]),
        ("rx90_sim", ["time_mode:=sometimes"], ["sometimes", "lock_step"]),
        ("rx90_sim", ["initial_position:=[0.0, 9.0, 0.0, 0.0, 0.0, 0.0]"], ["joint_2", "9"]),
        ("rx90_sim", ["initial_position:=[0.0]"], ["initial_position", "six"]),
        ("rx90_sim", ["real_time_factor:=-1.0"], ["real_time_factor", "-1"]),
        ("rx90_sim", ["real_time_factor:=fast"], ["real_time_factor", "fast"]),
        ("rx90_sim", ["initial_position:=[]"], ["initial_position is empty", "list of numbers"]),
        ("rx90_sim", ["initial_position:=[0, 9, 0, 0, 0, 0]"], ["joint_2", "9"]),
        ("rx90_sim", ["real_time_facto:=1.0"], ["real_time_facto is unknown", "real_time_factor", "step_ticks"]),
        ("rx90_sim", ["friction:=nowhere.yaml"], ["nowhere.yaml"]),
        ("rx90_sim", ["qos_overrides./joint_states.publisher.depth:=0"], ["joint_states.publisher.depth is 0", "[1,"]),
        (
            "rx90_sim",
            ["qos_overrides./motor_states.publisher.depth:=5"],
            ["motor_states.publisher.depth is unknown", "depth, reliability, durability of /clock.publisher"],
        ),
        ("rx90_controller", ["position_rate:=3000"], ["3000", "4000"]),
        ("rx90_controller", ["controller:=nowhere.yaml"], ["nowhere.yaml"]),
        ("rx90_controller", ["joints:=3"], ["parameter joints is 3", "joint_1, joint_2"]),
        ("rx90_cell", ["paused:=true"], ["paused is unknown to rx90_controller", "-p rx90_sim:paused:="]),
    ],
)
def test_a_bad_parameter_is_one_line(
    processes: Processes, name: str, arguments: list[str], accepted: list[str]
) -> None:
    """The line names the program, the offending value and what is accepted; the exit code is 2."""
    parameters = [word for argument in arguments for word in ("-p", argument)]
    done = processes.run(name, "--ros-args", *parameters)
    assert done.returncode == 2
    line = the_line(done.stderr)
    assert line.startswith(f"{name}: ")
    assert all(word in line for word in accepted), line


@pytest.mark.ros
@pytest.mark.parametrize(
    ("variable", "value", "accepted"),
    [("ROS_DOMAIN_ID", "500", "0 to 232"), ("RMW_IMPLEMENTATION", "rmw_nothing_cpp", "rmw_fastrtps_cpp")],
)
@pytest.mark.parametrize(
    ("name", "arguments", "code"),
    [
        ("rx90_sim", [], 2),
        ("rx90_line", ["--from-file", "robots/rx90b/task.yaml"], 2),
        ("rx90_bag", ["record", "--output", "never_made"], 2),
        ("rx90_demo", ["--output", "never_made"], 2),
    ],
)
def test_an_environment_that_cannot_be_is_one_line(
    processes: Processes,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    arguments: list[str],
    code: int,
    variable: str,
    value: str,
    accepted: str,
) -> None:
    """A DDS domain that has no ports, or a middleware that is not there, is named with what is accepted."""
    monkeypatch.setenv(variable, value)
    done = processes.run(name, *arguments)
    assert done.returncode == code
    line = the_line(done.stderr)
    assert all(word in line for word in (name, variable, value, accepted)), line
    assert not Path("never_made").exists()


@pytest.mark.ros
def test_a_diverging_arm_ends_the_run_with_joint_and_tick(
    processes: Processes, edited_yaml: Any, shipped_files: Any
) -> None:
    """A gain far too large for an amplifier without limits ends the run with one line, not with NaN."""
    drives: Path = edited_yaml(shipped_files.drives, ("motor", "peak_current"), [1e7] * 6)
    law: Path = edited_yaml(shipped_files.controller, ("servo", "kv"), [400.0] * 3 + [1.2e4] + [400.0] * 2)
    law = edited_yaml(law, ("supervision", "following_error"), [1.0] * 6)
    law = edited_yaml(law, ("supervision", "over_speed"), 10.0)
    cell = processes.start(
        "rx90_cell", "--ros-args", "-p", f"drives:={drives}", "-p", f"rx90_controller:controller:={law}",
        "-p", "rx90_sim:real_time_factor:=0.0",
    )  # fmt: skip
    cell.wait_for(r"rx90_cell: the state of joint_\d diverged in tick \d+")
    assert cell.wait() == 3
    assert "Traceback" not in cell.output


@pytest.mark.ros
def test_the_simulation_takes_the_steps_that_the_arm_needs_or_says_so(
    processes: Processes, edited_yaml: Any, shipped_files: Any
) -> None:
    """Stiff bristles: the log tells how many plant steps the node takes by itself; fewer asked for are one line."""
    file: Path = edited_yaml(shipped_files.friction, ("elements", "joint_6", "c0"), 5.0e5)
    told = ["--ros-args", "-p", f"friction:={file}"]
    simulation = processes.start("rx90_sim", *told)
    simulation.wait_for(r"ready: .*, [2-9] plant steps in a tick")
    done = processes.run("rx90_sim", *told, "-p", "substeps:=2")
    assert done.returncode == 2
    line = the_line(done.stderr)
    assert re.search(r"friction\.joint_6\.c0 is 500000 Nm/rad, .*2 plant steps.*substeps [3-9]", line), line
