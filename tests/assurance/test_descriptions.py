"""What an audit of a description finds, and what it leaves in peace."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid import audit_urdf
from sdpid.assurance.descriptions.checks import carried, carried_theta
from sdpid.errors import ModelError
from sdpid.estimation.constraints.hull import Hull
from sdpid.robot.description.bodies import read_urdf_bodies
from sdpid.robot.inertia import complement, margin, point_masses
from tests.helpers.commands import ran, refused, run
from tests.helpers.descriptions import box, chain, diagonal, inertial, inertial_of
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE
from tests.helpers.strategies import bodies, reals, rotations

GOOD = diagonal(1.0, 0.01, 0.01, 0.012)


def kinds(text: str) -> dict[str, str]:
    """Return the severities of the findings by kind."""
    return {finding.kind: finding.severity for finding in audit_urdf(text).findings}


@given(bodies(), rotations(), st.sampled_from(["continuous", "fixed"]))
def test_bodies_of_point_masses_are_never_errors(
    body: np.ndarray, R: np.ndarray, kind: str
) -> None:
    audit = audit_urdf(chain(inertial_of(body), GOOD, joints=("continuous", kind)))
    assert audit.passed
    assert audit.bodies[1].consistent
    assert audit.bodies[1].second_moment == pytest.approx(
        float(margin(body, "pseudo_inertia")), rel=1e-6
    )
    assert audit.bodies[1].triangle_ratio < 1.0


@given(
    reals(0.05, 5.0),
    reals(1e-6, 1.0),
    reals(1e-6, 1.0),
    reals(1e-9, 1.0),
    rotations(),
    reals(-1, 1),
)
def test_a_violated_triangle_is_always_an_error(
    mass: float, a: float, b: float, excess: float, R: np.ndarray, x: float
) -> None:
    tensor = R @ np.diag([a, b, (a + b) * (1.0 + excess)]) @ R.T
    tensor = 0.5 * (tensor + tensor.T)
    audit = audit_urdf(chain(inertial(mass, np.array([x, 0.0, 0.1]), tensor)))
    (error,) = audit.errors
    assert error.kind == "triangle"
    assert error.link == "link1"
    assert error.value < 0.0


def test_verdicts_are_exact() -> None:
    # A rod and a plate are on the edge, decimals that binary numbers cannot hold included.
    assert kinds(chain(diagonal(1.0, 0.0, 0.3, 0.3))) == {"no_thickness": "warning"}
    assert kinds(chain(diagonal(1.0, 0.1, 0.2, 0.3))) == {"no_thickness": "warning"}
    assert kinds(chain(diagonal(1.0, 0.1, 0.2, 0.30000000000000004))) == {"triangle": "error"}


@pytest.mark.parametrize(
    ("content", "kind", "severity"),
    [
        (diagonal(-1.0, 0.01, 0.01, 0.01), "negative_mass", "error"),
        (diagonal(0.0, 0.01, 0.01, 0.01), "massless_inertia", "error"),
        (diagonal(1.0, -0.01, 0.01, 0.01), "negative_moment", "error"),
        (GOOD.replace('ixx="0.01"', 'ixx="nan"'), "unreadable", "error"),
        (GOOD.replace('ixx="0.01"', 'ixx="1e999"'), "unreadable", "error"),
        (GOOD.replace('ixx="0.01"', 'ixx="${i}"'), "unreadable", "error"),
        (GOOD.replace('ixx="0.01"', ""), "unreadable", "error"),
        (GOOD.replace('xyz="0.0 0.0 0.0"', 'xyz="0 0"'), "unreadable", "error"),
        (GOOD.replace("ixx=", 'iyx="0.1" ixx='), "not_symmetric", "error"),
        (GOOD.replace("ixx=", 'iyx="0" ixx='), None, None),
        (diagonal(0.0, 0.0, 0.0, 0.0), "moves_nothing", "error"),
        (diagonal(1.0, 0.0, 0.0, 0.0), "point", "warning"),
        (diagonal(1.0, 1.0, 1.0, 1.0), "identity", "warning"),
        (GOOD + box(0.02), "too_dense", "warning"),
        (GOOD + box(20.0), "too_light", "warning"),
        (diagonal(1.0, 0.01, 0.01, 0.01) + box(0.1), "too_wide", "warning"),
        (diagonal(0.001, 0.1, 0.1, 0.1), "too_wide", "warning"),
        (diagonal(1.0, 1e-9, 1e-9, 1e-9) + box(0.1), "too_narrow", "warning"),
        (diagonal(1.0, 0.0016, 0.0016, 0.0016) + box(0.1), None, None),
    ],
)
def test_accidents(content: str, kind: str | None, severity: str | None) -> None:
    found = kinds(chain(content))
    if kind is None:
        assert not found
    else:
        assert found[kind] == severity


def test_links_that_only_place_others_are_in_order() -> None:
    # A massless link in between: some loaders refuse it, dynamics exist all the same.
    assert kinds(chain("", GOOD)) == {"moving_without_mass": "warning"}
    # A frame without mass that is fixed to a body is nothing to speak of.
    assert not kinds(chain(GOOD, diagonal(0.0, 0.0, 0.0, 0.0), joints=("continuous", "fixed")))
    # The mass may be in what is fixed to the link that moves.
    assert not kinds(chain("", GOOD, joints=("continuous", "fixed")))
    assert kinds(chain(GOOD, diagonal(0.1, 0.0, 0.0, 0.0), joints=("continuous", "fixed"))) == {
        "point": "note"
    }


def test_copies() -> None:
    other = GOOD.replace('value="1.0"', 'value="2.0"')
    assert kinds(chain(GOOD, other)) == {"copied": "warning"}
    assert kinds(chain(GOOD + box(0.3), GOOD + box(0.3))) == {}
    assert kinds(chain(GOOD + box(0.3), GOOD + box(0.4))) == {"copied": "note"}


def test_center_of_mass_outside() -> None:
    tensor = np.diag([0.0016] * 3)
    away = inertial(1.0, np.array([0.08, 0.0, 0.0]), tensor)
    (finding,) = audit_urdf(chain(away + box(0.1))).findings
    assert (finding.kind, finding.severity) == ("com_outside", "warning")
    assert finding.value == pytest.approx(0.03, abs=1e-12)
    hidden = kinds(chain(away + box(0.1) + box(0.2, "visual")))
    assert hidden == {"com_outside": "note"}


def test_units_are_named() -> None:
    millimeters = chain(diagonal(1.0, 1667.0, 1667.0, 1667.0) + box(0.1))
    assert "kg·mm²" in audit_urdf(millimeters).describe()
    grams = chain(diagonal(800.0, 1.3, 1.3, 1.3) + box(0.1))
    assert "grams" in audit_urdf(grams).describe()


def test_wrong_points_are_named() -> None:
    # A cube of 1 kg, 0.3 m from the origin of its link.
    com, own = np.array([0.3, 0.0, 0.0]), np.diag([1.0 / 600.0] * 3)
    shape = box(0.1).replace("<geometry>", '<origin xyz="0.3 0 0"/><geometry>')
    shift = complement(np.outer(com, com))
    assert not kinds(chain(inertial(1.0, com, own) + shape))
    assert kinds(chain(inertial(1.0, com, own + shift) + shape)) == {"wrong_point": "warning"}
    twice = audit_urdf(chain(inertial(1.0, com, own - shift) + shape))
    assert "taken off twice" in twice.errors[0].message


def test_rounding_is_offered_as_a_reason() -> None:
    rounded = audit_urdf(chain(diagonal(1.0, 0.01001, 0.02002, 0.03004)))
    assert "rounding" in rounded.errors[0].message
    assert "rounding" not in audit_urdf(chain(diagonal(1.0, 0.01, 0.01, 0.03))).errors[0].message


@given(st.integers(0, 2**32 - 1))
def test_what_is_inside_a_shape_fits_into_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.3, 0.3, (12, 3)) * rng.uniform(0.1, 1.0, 3)
    shape = Hull.of(points, "points")
    masses = rng.uniform(0.0, 1.0, 12)
    body = point_masses(masses, points)
    com = body[1:4] / body[0]
    away = points - com
    spread = shape.spread(com, np.einsum("k,ki,kj->ij", masses, away, away) / masses.sum())
    assert spread <= 1.0 + 1e-9
    assert shape.distance(com) <= 0.0
    # Distances outside: against the best of many convex combinations.
    far = rng.uniform(-1.0, 1.0, 3) + np.array([1.5, 0.0, 0.0])
    shares = rng.dirichlet(np.full(12, 0.3), 2000)
    sampled = np.linalg.norm(shares @ points - far, axis=1).min()
    corner = np.linalg.norm(points - far, axis=1).min()
    distance = shape.distance(far)
    assert distance <= min(sampled, corner) + 1e-12
    assert distance >= float(np.max(shape.normals @ far - shape.offsets)) - 1e-12


def test_numbers_are_pinocchios() -> None:
    robot = sdpid.load_robot(TREE)
    _, described = read_urdf_bodies(TREE, "tree")
    groups = carried(described)
    ours = np.array([carried_theta(groups[name]) for name in robot.link_names])
    assert np.allclose(ours, robot.prior, rtol=1e-12, atol=1e-15)


def test_kinematics_alone_are_no_error(denso: sdpid.RobotModel) -> None:
    # The robot of the case study comes without inertias: they are to be identified.
    assert denso.urdf is not None
    assert kinds(denso.urdf) == {"no_inertials": "warning"}


def test_mjcf() -> None:
    pytest.importorskip("mujoco")
    text = (
        '<mujoco><worldbody><body name="a"><joint/><inertial pos="0 0 0" mass="1" '
        'fullinertia="1 1 3 0 0 0"/><body name="b"><joint/><geom size="0.1"/>'
        '<body name="c"><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></body>'
        '</body><body name="d"><joint/></body></worldbody></mujoco>'
    )
    audit = audit_urdf(text)
    assert [(f.kind, f.link) for f in audit.errors] == [("triangle", "a"), ("moves_nothing", "d")]
    assert [body.moving for body in audit.bodies] == [True, True, True, True]


def test_json_and_table_are_plain() -> None:
    audit = audit_urdf(chain(GOOD, diagonal(1.0, 0.0, 0.0, -1.0), ""))
    content = json.loads(json.dumps(audit.to_dict(), allow_nan=False))
    assert content["passed"] is False
    assert len(content["bodies"]) == 4
    assert {f["severity"] for f in content["findings"]} == {"error"}
    table = audit.table().splitlines()
    assert len(table) == 5
    assert [line.startswith("link2 !") for line in table].count(True) == 1


@pytest.mark.parametrize(
    "text",
    ["<robot", "<sdf/>", "<robot/>", chain(GOOD, GOOD).replace("link2", "link1"), "no such file"],
)
def test_what_cannot_be_read(text: str) -> None:
    refuses(ModelError, ".", audit_urdf, text)


def test_command(tmp_path: Path) -> None:
    good, bad, none = tmp_path / "good.urdf", tmp_path / "bad.urdf", tmp_path / "none.urdf"
    good.write_text(chain(GOOD))
    bad.write_text(chain(diagonal(1.0, 0.01, 0.01, 0.03)))
    ran("audit", good)
    refused(run("audit", none), 2, "none.urdf")
    out = tmp_path / "out.urdf"
    done = run("audit", bad, "--repair", out, "--json")
    assert done.exit_code == 3
    assert json.loads(done.stdout)["repair"]["bodies"][0]["link"] == "link1"
    ran("audit", out)
