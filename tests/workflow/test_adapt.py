"""Friction is refitted to another recording, and the rigid part stays."""

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError
from tests.helpers.refusals import refuses
from tests.helpers.runs import arm, recorded

LINKS = 20


def test_only_friction_moves_and_the_result_is_proven() -> None:
    first = sdpid.identify(arm(), recorded(1), intervals=False).estimate
    warm = recorded(2, damping=0.8)
    adapted = sdpid.adapt(first, warm)
    np.testing.assert_array_equal(adapted.theta[:LINKS], first.theta[:LINKS])
    found, old = adapted.named_theta(), first.named_theta()
    for joint in ("1", "2"):
        assert old[f"Fv{joint}"] == pytest.approx(0.4, abs=0.05)
        assert found[f"Fv{joint}"] == pytest.approx(0.8, abs=0.05)
    assert sdpid.certify(adapted).passed
    samples = adapted.problem.samples
    before, after = (sdpid.validate(each, samples).relative for each in (first, adapted))
    assert after < 0.5 * before


def test_rotors_and_gravity_stay_too() -> None:
    log = recorded(3)
    first = sdpid.identify(arm(), log, effects=("rotor_inertia", "tilt"), intervals=False).estimate
    adapted = sdpid.adapt(first, recorded(4))
    old, new = first.named_theta(), adapted.named_theta()
    for name in ("Gx", "Gy", "Ia1", "Ia2"):
        assert new[name] == old[name]


def test_an_estimate_without_links_is_refused() -> None:
    result = sdpid.identify(arm(), recorded(1), intervals=False)
    refuses(DataError, "no standard parameters", sdpid.adapt, result.wls, recorded(2))
