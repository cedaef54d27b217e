"""What stays open, and why: by trial of other motions."""

from dataclasses import dataclass

import numpy as np
import pytest

from sdpid._common.arrays import Array
from sdpid.excitation.expected.open_directions import Asked, OpenDirection, open_directions
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import structural_base
from tests.helpers.robots import small_arm

ARM = small_arm(3)
FRICTION = FrictionModel.from_terms(("coulomb", "viscous"), ARM.joint_names)
BASE = structural_base(ARM, FRICTION)
TIME = np.arange(0.0, 20.0, 0.05)[:, None]
OMEGA = np.array([0.9, 1.3, 2.1])


@dataclass(frozen=True)
class Limits:
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array


def states(size: Array) -> tuple[Array, Array, Array]:
    angle = TIME * OMEGA
    return size * np.sin(angle), size * OMEGA * np.cos(angle), -size * OMEGA**2 * np.sin(angle)


def found(
    size: Array, *, density: float = 0.01, believed: float = 1.0, limits: Limits | None = None
) -> tuple[OpenDirection, ...]:
    motion = states(size)
    W = ARM.regressor(*motion)
    W = np.concatenate([W, FRICTION.columns(motion[1], motion[2])], axis=2)[:, :, BASE.kept]
    information = np.einsum("kjb,kjc->bc", W, W) / density
    return open_directions(
        Asked(
            robot=ARM,
            friction=FRICTION,
            base=BASE,
            motion=motion,
            density=np.full(3, density),
            information=information,
            believed=believed * np.eye(BASE.count),
            limits=limits,
        )
    )


def test_a_rich_motion_leaves_nothing_open() -> None:
    assert found(np.array([1.5, 1.5, 1.5]), density=1e-6) == ()


def test_a_joint_that_hardly_moves_is_named() -> None:
    size = np.array([1.5, 1.5, 1e-3])
    directions = found(size)
    assert directions
    assert all(0.7 < each.told <= 1.0 for each in directions)
    assert any("Fv3" in each.parameters for each in directions)
    own = next(each for each in directions if each.parameters[0] == "Fv3")
    assert own.cause == "range"
    assert own.joint == ARM.joint_names[2]


@pytest.mark.parametrize(("width", "says"), [(2e-3, "are reached"), (3.0, "stand in the way")])
def test_limits_are_named_where_they_are_reached(width: float, says: str) -> None:
    limits = Limits(np.full(3, -width / 2.0), np.full(3, width / 2.0), np.ones(3), np.ones(3))
    directions = found(np.array([1.5, 1.5, 1e-3]), limits=limits)
    own = [each for each in directions if each.joint == ARM.joint_names[2]]
    assert any(says in each.words for each in own)


def test_without_beliefs_weak_directions_are_open() -> None:
    directions = found(np.array([1.5, 1.5, 1e-5]), believed=0.0)
    assert directions
    assert all("nothing was known before" in each.words for each in directions)
