"""Where what costs less predicts better, remedies are tried, and what they give is said."""

import io
from functools import cache
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.output.report.report import report_html
from sdpid.workflow.result import Identification
from tests.helpers.world import arm_log, arm_urdf


@cache
def log(seed: int) -> sdpid.Recording:
    pandas = pytest.importorskip("pandas")
    return sdpid.read_recording(pandas.read_csv(io.StringIO(arm_log(seed))))


def identified(factors: tuple[float, ...], **options: Any) -> Identification:
    """Return what `identify` finds of the arm by a description whose links are off by factors."""
    return sdpid.identify(
        sdpid.load_robot(arm_urdf(np.array(factors))),
        log(1),
        validation=log(2),
        effects="none",
        intervals=False,
        accept="effort_spoils",
        **options,
    )


def test_a_bound_that_is_too_tight_is_found_and_widened() -> None:
    off = (1.15, 0.85, 1.15, 0.85, 1.15, 0.85)
    robot = sdpid.load_robot(arm_urdf(np.array(off)))
    limits = sdpid.Constraints.of_size(robot, mass_max=3.0)
    result = identified(off, constraints=limits)
    tried = {each.option: each for each in result.remedies}
    assert list(tried) == ["--no-prior", "--mass-max 30", "--without-effort joint_2"]
    assert [each.helps for each in tried.values()] == [False, True, False]
    assert "mass of link_2 at most 3 kg" in tried["--mass-max 30"].cause
    headline = result.headline
    assert headline.step.startswith("identify again with --mass-max 30: bounds hold it back (mass")
    assert headline.warnings[0] == "use it: least squares predicts better what was held out"
    assert "--mass-max 30: 1.13 % in place of 1.49 %" in headline.tried
    assert any(line.startswith("tried          --no-prior: ") for line in headline.lines)
    assert "Tried: --no-prior: 1.49 % in place of 1.49 %, no remedy; --mass" in report_html(result)
    # What is promised is what comes of it.
    wider = identified(off, constraints=sdpid.Constraints.of_size(robot, mass_max=30.0))
    assert wider.remedies == ()
    error = wider.held_out.fit.told.relative
    assert error == pytest.approx(tried["--mass-max 30"].error, rel=1e-3)
    assert wider.to_dict()["remedies"] == []


def test_a_description_that_is_wrong_and_believed_is_found() -> None:
    wrong = (1.0, 1.0, 6.0, 1.0, 1.0, 1.0)
    result = identified(wrong, prior=sdpid.Prior(strength=1e5))
    (best, *others) = result.remedies
    assert best.option == "--no-prior"
    assert best.helps
    assert not any(each.helps for each in others)
    assert "identify again with --no-prior: the belief in the description" in result.headline.step
    free = identified(wrong, prior=False)
    assert free.held_out.fit.told.relative == pytest.approx(best.error, rel=1e-3)
