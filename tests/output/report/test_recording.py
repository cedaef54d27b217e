"""What the report says of a recording."""

import pytest

import sdpid
from sdpid.output.report.sections.recording import units
from tests.helpers.robots import TREE


@pytest.mark.parametrize(("description", "effort"), [(TREE, "N, N·m"), ("denso_vp6242", "N·m")])
def test_units_are_those_of_the_joints(description: str, effort: str) -> None:
    found = units(sdpid.load_robot(description))
    assert set(found["effort"].split(", ")) == set(effort.split(", "))
    assert ("m/s" in found["velocity"].split(", ")) == ("N" in effort.split(", "))
