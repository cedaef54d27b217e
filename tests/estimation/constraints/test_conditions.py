"""Every condition against random bodies made of point masses: inside passes, outside fails."""

from __future__ import annotations

import pickle
from collections import Counter
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

import sdpid
from sdpid._common.arrays import Array
from sdpid.constraints import (
    CenterOfMassInBox,
    CenterOfMassInEllipsoid,
    CenterOfMassInHull,
    EqualLinks,
    Fixed,
    FixedLink,
    MassInEllipsoid,
    MirrorPair,
    MirrorSymmetry,
    TotalMass,
)
from sdpid.errors import DataError, ModelError
from sdpid.estimation.constraints.condition import Condition, Cone, Layout, Row
from sdpid.estimation.constraints.hull import hull_facets
from sdpid.estimation.constraints.named import Constraint
from sdpid.estimation.estimate import FEASIBLE
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import margin, physical_parameters, point_masses, pseudo_inertia
from sdpid.robot.model.geometry import collision_points, link_placements
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.helpers.arm import LAST, arm_problem
from tests.helpers.data import FRICTION, random_links
from tests.helpers.robots import TREE
from tests.helpers.strategies import SEEDS, bodies, reals, rotations

# Rows are sums of ten products of numbers of order ten.
ROUNDING = 1e-12

ROBOT = load_robot(TREE)
LINK = "left_arm"


def layout_of(robot: RobotModel) -> Layout:
    return Layout(robot, FrictionModel.from_terms(FRICTION, robot.joint_names))


def compiled(condition: Condition, robot: RobotModel = ROBOT) -> list[Row | Cone]:
    return list(condition.compile(layout_of(robot)))


def rows_of(condition: Condition, robot: RobotModel = ROBOT) -> list[Row]:
    return [row for row in compiled(condition, robot) if isinstance(row, Row)]


def excess(condition: Condition, theta: Array, robot: RobotModel = ROBOT) -> float:
    """Return by how much theta violates the worst row or cone, negative inside."""
    worst = -np.inf
    for part in compiled(condition, robot):
        if isinstance(part, Row):
            value = part.coefficients @ theta
            worst = max(worst, part.lower - value, value - part.upper)
        else:
            body = theta[10 * part.link : 10 * part.link + 10]
            worst = max(worst, np.linalg.norm(part.vectors @ body) - part.axis @ body)
    return float(worst)


