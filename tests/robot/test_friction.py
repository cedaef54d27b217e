"""Terms of friction: what they add, their bounds, ranks, places and files."""

import json
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import LoadFriction, PosedTerm, Tilt, horizontal_axes
from sdpid.robot.friction.position import way_of
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
from tests.helpers.data import base_of, random_bodies
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC, small_arm
from tests.helpers.small_robots import MODELS
from tests.helpers.strategies import SEEDS, friction_terms_of, random_states, rotations, states

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


def effort_of(curve: EffortCurve, s: Array) -> Array:
    """Return what a curve says of the effort (K,) at velocities, away from jumps."""
    size = curve.size
    if curve.kind in ("slope", "constant"):
        return size * (s if curve.kind == "slope" else np.ones_like(s))
    if curve.kind == "jump":
        return np.where(s > curve.numbers[0], size, curve.numbers[1])
    value = size * np.sign(s) * CURVES[curve.kind](np.abs(s), *curve.numbers)
    return np.where(curve.side * s < 0.0, 0.0, value)


def simulated_efforts(term: FrictionTerm, values: Array, v: Array) -> Array:
    """Return what the curves of a term say of the efforts (K, n)."""
    effort = np.zeros_like(v)
    for acting, places, own in term.acting(values, NAMES):
        ways = [way_of("term", place, None, NAMES)[0] for place in places]
        for curve in simulated_curves(acting, own, [str(place) for place in places]):
            way = ways[curve.joint]
            effort += effort_of(curve, v @ way)[:, None] * way
    return effort


@pytest.mark.parametrize("term", [*TERMS, Waves()], ids=lambda term: type(term).__name__)
@given(seed=SEEDS)
def test_a_simulation_takes_the_efforts_of_the_columns(term: FrictionTerm, seed: int) -> None:
    rng = np.random.default_rng(seed)
    v = rng.uniform(-2.0, 2.0, (50, 2))
    values = rng.uniform(0.1, 2.0, len(term.parameters(NAMES)))
    found = simulated_efforts(term, values, v)
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
        EffortCurve("load", 0, 0.1, (0.5, 0.2, 0.0)),
        EffortCurve("jump", 0, 0.0, (0.0, 0.0, 0.0)),
        EffortCurve("load", 1, 0.2, (0.0, 0.4, 0.3)),
    ]
    assert not list(simulated_curves(Tilt(), values, NAMES))


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
ROBOTS = {"arm": ARM, "mimic": sdpid.load_robot(TREE_MIMIC), **MODELS}


def motion_of(robot: sdpid.RobotModel, seed: int, count: int = 20) -> SampledMotion:
    q, v, a = random_states(np.random.default_rng(seed), robot.n, count)
    return SampledMotion(position=q, velocity=v, acceleration=a, robot=robot)


def efforts(robot: sdpid.RobotModel, motion: SampledMotion, bodies: object) -> Array:
    return robot.inverse_dynamics(
        np.ravel(np.asarray(bodies)), motion.position, motion.velocity, motion.acceleration
    )


@given(rotations())
def test_horizontal_axes_are_across_gravity(R: Array) -> None:
    axes = horizontal_axes(R[0])
    np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(axes @ R[0], 0.0, atol=1e-12)
    np.testing.assert_array_equal(horizontal_axes(np.array([0.0, 0.0, -9.81])), np.eye(3)[:2])


@pytest.mark.parametrize("name", ROBOTS)
def test_friction_of_the_load_is_a_share_of_the_efforts(name: str) -> None:
    robot = ROBOTS[name]
    motion, bodies = motion_of(robot, 1), random_bodies(robot, 1)
    size, v = np.abs(efforts(robot, motion, bodies)), motion.velocity
    columns = LoadFriction(bodies).columns_in(motion, robot.joint_names)
    share = np.linspace(0.05, 0.2, robot.n)
    np.testing.assert_allclose(columns @ share, share * size * np.sign(v), atol=1e-10)
    # It may share its sign with a sigmoid.
    c, speeds = np.linspace(0.0, 1.0, robot.n), np.linspace(0.1, 1.0, robot.n)
    term = LoadFriction(bodies, share=tuple(c.tolist()), velocity=tuple(speeds.tolist()))
    found = term.columns_in(motion, robot.joint_names).sum(axis=1)
    sign = (1.0 - c) * np.sign(v) + c * np.tanh(v / speeds)
    np.testing.assert_allclose(found, size * sign, atol=1e-10)


def test_bodies_of_the_description_are_the_default() -> None:
    robot = sdpid.load_robot(TREE)
    motion = motion_of(robot, 2)
    described = tuple(map(tuple, robot.prior.tolist()))
    for term in (Tilt, LoadFriction):
        np.testing.assert_array_equal(
            term().columns_in(motion, robot.joint_names),
            term(described).columns_in(motion, robot.joint_names),
        )


