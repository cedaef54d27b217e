"""Terms of friction: what they add, their bounds, ranks, places and files."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.robot.description.dh_table import DhJoint
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import LoadFriction, PosedTerm, Tilt, horizontal_axes
from sdpid.robot.friction.term import (
    EffortCurve,
    FrictionTerm,
    OpenParameter,
    SampledMotion,
    TermParameter,
    simulated_curves,
)
from sdpid.robot.friction.terms import (
    BY_NAME,
    AsymmetricCoulomb,
    Coulomb,
    Coupling,
    Offset,
    RotorInertia,
    SigmoidFriction,
    SquareRootFriction,
    Stribeck,
    Viscous,
    term_from_dict,
    term_to_dict,
)
from sdpid.robot.model.base_parameters import BaseParameters, generic_states, structural_base
from tests.helpers.data import friction_model, random_links
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC, planar_arm, small_arm
from tests.helpers.small_robots import MODELS
from tests.helpers.strategies import SEEDS, friction_terms_of, random_states, rotations, states
from tests.helpers.tolerances import REGROUPING

NAMES = ("a", "b")
TERMS = [
    Coulomb(),
    Coulomb(width=0.1, dead_zone=0.05),
    AsymmetricCoulomb(),
    AsymmetricCoulomb(width=0.1),
    Viscous(),
    Offset(),
    RotorInertia(),
    SigmoidFriction(velocity=0.2),
    SquareRootFriction(),
    Stribeck(velocity=0.3),
    Stribeck(velocity=0.3, width=0.1, exponent=1.0),
    Coupling("a", "b", 0.1),
]


class Waves(sdpid.friction.JointwiseTerm):
    """A term of one's own that is a line between the speeds at which a simulation looks."""

    symbol, unit, nonnegative = "Fw", "N.m.s/rad", True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        return np.asarray(0.5 * velocity)


# Smooth curves by their kind, at a speed.
CURVES = {
    "tanh": lambda s, _, edge, w: np.where(s < edge, 0.0, np.tanh(s / w) - np.tanh(edge / w)),
    "root": lambda s, *_: np.sqrt(s),
    "peak": lambda s, a, b, _: np.exp(-((s / a) ** b)) - 1.0,
    "smooth_peak": lambda s, a, b, w: np.exp(-((s / a) ** b)) * np.tanh(s / w),
    "line": lambda s, _, begin, end: np.clip(s, begin, end) - begin,
}


def effort_of(curve: EffortCurve, v: Array) -> Array:
    """Return what a curve says of the efforts (K, n), away from jumps."""
    (j, other), size, effort = curve.joints, curve.size, np.zeros_like(v)
    if curve.kind in ("slope", "constant"):
        effort[:, j] = size * (v[:, other] if curve.kind == "slope" else 1.0)
        return effort
    s = v[:, j] + (v[:, other] if other >= 0 else 0.0)
    if curve.kind == "jump":
        value = np.where(s > curve.numbers[0], size, curve.numbers[1])
    else:
        value = size * np.sign(s) * CURVES[curve.kind](np.abs(s), *curve.numbers)
        value = np.where(curve.side * s < 0.0, 0.0, value)
    for joint in {j, other} - {-1}:
        effort[:, joint] = value
    return effort


@pytest.mark.parametrize("term", [*TERMS, Waves()], ids=lambda term: type(term).__name__)
@given(seed=SEEDS)
def test_a_simulation_takes_the_efforts_of_the_columns(term: FrictionTerm, seed: int) -> None:
    rng = np.random.default_rng(seed)
    v = rng.uniform(-2.0, 2.0, (50, 2))
    values = rng.uniform(0.1, 2.0, len(term.parameters(NAMES)))
    curves = list(simulated_curves(term, values, NAMES))
    found = np.sum([np.zeros_like(v), *(effort_of(each, v) for each in curves)], axis=0)
    wanted = term.columns(v, np.zeros_like(v), NAMES) @ values
    # A term of one's own is taken as constant below the first speed that is looked at.
    atol = 2e-4 if isinstance(term, Waves) else 1e-9
    np.testing.assert_allclose(found, wanted, atol=atol)


