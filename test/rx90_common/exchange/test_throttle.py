"""Lines that would flood the terminal."""

from __future__ import annotations

from rx90_common.exchange.throttle import ThrottledLog


def test_a_kind_of_line_comes_at_once_and_then_with_a_count() -> None:
    """Of a thousand lines within a second one is printed; five seconds later the next one tells of the others."""
    now, said = [10.0], []
    log = ThrottledLog(said.append, lambda: now[0])
    for k in range(1000):
        log.say("bad", f"bad {k}")
        now[0] += 0.001
    log.say("other", "other")
    assert said == ["bad 0", "other"]
    now[0] += 5.0
    log.say("bad", "bad again")
    now[0] += 5.0
    log.say("bad", "bad once more")
    assert said[2:] == ["bad again (and 999 times before)", "bad once more"]
