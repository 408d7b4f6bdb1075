"""`rx90_identify --bristle-kinds` on bags of a joint with elasto-plastic bristles, made in the closed loop."""

from __future__ import annotations

import io
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from schema_faults import schema_faults
from terminal import Terminal

import rx90_emulator as rx
from rx90_common.base.errors import DONE
from rx90_common.description.coupling import RX_WRIST
from rx90_common.friction import FrictionSet, load_friction
from rx90_common.friction.parts.bristles import ElastoPlastic
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.experiments.plan import PlanOptions, make_plan
from rx90_emulator.identification.experiments.series import run_on_engine
from rx90_emulator.identification.presliding import kinds as kinds_module
from rx90_emulator.identification.presliding.bristle_motion import FAMILIES
from rx90_emulator.loop.setup import Setup

TRUTH = ElastoPlastic(0.6)


class Outcome(NamedTuple):
    """What the command wrote and said: friction file, its content, standard output and error, and the bags."""

    file: Path
    content: dict[str, Any]
    said: str
    shown: str
    bags: dict[str, Path]


@pytest.fixture(scope="module")
def outcome(shipped: Setup, tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """Run sweeps and three micro-oscillations of joint 4, whose bristles are elasto-plastic, and identify it."""
    folder = tmp_path_factory.mktemp("kinds")
    elements = list(shipped.friction.elements)
    elements[3] = replace(elements[3], bristles=TRUTH)
    truth = replace(shipped, friction=FrictionSet(shipped.friction.names, tuple(elements)))
    options = PlanOptions(
        speeds=8, groups=("joint_4",), presliding_cycles=(2e-3,) * 3, tone_amplitudes=(1.2e-4, 6e-5, 3e-5), burst=2.4
    )
    bags = {}
    for experiment in make_plan(truth.robot, truth.drives, options):
        bags[str(experiment.kind)] = folder / experiment.name
        run_on_engine(truth, experiment, folder / experiment.name)
    file, said, shown = folder / "friction.yaml", io.StringIO(), Terminal()
    words = [word for use, bag in bags.items() for word in (f"--{use}", str(bag))]
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said), redirect_stderr(shown):
        patch.setattr(kinds_module, "FAMILIES", FAMILIES[:3])  # blocks of one number: more take longer
        assert run("rx90_identify", [*words, "--output", str(file), "--bristle-kinds"]) == DONE, said.getvalue()
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    return Outcome(file, content, said.getvalue(), shown.getvalue(), bags)


def test_the_file_carries_the_kind_and_where_it_comes_from(outcome: Outcome) -> None:
    """The kind is that of the plant, its break-away within four deviations, by the bag of micro-oscillations."""
    found = outcome.content["identification"]["bristles"]["joint_4"]
    assert found["decision"] == "elasto-plastic"
    assert list(found["tried"]) == [family.name for family in FAMILIES[:3]]
    (label,) = found["bags"]
    bags = outcome.content["identification"]["bags"]
    assert bags[label]["path"] == str(outcome.bags["presliding"])
    number = outcome.content["identification"]["parameters"]["joint_4"]["bristles.break_away"]
    assert number["provenance"] == "identified"
    assert number["bags"] == [label]
    error = number["value"] - TRUTH.break_away
    assert abs(error) < min(0.1, 4.0 * number["deviation"] + 0.02)
    assert outcome.content["elements"]["joint_4"]["note"].startswith("bristles: elasto-plastic, told")
    assert schema_faults("friction", outcome.file) == []


def test_what_was_not_compared_stays_lugre_and_says_so(outcome: Outcome) -> None:
    """Joints that did not move, those of the coupled wrist as well, have LuGre's bristles and the reason."""
    for name, reason in (("joint_1", "0 micro-oscillations; 3"), ("joint_5_6", "0 micro-oscillations; 6")):
        assert "bristles" not in outcome.content["elements"][name]
        assert outcome.content["elements"][name]["note"].startswith(f"bristles: not compared: {reason}")
        assert outcome.content["identification"]["bristles"][name]["decision"] == "not compared"


def test_the_plant_runs_with_the_file(outcome: Outcome, shipped: Setup) -> None:
    """The plant that loads the file has the bristles written there, c0 near the truth, and runs a motion with them."""
    element = load_friction(outcome.file, RX_WRIST.element_names(shipped.robot.joint_names)).elements[3]
    written = outcome.content["elements"]["joint_4"]["bristles"]
    assert element.bristles == ElastoPlastic(written["break_away"])
    truth = shipped.friction.elements[3]
    assert element.c0 == pytest.approx(truth.c0, rel=0.05)
    setup = rx.load_setup(friction=outcome.file)
    names, rest = shipped.robot.joint_names, np.zeros(6)
    points = rx.TrajectoryPoints.create(names, names, [0.0, 0.2], [rest, 1e-3 * np.eye(6)[3]], [rest] * 2, [rest] * 2)
    series = rx.simulate(setup, points).series["friction_states"]
    assert series.effort is not None
    assert np.isfinite(series.effort).all()


def test_a_validation_holds_the_bristles(outcome: Outcome) -> None:
    """The run that was not used confirms the identification, and the file given by itself."""
    assert f"validation {outcome.bags['validation']}: confirmed" in outcome.said
    words = ["--friction", str(outcome.file), "--validation", str(outcome.bags["validation"])]
    assert run("rx90_identify", words) == DONE


def test_terminal_and_page_show_the_choice(outcome: Outcome) -> None:
    """A table of all kinds with the decision and how sure it is; progress names joint and kind and ends complete."""
    assert "bristles of joint_4: elasto-plastic, told from the others by" in outcome.said
    assert "bristles of joint_5, joint_6, joint_5_6: not compared: 0 micro-oscillations; 6 or more" in outcome.said
    assert "joint_4: elasto-plastic" in outcome.shown
    assert "| 54/54 [" in outcome.shown  # three bags, two fits, four joints and the wrist's 27 + 9, one validation
    text = outcome.file.with_suffix(".html").read_text(encoding="utf-8")
    assert "Kinds of bristles" in text
    assert "told from the others by" in text
