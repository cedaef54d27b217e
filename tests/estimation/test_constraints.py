"""Every condition against bodies made of point masses, and optima under it."""

import pickle
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

import sdpid
from sdpid import RobotModel, load_robot, solve_sdp
from sdpid import constraints as of
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.estimation.constraints.feasible_set import Constraint
from sdpid.estimation.constraints.hull import hull_facets
from sdpid.estimation.estimate import FEASIBLE
from sdpid.estimation.problem import Problem
from sdpid.robot.inertia import physical_parameters, point_masses, pseudo_inertia
from sdpid.robot.model.geometry import collision_points, link_placements
from tests.helpers.arm import LAST, REFLECTION, arm_problem
from tests.helpers.data import FRICTION, friction_model, random_links
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, small_arm
from tests.helpers.strategies import SEEDS, bodies, reals, rotations

# Rows are sums of ten products of numbers of order ten.
ROUNDING = 1e-12
ROBOT = load_robot(TREE)
LINK = "left_arm"
BOX = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)


def layout_of(robot: RobotModel, *terms: Any) -> of.Layout:
    """Return where parameters are."""
    return of.Layout(robot, friction_model(robot, terms or FRICTION))


def compiled(condition: of.Condition, robot: RobotModel = ROBOT) -> list[of.Row | of.Cone]:
    return list(condition.compile(layout_of(robot)))


def rows_of(condition: of.Condition, robot: RobotModel = ROBOT) -> list[of.Row]:
    return [row for row in compiled(condition, robot) if isinstance(row, of.Row)]


def excess(condition: of.Condition, theta: Array, robot: RobotModel = ROBOT) -> float:
    """Return by how much theta violates the worst row or cone, negative inside."""
    worst = -np.inf
    for part in compiled(condition, robot):
        if isinstance(part, of.Row):
            value = part.coefficients @ theta
            worst = max(worst, part.lower - value, value - part.upper)
        else:
            body = theta[10 * part.link : 10 * part.link + 10]
            worst = max(worst, np.linalg.norm(part.vectors @ body) - part.axis @ body)
    return float(worst)


def satisfied(
    condition: of.Condition, theta: Array, *, robot: RobotModel = ROBOT, tol: float = ROUNDING
) -> bool:
    return excess(condition, theta, robot) <= tol


def theta_with(changes: dict[str, Array], *, seed: int = 0, robot: RobotModel = ROBOT) -> Array:
    """Return random links and friction, some links replaced."""
    rng = np.random.default_rng(seed)
    links = random_links(rng, robot.n_links)
    for name, body in changes.items():
        links[robot.link_names.index(name)] = body
    count = layout_of(robot).count - links.size
    return np.concatenate([links.ravel(), rng.uniform(0.0, 1.0, count)])


def center(body: Array) -> Array:
    return physical_parameters(body)[1]


def ball_points(rng: np.random.Generator, count: int, low: float, high: float) -> Array:
    points = rng.normal(size=(count, 3))
    radii = rng.uniform(low, high, (count, 1))
    return np.asarray(radii * points / np.linalg.norm(points, axis=1, keepdims=True))


@st.composite
def ellipsoids(draw: st.DrawFn) -> dict[str, Array]:
    rng = np.random.default_rng(draw(SEEDS))
    return {
        "center": rng.uniform(-0.3, 0.3, 3),
        "semi_axes": rng.uniform(0.05, 0.5, 3),
        "rotation": draw(rotations()),
    }


def in_frame(y: Array, ellipsoid: dict[str, Array]) -> Array:
    """Return points of the unit ball's space in the ellipsoid's."""
    return (y * ellipsoid["semi_axes"]) @ ellipsoid["rotation"].T + ellipsoid["center"]


def weighed(points: Array, seed: int) -> Array:
    masses = np.random.default_rng(seed).uniform(0.01, 2.0, len(points))
    return point_masses(masses, points)


def mirrored(points: Array, normal: Sequence[float], point: Sequence[float]) -> Array:
    n = np.asarray(normal) / np.linalg.norm(normal)
    return points - 2.0 * np.outer((points - np.asarray(point)) @ n, n)