def satisfied(
    condition: Condition, theta: Array, *, robot: RobotModel = ROBOT, tol: float = ROUNDING
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


class TestTotalMass:
    @given(SEEDS, reals(0.0, 2.0), reals(-4.0, 4.0))
    def test_exactly_within_its_tolerance(self, seed: int, tolerance: float, off: float) -> None:
        assume(abs(abs(off) - tolerance) > 1e-9)
        theta = theta_with({}, seed=seed)
        masses = theta[: 10 * ROBOT.n_links : 10]
        total = masses.sum() + off
        assume(total > 0.0)
        condition = TotalMass(total, tolerance=tolerance)
        assert satisfied(condition, theta) == (abs(off) < tolerance)

    def test_of_a_group(self) -> None:
        theta = theta_with({})
        group = ("thumb", "column")
        masses = [theta[10 * ROBOT.link_names.index(name)] for name in group]
        condition = TotalMass(sum(masses), links=group)
        assert satisfied(condition, theta)
        assert not satisfied(TotalMass(sum(masses) + 0.1, links=group), theta)
        (row,) = rows_of(condition)
        assert row.name == "total mass of thumb, column"
        assert row.lower == row.upper


class TestCenterOfMass:
    @given(bodies(), SEEDS)
    def test_box(self, body: Array, seed: int) -> None:
        rng = np.random.default_rng(seed)
        lower, upper = np.sort(rng.uniform(-0.6, 0.6, (2, 3)), axis=0)
        inside = bool(((lower < center(body)) & (center(body) < upper)).all())
        condition = CenterOfMassInBox(LINK, lower, upper)
        assert len(rows_of(condition)) == 6
        assert satisfied(condition, theta_with({LINK: body})) == inside
        around = CenterOfMassInBox(LINK, center(body) - 0.01, center(body) + 0.01)
        assert excess(around, theta_with({LINK: body})) < 0.0

    def test_box_open_and_closed(self) -> None:
        body = point_masses([1.0, 1.0], [[0.2, 0.1, 0.0], [0.2, 0.3, 1.0]])
        theta = theta_with({LINK: body})
        condition = CenterOfMassInBox(LINK, (0.2, 0.1, -np.inf), (0.2, np.inf, 0.6))
        assert [row.name for row in rows_of(condition)] == [
            "center of mass of left_arm, x known",
            "center of mass of left_arm, y at least",
            "center of mass of left_arm, z at most",
        ]
        assert satisfied(condition, theta)
        assert not satisfied(CenterOfMassInBox(LINK, (0.3,) * 3, (0.3, 1, 1)), theta)

    @given(bodies(), ellipsoids())
    def test_ellipsoid(self, body: Array, ellipsoid: dict[str, Array]) -> None:
        y = (center(body) - ellipsoid["center"]) @ ellipsoid["rotation"] / ellipsoid["semi_axes"]
        assume(abs(np.linalg.norm(y) - 1.0) > 1e-9)
        condition = CenterOfMassInEllipsoid(LINK, **ellipsoid)
        theta = theta_with({LINK: body})
        assert satisfied(condition, theta) == (np.linalg.norm(y) < 1.0)
        around = CenterOfMassInEllipsoid(LINK, center(body) + 0.01, (0.02, 0.03, 0.04))
        assert excess(around, theta) < 0.0
        (cone,) = compiled(condition)
        assert isinstance(cone, Cone)
        assert cone.axis @ body == body[0]

    @given(SEEDS, st.integers(4, 30))
    def test_hull_of_points(self, seed: int, count: int) -> None:
        rng = np.random.default_rng(seed)
        corners = rng.uniform(-0.4, 0.4, (count, 3))
        condition = CenterOfMassInHull(LINK, corners)
        inside = weighed(corners[rng.integers(0, count, 8)], seed)
        assert satisfied(condition, theta_with({LINK: inside}))
        # One corner moved out along a direction in which it is the farthest.
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        outside = corners[np.argmax(corners @ direction)] + 0.01 * direction
        body = point_masses([1.0, 1.0], outside + 0.2 * np.array([[1, 0, 0], [-1, 0, 0]]))
        assert not satisfied(condition, theta_with({LINK: body}))

    @given(SEEDS, st.sampled_from([1e-3, 1e-2, 0.1]))
    def test_fewer_facets_contain_the_hull(self, seed: int, tolerance: float) -> None:
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

    def test_a_cube_has_six_facets(self) -> None:
        corners = np.stack(np.meshgrid(*[[1.0, 3.0]] * 3), axis=-1).reshape(-1, 3)
        rng = np.random.default_rng(0)
        points = np.concatenate([corners, corners, rng.uniform(1.0, 3.0, (50, 3))])
        assert len(rows_of(CenterOfMassInHull(LINK, points))) == 6

    @pytest.mark.parametrize("name", ["ur5_robot", "panda"])
    def test_hull_of_a_real_link(self, name: str) -> None:
        robot = load_robot(name)
        link = robot.link_names[2]
        points = collision_points(robot, link)
        for tolerance in (0.0, 1e-3):
            condition = CenterOfMassInHull(link, tolerance=tolerance)
            inside = theta_with({link: weighed(points, 1)}, robot=robot)
            assert excess(condition, inside, robot) < 0.0
            for axis in np.concatenate([np.eye(3), -np.eye(3)]):
                farthest = points[np.argmax(points @ axis)]
                corner = theta_with({link: point_masses([2.0], [farthest])}, robot=robot)
                beyond = point_masses([2.0], [farthest + 2e-3 * axis])
                assert satisfied(condition, corner, robot=robot)
                out = theta_with({link: beyond}, robot=robot)
                assert not satisfied(condition, out, robot=robot)
        exact = len(rows_of(CenterOfMassInHull(link), robot))
        assert exact <= len(ConvexHull(points).equations)
        assert len(rows_of(condition, robot)) < exact

    def test_what_is_fixed_to_a_link_is_in_its_hull(self) -> None:
        text = TREE.replace(
            '<link name="bracket">',
            '<link name="bracket"><collision><geometry><box size="0.2 0.2 0.2"/></geometry>'
            "</collision>",
        )
        robot = load_robot(text)
        condition = CenterOfMassInHull("right_arm")
        at = {"right_arm": point_masses([1.0], [[0.2, 0.0, 0.1]])}
        assert satisfied(condition, theta_with(at, robot=robot), robot=robot)
        off = {"right_arm": point_masses([1.0], [[0.2, 0.0, 0.21]])}
        assert not satisfied(condition, theta_with(off, robot=robot), robot=robot)
        with pytest.raises(ModelError, match="no collision geometry"):
            compiled(CenterOfMassInHull("column"), robot)


class TestMassInEllipsoid:
    @given(ellipsoids(), SEEDS, st.integers(1, 12))
    def test_sign(self, ellipsoid: dict[str, Array], seed: int, count: int) -> None:
        rng = np.random.default_rng(seed)
        condition = MassInEllipsoid(LINK, **ellipsoid)
        inside = weighed(in_frame(ball_points(rng, count, 0.0, 0.999), ellipsoid), seed)
        outside = weighed(in_frame(ball_points(rng, count, 1.001, 3.0), ellipsoid), seed)
        assert excess(condition, theta_with({LINK: inside})) < 0.0
        assert excess(condition, theta_with({LINK: outside})) > 0.0
        surface = weighed(in_frame(ball_points(rng, count, 1.0, 1.0), ellipsoid), seed)
        assert abs(excess(condition, theta_with({LINK: surface}))) < 1e-10

    def test_unit_is_kilograms(self) -> None:
        center = np.array([0.1, 0.2, 0.3])
        (row,) = rows_of(MassInEllipsoid(LINK, center, (0.1, 0.2, 0.3)))
        theta = theta_with({LINK: point_masses([2.5], [center])})
        assert row.coefficients @ theta == pytest.approx(2.5)
        theta = theta_with({LINK: point_masses([2.5], [center + 0.2 * np.eye(3)[0]])})
        assert row.coefficients @ theta == pytest.approx(2.5 * (1 - 4))

    @given(bodies(), ellipsoids())
    def test_whatever_passes_is_a_body_inside(
        self, body: Array, ellipsoid: dict[str, Array]
    ) -> None:
        """Four point masses with the body's moments, found by turning a square root of J."""
        T = np.eye(4)
        T[:3] = MassInEllipsoid(LINK, **ellipsoid).to_ball()
        # Grown until the condition just holds; some of the body's own masses may be outside.
        y2 = np.trace((T @ pseudo_inertia(body) @ T.T)[:3, :3]) / body[0]
        ellipsoid = {**ellipsoid, "semi_axes": ellipsoid["semi_axes"] * np.sqrt(1.01 * y2)}
        condition = MassInEllipsoid(LINK, **ellipsoid)
        assert satisfied(condition, theta_with({LINK: body}))
        T[:3] = condition.to_ball()
        J = T @ pseudo_inertia(body) @ T.T
        Q = np.diag([-1.0, -1.0, -1.0, 1.0])
        V = np.linalg.cholesky(J)
        # Rotate pairs of columns until every column v has the same v^T Q v = tr(Q J)/4 > 0.
        wanted = np.trace(Q @ J) / 4.0
        for k in range(3):
            H = V.T @ Q @ V
            d = np.diag(H)[k:] - wanted
            i, j = k + int(np.argmax(d)), k + int(np.argmin(d))
            if H[i, i] - H[j, j] > 1e-14:
                a, b, c = H[j, j] - wanted, 2.0 * H[i, j], H[i, i] - wanted
                t = (-b + np.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)
                V[:, [i, j]] = V[:, [i, j]] @ np.array([[1, -t], [t, 1]]) / np.hypot(1.0, t)
            V[:, [k, i]] = V[:, [i, k]]
        masses, y = V[3] ** 2, (V[:3] / V[3]).T
        assert (np.linalg.norm(y, axis=1) < 1.0).all()
        np.testing.assert_allclose(
            point_masses(masses, in_frame(y, ellipsoid)), body, atol=1e-9 * np.abs(body).max()
        )


class TestEquations:
    def test_fixed(self) -> None:
        theta = theta_with({})
        names = layout_of(ROBOT).names
        values = {name: theta[names.index(name)] for name in ("m_3", "xy_2", "Fv2")}
        assert satisfied(Fixed(values), theta)
        for name in values:
            assert not satisfied(Fixed({**values, name: values[name] + 1e-6}), theta)
        assert [row.name for row in rows_of(Fixed(values))] == [
            "m_3 fixed",
            "xy_2 fixed",
            "Fv2 fixed",
        ]

    @given(bodies(), st.integers(0, 9))
    def test_fixed_link(self, body: Array, entry: int) -> None:
        condition = FixedLink(LINK, body)
        assert satisfied(condition, theta_with({LINK: body}))
        assert not satisfied(condition, theta_with({LINK: body + 1e-6 * np.eye(10)[entry]}))
        prior = ROBOT.prior[ROBOT.link_names.index(LINK)]
        assert satisfied(FixedLink(LINK), theta_with({LINK: prior}))
        assert not satisfied(FixedLink(LINK), theta_with({LINK: 1.1 * prior}))

    @given(bodies(), st.integers(0, 9))
    def test_equal_links(self, body: Array, entry: int) -> None:
        condition = EqualLinks("finger", "thumb")
        assert satisfied(condition, theta_with({"finger": body, "thumb": body}))
        other = body + 1e-6 * np.eye(10)[entry]
        assert not satisfied(condition, theta_with({"finger": body, "thumb": other}))

    @given(SEEDS, st.integers(1, 6))
    def test_mirror_symmetry(self, seed: int, count: int) -> None:
        rng = np.random.default_rng(seed)
        normal, point = rng.normal(size=3), rng.uniform(-0.3, 0.3, 3)
        half = rng.uniform(-0.4, 0.4, (count, 3))
        whole = weighed(half, seed) + weighed(mirrored(half, normal, point), seed)
        condition = MirrorSymmetry(LINK, normal, point)
        assert satisfied(condition, theta_with({LINK: whole}))
        n = normal / np.linalg.norm(normal)
        lopsided = whole + point_masses([0.5], [point + 0.1 * n])
        assert excess(condition, theta_with({LINK: lopsided})) == pytest.approx(0.05)

    @given(SEEDS)
    def test_mirror_symmetry_says_all_and_says_it_once(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        normal, point = rng.normal(size=3), rng.uniform(-0.3, 0.3, 3)
        n = normal / np.linalg.norm(normal)
        M = np.eye(4)
        M[:3, :3] -= 2.0 * np.outer(n, n)
        M[:3, 3] = 2.0 * (n @ point) * n
        rows = rows_of(MirrorSymmetry(LINK, 3.0 * normal, point))
        start = 10 * ROBOT.link_names.index(LINK)
        A = np.stack([row.coefficients for row in rows])[:, start : start + 10]
        assert np.linalg.matrix_rank(A) == len(A) == 3
        # Any parameters that satisfy the rows, a body's or not, are their own mirror image.
        free = np.linalg.svd(A)[2][3:]
        J = pseudo_inertia(free)
        np.testing.assert_allclose(M @ J @ M.T, J, atol=1e-12)

    @given(SEEDS, rotations(), st.integers(1, 6))
    def test_mirror_pair_from_frame_to_frame(self, seed: int, R: Array, count: int) -> None:
        rng = np.random.default_rng(seed)
        points = rng.uniform(-0.4, 0.4, (count, 3))
        reflection = np.eye(4)
        reflection[:3, :3], reflection[:3, 3] = -R, rng.uniform(-0.3, 0.3, 3)
        image = weighed(points @ reflection[:3, :3].T + reflection[:3, 3], seed)
        condition = MirrorPair("finger", "thumb", reflection=reflection)
        body = weighed(points, seed)
        assert satisfied(condition, theta_with({"finger": body, "thumb": image}))
        wrong = image + point_masses([1e-3], [[0.1, 0.2, 0.3]])
        assert not satisfied(condition, theta_with({"finger": body, "thumb": wrong}))

    @given(SEEDS, st.booleans(), st.booleans())
    def test_mirror_pair_in_the_base_frame(self, seed: int, moved: bool, floats: bool) -> None:
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
        condition = MirrorPair(first, second, normal, point, position=position)
        right = {first: body(world, first), second: body(other, second)}
        assert satisfied(condition, theta_with(right, robot=robot), robot=robot)
        wrong = {first: body(world, first), second: body(world, second)}
        assert not satisfied(condition, theta_with(wrong, robot=robot), robot=robot)

    @pytest.mark.parametrize("name", ["a1", "go2"])
    def test_the_legs_of_a_quadruped_are_mirror_images(self, name: str) -> None:
        robot = load_robot(name)
        theta = theta_with({}, robot=robot)
        theta[: robot.prior.size] = robot.prior.ravel()
        legs = [link for link in robot.link_names if link.startswith("FL_")]
        assert len(legs) == 3
        for link in legs:
            other = link.replace("FL", "FR")
            assert satisfied(MirrorPair(link, other, (0, 1, 0)), theta, robot=robot)
            assert not satisfied(MirrorPair(link, other, (1, 0, 0)), theta, robot=robot)

    @pytest.mark.parametrize(
        ("condition", "count"),
        [
            (Fixed({"m_1": 1.0, "Fs1": 0.1}), 2),
            (FixedLink(LINK), 10),
            (EqualLinks("finger", "thumb"), 10),
            (MirrorSymmetry(LINK, (0, 1, 0)), 3),
            (MirrorPair("finger", "thumb", (0, 1, 0)), 10),
        ],
    )
    def test_equations_are_independent(self, condition: Condition, count: int) -> None:
        rows = rows_of(condition)
        matrix = np.stack([row.coefficients for row in rows])
        assert len(rows) == np.linalg.matrix_rank(matrix) == count
        assert len({row.name for row in rows}) == count
        assert all(row.lower == row.upper for row in rows)


BOX = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
ALL: tuple[Condition, ...] = (
    TotalMass(3.0, tolerance=0.1, links=["finger"]),
    CenterOfMassInBox(LINK, (-0.1,) * 3, (0.1,) * 3),
    CenterOfMassInEllipsoid(LINK, (0, 0, 0), (0.1, 0.1, 0.1)),
    CenterOfMassInHull(LINK, BOX),
    MassInEllipsoid(LINK, (0, 0, 0), (0.1, 0.1, 0.1)),
    Fixed({"m_1": 2.0}),
    FixedLink(LINK),
    EqualLinks(LINK, "finger"),
    MirrorSymmetry(LINK, (0, 1, 0)),
    MirrorPair(LINK, "right_arm", (0, 1, 0)),
)


@pytest.mark.parametrize("condition", ALL, ids=lambda c: type(c).__name__)
def test_each_is_named_read_only_and_travels(condition: Condition) -> None:
    parts = compiled(condition)
    assert len({part.name for part in parts}) == len(parts)
    for part in parts:
        assert LINK in part.name or "finger" in part.name or "m_1" in part.name
        arrays = [part.coefficients] if isinstance(part, Row) else [part.axis, part.vectors]
        assert not any(array.flags.writeable for array in arrays)
    # Workers of joblib get their problems by pickle.
    again = compiled(pickle.loads(pickle.dumps(condition)))
    assert [part.name for part in again] == [part.name for part in parts]
    with pytest.raises(AttributeError):
        condition.link = "other"  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        (TotalMass(1.0, links=("nose",)), "no link 'nose'"),
        (CenterOfMassInBox("nose", (0, 0, 0), (1, 1, 1)), "no link 'nose'"),
        (CenterOfMassInEllipsoid("nose", (0, 0, 0), (1, 1, 1)), "no link 'nose'"),
        (CenterOfMassInHull("nose"), "no link 'nose'"),
        (MassInEllipsoid("nose", (0, 0, 0), (1, 1, 1)), "no link 'nose'"),
        (Fixed({"m_99": 1.0}), "m_99"),
        (FixedLink("nose"), "no link 'nose'"),
        (EqualLinks("finger", "nose"), "no link 'nose'"),
        (MirrorSymmetry("nose", (0, 1, 0)), "no link 'nose'"),
        (MirrorPair("nose", "finger", (0, 1, 0)), "no link 'nose'"),
    ],
)
def test_links_and_parameters_that_the_robot_does_not_have(
    condition: Condition, message: str
) -> None:
    with pytest.raises(ModelError, match=message):
        compiled(condition)


