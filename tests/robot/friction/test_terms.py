"""Friction and drive terms: names, columns, and what is refused."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given

from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm, OpenParameter
from sdpid.robot.friction.terms import (
    AsymmetricCoulomb,
    Coulomb,
    Coupling,
    Offset,
    RotorInertia,
    SigmoidFriction,
    SquareRootFriction,
    Stribeck,
    Viscous,
)
from tests.helpers.refusals import refuses
from tests.helpers.strategies import states

NAMES = ("a", "b", "c")
V = np.array([[0.5, -2.0, 0.0], [-0.01, 0.01, 3.0]])
A = np.array([[1.0, 2.0, 3.0], [-4.0, 5.0, -6.0]])


def diagonal(rows: Array) -> Array:
    return np.stack([np.diag(row) for row in rows])


def smooth(v: Array, widths: tuple[float, ...]) -> Array:
    each = [np.tanh(x / w) if w else np.sign(x) for x, w in zip(v.T, widths, strict=True)]
    return np.transpose(each)


def of(*terms: Any) -> FrictionModel:
    return FrictionModel.from_terms(terms, NAMES)


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


def test_names_and_objects_are_the_same_terms() -> None:
    objects = of(Coulomb(), Viscous(), Offset(), RotorInertia(), AsymmetricCoulomb())
    names = of("coulomb", "viscous", "offset", "rotor_inertia", "asymmetric_coulomb")
    assert objects == names
    assert of(Stribeck(), SigmoidFriction(), SquareRootFriction()) == of(
        "stribeck", "sigmoid", "square_root"
    )


@given(states(3))
def test_asymmetric_coulomb_is_coulomb_when_both_sides_agree(
    random: tuple[Array, Array, Array],
) -> None:
    _, v, a = random
    sides = of("asymmetric_coulomb")
    assert [p.name for p in sides.parameters] == ["Fsp1", "Fsp2", "Fsp3", "Fsn1", "Fsn2", "Fsn3"]
    columns = sides.columns(v, a)
    np.testing.assert_array_equal(
        columns[:, :, :3] + columns[:, :, 3:], of("coulomb").columns(v, a)
    )
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


def test_terms_stand_in_the_order_given() -> None:
    model = of("viscous", Coupling("a", "b"), "coulomb")
    names = [p.name for p in model.parameters]
    assert names == ["Fv1", "Fv2", "Fv3", "Ia1_2", "Fv1_2", "Fs1_2", "Fs1", "Fs2", "Fs3"]
    assert model.columns(V, A).shape == (2, 3, 9)


def test_no_terms() -> None:
    model = of()
    assert model.parameters == ()
    assert model.columns(V, A).shape == (2, 3, 0)


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
    refuses(ModelError, says, FrictionModel.from_terms, terms, NAMES)


@pytest.mark.parametrize("field", ["width", "dead_zone"])
@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_bad_widths_are_model_errors(field: str, value: float) -> None:
    for term in (Coulomb, AsymmetricCoulomb):
        with pytest.raises(ModelError, match=f"{field} is {value}"):
            of(term(**{field: value}))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Stribeck(velocity=0.0), "velocity is 0.0; give a positive velocity"),
        (lambda: Stribeck(exponent=0.0), "exponent is 0.0"),
        (lambda: Stribeck(width=-1.0), "width is -1.0"),
        (lambda: SigmoidFriction(velocity=(0.1, -0.1, 0.1)), "give a positive velocity"),
        (lambda: Coupling("a", "b", width=-1.0), "width is -1.0"),
        (lambda: Coupling("a", "b", width=(1.0, 1.0)), "give one number"),  # type: ignore[arg-type]
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
    opened = term.open_parameters(speeds, NAMES)
    assert opened
    assert len({p.name for p in opened}) == len(opened)
    with pytest.raises(ModelError, match="is open; give it a value, or let build_problem"):
        of(term).columns(V, A)
    closed = term.with_values([p.upper for p in opened])
    assert closed.open_parameters(speeds, NAMES) == ()
    assert np.isfinite(of(closed).columns(V, A)).all()
    assert of(closed).parameters == of(term).parameters
    assert closed.with_values([]) == closed


def test_limits_follow_the_measured_speeds() -> None:
    speeds = [np.linspace(0.0, 2.0, 101), np.full(9, 3.0), np.zeros(4)]
    slow, fast, standing = Coulomb(width=None).open_parameters(speeds, NAMES)
    assert (slow.name, slow.unit) == ("width1", "rad/s")
    assert (slow.lower, slow.upper) == pytest.approx((0.01, 1.0))
    assert (fast.lower, fast.upper) == pytest.approx((0.3, 1.5))
    assert 0.0 < standing.lower < standing.upper
    rounding = [np.full(9, 6e-16), np.full(9, 1e-12), np.full(9, 9e-7)]
    for p in Coulomb(width=None).open_parameters(rounding, NAMES):
        assert (p.lower, p.upper) == (standing.lower, standing.upper)
    nobody = Stribeck().open_parameters([np.zeros(0)] * 3, NAMES)
    assert all(0.0 < p.lower < p.upper for p in nobody)


def test_a_sigmoid_is_looked_for_below_the_usual_speeds() -> None:
    speeds = [np.linspace(0.5, 2.0, 101), np.linspace(0.0, 0.05, 9), np.zeros(4)]
    usual, slow, standing = SigmoidFriction().open_parameters(speeds, NAMES)
    assert (usual.lower, usual.upper) == (0.02, 1.0)
    assert (slow.lower, slow.upper) == pytest.approx((0.005, 0.025))
    assert 0.0 < standing.lower < standing.upper


def test_values_go_field_by_field_over_the_joints() -> None:
    closed = Stribeck(width=None).with_values([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    assert closed == Stribeck(velocity=(1.0, 2.0, 3.0), width=(0.1, 0.2, 0.3))
    np.testing.assert_array_equal(
        closed.characteristic_speeds(3), [[1.0, 2.0, 3.0], [0.1, 0.2, 0.3]]
    )


@given(states(3))
def test_friction_opposes_motion(random: tuple[Array, Array, Array]) -> None:
    _, v, a = random
    for term in (SquareRootFriction(), Stribeck(0.5), SigmoidFriction(0.5)):
        assert np.einsum("ki,kij->kj", v, of(term).columns(v, a)).min() >= 0.0


def test_terms_are_described_in_plain_values() -> None:
    found = of("viscous", Coulomb(width=(0.1, 0.2, 0.3)), Coupling("a", "b")).described()
    assert found[0] == {"term": "Viscous", "parameters": ["Fv1", "Fv2", "Fv3"]}
    assert found[1]["width"] == [0.1, 0.2, 0.3]
    assert found[2]["parameters"] == ["Ia1_2", "Fv1_2", "Fs1_2"]
    assert json.loads(json.dumps(found)) == found


def test_terms_are_a_namespace_of_the_package() -> None:
    import sdpid

    assert sdpid.friction.Coulomb is Coulomb
    assert not hasattr(sdpid, "Coulomb")
    assert set(vars(sdpid.friction)) >= set(sdpid.friction.__all__)