def matter(body: Array, Q: Array) -> tuple[Array, Array]:
    """Return masses (4,) and positions (4, 3) of point masses that make up a body.

    With ⟨Q, J⟩ ≥ 0 each of them has ``x^T·Q·x ≥ 0`` of its own (x homogeneous): factors of J are
    turned two by two until all of them have the same (Sturm and Zhang, 2003).
    """
    values, vectors = np.linalg.eigh(pseudo_inertia(body))
    factors = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    share = float(np.sum(Q * (factors.T @ factors))) / 4.0
    for _ in range(3):
        sizes = np.einsum("ki,ij,kj->k", factors, Q, factors)
        i, j = int(np.argmin(sizes)), int(np.argmax(sizes))
        if sizes[j] - sizes[i] <= 1e-15 * abs(sizes).max():
            break
        # The turn (1, t) of the pair that has the share: a quadratic equation in t.
        a, c = sizes[j] - share, sizes[i] - share
        b = float(factors[i] @ Q @ factors[j])
        t = (-b + np.sqrt(max(b * b - a * c, 0.0))) / a
        one, other = factors[i] + t * factors[j], -t * factors[i] + factors[j]
        factors[i], factors[j] = np.array([one, other]) / np.sqrt(1.0 + t * t)
    masses = factors[:, 3] ** 2
    used = masses > 1e-12 * masses.sum()
    return masses[used], factors[used, :3] / factors[used, 3:]


@given(SEEDS, reals(0.0, 2.0), reals(-4.0, 4.0), st.booleans())
def test_total_mass_is_known_within_its_tolerance(
    seed: int, tolerance: float, off: float, links: bool
) -> None:
    assume(abs(abs(off) - tolerance) > 1e-9)
    theta = theta_with({}, seed=seed)
    group = ("thumb", "column") if links else None
    own = [ROBOT.link_names.index(name) for name in group or ROBOT.link_names]
    total = theta[: 10 * ROBOT.n_links : 10][own].sum() + off
    assume(total > 0.0)
    condition = of.TotalMass(total, tolerance=tolerance, links=group)
    assert satisfied(condition, theta) == (abs(off) < tolerance)
    (row,) = rows_of(condition)
    assert row.name == ("total mass of thumb, column" if links else "total mass")


@given(bodies(), SEEDS)
def test_center_of_mass_in_a_box(body: Array, seed: int) -> None:
    rng = np.random.default_rng(seed)
    lower, upper = np.sort(rng.uniform(-0.6, 0.6, (2, 3)), axis=0)
    inside = bool(((lower < center(body)) & (center(body) < upper)).all())
    condition = of.CenterOfMassInBox(LINK, lower, upper)
    assert len(rows_of(condition)) == 6
    assert satisfied(condition, theta_with({LINK: body})) == inside
    around = of.CenterOfMassInBox(LINK, center(body) - 0.01, center(body) + 0.01)
    assert excess(around, theta_with({LINK: body})) < 0.0


def test_a_box_open_and_closed() -> None:
    body = point_masses([1.0, 1.0], [[0.2, 0.1, 0.0], [0.2, 0.3, 1.0]])
    theta = theta_with({LINK: body})
    condition = of.CenterOfMassInBox(LINK, (0.2, 0.1, -np.inf), (0.2, np.inf, 0.6))
    assert [row.name for row in rows_of(condition)] == [
        "center of mass of left_arm, x known",
        "center of mass of left_arm, y at least",
        "center of mass of left_arm, z at most",
    ]
    assert satisfied(condition, theta)
    assert not satisfied(of.CenterOfMassInBox(LINK, (0.3,) * 3, (0.3, 1, 1)), theta)


@given(bodies(), ellipsoids())
def test_center_of_mass_in_an_ellipsoid(body: Array, ellipsoid: dict[str, Array]) -> None:
    y = (center(body) - ellipsoid["center"]) @ ellipsoid["rotation"] / ellipsoid["semi_axes"]
    assume(abs(np.linalg.norm(y) - 1.0) > 1e-9)
    condition = of.CenterOfMassInEllipsoid(LINK, **ellipsoid)
    theta = theta_with({LINK: body})
    assert satisfied(condition, theta) == (np.linalg.norm(y) < 1.0)
    around = of.CenterOfMassInEllipsoid(LINK, center(body) + 0.01, (0.02, 0.03, 0.04))
    assert excess(around, theta) < 0.0
    (cone,) = compiled(condition)
    assert isinstance(cone, of.Cone)
    assert cone.axis @ body == body[0]


@given(SEEDS, st.integers(4, 30))
def test_hull_of_points(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-0.4, 0.4, (count, 3))
    condition = of.CenterOfMassInHull(LINK, corners)
    # Of a cube six facets are left, however many points are within.
    assert len(rows_of(of.CenterOfMassInHull(LINK, np.vstack([BOX, 0.5 + corners])))) == 6
    inside = weighed(corners[rng.integers(0, count, 8)], seed)
    assert satisfied(condition, theta_with({LINK: inside}))
    # One corner moved out along a direction in which it is the farthest.
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    outside = corners[np.argmax(corners @ direction)] + 0.01 * direction
    body = point_masses([1.0, 1.0], outside + 0.2 * np.array([[1, 0, 0], [-1, 0, 0]]))
    assert not satisfied(condition, theta_with({LINK: body}))