def test_what_has_no_curves_is_refused_by_a_simulation() -> None:
    class Unknown(FrictionTerm):
        parameters, columns = Waves.parameters, Waves.columns

    class Columns(Waves):
        columns = Coupling.columns

    class Inertia(Waves):
        def shape(self, velocity: Array, acceleration: Array) -> Array:
            return acceleration

    def curves(term: FrictionTerm) -> list[EffortCurve]:
        return list(simulated_curves(term, np.ones(2), NAMES))

    for term in (Unknown(), Columns()):
        refuses(ModelError, "neither one of sdpid's own", curves, term)
    refuses(ModelError, "depends on the acceleration", curves, Inertia())


def test_a_load_is_simulated_with_a_jump_where_its_sign_is_exact() -> None:
    values = np.array([0.1, 0.2])
    term = LoadFriction(width=(0.0, 0.3), share=(0.5, 0.0), velocity=(0.2, 0.4))
    curves = list(simulated_curves(term, values, NAMES))
    assert curves == [
        EffortCurve("load", (0, -1), 0.1, (0.5, 0.2, 0.0)),
        EffortCurve("jump", (0, -1), 0.0, (0.0, 0.0, 0.0)),
        EffortCurve("load", (1, -1), 0.2, (0.0, 0.4, 0.3)),
    ]
    assert not list(simulated_curves(Tilt(), values, NAMES))
    refuses(ModelError, r"numbers in \[0, 1\]", LoadFriction, share=(2.0,), velocity=(0.1,))
    refuses(ModelError, "give ten numbers", Tilt, ((1.0,) * 9,))


def test_base_parameters_are_called_as_the_friction_of_ones_own() -> None:
    class Numbered(Waves):
        def parameters(self, joint_names: Any) -> tuple[TermParameter, ...]:
            count = range(len(joint_names))
            return tuple(TermParameter(f"Foo_{j + 1}", "1", True, j) for j in count)

        def shape(self, velocity: Array, acceleration: Array) -> Array:
            return np.asarray(velocity**3)

    names = base_of(ARM, Numbered()).names
    assert {f"Foo_{j + 1}" for j in range(ARM.n)} <= set(names)
    assert any(name.startswith("xxr") for name in names)


def test_both_sides_of_a_joint_are_believed_alike() -> None:
    model = FrictionModel.from_terms((Viscous(), AsymmetricCoulomb()), NAMES)
    assert model.alike == ((2, 4), (3, 5))


@pytest.mark.parametrize("term", TERMS, ids=lambda term: type(term).__name__)
@given(seed=SEEDS)
def test_columns_lie_within(term: FrictionTerm, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends = np.sort(rng.normal(scale=0.3, size=(2, 2, 5, 2)), axis=0)
    ends[:, 0, 0] = [[-0.1, 0.0], [0.0, 0.2]]
    model = FrictionModel.from_terms((term,), NAMES)
    low, high = model.enclosed((ends[0, 0], ends[1, 0]), (ends[0, 1], ends[1, 1]))
    for share in (0.0, 1.0, *rng.uniform(size=20)):
        v, a = ends[0] + share * (ends[1] - ends[0])
        columns = model.columns(v, a)
        assert np.all(low <= columns + 1e-12)
        assert np.all(columns <= high + 1e-12)


# Terms that depend on the position: gravity's direction, and friction of the load.


ARM = small_arm(4)
GRAVITIES = ((0.0, 0.0, -9.81), (0.0, 0.0, 9.81), (9.81, 0.0, 0.0), (3.0, -5.0, 2.0))


def bodies_of(robot: sdpid.RobotModel, seed: int) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, random_links(np.random.default_rng(seed), robot.n_links).tolist()))


def motion_of(robot: sdpid.RobotModel, seed: int, count: int = 20) -> SampledMotion:
    q, v, a = random_states(np.random.default_rng(seed), robot.n, count)
    return SampledMotion(position=q, velocity=v, acceleration=a, robot=robot)


def efforts(robot: sdpid.RobotModel, motion: SampledMotion, bodies: object) -> Array:
    return robot.inverse_dynamics(
        np.ravel(np.asarray(bodies)), motion.position, motion.velocity, motion.acceleration
    )


