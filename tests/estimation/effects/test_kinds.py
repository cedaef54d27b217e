"""Where effects are made linear, and what they say."""

from __future__ import annotations

import numpy as np
import pytest

from sdpid.estimation.effects.kinds import EFFECTS, at_estimate
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.terms import Coulomb, RotorInertia, SigmoidFriction, Viscous
from tests.helpers.data import random_links
from tests.helpers.robots import small_arm

ARM = small_arm(2)
LINKS = random_links(np.random.default_rng(0), 2)
BODIES = tuple(tuple(float(x) for x in body) for body in LINKS)
TERMS = (Coulomb(width=0.005), SigmoidFriction((0.1, 0.4)), Viscous())


def test_the_load_rubs_where_the_joint_does() -> None:
    friction = {"Fs1": 3.0, "Fs2": 0.0, "Fsg1": 1.0, "Fsg2": 2.0, "Fv1": 1.0, "Fv2": 1.0}
    term = next(each for each in EFFECTS if each.name == "load").term(ARM, TERMS)
    assert term == LoadFriction(width=0.005)
    assert at_estimate(term, LINKS, friction, TERMS) == LoadFriction(
        BODIES, width=0.005, share=(0.25, 1.0), velocity=(0.1, 0.4)
    )
    # Without a sigmoid it is the sign, and other terms are what they were.
    assert at_estimate(term, LINKS, friction, TERMS[:1]) == LoadFriction(BODIES, width=0.005)
    assert at_estimate(Tilt(), LINKS, friction, TERMS) == Tilt(BODIES)
    assert at_estimate(RotorInertia(), LINKS, friction, TERMS) == RotorInertia()


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_every_effect_says_what_it_is(effect: object) -> None:
    (found,) = [each for each in EFFECTS if each is effect]
    assert 0.0 < found.least_fall < 1.0
    assert found.title
    assert found.meaning
    parameters = {"Gx": 0.01, "Gy": -0.02, "Fl1": 0.05, "Fl2": 0.1}
    words = {"tilt": "0.57° about x and -1.15° about y", "load": "5.0 to 10.0 % of the load"}
    assert words.get(found.name, "") in found.size(parameters)
