"""Parameters of goals, named as those of ros2_controllers' joint_trajectory_controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rclpy.node import Node

from rx90_common.base.rates import Rates
from rx90_common.exchange.node_tools import declare
from rx90_controller.goals.goal import GoalOptions
from rx90_controller.goals.tolerances import GoalTolerances

_LARGEST = 1e6  # rad, rad/s, s


@dataclass(frozen=True)
class GoalParameters:
    """What goals are held to, and how often it is said how they go.

    Attributes:
        options: what else is accepted.
        tolerances: where a goal has none of its own.
        monitor_ticks: position ticks from one feedback to the next.
        state_ticks: position ticks from one state of the controller to the next.
        scaling: share of a trajectory's own speed at which it is followed, until another one is asked for.
    """

    options: GoalOptions
    tolerances: GoalTolerances
    monitor_ticks: int
    state_ticks: int
    scaling: float


def declare_goal_parameters(node: Node, names: Sequence[str], rates: Rates) -> GoalParameters:
    """Declare the parameters and return them; `names` are those of the joints.

    Raises:
        ConfigError: naming parameter, value and what is accepted.
    """
    return GoalParameters(
        _options(node),
        _tolerances(node, names),
        _ticks(node, rates, "action_monitor_rate", 20.0, "rate of the action's feedback, in simulated time, Hz"),
        _ticks(node, rates, "state_publish_rate", 50.0, "rate of ~/controller_state, in simulated time, Hz"),
        declare(
            node, "speed_scaling.initial_scaling_factor", 1.0,
            "share of their own speed at which trajectories are followed, until ~/speed_scaling_input says otherwise",
            low=0.0, high=1.0,
        ),
    )  # fmt: skip


def _options(node: Node) -> GoalOptions:
    usual = GoalOptions()
    texts = {
        "allow_partial_joints_goal": "whether a trajectory may name some of the joints; the others hold",
        "allow_nonzero_velocity_at_trajectory_end": "whether the last point may have a velocity; then the arm brakes",
        "allow_trajectory_replacement": "whether points may be left out that are not later than the start, which leads "
        "on from where the path is then",
    }
    return GoalOptions(**{name: declare(node, name, getattr(usual, name), about) for name, about in texts.items()})


def _tolerances(node: Node, names: Sequence[str]) -> GoalTolerances:
    def limit(name: str, default: float, about: str) -> float:
        return declare(node, f"constraints.{name}", default, about, low=0.0, high=_LARGEST)

    return GoalTolerances.defaults(
        names,
        goal_time=limit("goal_time", 0.0, "how long after its end a goal may take to be reached, s; 0: for ever"),
        stopped_velocity_tolerance=limit(
            "stopped_velocity_tolerance", 0.01, "velocity that a joint may have at the goal, rad/s; 0: any"
        ),
        trajectory={
            name: limit(f"{name}.trajectory", 0.0, f"how far {name} may be off the path, rad; 0: any") for name in names
        },
        goal={
            name: limit(f"{name}.goal", 0.0, f"how far {name} may be off at the goal, rad; 0: any") for name in names
        },
    )


def _ticks(node: Node, rates: Rates, name: str, default: float, about: str) -> int:
    rate = declare(node, name, default, f"{about}; every whole number of position ticks", low=0.1, high=20000.0)
    return max(1, round(rates.position_hz / rate))