@given(st.integers(0, 99), st.sampled_from(GRAVITIES))
def test_a_tilt_is_how_efforts_change_with_gravity(seed: int, gravity: tuple[float, float, float]):
    robot = sdpid.RobotModel.from_pinocchio(ARM.pin_model, gravity=gravity)
    motion, bodies = motion_of(robot, seed), bodies_of(robot, seed)
    columns = Tilt(bodies).columns_in(motion, robot.joint_names)
    upright = efforts(robot, motion, bodies)
    for k, axis in enumerate(horizontal_axes(robot.gravity)):
        turned = robot.gravity + np.cross(axis, robot.gravity)
        other = sdpid.RobotModel.from_pinocchio(ARM.pin_model, gravity=turned.tolist())
        change = efforts(other, motion, bodies) - upright
        np.testing.assert_allclose(columns[:, :, k], change, atol=1e-10)


@given(rotations())
def test_horizontal_axes_are_across_gravity(R: Array) -> None:
    axes = horizontal_axes(R[0])
    np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(axes @ R[0], 0.0, atol=1e-12)
    np.testing.assert_array_equal(horizontal_axes(np.array([0.0, 0.0, -9.81])), np.eye(3)[:2])
    refuses(ModelError, "no gravity", horizontal_axes, np.zeros(3))


@pytest.mark.parametrize("robot", [ARM, sdpid.load_robot(TREE_MIMIC), *MODELS.values()])
def test_friction_of_the_load_is_a_share_of_the_efforts(robot: sdpid.RobotModel) -> None:
    motion, bodies = motion_of(robot, 1), bodies_of(robot, 1)
    columns = LoadFriction(bodies).columns_in(motion, robot.joint_names)
    share = np.linspace(0.05, 0.2, robot.n)
    expected = share * np.abs(efforts(robot, motion, bodies)) * np.sign(motion.velocity)
    np.testing.assert_allclose(columns @ share, expected, atol=1e-10)


def test_friction_of_the_load_may_share_its_sign_with_a_sigmoid() -> None:
    motion, bodies = motion_of(ARM, 5), bodies_of(ARM, 5)
    share, speeds = (0.0, 0.3, 1.0, 0.5), (0.1, 0.2, 0.5, 1.0)
    term = LoadFriction(bodies, share=share, velocity=speeds)
    found = term.columns_in(motion, ARM.joint_names).sum(axis=1)
    v, c = motion.velocity, np.array(share)
    sign = (1.0 - c) * np.sign(v) + c * np.tanh(v / np.array(speeds))
    np.testing.assert_allclose(found, np.abs(efforts(ARM, motion, bodies)) * sign, atol=1e-10)
    refuses(ModelError, "one a joint of each", LoadFriction, share=(0.5,))


def test_bodies_of_the_description_are_the_default() -> None:
    robot = sdpid.load_robot(TREE)
    motion = motion_of(robot, 2)
    described = tuple(tuple(float(x) for x in body) for body in robot.prior)
    for term in (Tilt, LoadFriction):
        np.testing.assert_array_equal(
            term().columns_in(motion, robot.joint_names),
            term(described).columns_in(motion, robot.joint_names),
        )


@pytest.mark.parametrize("term", [Tilt(), LoadFriction()])
def test_what_cannot_be_evaluated_is_refused(term: PosedTerm) -> None:
    motion = motion_of(ARM, 3)
    with pytest.raises(ModelError, match="depends on the position"):
        term.columns(motion.velocity, motion.acceleration, ARM.joint_names)
    refuses(ModelError, "needs", type(term)(((1.0,) * 10,)).columns_in, motion, ARM.joint_names)
    floating = sdpid.load_robot(TREE, root="free_flyer")
    still, position = np.zeros((1, floating.n - 6)), np.zeros((1, floating.pin_model.nq))
    state = SampledMotion(position=position, velocity=still, acceleration=still, robot=floating)
    refuses(ModelError, "floats", term.columns_in, state, floating.joint_names[6:])


def test_base_parameters_hold_them() -> None:
    bodies = bodies_of(ARM, 4)
    friction = FrictionModel.from_terms(
        ("coulomb", "viscous", Tilt(bodies), LoadFriction(bodies)), ARM.joint_names
    )
    base = structural_base(ARM, friction)
    assert {"Gx", "Gy", "Fl1", "Fl4"} <= set(base.names)
    units = dict(zip(base.names, base.units, strict=True))
    assert (units["Gx"], units["Fl1"]) == ("rad", "1")
    # At an instant without a position they have no columns.
    plain = friction.columns(np.ones((1, 4)), np.zeros((1, 4)))
    assert not plain[:, :, 8:].any()


# Rank and names of base parameters with every combination of friction terms.


