"""Feasible bodies lie in the box."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.assurance.log_proof.box import Box
from sdpid.estimation.constraints.condition import Layout
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.robot.inertia import inertia_tensor
from tests.helpers.data import flat_links, friction_model, random_links
from tests.helpers.robots import small_arm
from tests.helpers.strategies import SEEDS

ARM = small_arm(2)
ROUNDING = 1.0 + 1e-12


def feasible(consistency: Any, bodies: Array) -> FeasibleSet:
    """Return a set on whose bounds these bodies lie."""
    limits = Constraints(mass_max=float(bodies[:, 0].max()), theta_max=float(np.abs(bodies).max()))
    return FeasibleSet.build(limits, consistency, Layout(ARM, friction_model(ARM, ())))


@given(SEEDS, st.sampled_from(["pseudo_inertia", "spatial_inertia"]), st.booleans())
def test_feasible_bodies_are_inside(seed: int, consistency: Any, flat: bool) -> None:
    rng = np.random.default_rng(seed)
    bodies = flat_links(rng, 2) if flat else random_links(rng, 2)
    # Lighter than far out: masses and inertias of any proportion.
    scale = 10.0 ** rng.uniform(-1.0, 1.0)
    bodies[:, 1:4] *= scale
    bodies[:, 4:] *= scale**2
    box = Box.of(feasible(consistency, bodies))
    assert np.all(np.abs(bodies.ravel()) <= box.theta * ROUNDING)
    norms = np.linalg.norm(inertia_tensor(bodies), 2, axis=(-2, -1))
    sizes = np.stack([bodies[:, 0], np.linalg.norm(bodies[:, 1:4], axis=1), norms], axis=1)
    assert np.all(sizes <= box.bodies * ROUNDING)
    own = Box.around(bodies.ravel(), 2)
    assert np.all(sizes <= own.bodies * ROUNDING)


@pytest.mark.parametrize("consistency", ["none", "pseudo_inertia", "spatial_inertia"])
def test_consistency_makes_it_smaller(consistency: Any) -> None:
    rng = np.random.default_rng(0)
    bodies = random_links(rng, 2)
    box = Box.of(feasible(consistency, bodies))
    wide = np.abs(bodies).max()
    products = box.theta.reshape(2, 10)[:, [5, 7, 8]]
    expected = wide / 2.0 if consistency == "pseudo_inertia" else wide
    np.testing.assert_allclose(products, expected)
