"""rx90_config friction: elements beside each other with the source of each number, and taken into another file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from friction_bench.rig.rig_file import load_rig
from rx90_common.base.config import load_yaml, yaml_text
from rx90_common.base.share import config_path
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.friction_file import ALL_ELEMENTS, FrictionFile
from rx90_emulator.cli.frame import run

Captured = pytest.CaptureFixture[str]


def shipped(name: str) -> FrictionFile:
    """Return shipped friction."""
    return FrictionFile.read(config_path(f"friction/{name}.yaml"))


def told(capsys: Captured, *words: str) -> str:
    """Return what the command prints; it must be done."""
    assert run("rx90_config", ["friction", *words]) == 0, capsys.readouterr().err
    return capsys.readouterr().out


def test_each_number_has_its_source_and_its_torque(capsys: Captured) -> None:
    """The source of a value is what its element, else all elements, else the file says; the torque is the curve's."""
    found = json.loads(told(capsys, "puma560:joint_3", "manutec_r3", "tx40", "--speed", "2", "--json"))
    by_element = {one["element"]: one for one in found}
    assert len(found) == 1 + 6 + 7
    puma = by_element["puma560:joint_3"]["parameters"]
    assert puma["tau_c.negative"]["value"] == 5.63916
    assert puma["tau_c.negative"]["provenance"] == "derived"
    assert "Corke and Armstrong-Helouvry" in puma["tau_c.negative"]["source"]
    assert puma["c0"]["assumed"]
    assert "guessed deflection" in puma["c0"]["source"]
    inner, outer = (by_element[f"manutec_r3:joint_{k}"]["parameters"]["tau_c"] for k in (1, 4))
    assert (inner["provenance"], outer["provenance"]) == ("derived", "published")
    assert "before the gear" in inner["source"]
    assert "behind the gear" in outer["source"]
    parameters = [by_element[f"tx40:joint_{k}"]["parameters"] for k in (4, 5)]
    assert [one["c2"]["provenance"] for one in parameters] == ["published", "derived"]
    assert [one["delta"]["provenance"] for one in parameters] == ["assumed", "assumed"]
    for at, speed in zip(by_element["puma560:joint_3"]["torque"], (0.02, 0.2, 2.0), strict=True):
        assert at["speed"] == pytest.approx(speed)
        assert (at["positive"], at["negative"]) == pytest.approx((7.08923 + 3.98043 * speed, 5.63916 + 3.98043 * speed))


def test_the_table_marks_what_is_assumed_and_names_the_sources(capsys: Captured) -> None:
    """A line for each element, a star at each assumed value, and below for each file which values come from where."""
    lines = told(capsys, "puma560:joint_3", "rx90b:joint_3").splitlines()
    assert lines[2].split()[:4] == ["puma560:joint_3", "7.089/5.639", "7.089/5.639*", "0.05*"]
    assert lines[3].split()[:3] == ["rx90b:joint_3", "18*", "23*"]
    assert lines[2].split()[-1] == "-"
    assert told(capsys, "erob80_50:m3").splitlines()[2].split()[-1] == "load"
    heads = [k for k, line in enumerate(lines) if line.endswith("friction.yaml)") or line.endswith("puma560.yaml)")]
    assert [lines[k] for k in heads] == ["puma560 (friction/puma560.yaml)", "rx90b (robots/rx90b/friction.yaml)"]
    assert lines[heads[0] + 1].startswith("  tau_c, c2: derived; Corke and Armstrong-Helouvry")
    whole = told(capsys, "manutec_r3")
    assert "  tau_c, tau_s, c2 of joint_1, joint_2, joint_3: derived; " in whole
    assert "  tau_c, tau_s, c2 of joint_4, joint_5, joint_6: published; " in whole


def test_an_element_is_taken_with_its_sources(capsys: Captured, tmp_path: Path) -> None:
    """The file has the other's element bit for bit, says so, keeps the rest, and a robot takes it."""
    out = tmp_path / "mine.yaml"
    told(capsys, "rx90b", "--take", "joint_3=puma560", "--take", "joint_5=ur10e:wrist_2_joint", "-o", str(out))
    base, made = FrictionFile.read(config_path("robots/rx90b/friction.yaml")), FrictionFile.read(out)
    assert made.elements == {
        **base.elements,
        "joint_3": shipped("puma560").elements["joint_3"],
        "joint_5": shipped("ur10e").elements["wrist_2_joint"],
    }
    assert made.about["joint_5"]["note"] == "taken from friction/ur10e.yaml, wrist_2_joint"
    assert run("rx90_config", ["show", "--friction", str(out), "--json"]) == 0
    values = {one["name"]: one for one in json.loads(capsys.readouterr().out)}
    for place, provenance, words in (
        ("joint_3.tau_c.positive", "derived", "Corke and Armstrong-Helouvry"),
        ("joint_3.c1", "assumed", "1 ms c0"),
        ("joint_5.c2", "published", "Mamedov and Mikhel"),
        ("joint_4.c2", "assumed", "magnitudes from published"),
    ):
        one = values[f"friction.elements.{place}"]
        assert (one["provenance"], words in one["source"]) == (provenance, True), place
    told(capsys, "rx90b", "--take", "tx40", "-o", str(tmp_path / "all.yaml"))
    every = FrictionFile.read(config_path("robots/tx40/friction.yaml")).elements
    assert FrictionFile.read(tmp_path / "all.yaml").elements == every