@given(SEEDS, st.sampled_from([1e-3, 1e-2, 0.1]))
def test_fewer_facets_contain_the_hull(seed: int, tolerance: float) -> None:
    rng = np.random.default_rng(seed)
    points = ball_points(rng, 80, 0.2, 0.3) + rng.uniform(-1.0, 1.0, 3)
    normals, offsets = hull_facets(points, "ball")
    few, limits = hull_facets(points, "ball", tolerance=tolerance)
    assert (points @ few.T - limits).max() <= ROUNDING
    tried = points.mean(axis=0) + ball_points(rng, 500, 0.0, 0.7)
    allowed = tried[(tried @ few.T <= limits).all(axis=1)]
    assert (allowed @ normals.T - offsets).max() <= tolerance + ROUNDING
    if tolerance == 0.1:
        assert len(few) < len(normals)


@pytest.mark.parametrize("name", ["ur5_robot", "panda"])
def test_hull_of_a_real_link(name: str) -> None:
    robot = load_robot(name)
    link = robot.link_names[2]
    points = collision_points(robot, link)
    for tolerance in (0.0, 1e-3):
        condition = of.CenterOfMassInHull(link, tolerance=tolerance)
        inside = theta_with({link: weighed(points, 1)}, robot=robot)
        assert excess(condition, inside, robot) < 0.0
        for axis in np.concatenate([np.eye(3), -np.eye(3)]):
            farthest = points[np.argmax(points @ axis)]
            corner = theta_with({link: point_masses([2.0], [farthest])}, robot=robot)
            beyond = point_masses([2.0], [farthest + 2e-3 * axis])
            assert satisfied(condition, corner, robot=robot)
            out = theta_with({link: beyond}, robot=robot)
            assert not satisfied(condition, out, robot=robot)
    exact = len(rows_of(of.CenterOfMassInHull(link), robot))
    assert exact <= len(ConvexHull(points).equations)
    assert len(rows_of(condition, robot)) < exact


def test_what_is_fixed_to_a_link_is_in_its_hull() -> None:
    text = TREE.replace(
        '<link name="bracket">',
        '<link name="bracket"><collision><geometry><box size="0.2 0.2 0.2"/></geometry>'
        "</collision>",
    )
    robot = load_robot(text)
    condition = of.CenterOfMassInHull("right_arm")
    at = {"right_arm": point_masses([1.0], [[0.2, 0.0, 0.1]])}
    assert satisfied(condition, theta_with(at, robot=robot), robot=robot)
    off = {"right_arm": point_masses([1.0], [[0.2, 0.0, 0.21]])}
    assert not satisfied(condition, theta_with(off, robot=robot), robot=robot)
    refuses(ModelError, "no collision geometry", compiled, of.CenterOfMassInHull("column"), robot)
    flat = load_robot(text.replace('size="0.2 0.2 0.2"', 'size="1 1 0"'))
    refuses(DataError, "hull has no volume", compiled, condition, flat)