Term = str | FrictionTerm

# At most one of a line: two would define the same parameters.
CHOICES: tuple[tuple[Term | None, ...], ...] = (
    (None, "coulomb", Coulomb(width=0.02), Coulomb(width=0.5)),
    (None, "viscous"),
    (None, "offset"),
    (None, "rotor_inertia"),
    (None, "asymmetric_coulomb", AsymmetricCoulomb(width=0.02)),
    (None, Stribeck(0.3), Stribeck(0.01), Stribeck(0.05, width=0.01)),
    (None, SigmoidFriction(0.02), SigmoidFriction(0.3)),
    (None, "square_root"),
)
ROBOTS = {
    "vertical_slide": sdpid.RobotModel.from_mdh(
        (DhJoint(kind="prismatic"), DhJoint(alpha=np.pi / 2), DhJoint(d=0.3))
    ),
    "planar": planar_arm(),
    "arm": ARM,
    "tree": sdpid.load_robot(TREE),
    "mimic": sdpid.load_robot(TREE_MIMIC),
    "floating": sdpid.load_robot(TREE, root="free_flyer"),
}


def base_of(robot: sdpid.RobotModel, *terms: Term) -> BaseParameters:
    return structural_base(robot, friction_model(robot, terms))


def rows_of(robot: sdpid.RobotModel, friction: FrictionModel, seed: int) -> Array:
    """Return regressor rows at states fast and slow, columns scaled to unit length."""
    q, v, a = generic_states(robot, 400, seed)
    v = v.copy()
    speeds = 10.0 ** np.random.default_rng(seed).uniform(-3.0, 1.0, (400, 1))
    v[200:] *= speeds[200:]
    W = np.concatenate([robot.regressor(q, v, a), friction.columns(v, a)], axis=2)
    return W.reshape(-1, W.shape[2])


def check(robot: sdpid.RobotModel, terms: tuple[Term, ...], seed: int) -> BaseParameters:
    friction = friction_model(robot, terms)
    base = structural_base(robot, friction)
    W = rows_of(robot, friction, seed)
    share = REGROUPING + 10.0 * base.largest_dropped
    error = np.abs(W[:, base.kept] @ base.matrix - W).max(axis=0)
    assert error.max() <= share * max(np.abs(W).max(), 1.0)
    # What is kept is independent at these states, which the scan has not seen.
    kept = W[:, base.kept]
    singular = np.linalg.svd(kept / np.linalg.norm(kept, axis=0), compute_uv=False)
    assert singular[-1] > 1e-5
    assert len(set(base.names)) == base.count
    for row, kept_column in zip(base.matrix, base.kept, strict=True):
        assert row[kept_column] == 1.0
    return base


@given(
    st.tuples(*(st.sampled_from(c) for c in CHOICES)),
    st.booleans(),
    st.sampled_from(sorted(ROBOTS)),
)
@settings(max_examples=50, deadline=None)
def test_every_combination(chosen: tuple[Term | None, ...], coupled: bool, place: str) -> None:
    robot = ROBOTS[place]
    terms = tuple(term for term in chosen if term is not None)
    if coupled:
        terms += (Coupling(robot.joint_names[-2], robot.joint_names[-1], width=0.02),)
    check(robot, terms, 3)


def test_an_offset_of_a_slide_along_gravity() -> None:
    """Mass shows as a + g, rotor inertia as a, offset as 1: two parameters for three."""
    robot = ROBOTS["vertical_slide"]
    base = base_of(robot, "offset", "rotor_inertia")
    assert base.expression("mr1").endswith("+ Ia1")
    assert base.expression("For1") == "Fo1 - 9.81*Ia1"
    assert "Ia1" not in base.names
    alone = base_of(robot, "offset")
    assert {"mr1", "Fo1"} <= set(alone.names)


def test_duplicates_fold() -> None:
    robot = small_arm(2)
    base = base_of(robot, Coulomb(width=0.1), AsymmetricCoulomb(width=0.1))
    assert base.expression("Fsr2") == "Fs2 + Fsn2"
    assert base.expression("Fspr2") == "Fsp2 - Fsn2"
    same = base_of(robot, Coulomb(width=0.1), SigmoidFriction(0.1))
    assert same.expression("Fsr1") == "Fs1 + Fsg1"
    assert not any(n.startswith("Fsg") for n in same.names)


