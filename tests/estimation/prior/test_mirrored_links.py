"""The belief that links are nearly mirror images of each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid.constraints import Layout, MirrorPair, mirror_pairs
from sdpid.errors import DataError, ModelError
from sdpid.estimation.prior.alike import alike_rows
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import pseudo_inertia
from tests.helpers.arm import ARM, BODIES, FIRST, LAST, REFLECTION, arm_problem
from tests.helpers.data import random_links

PAIR = MirrorPair(FIRST, LAST, reflection=REFLECTION)


@given(st.integers(0, 2**31), st.floats(0.01, 1.0))
def test_nats_of_a_difference(seed: int, within: float) -> None:
    """By the definition, with matrices that the rows do not see."""
    rng = np.random.default_rng(seed)
    believed, bodies = random_links(rng, 2), random_links(rng, 2)
    layout = Layout(ARM, FrictionModel.from_terms(("viscous",), ARM.joint_names))
    theta = np.concatenate([bodies.ravel(), rng.normal(size=2)])
    rows = alike_rows((PAIR,), within, believed, layout)
    H = REFLECTION
    (A0, B0), (A, B) = pseudo_inertia(believed), pseudo_inertia(bodies)
    L = np.linalg.cholesky((H @ A0 @ H.T + B0) / 2)
    off = np.linalg.solve(L, np.linalg.solve(L, B - H @ A @ H.T).T)
    wanted = float(np.sum(off**2)) / within**2
    assert float(np.sum((rows @ theta) ** 2)) == pytest.approx(wanted, rel=1e-9)


def test_the_tighter_the_nearer() -> None:
    off = []
    for within in (10.0, 1.0, 0.1, 0.01):
        prior = sdpid.Prior(bodies=BODIES, alike=PAIR, within=within)
        theta = sdpid.solve_sdp(arm_problem(prior=prior)).theta
        assert theta is not None
        first, second = pseudo_inertia(theta[:20].reshape(2, 10))
        off.append(float(np.linalg.norm(second - REFLECTION @ first @ REFLECTION)))
    assert off == sorted(off, reverse=True)
    assert off[-1] < 0.02 * off[0]


def test_a_described_robot_pays_nothing() -> None:
    robot = sdpid.load_robot("a1", root="free_flyer")
    layout = Layout(robot, FrictionModel.from_terms((), robot.joint_names, first=robot.n_base))
    rows = alike_rows(mirror_pairs(robot), 0.05, robot.prior, layout)
    assert rows.shape == (60, layout.count)
    assert float(np.abs(rows @ robot.prior.ravel()).max()) < 1e-9


def test_what_a_prior_says_and_refuses() -> None:
    pairs = (PAIR, MirrorPair(LAST, FIRST, reflection=REFLECTION))
    prior = sdpid.Prior(alike=pairs, within=0.1)
    assert prior == sdpid.Prior(alike=list(pairs), within=0.1)
    assert hash(prior) == hash(sdpid.Prior(alike=pairs, within=0.1))
    assert prior != sdpid.Prior(alike=pairs[:1], within=0.1)
    assert prior != sdpid.Prior(alike=pairs, within=0.2)
    problem = arm_problem(prior=sdpid.Prior(bodies=BODIES, alike=pairs))
    assert problem.prior is not None
    assert any(
        note.startswith("prior: mirror images of each other within 5 %: link_1 and link_2")
        for note in problem.prior.notes
    )
    with pytest.raises(DataError, match=r"within is 0\.0; give a positive share"):
        sdpid.Prior(alike=PAIR, within=0.0)
    with pytest.raises(DataError, match="alike holds 'link_1'"):
        sdpid.Prior(alike=("link_1",))  # type: ignore[arg-type]
    other = MirrorPair(FIRST, "tail", reflection=REFLECTION)
    with pytest.raises(ModelError, match="no link 'tail'"):
        arm_problem(prior=sdpid.Prior(bodies=BODIES, alike=other))  # type: ignore[arg-type]
