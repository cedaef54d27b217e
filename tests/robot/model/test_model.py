"""Regressor and mass matrix against Pinocchio's own algorithms."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.helpers.data import random_links
from tests.helpers.refusals import refuses
from tests.helpers.robots import MIMIC, TREE, TREE_MIMIC, TREE_MIMIC_NO_OFFSET
from tests.helpers.small_robots import SMALL
from tests.helpers.strategies import SEEDS, dh_tables, random_states
from tests.helpers.tolerances import DYNAMICS, KINEMATICS


@pytest.fixture(scope="module")
def tree() -> RobotModel:
    return load_robot(TREE)


@pytest.fixture(scope="module")
def mimicking() -> RobotModel:
    return load_robot(TREE_MIMIC)


def assert_same(actual: Array, expected: Array, tolerance: float = DYNAMICS) -> None:
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * scale)


def pin_states(
    robot: RobotModel, states: tuple[Array, Array, Array]
) -> list[tuple[Array, Array, Array]]:
    """Return (q, v, a) for Pinocchio, configurations made by its own integrate."""
    model, (positions, v, a) = robot.pin_model, states
    return [
        (pin.integrate(model, pin.neutral(model), q), dq, ddq)
        for q, dq, ddq in zip(positions, v, a, strict=True)
    ]


def check_against_pinocchio(robot: RobotModel, rng: np.random.Generator, count: int = 4) -> None:
    theta = random_links(rng, robot.n_links)
    states = random_states(rng, robot.n, count)
    Y = robot.regressor(*states)
    assert Y.shape == (count, robot.n, 10 * robot.n_links)
    efforts = robot.inverse_dynamics(theta, *states)
    masses = robot.mass_matrix(theta, states[0])
    model = robot.with_inertias(theta)
    data = model.createData()
    for k, (q, v, a) in enumerate(pin_states(robot, states)):
        # With a single joint the binding returns one axis less.
        expected = pin.computeJointTorqueRegressor(model, data, q, v, a).reshape(Y[k].shape)
        assert_same(Y[k], expected)
        assert_same(efforts[k], pin.rnea(model, data, q, v, a))
        upper = np.triu(pin.crba(model, data, q))
        assert_same(masses[k], upper + np.triu(upper, 1).T)


@given(dh_tables(), SEEDS)
def test_serial_arms(table: object, seed: int) -> None:
    check_against_pinocchio(RobotModel.from_mdh(table), np.random.default_rng(seed))  # type: ignore[arg-type]


@given(SEEDS)
def test_a_tree_with_prismatic_and_continuous_joints(tree: RobotModel, seed: int) -> None:
    assert tree.pin_model.nq > tree.pin_model.nv
    check_against_pinocchio(tree, np.random.default_rng(seed))


@pytest.mark.parametrize("name", ["xarm7", "kinova", "talos_reduced", "icub", "allegro_left_hand"])
def test_robots_of_example_robot_data(name: str) -> None:
    robot = load_robot(name)
    np.testing.assert_array_equal(robot.expansion, np.eye(robot.n))
    check_against_pinocchio(robot, np.random.default_rng(1), count=2)


@pytest.mark.parametrize("source", [TREE, "solo12", "talos_reduced"])
def test_a_floating_base(source: str) -> None:
    robot = load_robot(source, root="free_flyer")
    rng = np.random.default_rng(2)
    model = robot.pin_model
    assert (robot.n, robot.n_base, robot.n_links) == (model.nv, 6, model.njoints - 1)
    assert robot.joint_names[:6] == tuple(
        f"root_joint/{axis}" for axis in ("vx", "vy", "vz", "wx", "wy", "wz")
    )
    theta = random_links(rng, robot.n_links)
    tangent, v, a = random_states(rng, robot.n, 4)
    q = np.stack([pin.integrate(model, pin.neutral(model), x) for x in tangent])
    Y, efforts = robot.regressor(q, v, a), robot.inverse_dynamics(theta, q, v, a)
    full = robot.with_inertias(theta)
    data = full.createData()
    for k in range(4):
        assert_same(Y[k], pin.computeJointTorqueRegressor(full, data, q[k], v[k], a[k]))
        assert_same(efforts[k], pin.rnea(full, data, q[k], v[k], a[k]))
        upper = np.triu(pin.crba(full, data, q[k]))
        assert_same(robot.mass_matrix(theta, q)[k], upper + np.triu(upper, 1).T)


@given(SEEDS)
def test_mimic_joints_are_the_whole_robots_projection(
    tree: RobotModel, mimicking: RobotModel, seed: int
) -> None:
    """Virtual work: the efforts of the coordinates are E^T times those of all joints."""
    rng = np.random.default_rng(seed)
    assert mimicking.joint_names == tuple(n for n in tree.joint_names if n != MIMIC["joint"])
    theta = random_links(rng, tree.n_links)
    q, v, a = random_states(rng, mimicking.n, 3)
    E = np.zeros((tree.n, mimicking.n))
    for row, name in enumerate(tree.joint_names):
        source = name if name in mimicking.joint_names else MIMIC["source"]
        E[row, mimicking.joint_names.index(str(source))] = (
            1.0 if source == name else MIMIC["multiplier"]
        )
    np.testing.assert_allclose(mimicking.expansion, E)
    offset = np.array([MIMIC["offset"] if n == MIMIC["joint"] else 0.0 for n in tree.joint_names])
    whole = tree.inverse_dynamics(theta, q @ E.T + offset, v @ E.T, a @ E.T)
    assert_same(mimicking.inverse_dynamics(theta, q, v, a), whole @ E)
    masses = tree.mass_matrix(theta, q @ E.T + offset)
    assert_same(mimicking.mass_matrix(theta, q), E.T @ masses @ E)


def test_a_mimic_of_a_mimic_is_followed_to_its_source() -> None:
    chain = TREE_MIMIC.replace(
        '<limit lower="-2" upper="1.5" effort="30" velocity="3"/>',
        '<limit lower="-2" upper="1.5" effort="30" velocity="3"/>'
        '<mimic joint="thumb" multiplier="3" offset="-1"/>',
    )
    robot = load_robot(chain)
    assert robot.joint_names == ("lift", "left", "slide", "finger")
    # right = 3·thumb − 1 = 3·(−0.7·finger + 0.2) − 1
    row = list(robot.pin_model.names).index("right") - 1
    np.testing.assert_allclose(robot.expansion[row], [0, 0, 0, -2.1])
    assert robot.offset[row] == pytest.approx(-0.4)


def test_a_floating_base_takes_a_mimic_joint_without_offset() -> None:
    robot = load_robot(TREE_MIMIC_NO_OFFSET, root="free_flyer")
    assert robot.n == robot.pin_model.nv - 1


@given(dh_tables(prismatic=False), SEEDS)
@settings(max_examples=10)
def test_consistent_links_have_a_positive_definite_mass_matrix(table: object, seed: int) -> None:
    robot = RobotModel.from_mdh(table)  # type: ignore[arg-type]
    rng = np.random.default_rng(seed)
    theta = random_links(rng, robot.n_links)
    q = rng.uniform(-np.pi, np.pi, (10, robot.n))
    assert np.linalg.eigvalsh(robot.mass_matrix(theta, q)).min() > 0.0


def test_one_configuration_gives_one_mass_matrix(denso: RobotModel) -> None:
    rng = np.random.default_rng(3)
    theta, q = random_links(rng, 6), rng.uniform(-1, 1, (2, 6))
    both = denso.mass_matrix(theta, q)
    assert both.shape == (2, 6, 6)
    np.testing.assert_array_equal(denso.mass_matrix(theta, q[1]), both[1])
    # Friction behind the links' parameters is ignored.
    np.testing.assert_array_equal(denso.mass_matrix(np.append(theta.ravel(), np.ones(12)), q), both)


def test_a_pinocchio_model_is_copied_and_keeps_its_gravity(tree: RobotModel) -> None:
    model = tree.pin_model.copy()
    model.gravity.linear = np.array([1.0, 2.0, 3.0])
    robot = load_robot(model)
    model.gravity.linear = np.zeros(3)
    np.testing.assert_array_equal(robot.gravity, [1.0, 2.0, 3.0])
    assert robot.urdf is None
    np.testing.assert_array_equal(robot.prior, tree.prior)
    turned = load_robot(model, gravity=(0.0, 9.81, 0.0))
    np.testing.assert_array_equal(turned.gravity, [0.0, 9.81, 0.0])


def test_the_description_is_the_prior(tree: RobotModel) -> None:
    assert tree.name == "tree"
    assert tree.urdf == TREE
    assert tree.link_names == ("column", "left_arm", "left_slide", "right_arm", "finger", "thumb")
    # The welded bracket belongs to the link that carries it.
    assert tree.prior[3, 0] == pytest.approx(1.5)
    assert tree.parameter_names[10] == "m_2"
    assert len(tree.parameter_names) == len(tree.parameter_units) == 60
    with pytest.raises(ValueError, match="read-only"):
        tree.prior[0, 0] = 1.0


def test_limits_of_a_tree(tree: RobotModel) -> None:
    limits = dict(zip(tree.joint_names, tree.position_limits.tolist(), strict=True))
    assert limits["right"] == [-2.0, 1.5]
    assert limits["left"] == [-np.inf, np.inf]
    speeds = dict(zip(tree.joint_names, tree.velocity_limits, strict=True))
    assert speeds["lift"] == 2.0
    efforts = dict(zip(tree.joint_names, tree.effort_limits, strict=True))
    assert efforts["slide"] == 50.0


def test_limits_of_zero_are_none() -> None:
    limits = '<limit effort="80" velocity="3"/>'
    text = SMALL["without_limits"].urdf
    assert limits in text
    robot = load_robot(text.replace(limits, '<limit effort="0" velocity="0"/>'))
    np.testing.assert_array_equal(robot.position_limits, [[-np.inf, np.inf]] * 2)
    assert np.isinf([*robot.velocity_limits, *robot.effort_limits]).all()


def test_continuous_joints_take_angles(tree: RobotModel) -> None:
    q = np.linspace(-1.0, 1.0, tree.n)[None]
    configuration = tree.configuration(q)
    assert configuration.shape == (1, tree.pin_model.nq)
    turned = q.copy()
    turned[0, tree.joint_names.index("left")] += 2 * np.pi
    np.testing.assert_allclose(tree.configuration(turned), configuration, atol=KINEMATICS)


def test_efforts_are_linear_in_the_parameters(denso: RobotModel) -> None:
    rng = np.random.default_rng(4)
    one, two = random_links(rng, 6), random_links(rng, 6)
    states = random_states(rng, 6, 5)
    summed = denso.inverse_dynamics(one, *states) - 2.5 * denso.inverse_dynamics(two, *states)
    assert_same(denso.inverse_dynamics(one - 2.5 * two, *states), summed)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"q": np.zeros((3, 5))}, "position: 5 columns"),
        ({"q": np.zeros(6)}, "position: has 1 axes"),
        ({"v": np.zeros((2, 6))}, r"velocity: shape \(2, 6\), expected \(3, 6\)"),
        ({"a": np.zeros((3, 7))}, "acceleration: shape"),
        ({"a": np.full((3, 6), np.nan)}, "acceleration: 18 of 18 values are not finite"),
        ({"q": [[1.0, 2.0], [3.0]]}, "position: not a rectangular array"),
        ({"v": np.full((3, 6), 1j)}, "velocity: .*complex"),
    ],
)
def test_bad_states_are_data_errors(denso: RobotModel, change: dict[str, Array], says: str) -> None:
    states = {"q": np.zeros((3, 6)), "v": np.zeros((3, 6)), "a": np.zeros((3, 6))} | change
    refuses(DataError, says, denso.regressor, **states)


@given(st.integers(0, 3))
@settings(max_examples=4)
def test_no_samples_give_no_rows(denso: RobotModel, count: int) -> None:
    empty = np.zeros((count, 6))
    assert denso.regressor(empty, empty, empty).shape == (count, 6, 60)


def test_friction_of_the_description() -> None:
    text = TREE.replace("</joint>", '<dynamics damping="0.5" friction="2"/></joint>', 1)
    viscous, coulomb = load_robot(text).described_friction()
    assert sorted(viscous) == [0.0] * 5 + [0.5]
    assert sorted(coulomb) == [0.0] * 5 + [2.0]
    for key in ("friction", "damping"):
        with pytest.raises(ModelError, match=rf"{key} is -\d.*, the least is 0"):
            load_robot(text.replace(f'{key}="', f'{key}="-'))
    with pytest.raises(ModelError, match="damping of <dynamics> is 'much'"):
        load_robot(text.replace('damping="0.5"', 'damping="much"'))
