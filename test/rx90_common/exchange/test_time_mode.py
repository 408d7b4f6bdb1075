"""What the simulation says of time."""

from __future__ import annotations

import pytest

from rx90_common.base.errors import ExchangeError, MessageError
from rx90_common.base.rates import Rates
from rx90_common.exchange.time_mode import TimeMode


def test_the_text_carries_mode_and_rates() -> None:
    """What is written can be read, and is readable."""
    mode = TimeMode("free_running", Rates(8000, 2000))
    assert mode.text == "free_running base_rate=8000 position_rate=2000"
    assert TimeMode.parse(mode.text) == mode
    of_robot = TimeMode("free_running", Rates(8000, 2000), "my arm")
    assert of_robot.text == f"{mode.text} robot=my arm"
    assert TimeMode.parse(of_robot.text) == of_robot


@pytest.mark.parametrize(
    ("theirs", "robot", "complaint"),
    [
        (Rates(2000, 1000), "rx90b", "base_rate is 4000 Hz here and 2000 Hz in the simulation"),
        (Rates(4000, 500), None, "position_rate is 1000 Hz here and 500 Hz in the simulation"),
        (Rates(), "tx40", "the robot is 'rx90b' here and 'tx40' in the simulation; accepted: the same in both nodes"),
    ],
)
def test_other_rates_and_robots_are_refused_with_both_values(theirs: Rates, robot: str | None, complaint: str) -> None:
    """One line names the rate, or the robots, and both values; who names no robot is not asked for it."""
    TimeMode("lock_step", Rates()).check(Rates(), "rx90b")
    TimeMode("lock_step", Rates(), "rx90b").check(Rates(), "rx90b")
    with pytest.raises(ExchangeError, match=complaint):
        TimeMode("lock_step", theirs, robot).check(Rates(), "rx90b")


@pytest.mark.parametrize(
    "text", ["", "lock_step", "sometimes base_rate=4000 position_rate=1000", "lock_step base_rate=x position_rate=1",
             "lock_step base_rate=0 position_rate=1000", "lock_step position_rate=4000 base_rate=1000"]
)  # fmt: skip
def test_another_text_is_refused(text: str) -> None:
    """A text that is not the simulation's is named with what is accepted."""
    with pytest.raises(MessageError, match="accepted: lock_step, free_running"):
        TimeMode.parse(text)
