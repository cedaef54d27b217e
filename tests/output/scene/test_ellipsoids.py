"""Inertia ellipsoids: those of uniform ellipsoids are themselves; impossible bodies have none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sdpid._common.arrays import Array
from sdpid.output.scene.ellipsoids import inertia_ellipsoid
from sdpid.robot.inertia import pseudo_inertia, theta_from_physical

# Lengths of axes come from square roots of second moments about the center, which cancel against
# the shift of the center of mass: of lengths a thousandth of it some seven digits are left.
AXES = 1e-5

lengths = st.lists(st.floats(0.01, 1.0), min_size=3, max_size=3)
vectors = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3)


def uniform(mass: float, center: Array, axes: Array) -> Array:
    """Return the parameters of a uniform solid ellipsoid, integrated over its ball."""
    moments = 0.2 * mass * axes @ axes.T
    return theta_from_physical(mass, center, np.trace(moments) * np.eye(3) - moments)


@given(st.floats(0.01, 100.0), vectors, lengths, vectors)
def test_a_uniform_ellipsoid_gives_itself(
    mass: float, center: list[float], sizes: list[float], turn: list[float]
) -> None:
    rotation = Rotation.from_rotvec(turn).as_matrix()
    found = inertia_ellipsoid(uniform(mass, np.array(center), rotation * sizes))
    assert np.allclose(found.center, center, atol=1e-12)
    assert np.allclose(found.lengths, np.sort(sizes), rtol=AXES)
    assert np.allclose(found.axes @ found.axes.T, rotation * np.square(sizes) @ rotation.T)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_its_moments_are_those_of_a_ball_of_points() -> None:
    """Against an integral that knows no formula: points drawn evenly in the ellipsoid."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (400_000, 3))
    points = points[np.linalg.norm(points, axis=1) < 1.0] * [0.1, 0.2, 0.4]
    inertia = np.mean(np.sum(points**2, axis=1)) * np.eye(3) - points.T @ points / len(points)
    found = inertia_ellipsoid(theta_from_physical(1.0, np.zeros(3), inertia))
    assert np.allclose(found.lengths, [0.1, 0.2, 0.4], rtol=0.01)  # of 200,000 points


@given(vectors, vectors, st.integers(1, 2))
def test_plates_and_rods_are_flat(center: list[float], turn: list[float], flat: int) -> None:
    sizes = np.array([0.3, 0.2, 0.1])
    sizes[3 - flat :] = 0.0
    rotation = Rotation.from_rotvec(turn).as_matrix()
    found = inertia_ellipsoid(uniform(2.0, np.array(center), rotation * sizes))
    assert np.allclose(found.lengths, np.sort(sizes), atol=1e-6)
    assert np.allclose(found.rotation.T @ found.rotation, np.eye(3))


@pytest.mark.parametrize(
    "body",
    [
        pytest.param(np.zeros(10), id="nothing"),
        pytest.param([0, 0, 0, 0, 1, 0, 1, 0, 0, 1], id="no mass"),
        pytest.param([-1, 0, 0, 0, 1, 0, 1, 0, 0, 1], id="negative mass"),
        pytest.param([1, 0, 0, 0, -1, 0, 1, 0, 0, 1], id="negative inertia"),
        pytest.param([1, 0, 0, 0, 1, 0, 1, 0, 0, 3], id="triangle inequality"),
        pytest.param([1, 1, 0, 0, 1, 0, 0.5, 0, 0, 1], id="center too far out"),
        pytest.param([1e-300, 1, 1, 1, 1, 0, 1, 0, 0, 1], id="overflow"),
        pytest.param([1, np.nan, 0, 0, 1, 0, 1, 0, 0, 1], id="no number"),
        pytest.param([1e300] * 10, id="huge"),
    ],
)
def test_impossible_bodies_have_none(body: Array) -> None:
    assert inertia_ellipsoid(body) is None


@given(st.lists(st.floats(-1.0, 1.0), min_size=16, max_size=16))
def test_exactly_consistent_bodies_have_one(entries: list[float]) -> None:
    from sdpid.robot.inertia import from_pseudo_inertia

    root = np.reshape(entries, (4, 4))
    body = from_pseudo_inertia(root @ root.T + 1e-3 * np.eye(4))
    assert inertia_ellipsoid(body) is not None
    values, vectors = np.linalg.eigh(pseudo_inertia(body))
    values[0] = -0.1
    assert inertia_ellipsoid(from_pseudo_inertia(vectors * values @ vectors.T)) is None
