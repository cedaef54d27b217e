"""Bounds of friction columns over ranges of motion."""

import numpy as np
import pytest
from hypothesis import given

from sdpid.robot.friction.model import FrictionModel
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
from tests.helpers.strategies import SEEDS

NAMES = ("a", "b")
TERMS = [
    Coulomb(),
    Coulomb(width=0.1, dead_zone=0.05),
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