def test_a_set_of_the_library_is_found_by_its_name_and_has_its_deviations(capsys: Captured) -> None:
    """Beside a published set of the same arm: values with the deviations of the file, and omega_d as assumed."""
    names = ("ur10e_mamedov:wrist_1_joint", "ur10e:wrist_1_joint")
    identified, published = (one["parameters"] for one in json.loads(told(capsys, *names, "--json")))
    stated = FrictionFile.read(config_path("friction/library/ur10e_mamedov.yaml")).identification
    assert stated is not None
    for parameter, attribute in (("tau_c", "tau_c_positive"), ("c2", "c2"), ("alpha", "alpha")):
        assert identified[parameter]["deviation"] == stated["parameters"]["wrist_1_joint"][attribute]["deviation"]
        assert identified[parameter]["provenance"] == "identified"
    assert identified["omega_d"]["assumed"]
    assert not any("deviation" in one for one in published.values())
    assert "2.025 +- 0.083" in told(capsys, *names)


def test_what_was_identified_is_not_said_of_what_was_taken(capsys: Captured, tmp_path: Path) -> None:
    """An element that is replaced loses its entry in `identification`; the others keep theirs."""
    one = FrictionElement(1.0, 1.0, 1.0, 1.0, 0.05, 1.0, 1e3, 1.0, 1.0)
    entry = {"provenance": "identified", "value": 1.0}
    known = {"parameters": {"joint_1": {"c2": entry}, "joint_3": {"c2": entry}}}
    own, out = tmp_path / "own.yaml", tmp_path / "out.yaml"
    own.write_text(FrictionFile({"joint_1": one, "joint_3": one}, "identified", "bags", known).text())
    told(capsys, str(own), "--take", "joint_3=puma560", "--output", str(out))
    made = FrictionFile.read(out)
    assert made.identification == {"parameters": {"joint_1": {"c2": entry}}}
    (joint_1, joint_3) = json.loads(told(capsys, str(out), "--json"))
    assert joint_1["parameters"]["c2"]["provenance"] == "identified"
    assert joint_3["parameters"]["c2"]["provenance"] == "derived"


def test_what_a_file_says_of_its_values_is_written_back(tmp_path: Path) -> None:
    """Provenance, source and note of all elements and of single ones come back as they stood."""
    file = shipped("manutec_r3")
    assert file.about[ALL_ELEMENTS]["provenance"] == {"tau_c": "published", "c2": "published", "tau_s": "published"}
    assert set(file.about) == {ALL_ELEMENTS, "joint_1", "joint_2", "joint_3"}
    path = tmp_path / "again.yaml"
    path.write_text(file.text(), encoding="utf-8")
    assert FrictionFile.read(path) == file


def test_the_rig_takes_a_line_of_a_friction_file(tmp_path: Path) -> None:
    """An element as it stands in a friction file, sources and all, is the joint of a rig that is emulated."""
    content = load_yaml(config_path("rig/gm8224_lugre.yaml")).content
    content["emulation"]["joint_friction"]["lugre"] = load_yaml(config_path("friction/manutec_r3.yaml")).content[
        "elements"
    ]["joint_1"]
    path = tmp_path / "rig.yaml"
    path.write_text(yaml_text(content))
    assert load_rig(path).plant.joint == shipped("manutec_r3").elements["joint_1"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "friction 'nowhere': no such file; accepted: panda, rx90b, rx90b/paper, tx40, erob80_100,"),
        (["rx90b:joint_9"], "friction 'rx90b:joint_9': no such element; accepted: joint_1, joint_2"),
        (["rx90b", "--take", "erob80_50:m1", "-o", "x"], "'m1' is no element of rx90b; accepted: joint_1,"),
        (["rx90b", "--take", "joint_3=ur10", "-o", "x"], "ur10 has no element of that name; accepted: one of should"),
        (["rx90b", "--take", "puma560"], "--take and --output: only one of them is there; accepted: both, or none"),
        (["rx90b", "--plot", "x.gif"], "--plot x.gif; accepted: a file with .png, .svg, .pdf"),
    ],
)
def test_refusals_name_what_is_accepted(
    capsys: Captured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    """What cannot be done is refused in one line, before anything is written."""
    monkeypatch.chdir(tmp_path)
    assert run("rx90_config", ["friction", *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_curves_have_a_panel_for_each_name_and_a_colour_for_each_file() -> None:
    """Elements of one name share a panel, single ones and those of one file all one; the curves are their torque."""
    from rx90_emulator.configuration.friction import FrictionChoice, comparison_plot

    def panels(*words: str) -> list[Any]:
        return list(comparison_plot([FrictionChoice.named(word) for word in words], 2.0).panels)

    every = panels("puma560", "rx90b", "ur10")
    assert [len(panel.marks) for panel in every] == [2] * 6 + [1] * 7
    assert {panel.marks[-1].colour for panel in every[:7]} == {every[0].marks[1].colour}
    (whole,) = panels("erob80_50")
    assert [curve.label for curve in whole.marks] == [f"erob80_50:m{k}" for k in range(1, 7)]
    (single,) = panels("puma560:joint_3", "ur10:elbow_joint")
    assert [curve.label for curve in single.marks] == ["puma560:joint_3", "ur10:elbow_joint"]
    curve = single.marks[0]
    torque = shipped("puma560").elements["joint_3"].steady_torque(curve.x)
    assert curve.y == pytest.approx(torque, nan_ok=True)
    assert (np.nanmin(curve.x), np.nanmax(curve.x)) == pytest.approx((-2.0, 2.0))
