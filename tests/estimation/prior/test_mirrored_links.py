"""The belief that links are nearly mirror images of each other."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid.constraints import Layout, MirrorPair, mirror_pairs
from sdpid.errors import CertificateError, DataError, ModelError
from sdpid.estimation.prior.alike import Alike
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import pseudo_inertia
from sdpid.verifier.reading import digest
from sdpid.workflow.verify import Verification
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
    rows = Alike.of(PAIR, within, believed, layout).rows
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
    found = [Alike.of(pair, 0.05, robot.prior, layout).rows for pair in mirror_pairs(robot)]
    rows = np.vstack(found)
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
    with pytest.raises(DataError, match="within is True; give a positive share"):
        sdpid.Prior(alike=pairs, within=True)
    with pytest.raises(DataError, match="alike holds 'link_1' and 'link_2' twice"):
        sdpid.Prior(alike=(PAIR, PAIR))
    planes = [MirrorPair(*names, normal=(0, 1, 0)) for names in (("a", "b"), ("b", "a"))]
    with pytest.raises(DataError, match="alike holds 'b' and 'a' twice"):
        sdpid.Prior(alike=planes)  # type: ignore[arg-type]
    with pytest.raises(DataError, match="alike holds 'link_1'"):
        sdpid.Prior(alike=("link_1",))  # type: ignore[arg-type]
    other = MirrorPair(FIRST, "tail", reflection=REFLECTION)
    with pytest.raises(ModelError, match="no link 'tail'"):
        arm_problem(prior=sdpid.Prior(bodies=BODIES, alike=other))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def stated() -> dict[str, Any]:
    """A certificate of an estimate that believes in two pairs."""
    pairs = (PAIR, MirrorPair(LAST, FIRST, reflection=REFLECTION))
    problem = arm_problem(prior=sdpid.Prior(bodies=BODIES, alike=pairs, within=0.3))
    return sdpid.certify(sdpid.solve_sdp(problem)).to_dict()


def verified(data: dict[str, Any], folder: Path) -> Verification:
    """Seal a certificate anew and check it."""
    (folder / "c.json").write_text(json.dumps({**data, "sha256": digest(data)}))
    return sdpid.verify(folder / "c.json")


def edited(data: dict[str, Any], way: tuple[Any, ...], change: Callable[[Any], Any]) -> Any:
    """Return a certificate with one number of its problem changed."""
    data = copy.deepcopy(data)
    place: Any = data["problem"]
    for key in way[:-1]:
        place = place[key]
    place[way[-1]] = change(place[way[-1]])
    return data


def test_a_certificate_states_what_is_believed(stated: dict[str, Any], tmp_path: Path) -> None:
    found = verified(stated, tmp_path)
    assert found.passed, found.problems
    words = "the last 20 of which believe links to be mirror images within 30 %: 'link_2' of"
    assert any(words in text for text in found.statements)


@pytest.mark.parametrize(
    ("way", "change"),
    [
        (("alike", 0, "within"), lambda _: 0.31),
        (("alike", 1, "inverse", 0, 0), lambda x: 1.001 * x),
        (("alike", 0, "reflection", 0, 3), lambda x: x + 1e-3),
        (("prior_matrix", -1, 12), lambda x: x + 1e-3),
        (("prior_rhs", -1), lambda _: 1e-3),
    ],
)
def test_beliefs_that_the_rows_do_not_have_are_rejected(
    stated: dict[str, Any], tmp_path: Path, way: tuple[Any, ...], change: Callable[[Any], Any]
) -> None:
    found = verified(edited(stated, way, change), tmp_path)
    assert not found.passed
    assert any("are not belief" in text for text in found.problems), found.problems


@pytest.mark.parametrize(
    ("way", "value", "message"),
    [
        (("alike", 0, "first"), 1, "belief 1 is about one link"),
        (("alike", 0, "reflection", 1, 1), 1.0, "the reflection of belief 1 is none"),
        (("alike", 1, "within"), -0.3, "the share of belief 2 is not positive"),
        (("alike", 1, "inverse", 0, 0), -1.0, "the inverse of belief 2 is not symmetric and"),
    ],
)
def test_beliefs_that_make_no_sense_are_rejected(
    stated: dict[str, Any], tmp_path: Path, way: tuple[Any, ...], value: float, message: str
) -> None:
    with pytest.raises(CertificateError, match=message):
        verified(edited(stated, way, lambda _: value), tmp_path)
