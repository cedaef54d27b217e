"""Gains are found from currents, or it is said why not."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.drive_gains.identify import identify_drive_gains
from sdpid.assurance.drive_gains.result import IdentifiedGains
from sdpid.errors import DataError, IdentifiabilityError, ModelError
from sdpid.robot.inertia import margin
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel

GAINS = np.array([13.0, 12.0, 10.0, 5.0, 6.0, 4.0])
MASS, COM = 2.5, np.array([0.03, -0.05, 0.12])
NOISE = 0.01  # A


@cache
def arm() -> RobotModel:
    return load_robot("ur5_robot")


def motion(seed: int, *, speed: float = 1.0) -> tuple[Array, Array, Array, Array]:
    """Return time, positions, velocities and accelerations of a smooth motion."""
    rng = np.random.default_rng(seed)
    t = np.arange(2000) / 100.0
    w, c = speed * rng.uniform(0.5, 3.0, (4, 6)), rng.uniform(0.0, 6.0, (4, 6))
    angle = w * t[:, None, None] + c
    size = 0.5
    return (
        t,
        size * np.sin(angle).sum(axis=1),
        size * (w * np.cos(angle)).sum(axis=1),
        -size * (w**2 * np.sin(angle)).sum(axis=1),
    )


def currents(
    seed: int,
    *,
    mass: float = 0.0,
    gains: Array = GAINS,
    links: float = 1.0,
    noise: float = NOISE,
    speed: float = 1.0,
    **others: Any,
) -> sdpid.Recording:
    """Return a log of currents, by Pinocchio's Newton-Euler recursion and a body on the flange."""
    robot = arm()
    model = robot.pin_model.copy()
    for k in range(1, 7):
        body = model.inertias[k]
        model.inertias[k] = pin.Inertia(links * body.mass, body.lever, links * body.inertia)
    if mass:
        body = pin.Inertia(mass, COM, 0.004 * mass * np.diag([1.0, 1.2, 0.8]))
        frame = next(f for f in model.frames if f.name == "ee_link")
        model.inertias[6] += frame.placement.act(body)
    t, q, v, a = motion(seed, speed=speed)
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *each) for each in zip(q, v, a, strict=True)])
    rng = np.random.default_rng(seed + 100)
    current = tau / gains + 0.05 * np.tanh(v / 0.01) + 0.02 * v + 0.03
    return sdpid.Recording(
        time=t,
        position=q,
        effort=current + noise * rng.standard_normal(q.shape),
        joint_names=robot.joint_names,
        **{"currents": True, **others},
    )


def identified(*logs: Any, **options: Any) -> IdentifiedGains:
    given: dict[str, Any] = {"load": MASS, "effects": "none", "frame": "ee_link", "starts": 1}
    return identify_drive_gains(arm(), *logs, **{**given, **options})


@cache
def plain() -> IdentifiedGains:
    return identified(currents(0), currents(1, mass=MASS))


def test_a_load_of_known_mass_shows_all_gains() -> None:
    found = plain()
    shift = np.log(found.gains.gains / GAINS)
    error = found.gains.standard_errors / found.gains.gains
    assert np.all(np.abs(shift) < 0.02)
    assert np.all(np.abs(shift) < 4.0 * error)
    assert found.starts == found.agreed == 2
    assert found.status == "optimal"
    np.testing.assert_allclose(found.loads[0].com, COM, atol=0.005)
    assert margin(found.loads[0].theta, "pseudo_inertia") > -1e-9
    # What is left is the noise, filtered.
    assert np.all(found.rmse < NOISE)


def test_more_known_of_the_load_narrows_the_intervals() -> None:
    load = sdpid.Load(mass=MASS, com=COM, inertia=0.004 * MASS * np.diag([1.0, 1.2, 0.8]))
    found = identified(currents(0), currents(1, mass=MASS), load=load)
    assert np.all(np.abs(np.log(found.gains.gains / GAINS)) < 0.02)
    assert np.all(found.gains.standard_errors < 1.02 * plain().gains.standard_errors)


def test_all_gains_follow_the_mass() -> None:
    double = identified(currents(0), currents(1, mass=MASS), load=2.0 * MASS, consistent=False)
    np.testing.assert_allclose(double.gains.gains, 2.0 * plain().unconstrained, rtol=1e-5)
    unsure = identified(
        currents(0), currents(1, mass=MASS), load=sdpid.Load(mass=MASS, mass_error=0.05 * MASS)
    )
    more = unsure.gains.relative_covariance - plain().gains.relative_covariance
    np.testing.assert_allclose(more, np.full((6, 6), 0.05**2), rtol=1e-3)
    assert unsure.gains.common_factor > 0.05
    assert any("5 %: so are all gains" in note for note in unsure.notes)


def test_one_known_gain_gives_the_scale() -> None:
    found = identified(currents(0), load=None, known={"shoulder_lift_joint": 12.0})
    assert found.gains.gains[1] == pytest.approx(12.0)
    assert found.gains.standard_errors[1] == 0.0
    error = np.log(found.gains.gains / GAINS) / (found.gains.standard_errors / GAINS + 1e-9)
    assert np.all(np.abs(error) < 4.0)


