"""The option of effects, and where the choice is told."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError
from sdpid.estimation.effects.kinds import names_of_effects
from sdpid.output.report.report import report_html
from sdpid.workflow.formulate import formulate
from tests.helpers.refusals import refuses
from tests.helpers.runs import arm, recorded


def test_the_option() -> None:
    assert names_of_effects("auto") is None
    assert names_of_effects("none") == ()
    assert names_of_effects("tilt") == ("tilt",)
    assert names_of_effects(["load", "falling"]) == ("load", "falling")
    assert names_of_effects("tilt, load") == ("tilt", "load")
    for effects in (["tilt", "wind"], "tilt,wind"):
        refuses(DataError, r"'wind'.*tilt, load, rotor_inertia", names_of_effects, effects)


@pytest.mark.parametrize("effects", [True, None, 3])
def test_what_holds_no_names_is_refused(effects: Any) -> None:
    with pytest.raises(DataError, match=r"effects: is .*'auto', 'none' or some of tilt"):
        sdpid.identify(arm(), recorded(1), effects=effects)


def test_an_arm_without_effects_gets_none() -> None:
    problem = formulate(arm(), recorded(1))
    assert not any(each.chosen for each in problem.effects)
    assert problem.effects
    plain = formulate(arm(), recorded(1), effects="none")
    assert plain.effects == ()
    assert plain.base.names == problem.base.names


def test_what_was_chosen_is_told_and_stands_in_the_result() -> None:
    result = sdpid.identify(arm(), recorded(1), effects=("rotor_inertia",), intervals=False)
    (told,) = result.effects
    assert told.chosen
    assert told.words in result.notes
    assert result.to_dict()["problem"]["effects"][0]["name"] == "rotor_inertia"
    assert any(name.startswith("Ia") for name in result.problem.base.names)


def test_files_say_what_was_asked_and_what_was_left_out(tmp_path: Path) -> None:
    result = sdpid.identify(arm(), recorded(1), effects="tilt,load", intervals=False)
    page = report_html(result, figures=False)
    assert "Tilt (Gx, Gy)" in page
    assert "LoadFriction (Fl1, Fl2; width 0.005" in page
    assert "bodies (" not in page
    file = sdpid.write_parameters(result.estimate, tmp_path / "parameters.json")
    told = {each["name"]: each for each in json.loads(file.read_text())["effects"]}
    assert told["tilt"]["chosen"]
    found = result.estimate.named_theta()
    assert f"{np.degrees(found['Gx']):.2f}° about x" in told["tilt"]["words"]
    # Effects that the data do not show stand in the notes, with their numbers.
    free = sdpid.identify(arm(), recorded(1), intervals=False)
    for each in free.effects:
        assert each.words in free.notes
        assert "would lower the cost by" in each.words


def test_costs_that_are_no_likelihood_choose_nothing() -> None:
    problem = formulate(arm(), recorded(1), weighting="eq9")
    assert problem.effects == ()


def test_without_consistency_and_without_a_prior() -> None:
    for options in ({"consistency": "none"}, {"prior": False}):
        problem = formulate(arm(), recorded(1), **options)
        assert problem.effects
        assert not any(each.chosen for each in problem.effects)
