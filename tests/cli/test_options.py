"""What options of the command line become."""

from typing import Any

import pytest

from sdpid.cli.endings import message
from sdpid.cli.options import Estimation, ProcessingOptions
from sdpid.constraints import MirrorPair, TotalMass
from sdpid.errors import DataError
from tests.helpers.legged import quadruped


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, {}),
        ({"mask": True}, {}),
        ({"mask": False}, {"reversal_time": None}),
        (
            {"mask_speed": 0.05, "mask_time": 0.0, "cutoff": 8.0},
            {"reversal_speed": 0.05, "reversal_time": 0.0, "cutoff_hz": 8.0},
        ),
        ({"filter_friction": False}, {"filter_friction": False}),
    ],
)
def test_the_processing(given: dict[str, Any], expected: dict[str, Any]) -> None:
    assert ProcessingOptions(**given).changes() == expected


def test_a_mask_that_is_off_has_no_size() -> None:
    with pytest.raises(DataError, match="mask-speed"):
        ProcessingOptions(mask=False, mask_speed=0.1).changes()


def test_a_message_that_gives_the_option_needs_no_hint() -> None:
    assert message(DataError("accept=['a'] (--accept a) overrules it.")).endswith("overrules it.")
    assert message(DataError("give units={}.")).endswith("--unit QUANTITY=UNIT.")
    assert message(DataError("give units={} (--unit time=ms).")).endswith("time=ms).")


def test_a_weighed_robot_with_legs_that_are_alike() -> None:
    arguments = Estimation(total_mass="2.5, 0.01", mirror=True).arguments(quadruped())
    mass, *pairs = arguments["constraints"].others
    assert isinstance(mass, TotalMass)
    assert (mass.mass, mass.tolerance) == (2.5, 0.01)
    assert len(pairs) == 6
    assert all(isinstance(pair, MirrorPair) for pair in pairs)
    assert Estimation().arguments(quadruped())["constraints"].others == ()
    with pytest.raises(DataError, match="expected a mass in kg, or a mass and by how much"):
        Estimation(total_mass="2.5,0.1,0.2").arguments(quadruped())


def test_legs_that_are_nearly_alike() -> None:
    robot = quadruped()
    arguments = Estimation(mirror_within="5%", mirror_friction="0.2").arguments(robot)
    assert (len(arguments["prior"].alike), arguments["prior"].within) == (6, 0.05)
    drives = arguments["constraints"].others
    assert [type(each).__name__ for each in drives] == 6 * ["EqualFriction"]
    assert {each.within for each in drives} == {0.2}
    for refused, text in (
        ({"mirror_within": "5", "mirror": True}, "beside --mirror it says nothing"),
        ({"mirror_within": "5%", "prior": False}, "beside --no-prior it says nothing"),
        ({"mirror_within": "0%"}, "have --mirror"),
        ({"mirror_within": "much"}, "expected a share such as 5% or 0.05"),
        ({"mirror_friction": "-1%"}, "--mirror-friction -1%: expected a share"),
    ):
        with pytest.raises(DataError, match=text):
            Estimation(**refused).arguments(robot)