def test_the_description_gives_the_scale_with_its_error() -> None:
    found = identified(currents(0), load=None, description_error=0.1)
    shift = np.log(found.gains.gains / GAINS)
    error = found.gains.standard_errors / found.gains.gains
    assert np.all(np.abs(shift[1:]) < 0.05)
    assert np.all(error[1:] > 0.02)
    assert np.all(np.abs(shift) < 3.0 * error)
    wide = identified(currents(0), load=None, description_error=0.2)
    assert np.all(wide.gains.standard_errors > found.gains.standard_errors)


def test_mountings_of_one_load_may_differ() -> None:
    logs = [currents(1, mass=MASS), currents(2, mass=MASS)]
    found = identified(currents(0), logs)
    assert len(found.loads) == 2
    assert np.all(found.gains.standard_errors < plain().gains.standard_errors)


@pytest.mark.parametrize(
    ("logs", "options", "error", "said"),
    [
        ((0,), {"load": None}, IdentifiabilityError, "only their ratios are shown"),
        ((0, 1), {"load": None}, DataError, "say the mass"),
        ((0,), {}, DataError, "no recording with load"),
        ((0, 1), {"load": [1.0, 2.0]}, DataError, "2 for 1 recordings"),
        ((0, 1), {"known": {"elbow": 1.0}}, DataError, "no joint 'elbow'"),
        ((0, 1), {"frame": "hand"}, ModelError, "no frame 'hand'"),
        ((0, 1), {"shared": ("rotors",)}, DataError, "no friction term"),
        ((0, 1), {"load": 60.0}, DataError, "heavier than the arm can tell"),
    ],
)
def test_what_makes_no_sense_is_told(
    logs: tuple[int, ...], options: dict[str, Any], error: type[Exception], said: str
) -> None:
    given = [currents(k, mass=MASS * k) for k in logs]
    with pytest.raises(error, match=said):
        identified(*given, **options)


def test_torques_are_no_currents() -> None:
    one = np.ones(6)
    with pytest.raises(DataError, match="efforts are torques in N·m"):
        identified(currents(0, currents=False), currents(1, mass=MASS))
    with pytest.raises(DataError, match="torques, not currents: the described links need"):
        identified(currents(0, gains=one), currents(1, gains=one, mass=MASS))
    taken = identified(
        currents(0, gains=one), currents(1, gains=one, mass=MASS), accept="effort_scale"
    )
    assert any("all gains are near 1 N·m/A" in note for note in taken.notes)
    assert not any("near 1" in note for note in plain().notes)


def test_a_recording_that_is_given_twice_is_told() -> None:
    log = currents(0)
    with pytest.raises(DataError, match="recording 1 without load and recording 1 with load"):
        identified(log, log)


def test_a_load_that_was_not_mounted_is_told() -> None:
    with pytest.raises(IdentifiabilityError, match=r"are open.*check that it was mounted"):
        identified(currents(0), currents(1))


def test_a_load_that_is_too_light_is_told() -> None:
    with pytest.raises(IdentifiabilityError, match="do not show the gains of all joints"):
        identified(currents(0, noise=0.2), currents(1, mass=0.02, noise=0.2), load=0.02)


def test_two_arms_are_told() -> None:
    with pytest.raises(DataError, match="not of one arm"):
        identified(currents(0), currents(1, mass=MASS, gains=GAINS[[0, 3, 2, 1, 4, 5]]))


TURNTABLE = """<robot name="turntable"><link name="base"/><link name="plate"><inertial>
<origin xyz="0.1 0 0"/><mass value="4"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0"
izz="0.2"/></inertial></link><joint name="turn" type="continuous"><parent link="base"/>
<child link="plate"/><axis xyz="0 0 1"/><limit effort="50" velocity="9"/></joint></robot>"""


def test_a_vertical_axis_shows_its_gain_only_by_a_known_inertia() -> None:
    """Gravity does not load it: of a load that is known by mass alone nothing is seen."""
    robot, logs = load_robot(TURNTABLE), []
    for inertia, seed in ((0.24, 0), (0.24 + 0.5, 1)):
        t, q, v, a = (each if each.ndim == 1 else each[:, :1] for each in motion(seed))
        current = inertia * a / 2.0 + 0.1 * np.tanh(v / 0.01) + 0.02 * v
        noise = NOISE * np.random.default_rng(seed).standard_normal(q.shape)
        logs.append(sdpid.Recording(time=t, position=q, effort=current + noise, currents=True))
    options: dict[str, Any] = {"effects": "none", "starts": 2, "accept": "effort_scale"}
    with pytest.raises(IdentifiabilityError, match="those of turn are open: what they move"):
        identify_drive_gains(robot, *logs, load=2.0, **options)
    whole = sdpid.Load(mass=2.0, com=[0.4, 0.0, 0.0], inertia=np.diag([0.1, 0.1, 0.18]))
    found = identify_drive_gains(robot, *logs, load=whole, **options)
    assert found.gains.gains[0] == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"mass": 0.0}, "give kg"),
        ({"mass": 1.0, "mass_error": 2.0}, "weigh the load"),
        ({"mass": 1.0, "com": [0.0, 1.0]}, "shape"),
        ({"mass": 1.0, "inertia": np.eye(3)}, "needs com"),
        ({"mass": 1.0, "com": np.zeros(3), "inertia": np.diag([1.0, 1.0, 3.0])}, "no body"),
    ],
)
def test_loads_that_cannot_be_are_told(given: dict[str, Any], said: str) -> None:
    with pytest.raises(DataError, match=said):
        sdpid.Load(**given)
