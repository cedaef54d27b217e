"""Hypothesis strategies: bodies that exist, kinematic tables, states.

Nothing is found by rejection: bodies are made of point masses, so they are consistent because
of what they are.
"""

import math
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sdpid._common.arrays import Array
from sdpid.robot.description.dh_table import DhJoint, DhTable
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.term import FrictionTerm
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
from sdpid.robot.inertia import point_masses, transform

# A core of six equal masses on the axes makes every body three-dimensional: its own second
# moments about its center are at least 2·CORE_MASS/6·CORE_RADIUS² in every direction, and no
# further point mass can take any of that away.
CORE_MASS = 0.3
CORE_RADIUS = 0.05
LEAST_MARGIN = CORE_MASS / 3.0 * CORE_RADIUS**2

SEEDS = st.integers(0, 2**32 - 1)


def reals(low: float, high: float) -> st.SearchStrategy[float]:
    """Floats in a range, without the denormal ones that only test the processor."""
    return st.floats(low, high, allow_subnormal=False)


@st.composite
def rotations(draw: st.DrawFn) -> Array:
    """Rotation matrices, from three angles."""
    a, b, c = draw(hnp.arrays(float, 3, elements=reals(-math.pi, math.pi)))
    Rz = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    Ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    Rx = np.array([[1, 0, 0], [0, np.cos(c), -np.sin(c)], [0, np.sin(c), np.cos(c)]])
    return Rz @ Ry @ Rx


def core(mass: float = CORE_MASS, radius: float = CORE_RADIUS) -> Array:
    """Six equal point masses on the axes about the origin, shape (10,)."""
    points = radius * np.concatenate([np.eye(3), -np.eye(3)])
    return point_masses(np.full(6, mass / 6.0), points)


@st.composite
def bodies(draw: st.DrawFn, *, points: int = 4) -> Array:
    """Bodies (10,): up to `points` random point masses and a core, in a random place."""
    count = draw(st.integers(0, points))
    masses = draw(hnp.arrays(float, count, elements=reals(0.01, 3.0)))
    positions = draw(hnp.arrays(float, (count, 3), elements=reals(-0.4, 0.4)))
    center = draw(hnp.arrays(float, 3, elements=reals(-0.3, 0.3)))
    whole = transform(core(), np.eye(3), center)
    if count:
        whole = whole + point_masses(masses, positions)
    return whole


@st.composite
def links(draw: st.DrawFn, count: int) -> Array:
    """Links (count, 10)."""
    return np.stack([draw(bodies()) for _ in range(count)])


ANGLES = st.one_of(
    st.sampled_from([0.0, math.pi / 2, -math.pi / 2, math.pi]), reals(-math.pi, math.pi)
)
LENGTHS = st.one_of(st.just(0.0), reals(-0.6, 0.6))

# Axes that are parallel or clearly not: a rank decision about axes a microradian apart is a
# matter of convention.
CLEAR_ANGLES = st.integers(-12, 12).map(lambda k: k * math.pi / 12)
CLEAR_LENGTHS = st.integers(-6, 6).map(lambda k: 0.1 * k)


@st.composite
def dh_joints(draw: st.DrawFn, *, prismatic: bool = True, clear: bool = False) -> DhJoint:
    """One row of a table."""
    kinds: list[Any] = ["revolute", "revolute", "prismatic"] if prismatic else ["revolute"]
    angles, lengths = (CLEAR_ANGLES, CLEAR_LENGTHS) if clear else (ANGLES, LENGTHS)
    return DhJoint(
        alpha=draw(angles),
        d=draw(lengths),
        theta=draw(angles),
        r=draw(lengths),
        kind=draw(st.sampled_from(kinds)),
    )


@st.composite
def dh_tables(
    draw: st.DrawFn,
    *,
    least: int = 1,
    most: int = 6,
    prismatic: bool = True,
    clear: bool = False,
    conventions: tuple[Literal["modified", "standard"], ...] = ("modified", "standard"),
) -> DhTable:
    """Tables with base placement and gravity in any direction.

    With `clear`, axes are parallel or at 15° at least, and lengths zero or 0.1 m at least.
    """
    size, angle = (CLEAR_LENGTHS, CLEAR_ANGLES) if clear else (reals(-1.0, 1.0), ANGLES)
    rows = st.lists(dh_joints(prismatic=prismatic, clear=clear), min_size=least, max_size=most)
    x, y, z = draw(st.tuples(size, size, size))
    joints, convention = tuple(draw(rows)), draw(st.sampled_from(conventions))
    if convention == "standard" and not any(joint.r for joint in joints):
        # A length d alone would be along x or z.
        joints = tuple(replace(joint, a=joint.d, d=0.0) for joint in joints)
    return DhTable(
        joints=joints,
        convention=convention,
        base_translation=draw(st.tuples(size, size, size)),
        base_rpy=draw(st.tuples(angle, angle, angle)),
        gravity=(10.0 * x, 10.0 * y, 10.0 * z),
    )


@st.composite
def states(draw: st.DrawFn, n: int, *, count: int = 5) -> tuple[Array, Array, Array]:
    """Positions, velocities and accelerations (count, n)."""
    return random_states(np.random.default_rng(draw(SEEDS)), n, count)


def random_states(rng: np.random.Generator, n: int, count: int) -> tuple[Array, Array, Array]:
    """Generic positions, velocities and accelerations (count, n)."""
    return (
        rng.uniform(-np.pi, np.pi, (count, n)),
        rng.uniform(-3.0, 3.0, (count, n)),
        rng.uniform(-10.0, 10.0, (count, n)),
    )


@st.composite
def friction_terms_of(draw: st.DrawFn, n: int) -> FrictionTerm:
    """One friction term of any kind for n joints, its numbers given or chosen joint by joint."""
    speed = reals(1e-3, 10.0)
    each = st.one_of(speed, st.tuples(*[speed] * n))
    width = st.one_of(st.just(0.0), each)
    bodies = st.none() | st.tuples(*[st.tuples(*[reals(-2.0, 2.0)] * 10)] * n)
    shares = st.tuples(*[reals(0.0, 1.0)] * n)
    kinds = (
        st.builds(Coulomb, width=width, dead_zone=st.sampled_from([0.0, 0.05])),
        st.builds(AsymmetricCoulomb, width=width),
        st.sampled_from([Viscous(), Offset(), RotorInertia(), SquareRootFriction()]),
        st.builds(SigmoidFriction, velocity=each),
        st.builds(Stribeck, velocity=each, exponent=reals(0.5, 2.0), width=width),
        st.builds(Coupling, first=st.just("b"), second=st.just("c"), width=speed),
        st.builds(Tilt, bodies=bodies),
        st.builds(LoadFriction, bodies=bodies, width=width),
        st.builds(LoadFriction, share=shares, velocity=st.tuples(*[speed] * n)),
    )
    return draw(st.one_of(kinds))