@pytest.mark.parametrize("term", [Tilt(), LoadFriction()], ids=lambda term: type(term).__name__)
def test_what_cannot_be_evaluated_is_refused(term: PosedTerm) -> None:
    motion, names = motion_of(ARM, 3), ARM.joint_names
    still = motion.velocity, motion.acceleration, names
    refuses(ModelError, "depends on the position", term.columns, *still)
    refuses(ModelError, "needs", type(term)(((1.0,) * 10,)).columns_in, motion, names)
    floating = sdpid.load_robot(TREE, root="free_flyer")
    state = motion_of(floating, 3)
    refuses(ModelError, "floats", term.columns_in, state, floating.joint_names[6:])


# A friction term is the same term after it was plain values.


@given(friction_terms_of(3))
def test_a_term_that_was_json_is_the_same_term(term: FrictionTerm) -> None:
    given = json.loads(json.dumps(term_to_dict(term), allow_nan=False))
    assert term_from_dict(given) == term


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
    base = (Coupling("root/0", "a"),)
    refuses(ModelError, "no joint 'root/0'", FrictionModel.from_terms, base, names, first=6)


class _Own(Coulomb):
    """A class that no file can hold."""


def from_dict(term: str, **fields: Any) -> Any:
    return partial(term_from_dict, {"term": term, **fields})


NO_WIDTH = {"dead_zone": 0.0}
REFUSED: dict[str, Callable[[], object]] = {
    r"no term is called 'Dahl'; there are coulomb, viscous.*square_root": partial(of, "Dahl"),
    "no term is called 'Coulomb'": partial(of, "Coulomb"),
    "no term is called 3": partial(of, 3),
    r"no term is called \['coulomb'\]": partial(of, ["coulomb"]),
    r"give a tuple of terms, such as \('coulomb',\)": partial(
        FrictionModel.from_terms, "coulomb", JOINTS
    ),
    "Fs1 is defined twice": partial(of, "coulomb", Coulomb(width=0.1)),
    "no joint 'd'; it has a, b, c": partial(of, Coupling("a", "d")),
    "named twice": partial(of, Coupling("a", "a")),
    "Coulomb: width is -0.1": partial(Coulomb, width=-0.1),
    "dead_zone is nan": partial(Coulomb, dead_zone=np.nan),
    "dead_zone is inf": partial(AsymmetricCoulomb, dead_zone=np.inf),
    "velocity is 0.0; give a positive velocity": partial(Stribeck, velocity=0.0),
    "exponent is 0.0": partial(Stribeck, exponent=0.0),
    "Stribeck: width is -1.0": partial(Stribeck, width=-1.0),
    "give a positive velocity": partial(SigmoidFriction, velocity=(0.1, -0.1, 0.1)),
    "Coupling: width is -1.0": partial(Coupling, "a", "b", width=-1.0),
    "give one number": partial(Coupling, "a", "b", width=(1.0, 1.0)),
    r"numbers in \[0, 1\]": partial(LoadFriction, share=(2.0,), velocity=(0.1,)),
    "one a joint of each": partial(LoadFriction, share=(0.5,)),
    "give ten numbers": partial(Tilt, ((1.0,) * 9,)),
    "no gravity": partial(horizontal_axes, np.zeros(3)),
    "0 < lower": partial(OpenParameter, "x", 0.0, 1.0, "rad/s"),
    "Coulomb.*no open parameters": partial(Coulomb().with_values, [1.0]),
    "Viscous.*no open parameters": partial(Viscous().with_values, [1.0]),
    "Coupling.*no open parameters": partial(Coupling("a", "b").with_values, [1.0]),
    "1 values for velocity, width": partial(Stribeck(width=None).with_values, [1.0]),
    "2 values, the robot 3 joints": partial(of(Coulomb(width=(0.1, 0.2))).columns, V, A),
    "_Own is a class of your own": partial(term_to_dict, _Own()),
    "no term is of the class 'Own'": from_dict("Own"),
    "no term is of the class None": partial(term_from_dict, {}),
    "has the settings none; missing or not known: 'width'": from_dict("Offset", width=1.0),
    "missing or not known: 'dead_zone'": from_dict("Coulomb", width=0.1),
    "Coulomb: width is -1.0": from_dict("Coulomb", width=-1.0, **NO_WIDTH),
    "Coulomb: a setting is {}": from_dict("Coulomb", width={}, **NO_WIDTH),
    "Coulomb: .*'str'": from_dict("Coulomb", width="x", **NO_WIDTH),
    "a setting is inf": from_dict("SigmoidFriction", velocity=1e999),
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_no_term_is_refused(words: str) -> None:
    refuses(ModelError, words, REFUSED[words])


OPEN: list[FrictionTerm] = [
    Coulomb(width=None),
    AsymmetricCoulomb(width=None),
    Stribeck(),
    Stribeck(width=None),
    SigmoidFriction(),
    Coupling("a", "c", width=None),
]


@pytest.mark.parametrize("term", OPEN, ids=repr)
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