@given(ellipsoids(), SEEDS, st.integers(1, 12))
def test_sign_of_mass_in_an_ellipsoid(ellipsoid: dict[str, Array], seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    condition = of.MassInEllipsoid(LINK, **ellipsoid)
    inside = weighed(in_frame(ball_points(rng, count, 0.0, 0.999), ellipsoid), seed)
    outside = weighed(in_frame(ball_points(rng, count, 1.001, 3.0), ellipsoid), seed)
    assert excess(condition, theta_with({LINK: inside})) < 0.0
    assert excess(condition, theta_with({LINK: outside})) > 0.0
    surface = weighed(in_frame(ball_points(rng, count, 1.0, 1.0), ellipsoid), seed)
    assert abs(excess(condition, theta_with({LINK: surface}))) < 1e-10


@given(bodies(), ellipsoids())
def test_whatever_passes_is_a_body_inside(body: Array, ellipsoid: dict[str, Array]) -> None:
    """Four point masses with the body's moments, found by turning a square root of J."""
    T = np.eye(4)
    T[:3] = of.MassInEllipsoid(LINK, **ellipsoid).to_ball()
    # Grown until the condition just holds; some of the body's own masses may be outside.
    y2 = np.trace((T @ pseudo_inertia(body) @ T.T)[:3, :3]) / body[0]
    ellipsoid = {**ellipsoid, "semi_axes": ellipsoid["semi_axes"] * np.sqrt(1.01 * y2)}
    condition = of.MassInEllipsoid(LINK, **ellipsoid)
    assert satisfied(condition, theta_with({LINK: body}))
    T[:3] = condition.to_ball()
    masses, points = matter(body, T.T @ np.diag([-1.0, -1.0, -1.0, 1.0]) @ T)
    inside = points @ T[:3, :3].T + T[:3, 3]
    assert (np.linalg.norm(inside, axis=1) < 1.0).all()
    found = point_masses(masses, points)
    np.testing.assert_allclose(found, body, atol=1e-9 * np.abs(body).max())


@given(bodies(), st.integers(0, 9))
def test_fixed_link(body: Array, entry: int) -> None:
    condition = of.FixedLink(LINK, body)
    assert satisfied(condition, theta_with({LINK: body}))
    assert not satisfied(condition, theta_with({LINK: body + 1e-6 * np.eye(10)[entry]}))
    prior = ROBOT.prior[ROBOT.link_names.index(LINK)]
    assert satisfied(of.FixedLink(LINK), theta_with({LINK: prior}))
    assert not satisfied(of.FixedLink(LINK), theta_with({LINK: 1.1 * prior}))


@given(SEEDS)
def test_mirror_symmetry_says_all_and_says_it_once(seed: int) -> None:
    rng = np.random.default_rng(seed)
    normal, point = rng.normal(size=3), rng.uniform(-0.3, 0.3, 3)
    n = normal / np.linalg.norm(normal)
    M = np.eye(4)
    M[:3, :3] -= 2.0 * np.outer(n, n)
    M[:3, 3] = 2.0 * (n @ point) * n
    rows = rows_of(of.MirrorSymmetry(LINK, 3.0 * normal, point))
    start = 10 * ROBOT.link_names.index(LINK)
    A = np.stack([row.coefficients for row in rows])[:, start : start + 10]
    assert np.linalg.matrix_rank(A) == len(A) == 3
    # Any parameters that satisfy the rows, a body's or not, are their own mirror image.
    free = np.linalg.svd(A)[2][3:]
    J = pseudo_inertia(free)
    np.testing.assert_allclose(M @ J @ M.T, J, atol=1e-12)


@given(SEEDS, rotations(), st.integers(1, 6))
def test_mirror_pair_from_frame_to_frame(seed: int, R: Array, count: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.4, 0.4, (count, 3))
    reflection = np.eye(4)
    reflection[:3, :3], reflection[:3, 3] = -R, rng.uniform(-0.3, 0.3, 3)
    image = weighed(points @ reflection[:3, :3].T + reflection[:3, 3], seed)
    condition = of.MirrorPair("finger", "thumb", reflection=reflection)
    body = weighed(points, seed)
    assert satisfied(condition, theta_with({"finger": body, "thumb": image}))
    wrong = image + point_masses([1e-3], [[0.1, 0.2, 0.3]])
    assert not satisfied(condition, theta_with({"finger": body, "thumb": wrong}))


@given(SEEDS, st.booleans(), st.booleans())
def test_mirror_pair_in_the_base_frame(seed: int, moved: bool, floats: bool) -> None:
    robot = load_robot(TREE, root="free_flyer") if floats else ROBOT
    rng = np.random.default_rng(seed)
    normal, point = rng.normal(size=3), rng.uniform(-0.3, 0.3, 3)
    position = None
    if moved:
        joints = rng.uniform(-1.0, 1.0, ROBOT.n)
        base = [0.3, -0.2, 0.5, 0.0, 0.0, np.sin(0.4), np.cos(0.4)]
        # A continuous joint of a floating robot is given as cosine and sine.
        position = np.concatenate([base, ROBOT.configuration(joints[None])[0]])
        position = position if floats else joints
    first, second = "left_arm", "right_arm"
    placements = dict(zip(robot.link_names, link_placements(robot, position), strict=True))
    world = rng.uniform(-0.4, 0.4, (5, 3))

    def body(points: Array, link: str) -> Array:
        P = placements[link]
        return weighed((points - P[:3, 3]) @ P[:3, :3], seed)

    other = mirrored(world, normal, point)
    condition = of.MirrorPair(first, second, normal, point, position=position)
    right = {first: body(world, first), second: body(other, second)}
    assert satisfied(condition, theta_with(right, robot=robot), robot=robot)
    wrong = {first: body(world, first), second: body(world, second)}
    assert not satisfied(condition, theta_with(wrong, robot=robot), robot=robot)


@pytest.mark.parametrize(
    ("condition", "count"),
    [
        (of.Fixed({"m_1": 1.0, "Fs1": 0.1}), 2),
        (of.FixedLink(LINK), 10),
        (of.EqualLinks("finger", "thumb"), 10),
        (of.MirrorSymmetry(LINK, (0, 1, 0)), 3),
        (of.MirrorPair("finger", "thumb", (0, 1, 0)), 10),
    ],
)
def test_equations_are_independent(condition: of.Condition, count: int) -> None:
    rows, theta = rows_of(condition), theta_with({})
    matrix = np.stack([row.coefficients for row in rows])
    if isinstance(condition, of.Fixed):
        assert [row.name for row in rows] == ["m_1 fixed", "Fs1 fixed"]
        np.testing.assert_array_equal(matrix @ theta, [theta[0], theta[10 * ROBOT.n_links]])
        assert [row.lower for row in rows] == [1.0, 0.1]
    assert len(rows) == np.linalg.matrix_rank(matrix) == count
    assert len({row.name for row in rows}) == count
    assert all(row.lower == row.upper for row in rows)


ALL: tuple[of.Condition, ...] = (
    of.TotalMass(3.0, tolerance=0.1, links=["finger"]),
    of.CenterOfMassInBox(LINK, (-0.1,) * 3, (0.1,) * 3),
    of.CenterOfMassInEllipsoid(LINK, (0, 0, 0), (0.1, 0.1, 0.1)),
    of.CenterOfMassInHull(LINK, BOX),
    of.MassInEllipsoid(LINK, (0, 0, 0), (0.1, 0.1, 0.1)),
    of.Fixed({"m_1": 2.0}),
    of.FixedLink(LINK),
    of.EqualLinks(LINK, "finger"),
    of.MirrorSymmetry(LINK, (0, 1, 0)),
    of.MirrorPair(LINK, "right_arm", (0, 1, 0)),
)


@pytest.mark.parametrize("condition", ALL, ids=lambda c: type(c).__name__)
def test_each_is_named_read_only_travels_and_knows_its_robot(condition: of.Condition) -> None:
    parts = compiled(condition)
    assert len({part.name for part in parts}) == len(parts)
    for part in parts:
        assert LINK in part.name or "finger" in part.name or "m_1" in part.name
        arrays = [part.coefficients] if isinstance(part, of.Row) else [part.axis, part.vectors]
        assert not any(array.flags.writeable for array in arrays)
    # Workers of joblib get their problems by pickle.
    again = compiled(pickle.loads(pickle.dumps(condition)))
    assert [part.name for part in again] == [part.name for part in parts]
    with pytest.raises(AttributeError):
        condition.link = "other"  # type: ignore[attr-defined]
    unknown = {"links": ("nose",), "values": {"m_99": 1.0}}
    named = [each for each in ("link", "first", "second", *unknown) if hasattr(condition, each)]
    assert named
    for name in named:
        other = replace(condition, **{name: unknown.get(name, "nose")})  # type: ignore[type-var]
        words = "'m_99'" if name == "values" else "no link 'nose'"
        refuses(ModelError, words, compiled, other)


ROUND = {"center": (0, 0, 0), "semi_axes": (1, 1, 1)}
NAMED: dict[str, dict[str, str]] = {
    **{"TotalMass": {}, "Fixed": {}, "EqualLinks": {"first": "a"}},
    **{kind: {"first": "a", "second": "b"} for kind in ("MirrorPair", "EqualFriction")},
}


@pytest.mark.parametrize(
    ("kind", "arguments", "message"),
    [
        ("TotalMass", {"mass": 0.0}, r"0\.0 kg; give a positive"),
        ("TotalMass", {"mass": np.nan}, "nan kg"),
        ("TotalMass", {"mass": 1.0, "tolerance": -1.0}, r"-1\.0 kg"),
        ("TotalMass", {"mass": 1.0, "links": "arm"}, r"\('arm',\)"),
        ("TotalMass", {"mass": 1.0, "links": ()}, "at least one"),
        ("TotalMass", {"mass": 1.0, "links": ("a", "a")}, "each link once"),
        ("CenterOfMassInBox", {"lower": (1, 1, 1), "upper": (0, 2, 2)}, "above the upper"),
        ("CenterOfMassInBox", {"lower": (1, 1), "upper": (2, 2)}, "give 3"),
        ("CenterOfMassInBox", {"lower": ("a",) * 3, "upper": (2, 2, 2)}, "not numbers"),
        ("CenterOfMassInBox", {"lower": (np.nan,) * 3, "upper": (2, 2, 2)}, "lower is"),
        ("CenterOfMassInBox", {"lower": (np.inf,) * 3, "upper": (np.inf,) * 3}, "lower is"),
        ("CenterOfMassInBox", {"lower": (-np.inf,) * 3, "upper": (np.inf,) * 3}, "says nothing"),
        ("MassInEllipsoid", {"center": (0, 0), "semi_axes": (1, 1, 1)}, "center: 2 numbers"),
        ("MassInEllipsoid", {"center": (0, 0, 0), "semi_axes": (1, 0, 1)}, "give positive"),
        ("CenterOfMassInEllipsoid", {"center": (0, 0, np.inf), "semi_axes": (1, 1, 1)}, "finite"),
        ("CenterOfMassInEllipsoid", {**ROUND, "rotation": 2 * np.eye(3)}, "no rotation.*by 3"),
        ("MassInEllipsoid", {**ROUND, "rotation": np.eye(2)}, "no rotation matrix"),
        ("CenterOfMassInHull", {"points": BOX[:3]}, "at least 4"),
        ("CenterOfMassInHull", {"points": BOX * (1, 1, 0)}, "in a plane or on a line"),
        ("CenterOfMassInHull", {"points": BOX * (0, 0, 0) + 3.0}, "in a plane or on a line"),
        ("CenterOfMassInHull", {"points": BOX[:, :2]}, r"shape \(8, 2\)"),
        ("CenterOfMassInHull", {"points": BOX, "tolerance": -1.0}, r"-1\.0 m"),
        ("CenterOfMassInHull", {"package_dirs": "folder"}, r"\('folder',\)"),
        ("FixedLink", {"body": np.zeros(10)}, r"0\.0 kg"),
        ("FixedLink", {"body": np.ones(9)}, "9 numbers, give 10"),
        ("MirrorSymmetry", {"normal": (0, 0, 0)}, "normal is zero"),
        ("MirrorSymmetry", {"normal": (0, 1, 0), "point": (0, 0)}, "point: 2 numbers"),
        ("Fixed", {"values": {}}, "give a mapping"),
        ("Fixed", {"values": {"m_1": np.nan}}, "m_1 is nan"),
        ("Fixed", {"values": {"m_1": "heavy"}}, "'heavy'"),
        ("EqualLinks", {"second": "a"}, "named twice"),
        ("MirrorPair", {"second": "a", "normal": (0, 1, 0)}, "named twice.*MirrorSymmetry"),
        ("MirrorPair", {}, "either the normal"),
        ("MirrorPair", {"reflection": np.eye(4)}, "determinant is 1 and must be -1"),
        ("MirrorPair", {"reflection": np.diag([1.0, -2.0, 1.0, 1.0])}, "by 3"),
        ("MirrorPair", {"reflection": np.eye(3)}, r"\(3, 3\)"),
        ("MirrorPair", {"reflection": REFLECTION, "point": (0, 0, 1)}, "no point"),
        ("MirrorPair", {"reflection": REFLECTION, "normal": (0, 1, 0)}, "either"),
        ("EqualFriction", {"second": "a"}, "name two joints"),
        *(
            ("EqualFriction", {"within": within}, f"within is {within}; give a share")
            for within in (2, True, np.nan)
        ),
    ],
)
def test_what_makes_no_sense(kind: str, arguments: dict[str, Any], message: str) -> None:
    arguments = {**NAMED.get(kind, {"link": LINK}), **arguments}
    refuses(DataError, message, getattr(of, kind), **arguments)


def test_joints_and_bodies_that_the_robot_does_not_have(denso: RobotModel) -> None:
    refuses(ModelError, "has no joint 'a'", compiled, of.EqualFriction("a", "right"))
    words, link = r"mass of 0\.0 kg; give the body", denso.link_names[0]
    refuses(ModelError, words, compiled, of.FixedLink(link), denso)


def test_every_constraint_is_a_named_object() -> None:
    """Each once, with what it is about: nobody needs to read it out of a name."""
    problem = arm_problem(of.TotalMass(2.0, tolerance=0.5), of.TotalMass(1.0, links=(LAST,)))
    feasible = problem.feasible
    found = feasible.named
    assert len({c.name for c in found}) == len(found)
    assert Counter(c.kind for c in found) == {
        "consistency": 2,
        "mass": 4,
        "sign": 4,
        "theta_max": 2 * problem.n_theta - 8,
        "row": 3,
    }
    total = [c for c in found if c.name.startswith("total mass, ")]
    assert [(c.side, c.limit, c.link) for c in total] == [("least", 1.5, None), ("most", 2.5, None)]
    (equation,) = (c for c in found if c.kind == "row" and c.side is None)
    assert (equation.limit, feasible.row_names[equation.index]) == (1.0, f"total mass of {LAST}")
    heavy = [c for c in found if c.kind == "mass" and c.side == "most"]
    assert [(c.link, c.limit, c.unit) for c in heavy] == [
        (link, problem.constraints.mass_max, "kg") for link in problem.robot.link_names
    ]
    theta = np.array(solve_sdp(problem).theta)
    for c in found:
        if c.kind in ("mass", "sign", "theta_max"):
            assert c.sign * (theta[c.index] - c.limit) >= -FEASIBLE


@given(SEEDS, st.data())
def test_one_constraint_is_left_out_and_no_other(seed: int, data: st.DataObject) -> None:
    def key(constraint: Constraint) -> tuple[object, ...]:
        # Cones after one that is taken out move up.
        where = constraint.name if constraint.kind == "cone" else constraint.index
        return constraint.kind, where, constraint.side

    problem = _every_kind()
    feasible = problem.feasible
    left_out = data.draw(st.sampled_from(feasible.named))
    rest = feasible.without(left_out)
    expected = {key(constraint) for constraint in feasible.named} - {key(left_out)}
    if left_out.kind in ("mass", "sign"):
        expected.add(("theta_max", left_out.index, left_out.side))
    assert {key(constraint) for constraint in rest.named} == expected
    theta = 3.0 * np.random.default_rng(seed).standard_normal(problem.n_theta)
    assert rest.violation(theta) <= feasible.violation(theta)


@pytest.mark.parametrize(
    ("kind", "place", "value"),
    [
        ("consistency", 4, 0.0),  # Ixx of the first link
        ("sign", 20, -0.5),
        ("row", 0, 1.8),  # its mass: 2.8 kg in all
        ("cone", 11, 0.05),  # 5 cm from the center, where 2 cm are allowed and 10 cm
    ],
)
def test_what_one_constraint_alone_excludes_is_inside_without_it(
    kind: str, place: int, value: float
) -> None:
    feasible = _every_kind().feasible
    ball = [1.0, 0.0, 0.01, 0.0, 0.2, 0.0, 0.2, 0.0, 0.0, 0.2]
    theta = np.concatenate([ball, ball, np.ones(len(feasible.lower) - 20)])
    assert feasible.violation(theta) == 0.0
    theta[place] = value
    assert feasible.violation(theta) > FEASIBLE
    inside = [each for each in feasible.named if feasible.without(each).violation(theta) == 0.0]
    assert [each.kind for each in inside] == [kind]


@cache
def _every_kind() -> Problem:
    """Return a problem with constraints of each kind, two cones among them."""
    cone = of.CenterOfMassInEllipsoid(LAST, (0, 0.01, 0), (0.02, 0.05, 0.03))
    wide = of.CenterOfMassInEllipsoid(LAST, (0, 0, 0), (0.1, 0.1, 0.1))
    return arm_problem(
        of.TotalMass(2.0, tolerance=0.5), cone, wide, of.TotalMass(1.0, links=(LAST,))
    )


# ---- Friction of left and right joints: which terms, which way, and how much they may differ.


TERMS = ("asymmetric_coulomb", "viscous", "offset", "rotor_inertia", "stribeck", "load", "tilt")


@pytest.mark.parametrize("name", ["solo12", "talos_reduced"])
def test_mirrored_motions_meet_the_same_friction(name: str) -> None:
    """The image of a rotation is the other joint's, by Pinocchio's Jacobians, or its reverse."""
    robot = sdpid.load_robot(name, root="free_flyer")
    model, mirror = robot.pin_model, np.diag([1.0, -1.0, 1.0])
    data = model.createData()
    J = pin.computeJointJacobians(model, data, pin.neutral(model))
    turns = dict(zip(robot.joint_names[robot.n_base :], J[3:, robot.n_base :].T, strict=True))
    for pair in of.equal_friction(robot):
        image, other = -mirror @ turns[pair.first], turns[pair.second]
        assert np.allclose(image, -other if pair.opposite else other, atol=1e-6)


def test_motors_that_move_several_joints_leave_others_their_links() -> None:
    rows = {"HR_HFE": {"screw": 1.0}, "HR_KFE": {"screw": 2.0, "offset": -0.2}}
    plain, moved = (
        sdpid.load_robot("solo12", root="free_flyer", transmission=given)
        for given in (None, {"joints": rows})
    )
    pairs = [("FL_HAA", "FR_HAA"), ("HL_HAA", "HR_HAA"), ("FL_KFE", "FR_KFE")]
    found, expected = (of.equal_friction(robot, pairs=pairs) for robot in (moved, plain))
    assert found == expected


def test_terms_of_a_pair() -> None:
    robot = small_arm(3)
    layout = layout_of(robot, *TERMS, sdpid.friction.Coupling("joint_2", "joint_3"))
    for opposite in (False, True):
        rows = list(of.EqualFriction("joint_1", "joint_3", opposite=opposite).compile(layout))
        found = {
            frozenset(np.array(layout.names)[np.flatnonzero(row.coefficients)]) for row in rows
        }
        sides = [("Fsp", "Fsn"), ("Fsn", "Fsp")] if opposite else [("Fsp",) * 2, ("Fsn",) * 2]
        pairs = [*sides, ("Fv", "Fv"), ("Ia", "Ia"), ("Fst", "Fst"), ("Fl", "Fl")]
        names = {frozenset((f"{a}1", f"{b}3")) for a, b in pairs}
        assert found <= names
        assert {pair for pair in names if pair <= set(layout.names)} == found
        assert all(row.lower == row.upper == 0.0 for row in rows)
        assert all(row.coefficients.sum() == 0.0 for row in rows)


@pytest.mark.parametrize(("left", "right", "holds"), [(1.0, 1.2, True), (1.0, 1.25, False)])
def test_a_share_is_of_the_mean(left: float, right: float, holds: bool) -> None:
    layout = layout_of(small_arm(2), "viscous")
    theta = np.zeros(layout.count)
    for values in ((left, right), (right, left)):
        theta[-2:] = values
        rows = of.EqualFriction("joint_1", "joint_2", within=0.2).compile(layout)
        assert all(row.coefficients @ theta >= row.lower for row in rows) is holds


# ---- Pairs of left and right links, found by their names, and what they say of described robots.


@pytest.mark.parametrize(("name", "count"), [("a1", 6), ("go2", 6), ("talos_reduced", 14)])
def test_pairs_are_found_by_name(name: str, count: int) -> None:
    robot = sdpid.load_robot(name, root="free_flyer")
    pairs = of.mirror_pairs(robot)
    assert len(pairs) == count
    assert len({link for pair in pairs for link in (pair.first, pair.second)}) == 2 * count


FRONT = ("FL_hip", "FR_hip")
NO_PAIRS: tuple[tuple[Any, str], ...] = (
    ("FL_hip", "pairs is 'FL_hip'; give"),
    (3, "pairs is 3; give"),
    ([], "pairs is empty"),
    (["FL", "FR"], "pairs holds 'FL'; give"),
    ([("FL_hip",)], r"pairs holds \('FL_hip',\); give"),
    ([(*FRONT, "RL_hip")], "pairs holds .*'RL_hip'"),
    ([("FL_hip", 1)], r"pairs holds \('FL_hip', 1\)"),
    ([("FL_hip", "FL_hip")], "'FL_hip' twice in a pair"),
    ([FRONT, FRONT], "'FL_hip' and 'FR_hip' is given twice"),
    ([FRONT, FRONT[::-1]], "'FR_hip' and 'FL_hip' is given twice"),
)
NO_NORMALS: tuple[tuple[Any, str], ...] = (
    ((0.0, 0.0, 0.0), " is zero"),
    ((0.0, np.nan, 0.0), ": 1 of 3 values are not finite"),
    ((0.0, 1.0), ": 2 numbers, give 3"),
)
NO_KNEE = "'a1.*' has no joint knee"
OFF = r"'FL_hip' is 0\.[0-9]+ m away from that of 'RR_hip'"


@pytest.mark.parametrize(
    ("asked", "name", "given_", "error", "words"),
    [
        (of.equal_friction, "a1", {"pairs": [("FL_hip_joint", "RR_hip_joint")]}, ModelError, OFF),
        (of.equal_friction, "a1", {"pairs": [("knee", "RR_hip_joint")]}, ModelError, NO_KNEE),
        (of.equal_friction, "ur5_robot", {}, DataError, "no two joints of"),
        (of.mirror_pairs, "a1", {"pairs": [("FL_hip", "RR_hip")]}, ModelError, OFF),
        (of.mirror_pairs, "a1", {"pairs": [("foot", "FR_hip")]}, ModelError, "no link foot"),
        (of.mirror_pairs, "ur5_robot", {}, DataError, "differ in a word for a side"),
        *((of.mirror_pairs, "a1", {"pairs": pairs}, DataError, words) for pairs, words in NO_PAIRS),
        *(
            (asked, "a1", {"normal": normal}, DataError, f"normal{words}")
            for asked in (of.mirror_pairs, of.equal_friction)
            for normal, words in NO_NORMALS
        ),
    ],
)
def test_what_are_no_mirror_images_is_refused(
    asked: Any, name: str, given_: dict[str, Any], error: type[Exception], words: str
) -> None:
    robot = sdpid.load_robot(name, root="free_flyer")
    refuses(error, f"{asked.__name__}: .*{words}", asked, robot, **given_)


@pytest.mark.parametrize("size", [1e-300, 3.0, 1e300])
def test_legs_that_are_described_as_mirror_images_obey_whatever_a_normals_length(
    size: float,
) -> None:
    robot = sdpid.load_robot("a1", root="free_flyer")
    layout, theta = of.Layout(robot, friction_model(robot, ())), robot.prior.reshape(-1)
    pairs = of.mirror_pairs(robot, normal=(0.0, size, 0.0))
    assert [list(np.asarray(pair.normal)) for pair in pairs] == [[0.0, 1.0, 0.0]] * 6
    rows = [row for pair in pairs for row in pair.compile(layout)]
    assert len(rows) == 60
    assert max(abs(float(row.coefficients @ theta)) for row in rows) < 1e-12