@pytest.mark.parametrize("speed", [1e-3, 0.02, 0.5])
def test_what_bends_at_low_speed_is_not_taken_for_a_duplicate(speed: float) -> None:
    """At generic speeds all of these are signs, or nothing."""
    robot = small_arm(2)
    terms = ("coulomb", SigmoidFriction(speed), Stribeck(speed), Stribeck2(speed / 2))
    names = base_of(robot, *terms).names
    assert {"Fs1", "Fsg1", "Fst1", "Fsu1", "Fs2", "Fsg2", "Fst2", "Fsu2"} <= set(names)


class Stribeck2(Stribeck):
    """A second peak."""

    symbol = "Fsu"


# A friction term is the same term after it was plain values.


@given(friction_terms_of(3))
def test_a_term_that_was_json_is_the_same_term(term: FrictionTerm) -> None:
    given = json.loads(json.dumps(term_to_dict(term), allow_nan=False))
    assert term_from_dict(given) == term


@dataclass(frozen=True)
class _Own(Coulomb):
    """A class that no file can hold."""


def test_a_class_of_ones_own_is_refused() -> None:
    refuses(ModelError, "_Own is a class of your own", term_to_dict, _Own())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"term": "Own"}, "no term is of the class 'Own'"),
        ({}, "no term is of the class None"),
        ({"term": "Offset", "width": 1.0}, "has the settings none; missing or not known: 'width'"),
        ({"term": "Coulomb", "width": 0.1}, "missing or not known: 'dead_zone'"),
        ({"term": "Coulomb", "width": -1.0, "dead_zone": 0.0}, "width is -1.0"),
        ({"term": "Coulomb", "width": {}, "dead_zone": 0.0}, "Coulomb: a setting is {}"),
        ({"term": "Coulomb", "width": "x", "dead_zone": 0.0}, "Coulomb: "),
        ({"term": "SigmoidFriction", "velocity": 1e999}, "a setting is inf"),
    ],
)
def test_what_is_no_term_is_refused_in_words(given: dict[str, Any], message: str) -> None:
    refuses(ModelError, message, term_from_dict, given)


# Friction and drive terms: names, columns, and what is refused.


JOINTS = ("a", "b", "c")
V = np.array([[0.5, -2.0, 0.0], [-0.01, 0.01, 3.0]])
A = np.array([[1.0, 2.0, 3.0], [-4.0, 5.0, -6.0]])


def diagonal(rows: Array) -> Array:
    return np.stack([np.diag(row) for row in rows])


def smooth(v: Array, widths: tuple[float, ...]) -> Array:
    each = [np.tanh(x / w) if w else np.sign(x) for x, w in zip(v.T, widths, strict=True)]
    return np.transpose(each)


def of(*terms: Any) -> FrictionModel:
    return FrictionModel.from_terms(terms, JOINTS)


@pytest.mark.parametrize(
    ("term", "symbol", "shape", "nonnegative"),
    [
        ("coulomb", "Fs", np.sign(V), True),
        (Coulomb(width=0.1), "Fs", np.tanh(V / 0.1), True),
        (Coulomb(dead_zone=0.1), "Fs", np.where(np.abs(V) < 0.1, 0.0, np.sign(V)), True),
        ("viscous", "Fv", V, True),
        ("offset", "Fo", np.ones_like(V), False),
        ("rotor_inertia", "Ia", A, True),
        ("square_root", "Fq", np.sign(V) * np.abs(V) ** 0.5, True),
        (Coulomb(width=(0.1, 0.0, 2.0)), "Fs", smooth(V, (0.1, 0.0, 2.0)), True),
        (SigmoidFriction(velocity=0.3), "Fsg", np.tanh(V / 0.3), True),
        (Stribeck(velocity=0.3), "Fst", np.exp(-((V / 0.3) ** 2)) * np.sign(V), True),
        (
            Stribeck(velocity=(0.3, 2.0, 1.0), exponent=0.5, width=0.1),
            "Fst",
            np.exp(-np.sqrt(np.abs(V) / [0.3, 2.0, 1.0])) * np.tanh(V / 0.1),
            True,
        ),
    ],
)
def test_jointwise_terms(term: Any, symbol: str, shape: Array, nonnegative: bool) -> None:
    model = of(term)
    assert [p.name for p in model.parameters] == [f"{symbol}{j}" for j in (1, 2, 3)]
    assert [p.joint for p in model.parameters] == [0, 1, 2]
    assert all(p.nonnegative is nonnegative for p in model.parameters)
    np.testing.assert_array_equal(model.columns(V, A), diagonal(shape))


