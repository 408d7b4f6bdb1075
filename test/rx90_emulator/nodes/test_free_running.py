"""Free-running: the wall clock drives, commands are held, stale ones close the brakes."""

from __future__ import annotations

import signal
from itertools import count

import pytest
from processes import Processes
from ros_client import JOINTS, Client, seconds
from scipy.optimize import brentq
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from rx90_common.base.rates import NANOSECONDS, Rates
from rx90_common.exchange.endpoints import LATCHED_QOS, TICK_QOS
from rx90_common.exchange.topics import FREE_RUNNING, MOTOR_NAMES, TimeMode


@pytest.mark.ros
def test_time_runs_by_the_clock_with_pauses_and_without_a_controller(processes: Processes, client: Client) -> None:
    """A motion rests while time stands still, and goes on where it was; without a controller the brakes close.

    Time runs on without it, and the brakes open when it goes on.
    """
    simulation = processes.start(
        "rx90_sim", "--ros-args", "-p", "time_mode:=free_running", "-p", "command_timeout:=0.05"
    )
    controller = processes.start("rx90_controller")
    joints = client.listen("joint_states")
    reference = client.listen("rx90_controller/reference", depth=1)
    client.spin_until(lambda: bool(reference), "the controller to hold")
    client.send([(4.0, [0.1] * 6)])  # long enough to be paused in time on a loaded machine
    controller.wait_for("trajectory accepted")
    client.spin_until(lambda: reference[-1].position[0] > 0.03, "the motion")
    client.simulation.pause(True)
    controller.wait_for("the loops rest")
    resting, reached = seconds(reference[-1]), reference[-1].position[0]
    assert 0.03 < reached < 0.099
    client.simulation.pause(False)
    end = pytest.approx([0.1] * 6, abs=1e-12)
    client.spin_until(lambda: list(reference[-1].position) == end, "the end of the motion")
    # Not earlier than the cubic takes from where it was: no set-point was left out.
    done = brentq(lambda share: 0.1 * share * share * (3.0 - 2.0 * share) - reached, 0.0, 1.0)
    assert seconds(reference[-1]) > resting + 4.0 * (1.0 - done) - 0.01

    controller.signal(signal.SIGSTOP)
    stopped = seconds(joints[-1])
    client.spin_until(lambda: seconds(joints[-1]) > stopped + 0.5, "time to run on")
    assert "torque off, brakes closed" in simulation.output
    closed = len(simulation.lines)
    controller.signal(signal.SIGCONT)
    client.spin_until(lambda: any("the brakes open" in line for line in simulation.lines[closed:]), "open brakes")


@pytest.mark.ros
def test_a_mode_that_comes_late_costs_no_trajectory(processes: Processes, client: Client) -> None:
    """A trajectory that is sent between a simulation's first states and its mode is followed in that mode."""
    controller = processes.start("rx90_controller")
    states = client.node.create_publisher(JointState, "motor_states", TICK_QOS)
    reference = client.listen("rx90_controller/reference", depth=1)
    stamps = count()

    def simulate() -> bool:
        """Publish the states of the next ticks, as a simulation does that gets to run now and then."""
        message = JointState(name=list(MOTOR_NAMES), position=[0.0] * 6, velocity=[0.0] * 6, effort=[0.0] * 6)
        for _ in range(16):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(next(stamps) * 250_000, NANOSECONDS)
            states.publish(message)
        return False

    client.spin_until(lambda: states.get_subscription_count() > 0, "the controller")
    for _ in range(4):
        simulate()
    client.send([(0.1, [0.005] * len(JOINTS))])
    controller.wait_for("a trajectory waits for the simulation's first tick")
    mode = client.node.create_publisher(String, "time_mode", LATCHED_QOS)
    mode.publish(String(data=TimeMode(FREE_RUNNING, Rates()).text))
    client.spin_until(
        lambda: simulate() or (bool(reference) and reference[-1].position[0] > 0.00499), "the end of the motion"
    )
