"""Contacts at another frame or point than where feet touch the ground are found and named."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sdpid
from sdpid import Recording
from sdpid.experiment.inspection.accept import require_accepted
from sdpid.experiment.inspection.finding import Finding, Subject
from sdpid.experiment.inspection.places import point_checks
from sdpid.experiment.plant.legged import model
from tests.helpers.refusals import refuses

pytest.importorskip("mujoco")
LEGS = ("FL", "FR", "RL", "RR")


@cache
def robot() -> sdpid.RobotModel:
    return sdpid.load_robot("go1", root="free_flyer")


@cache
def log(motion: str) -> Recording:
    return sdpid.simulate_legged(robot(), motion, seed=4, duration=3.0).recording


def found(motion: str, **changes: object) -> list[Finding]:
    recording = replace(log(motion), contacts=replace(log(motion).contacts, **changes))
    return list(point_checks.points(Subject(log=recording, robot=None, floating=robot())))


@pytest.mark.parametrize("motion", ["stand", "trot", "hang"])
def test_right_contacts_are_left_alone(motion: str) -> None:
    assert not found(motion)


@pytest.mark.parametrize("motion", ["stand", "trot"])
def test_point_that_rests_is_named(motion: str) -> None:
    true = np.array(log(motion).contacts.offset)
    for stated in ([0.0, 0.0, 0.0], [0.03, 0.0, -0.02]):
        (finding,) = found(motion, offset=stated)
        assert (finding.severity, finding.kind) == ("warning", "contact_point")
        named = np.array(eval(finding.remedy.split("=")[1]))
        assert np.linalg.norm(named - true[0]) < 0.004
    # One foot alone.
    offset = true + np.array([[0.0, 0.0, 0.05], *3 * [[0.0, 0.0, 0.0]]])
    if motion == "stand":
        assert {f.message.split()[0] for f in found(motion, offset=offset)} == {"FL_foot"}


@pytest.mark.parametrize("part", ["calf", "thigh"])
def test_frame_that_moves_is_refused(part: str) -> None:
    frames = tuple(f"{leg}_{part}" for leg in LEGS)
    (finding,) = found("trot", frames=frames)
    assert (finding.severity, finding.kind) == ("refuse", "contact_frame")
    assert finding.remedy.endswith("FL_foot, FR_foot, RL_foot, RR_foot")
    refuses(sdpid.errors.DataError, "accept=\\['contact_frame'\\]", require_accepted, [finding])
    require_accepted([finding], "contact_frame")
    wrong = replace(log("trot"), contacts=replace(log("trot").contacts, frames=frames))
    told = {each.kind for each in sdpid.inspect_recording(wrong, robot()).findings}
    assert "contact_frame" in told
    assert not told & {"contact_point", "foot_moves", "base_late"}


def test_a_foot_that_slips_has_no_other_point(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model, "_GRIP", 0.05)
    solo = sdpid.load_robot("solo12", root="free_flyer")
    slips = sdpid.simulate_legged(solo, "trot", seed=2, duration=10.0).recording
    told = list(point_checks.points(Subject(log=slips, robot=None, floating=solo)))
    assert {each.kind for each in told} == {"foot_moves"}
    assert told[0].message.endswith(": it slips")


def test_a_foot_that_is_in_the_air_shows_no_point() -> None:
    down = np.array(log("trot").contacts.down)
    down[:, 0] = True
    assert not found("trot", down=down)