@pytest.mark.parametrize("name", sorted(BY_NAME.keys() - {"tilt"}))
def test_terms_with_a_name_can_be_written_as_code(name: str) -> None:
    symbols = {p.name.rstrip("123") for p in of(name).parameters}
    assert symbols == BY_NAME[name].efforts.keys()


@given(states(3))
def test_asymmetric_coulomb_is_coulomb_when_both_sides_agree(
    random: tuple[Array, Array, Array],
) -> None:
    _, v, a = random
    sides = of("asymmetric_coulomb")
    assert [p.name for p in sides.parameters] == ["Fsp1", "Fsp2", "Fsp3", "Fsn1", "Fsn2", "Fsn3"]
    columns = sides.columns(v, a)
    both = columns[:, :, :3] + columns[:, :, 3:]
    np.testing.assert_array_equal(both, of("coulomb").columns(v, a))
    # Friction opposes motion on either side: its power is never negative.
    power = np.einsum("ki,kij->kj", v, columns)
    assert power.min() >= 0.0
    assert np.count_nonzero(columns[:, :, :3] * columns[:, :, 3:]) == 0


@given(states(3))
def test_coupling(random: tuple[Array, Array, Array]) -> None:
    """Its effort is that of a motor that turns with the sum, less what is on the diagonal."""
    _, v, a = random
    term = Coupling("b", "c")
    model = of(term)
    assert [p.name for p in model.parameters] == ["Ia2_3", "Fv2_3", "Fs2_3"]
    assert [p.nonnegative for p in model.parameters] == [False, False, True]
    assert {p.joint for p in model.parameters} == {2}
    inertia, viscous, coulomb = 0.3, 0.7, 1.1
    both_v, both_a = v[:, 1] + v[:, 2], a[:, 1] + a[:, 2]
    motor = inertia * both_a + viscous * both_v + coulomb * np.sign(both_v)
    expected = np.zeros_like(v)
    expected[:, 1] = motor - inertia * a[:, 1] - viscous * v[:, 1]
    expected[:, 2] = motor - inertia * a[:, 2] - viscous * v[:, 2]
    efforts = model.columns(v, a) @ np.array([inertia, viscous, coulomb])
    np.testing.assert_allclose(efforts, expected, rtol=0, atol=1e-13)


def test_a_floating_base_has_no_friction() -> None:
    names = (*(f"root/{k}" for k in range(6)), "a", "b")
    model = FrictionModel.from_terms(("coulomb", Coupling("a", "b")), names, first=6)
    v = np.arange(1.0, 17.0).reshape(2, 8)
    columns = model.columns(v, v)
    assert columns.shape == (2, 8, 5)
    assert not columns[:, :6].any()
    with pytest.raises(ModelError, match="no joint 'root/0'"):
        FrictionModel.from_terms((Coupling("root/0", "a"),), names, first=6)


@pytest.mark.parametrize(
    ("terms", "says"),
    [
        (("Dahl",), r"no term is called 'Dahl'; there are coulomb, viscous.*square_root"),
        (("Coulomb",), "no term is called 'Coulomb'"),
        ((3,), "no term is called 3"),
        ((["coulomb"],), "no term is called"),
        ("coulomb", r"give a tuple of terms, such as \('coulomb',\)"),
        (("coulomb", Coulomb(width=0.1)), "Fs1 is defined twice"),
        ((Coupling("a", "d"),), "no joint 'd'; it has a, b, c"),
        ((Coupling("a", "a"),), "named twice"),
    ],
)
def test_bad_terms_are_model_errors(terms: Any, says: str) -> None:
    refuses(ModelError, says, FrictionModel.from_terms, terms, JOINTS)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Coulomb(width=-0.1), "width is -0.1"),
        (lambda: Coulomb(dead_zone=np.nan), "dead_zone is nan"),
        (lambda: AsymmetricCoulomb(dead_zone=np.inf), "dead_zone is inf"),
        (lambda: Stribeck(velocity=0.0), "velocity is 0.0; give a positive velocity"),
        (lambda: Stribeck(exponent=0.0), "exponent is 0.0"),
        (lambda: Stribeck(width=-1.0), "width is -1.0"),
        (lambda: SigmoidFriction(velocity=(0.1, -0.1, 0.1)), "give a positive velocity"),
        (lambda: Coupling("a", "b", width=-1.0), "width is -1.0"),
        (lambda: Coupling("a", "b", width=(1.0, 1.0)), "give one number"),
        (lambda: OpenParameter("x", 0.0, 1.0, "rad/s"), "0 < lower"),
        (lambda: Coulomb().with_values([1.0]), "no open parameters"),
        (lambda: Viscous().with_values([1.0]), "no open parameters"),
        (lambda: Coupling("a", "b").with_values([1.0]), "no open parameters"),
        (lambda: Stribeck(width=None).with_values([1.0]), "1 values for velocity, width"),
        (lambda: of(Coulomb(width=(0.1, 0.2))).columns(V, A), "2 values, the robot 3 joints"),
    ],
)
def test_bad_speeds_are_model_errors(make: Any, says: str) -> None:
    refuses(ModelError, says, make)


