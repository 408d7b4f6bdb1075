"""Files of configuration: how YAML is read and written, what is refused, and where files are found."""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from rx90_common.base import share
from rx90_common.base.config import read_yaml, yaml_text
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.models import FileModel, read_model


class Measured(FileModel):
    x: float


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str | bytes], Path]:
    def make(text: str | bytes) -> Path:
        path = tmp_path / "file.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return make


Write = Callable[[str | bytes], Path]


def refusal(call: Callable[[], Any], path: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        call()
    text = str(caught.value)
    assert str(path) in text
    assert "\n" not in text
    assert len(text) < 1000
    assert isinstance(caught.value, Rx90Error)
    return text


# Ten lines, each ten times the one before: ten to the power of ten values.
BOMB = "a0: &a0 [" + "1," * 10 + "]\n" + "".join(f"a{i}: &a{i} [{f'*a{i - 1},' * 10}]\n" for i in range(1, 10))

BROKEN: list[tuple[str | bytes, str]] = [
    ("", "holds nothing; accepted: a mapping"),
    ("- 1\n- 2\n", "holds a list; accepted: a mapping"),
    ("a: [1, 2\nb: 3", "not valid YAML"),
    ("a: 1\na: 2", "the key 'a' stands twice"),
    ("a: 1\n---\na: 2", "not valid YAML"),
    (b"\xff\xfe\x00", "cannot be read"),
    ("a: 1\n2: 3", "the key 2 is not a name"),
    ('"a\\nb": 1', r"the key 'a\nb' is not a name in one line"),
    ('a: ["\\ud800"]', "invalid Unicode character escape code"),
    ("a: !!int foo", "not valid YAML"),
    ("a: " + "[" * 100 + "]" * 100, "deeper than 64 levels"),
    ("a: " + "[" * 5000, "exceeded maximum nesting depth"),
    ("a: &x {b: *x}", "'x' stands for something that contains it"),
    ("a: 0x" + "f" * 100_000, "an integer of 100,002 characters; accepted: up to 400"),
    (BOMB, "more than 150,000 values"),
    (f"a: [{'1, ' * 190_000}1]", "has 190,000 commas and line ends; accepted: up to 150,000, and as many values"),
    ("a:\n" + "- - - - - -\n" * 70_000, "more than 150,000 values, line 250"),
    ("a: !" + "x" * 100_000 + " 1", "could not determine a constructor for the tag '!xxx"),
    ("a" * (3 << 20) + "b", "larger than 3,145,728 bytes"),
]


@pytest.mark.parametrize(("text", "words"), BROKEN, ids=range(len(BROKEN)))
def test_a_file_that_is_no_mapping_is_refused(write: Write, text: str | bytes, words: str) -> None:
    """What is not UTF-8, not YAML, not one mapping or says a key twice is refused in one line."""
    path = write(text)
    assert words in refusal(lambda: read_yaml(path), path)


def test_a_file_that_cannot_be_opened_is_refused(tmp_path: Path) -> None:
    """A missing file and a folder are refused by path."""
    for path in (tmp_path / "none.yaml", tmp_path):
        assert "cannot be read" in refusal(lambda p=path: read_yaml(p), path)


@pytest.mark.parametrize(
    ("text", "number"),
    [("1e5", 1e5), ("1.0e5", 1e5), ("-2E-3", -2e-3), ("1e+5", 1e5), (".5", 0.5), ("010", 10.0), ("0x1F", 31.0),
     ("0o17", 15.0)],
)  # fmt: skip
def test_numbers_are_what_they_look_like(write: Write, text: str, number: float) -> None:
    """Every usual way to write a number is one, with or without point and sign of the exponent."""
    assert read_yaml(write(f"x: {text}"))["x"] == number


@pytest.mark.parametrize("text", ["1:30", "2001-13-45", "2001-01-01", "0x", "0b_", "1_0", "1e", "1" * 400, "1e999"])
def test_what_only_resembles_a_number_is_refused(write: Write, text: str) -> None:
    """Times, dates and numbers beyond the range of a double are refused, not turned into other numbers."""
    path = write(f"x: {text}")
    assert "x is " in refusal(lambda: read_model(Measured, path), path)


@pytest.mark.parametrize("text", ["yes", "no", "on", "off", "y", "1:30", "2001-01-01", "1_0", "="])
def test_words_of_yaml_1_1_are_texts(write: Write, text: str) -> None:
    """What YAML 1.1 takes for switches, times, dates and grouped digits is a text, as in YAML 1.2."""
    assert read_yaml(write(f"{text}: {text}")) == {text: text}


def test_the_first_of_several_documents(write: Write) -> None:
    """Where a stream of documents is expected the first one counts, and it has to be a mapping."""
    assert read_yaml(write("a: 1\n---\nb: 2\n---\n"), first=True) == {"a": 1}
    path = write("")
    said = refusal(lambda: read_yaml(path, "a trajectory", first=True), path)
    assert said.endswith("holds nothing; accepted: a trajectory")


def test_a_list_that_is_used_twice_is_written_twice(write: Write) -> None:
    """No anchors stand in what is written: other programs read the files, too."""
    both = [1.0, 2.0]
    text = yaml_text({"a": both, "b": both})
    assert "&" not in text
    assert read_yaml(write(text)) == {"a": both, "b": both}


WORDS = st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), min_size=1) | st.sampled_from(
    ["1e5", "010", "1:30", "yes", "no", "null", "~", "2001-01-01", "0x1F", "0o17", ".inf", "1_0", "<<", "=", "a: b"]
)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(10**12), 10**12)
VALUES = st.recursive(
    NUMBERS | WORDS | st.booleans() | st.none(), lambda x: st.lists(x) | st.dictionaries(WORDS, x), max_leaves=12
)


@settings(max_examples=40)
@given(st.dictionaries(WORDS, VALUES, min_size=1))
def test_what_is_written_is_read_back(content: dict[str, Any]) -> None:
    """Any texts and numbers come back to the same bits, and a reader of YAML 1.1 sees the same."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file.yaml"
        path.write_text(yaml_text(content), encoding="utf-8")
        again = read_yaml(path)
        old = yaml.load(path.read_text(encoding="utf-8"), yaml.CSafeLoader)
    assert repr(again) == repr(old) == repr(content)  # tells 0.0 from -0.0, which == does not


def test_an_installed_package_finds_the_environment_s_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Away from a source tree the data folder is share/rx90_emulator under the environment's prefix."""
    monkeypatch.setattr(share, "ROOT", tmp_path / "site-packages")
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    with pytest.raises(ConfigError, match="data folder of rx90_emulator was not found"):
        share.share_directory()
    folder = tmp_path / "share" / share.PACKAGE
    (folder / "config").mkdir(parents=True)
    assert share.share_directory() == folder


def test_a_file_of_the_user_s_own_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A path that exists is taken as it is; a shipped name is found under config/; others are refused."""
    own = tmp_path / "friction.yaml"
    own.write_text("x: 1")
    assert share.resolve_config(str(own)) == own
    monkeypatch.chdir(tmp_path)
    assert share.resolve_config("friction.yaml") == Path("friction.yaml")
    assert share.resolve_config("robots/rx90b/drives.yaml") == share.config_path("robots/rx90b/drives.yaml")
    with pytest.raises(ConfigError, match=r"no file .robots/rx90b/nothing\.yaml."):
        share.resolve_config("robots/rx90b/nothing.yaml")
