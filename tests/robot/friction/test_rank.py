"""Rank and names of base parameters with every combination of friction terms."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.robot.description.dh_table import DhJoint, DhTable
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import (
    AsymmetricCoulomb,
    Coulomb,
    Coupling,
    SigmoidFriction,
    Stribeck,
)
from sdpid.robot.model.base_parameters import BaseParameters, generic_states, structural_base
from tests.helpers.data import friction_model
from tests.helpers.robots import TREE, TREE_MIMIC, planar_arm, small_arm
from tests.helpers.tolerances import REGROUPING

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
PLACES = ("vertical_slide", "planar", "arm", "tree", "mimic", "floating")


@functools.cache
def robot_of(place: str) -> sdpid.RobotModel:
    match place:
        case "vertical_slide":
            rows = (DhJoint(kind="prismatic"), DhJoint(alpha=np.pi / 2), DhJoint(d=0.3))
            return sdpid.RobotModel.from_mdh(DhTable(joints=rows, name=place))
        case "planar":
            return planar_arm()
        case "arm":
            return small_arm(4)
        case "floating":
            return sdpid.load_robot(TREE, root="free_flyer")
    return sdpid.load_robot(TREE_MIMIC if place == "mimic" else TREE)


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


@given(st.tuples(*(st.sampled_from(c) for c in CHOICES)), st.booleans(), st.sampled_from(PLACES))
@settings(max_examples=50, deadline=None)
def test_every_combination(chosen: tuple[Term | None, ...], coupled: bool, place: str) -> None:
    robot = robot_of(place)
    terms = tuple(term for term in chosen if term is not None)
    if coupled:
        terms += (Coupling(robot.joint_names[-2], robot.joint_names[-1], width=0.02),)
    check(robot, terms, 3)


@pytest.mark.parametrize("place", PLACES)
def test_all_terms_at_once(place: str) -> None:
    robot = robot_of(place)
    names = robot.joint_names[-2:]
    terms: tuple[Term, ...] = (
        *("coulomb", "viscous", "offset", "rotor_inertia", AsymmetricCoulomb(width=0.02)),
        *("square_root", Stribeck(0.02), SigmoidFriction(0.3), Coupling(*names)),
    )
    base = check(robot, terms, 4)
    joints = robot.n - robot.n_base
    for symbol in ("Fs", "Fv", "Fq", "Fst", "Fsg"):
        found = [n for n in base.names if n.rstrip("0123456789_") in (symbol, symbol + "r")]
        # The coupling's own parameters are called Fs and Fv too.
        own = [n for n in found if "_" not in n]
        assert len(own) == joints, symbol


def test_an_offset_of_a_slide_along_gravity() -> None:
    """Mass shows as a + g, rotor inertia as a, offset as 1: two parameters for three."""
    robot = robot_of("vertical_slide")
    base = base_of(robot, "offset", "rotor_inertia")
    assert base.expression("mr1").endswith("+ Ia1")
    assert base.expression("For1") == "Fo1 - 9.81*Ia1"
    assert "Ia1" not in base.names
    alone = base_of(robot, "offset")
    assert {"mr1", "Fo1"} <= set(alone.names)


def test_a_rotor_inertia_merges_with_zz_only_where_the_link_is_alone() -> None:
    base = base_of(planar_arm(), "rotor_inertia")
    assert base.expression("zzr1") == "zz_1 + 0.16*m_2 + Ia1"
    # The second rotor turns relative to the first link.
    assert "Ia2" in base.names
    assert "Iar1" not in base.names


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