OPEN: list[FrictionTerm] = [
    Coulomb(width=None),
    AsymmetricCoulomb(width=None),
    Stribeck(),
    Stribeck(width=None),
    SigmoidFriction(),
    Coupling("a", "c", width=None),
]


@pytest.mark.parametrize("term", OPEN)
def test_open_terms_have_columns_once_they_are_closed(term: FrictionTerm) -> None:
    speeds = [np.abs(V[:, j]) for j in range(3)]
    opened = term.open_parameters(speeds, JOINTS)
    assert opened
    assert len({p.name for p in opened}) == len(opened)
    refuses(ModelError, "is open; give it a value, or let build_problem", of(term).columns, V, A)
    closed = term.with_values([p.upper for p in opened])
    assert closed.open_parameters(speeds, JOINTS) == ()
    assert np.isfinite(of(closed).columns(V, A)).all()
    assert of(closed).parameters == of(term).parameters
    assert closed.with_values([]) == closed


def test_limits_follow_the_measured_speeds() -> None:
    speeds = [np.linspace(0.0, 2.0, 101), np.full(9, 3.0), np.zeros(4)]
    slow, fast, standing = Coulomb(width=None).open_parameters(speeds, JOINTS)
    assert (slow.name, slow.unit) == ("width1", "rad/s")
    assert (slow.lower, slow.upper) == pytest.approx((0.01, 1.0))
    assert (fast.lower, fast.upper) == pytest.approx((0.3, 1.5))
    assert 0.0 < standing.lower < standing.upper
    rounding = [np.full(9, 6e-16), np.full(9, 1e-12), np.full(9, 9e-7)]
    for p in Coulomb(width=None).open_parameters(rounding, JOINTS):
        assert (p.lower, p.upper) == (standing.lower, standing.upper)
    nobody = Stribeck().open_parameters([np.zeros(0)] * 3, JOINTS)
    assert all(0.0 < p.lower < p.upper for p in nobody)


def test_a_sigmoid_is_looked_for_below_the_usual_speeds() -> None:
    speeds = [np.linspace(0.5, 2.0, 101), np.linspace(0.0, 0.05, 9), np.zeros(4)]
    usual, slow, standing = SigmoidFriction().open_parameters(speeds, JOINTS)
    assert (usual.lower, usual.upper) == (0.02, 1.0)
    assert (slow.lower, slow.upper) == pytest.approx((0.005, 0.025))
    assert 0.0 < standing.lower < standing.upper


def test_values_go_field_by_field_over_the_joints() -> None:
    closed = Stribeck(width=None).with_values([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    assert closed == Stribeck(velocity=(1.0, 2.0, 3.0), width=(0.1, 0.2, 0.3))
    speeds = closed.characteristic_speeds(3)
    np.testing.assert_array_equal(speeds, [[1.0, 2.0, 3.0], [0.1, 0.2, 0.3]])


def test_terms_are_described_in_plain_values() -> None:
    found = of("viscous", Coulomb(width=(0.1, 0.2, 0.3)), Coupling("a", "b")).described()
    assert found[0] == {"term": "Viscous", "parameters": ["Fv1", "Fv2", "Fv3"]}
    assert found[1]["width"] == [0.1, 0.2, 0.3]
    assert found[2]["parameters"] == ["Ia1_2", "Fv1_2", "Fs1_2"]
    assert json.loads(json.dumps(found)) == found
