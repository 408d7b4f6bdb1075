"""Where config/ is found, in a source tree, an install space and a pip environment."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from rx90_common.base import share
from rx90_common.base.errors import ConfigError


def test_the_source_tree_is_its_own_share_folder() -> None:
    """In a checkout the data folder is the checkout, and shipped files are found under config/."""
    root = Path(share.__file__).resolve().parents[2]
    assert share.share_directory() == root
    assert share.config_path("robots/rx90b/friction.yaml").is_file()


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
    with pytest.raises(ConfigError, match="no file '~nobody_of_this_name/x'"):
        share.resolve_config("~nobody_of_this_name/x")
    with pytest.raises(ConfigError, match=r"no file .robots/rx90b/nothing\.yaml."):
        share.resolve_config("robots/rx90b/nothing.yaml")
