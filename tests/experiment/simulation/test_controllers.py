"""Controllers give what their formulas say, with slopes, and refuse what is none."""

import numpy as np
import pytest

import sdpid
from sdpid.controllers import PD, PID, ComputedTorque, P
from sdpid.errors import DataError
from sdpid.experiment.simulation.law import Controller
from tests.experiment.simulation.models import model_of
from tests.helpers.data import random_links
from tests.helpers.refusals import refuses
from tests.helpers.robots import planar_arm

KP, KD, KI = np.array([30.0, 20.0]), np.array([3.0, 2.0]), np.array([5.0, 4.0])


def laws() -> tuple[Controller, ...]:
    """Return one of each kind."""
    model = model_of(
        planar_arm(),
        ("viscous", "coulomb", "rotor_inertia"),
        [0.5, 0.4, 0.3, 0.2, 0.1, 0.2],
        random_links(np.random.default_rng(0), 2),
    )
    return (
        P(KP, KD),
        PD(KP, KD),
        PID(KP, KI, KD, feedforward=False),
        ComputedTorque(model, KP, KD),
        PD(KP, KD, effort_limit=np.array([5.0, 1e3])),
    )


@pytest.mark.parametrize("law", laws(), ids=repr)
def test_slopes_are_those_of_the_effort(law: Controller) -> None:
    rng = np.random.default_rng(1)
    q, v, qd, vd, ad, integral = rng.normal(size=(6, 5, 2))
    by_position, by_velocity = law.slopes(q, v, qd, vd, ad, integral)
    for j, h in enumerate(1e-6 * np.eye(2)):
        dq = law.effort(q + h, v, qd, vd, ad, integral) - law.effort(q - h, v, qd, vd, ad, integral)
        dv = law.effort(q, v + h, qd, vd, ad, integral) - law.effort(q, v - h, qd, vd, ad, integral)
        np.testing.assert_allclose(by_position[:, :, j], dq / 2e-6, rtol=1e-6, atol=1e-5)
        np.testing.assert_allclose(by_velocity[:, :, j], dv / 2e-6, rtol=1e-6, atol=1e-5)


def test_the_formulas() -> None:
    q, v, qd, vd, integral = np.random.default_rng(2).normal(size=(5, 3, 2))
    p, pd, pid = (law.effort(q, v, qd, vd, None, integral) for law in laws()[:3])
    np.testing.assert_allclose(p, KD * (KP * (qd - q) - v))
    np.testing.assert_allclose(pd, KP * (qd - q) + KD * (vd - v))
    np.testing.assert_allclose(pid, KP * (qd - q) - KD * v + KI * integral)
    limited = laws()[4].effort(q, v, qd, vd)
    np.testing.assert_allclose(limited[:, 0], np.clip(pd[:, 0], -5.0, 5.0))


def test_computed_torque_of_the_reference_is_inverse_dynamics() -> None:
    law = laws()[3]
    assert isinstance(law, ComputedTorque)
    q, v, a = np.random.default_rng(3).normal(size=(3, 4, 2))
    np.testing.assert_allclose(law.effort(q, v, q, v, a), law.model.inverse_dynamics(q, v, a))


def test_bad_gains_and_samples_are_told() -> None:
    refuses(DataError, r"kp is .* give positive numbers", PD, [0.0, 1.0], [1.0, 1.0])
    refuses(DataError, "lengths differ", PD, [1.0, 1.0], [1.0])
    with pytest.raises(DataError, match="integral is missing"):
        PID(KP, KI, KD).effort(*np.zeros((4, 3, 2)))
    with pytest.raises(DataError, match=r"velocity: shape \(2, 2\), expected \(3, 2\)"):
        PD(KP, KD).effort(np.zeros((3, 2)), np.zeros((2, 2)), np.zeros((3, 2)), np.zeros((3, 2)))
    with pytest.raises(DataError, match="gains of 3 joints, the model"):
        ComputedTorque(laws()[3].model, np.ones(3), np.ones(3))
    assert repr(sdpid.controllers.PD(KP, KD)) == "PD(2 joints, kp 20 to 30, kd 2 to 3)"
