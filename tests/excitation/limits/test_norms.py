"""Bounds on efforts and on the rates of efforts, against the derivatives themselves."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.excitation.limits.norms import body_sizes, effort_norms, link_norms, product
from tests.helpers.robots import TREE
from tests.helpers.strategies import SEEDS

# Coefficients of central differences of the first and second derivative, sixth order.
FIRST = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0
SECOND = np.array([2.0, -27.0, 270.0, -490.0, 270.0, -27.0, 2.0]) / 180.0
STEP = 2e-3


def taylor(jet: Array, t: float) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations of a polynomial with a jet (5, n) at 0."""
    factorial = np.array([1.0, 1.0, 2.0, 6.0, 24.0])
    out = []
    for order in range(3):
        powers = [t**k / factorial[k] for k in range(5 - order)]
        out.append(np.tensordot(powers, jet[order:], axes=1))
    return out[0], out[1], out[2]


def along(robot: sdpid.RobotModel, jet: Array) -> tuple[Array, Array]:
    """Return efforts (7, n) and positions of the links (7, links, 3) about an instant."""
    model, data = robot.pin_model, robot.pin_model.createData()
    efforts, origins = [], []
    for k in range(-3, 4):
        q, v, a = taylor(jet, k * STEP)
        configuration = robot.configuration(q[None])[0]
        efforts.append(pin.rnea(model, data, configuration, v, a).copy())
        pin.forwardKinematics(model, data, configuration)
        origins.append([place.translation.copy() for place in data.oMi][1:])
    return np.array(efforts), np.array(origins)


@given(seed=SEEDS, size=st.floats(0.1, 3.0))
def test_bounds_hold(seed: int, size: float) -> None:
    robot = sdpid.load_robot(TREE)
    rng = np.random.default_rng(seed)
    jet = size * rng.normal(size=(5, robot.n))
    jet[0] = rng.uniform(-1.0, 1.0, robot.n)
    efforts, origins = along(robot, jet)
    joints = np.abs(jet)[:, None, :]
    norms = link_norms(robot.pin_model, joints)
    gravity = float(np.linalg.norm(robot.gravity))
    bounds = sum(
        effort_norms(robot.pin_model, norms, k + 1, body, gravity)
        for k, body in enumerate(body_sizes(robot.prior))
    )
    bounds = np.asarray(bounds)[:, 0]
    values = [np.abs(efforts[3])]
    values += [np.abs(c @ efforts) / STEP**k for k, c in ((1, FIRST), (2, SECOND))]
    for value, bound in zip(values, bounds, strict=True):
        assert np.all(value <= bound * (1.0 + 1e-5) + 1e-5)
    speeds = np.linalg.norm(np.tensordot(FIRST, origins, axes=1) / STEP, axis=1)
    accelerations = np.linalg.norm(np.tensordot(SECOND, origins, axes=1) / STEP**2, axis=1)
    for i in range(robot.n_links):
        assert speeds[i] <= norms.origin[i + 1][1, 0] * (1.0 + 1e-6) + 1e-7
        assert accelerations[i] <= norms.origin[i + 1][2, 0] * (1.0 + 1e-6) + 1e-4


def test_bounds_are_met_by_a_pendulum() -> None:
    # One link about a horizontal axis through its frame: torque I·a + m·g·c·cos(q).
    text = """<robot name="p"><link name="b"/><link name="l"><inertial><origin xyz="0.5 0 0"/>
      <mass value="2"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
      <joint name="j" type="continuous"><parent link="b"/><child link="l"/><axis xyz="0 1 0"/>
      <limit effort="1" velocity="1"/></joint></robot>"""
    robot = sdpid.load_robot(text)
    joints = np.array([1.0, 0.0, 3.0, 0.0, 0.0])[:, None, None]
    norms = link_norms(robot.pin_model, joints)
    (found,) = effort_norms(robot.pin_model, norms, 1, body_sizes(robot.prior)[0], 9.81)[0]
    assert found == pytest.approx(2.0 * 0.25 * 3.0 + 2.0 * 0.5 * 9.81)


def test_product_is_leibniz() -> None:
    x, y = np.array([[2.0], [3.0], [5.0]]), np.array([[7.0], [11.0], [13.0]])
    np.testing.assert_array_equal(
        product(x, y, 3)[:, 0], [14.0, 2 * 11 + 3 * 7, 2 * 13 + 2 * 3 * 11 + 5 * 7]
    )
