"""Text from outside in a message."""

import unicodedata
from ast import literal_eval

from hypothesis import given
from hypothesis import strategies as st

from rx90_common.base.errors import BagError
from rx90_common.base.quoting import LIMIT, one_line, plain, quoted

FORGED = "joint_1\n[INFO] [rx90_sim]: all is well"
HOSTILE = st.text(st.sampled_from("a é\u0000\u0007\u001b\n\r\u0085\u2028\u202e\u2066\u200f\ud800\U0001f600\\'"))


@given(HOSTILE, st.integers(1, 30))
def test_text_from_outside_stays_one_visible_line_of_bounded_length(text: str, repeats: int) -> None:
    """Whatever a text holds: no control, format or separating character is left, no lone surrogate."""
    long = text * repeats
    for shown in (quoted(long, 20), plain(long, 20), quoted([long], 20), one_line(long), str(BagError(long))):
        assert not {unicodedata.category(c) for c in shown} & {"Cc", "Cf", "Cs", "Co", "Zl", "Zp"}
        shown.encode()
    assert len(quoted(long, 20)) < 20 * 12 + 40


@given(HOSTILE.filter(lambda text: len(text) <= LIMIT) | st.binary(max_size=LIMIT))
def test_a_short_text_is_quoted_as_python_writes_it(value: str | bytes) -> None:
    """What is quoted can be read back, so nothing is lost."""
    assert literal_eval(quoted(value)) == value


def test_a_large_value_is_quoted_by_its_beginning() -> None:
    """Neither a long list, nor long texts deep inside, nor an integer that Python does not write makes a long line."""
    for value in (["x" * 10**6] * 10**5, {"k": {"k": ["é\n" * 10**6]}}, 10**100_000, [-(10**5000)]):
        shown = quoted(value)
        assert len(shown) < 2 * LIMIT + 40
        assert "\n" not in shown