def test_a_description_without_inertias_fixes_nothing(denso: RobotModel) -> None:
    with pytest.raises(ModelError, match=r"mass of 0\.0 kg; give the body"):
        compiled(FixedLink(denso.link_names[0]), denso)


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
        (
            "CenterOfMassInEllipsoid",
            {"center": (0, 0, 0), "semi_axes": (1, 1, 1), "rotation": 2 * np.eye(3)},
            "no rotation matrix.*by 3",
        ),
        (
            "MassInEllipsoid",
            {"center": (0, 0, 0), "semi_axes": (1, 1, 1), "rotation": np.eye(2)},
            "no rotation matrix",
        ),
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
    ],
)
def test_numbers_that_make_no_sense(kind: str, arguments: dict[str, Any], message: str) -> None:
    named = {} if kind == "TotalMass" else {"link": LINK}
    with pytest.raises(DataError, match=message):
        getattr(sdpid.constraints, kind)(**named, **arguments)


@pytest.mark.parametrize(
    ("kind", "arguments", "message"),
    [
        ("Fixed", ({},), "give a mapping"),
        ("Fixed", ({"m_1": np.nan},), "m_1 is nan"),
        ("Fixed", ({"m_1": "heavy"},), "'heavy'"),
        ("EqualLinks", ("a", "a"), "named twice"),
        ("MirrorPair", ("a", "a", (0, 1, 0)), "named twice.*MirrorSymmetry"),
        ("MirrorPair", ("a", "b"), "either the normal"),
    ],
)
def test_pairs_that_make_no_sense(kind: str, arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(DataError, match=message):
        getattr(sdpid.constraints, kind)(*arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"reflection": np.eye(4)}, "determinant is 1 and must be -1"),
        ({"reflection": np.diag([1.0, -2.0, 1.0, 1.0])}, "by 3"),
        ({"reflection": np.eye(3)}, r"\(3, 3\)"),
        ({"reflection": np.diag([1.0, -1.0, 1.0, 1.0]), "point": (0, 0, 1)}, "no point"),
        ({"reflection": np.diag([1.0, -1.0, 1.0, 1.0]), "normal": (0, 1, 0)}, "either"),
    ],
)
def test_reflections_that_are_none(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(DataError, match=message):
        MirrorPair("a", "b", **arguments)


def test_flat_collision_geometry_says_so() -> None:
    plate = '<link name="column"><collision><geometry><box size="1 1 0"/></geometry></collision>'
    robot = load_robot(TREE.replace('<link name="column">', plate))
    with pytest.raises(DataError, match="hull has no volume"):
        compiled(CenterOfMassInHull("column"), robot)


def test_the_bodies_of_these_tests_exist() -> None:
    theta = theta_with({})
    links = theta[: 10 * ROBOT.n_links].reshape(-1, 10)
    assert (margin(links, "pseudo_inertia") > 0.0).all()


def test_every_constraint_is_a_named_object() -> None:
    """Each once, with what it is about: nobody needs to read it out of a name."""
    problem = arm_problem(TotalMass(2.0, tolerance=0.5), TotalMass(1.0, links=(LAST,)))
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
    cone = CenterOfMassInEllipsoid(LAST, (0, 0.01, 0), (0.02, 0.05, 0.03))
    wide = CenterOfMassInEllipsoid(LAST, (0, 0, 0), (0.1, 0.1, 0.1))
    return arm_problem(TotalMass(2.0, tolerance=0.5), cone, wide, TotalMass(1.0, links=(LAST,)))
