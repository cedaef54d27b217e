"""Gains are found from currents, or it is said why not."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import approx_fprime, least_squares

import sdpid
from sdpid import Load, RobotModel, Samples, identify_drive_gains, load_robot
from sdpid._common.arrays import Array
from sdpid.assurance.drive_gains.checks import require_shown
from sdpid.assurance.drive_gains.errors import gain_errors, score_blocks
from sdpid.assurance.drive_gains.fit import GainFit
from sdpid.assurance.drive_gains.model import GainModel
from sdpid.assurance.drive_gains.result import IdentifiedGains
from sdpid.errors import DataError, IdentifiabilityError, ModelError
from sdpid.robot.inertia import margin
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.motions import sines
from tests.helpers.refusals import refuses

GAINS = np.array([13.0, 12.0, 10.0, 5.0, 6.0, 4.0])
MASS, COM = 2.5, np.array([0.03, -0.05, 0.12])
NOISE = 0.01  # A


@cache
def arm() -> RobotModel:
    return load_robot("ur5_robot")


def motion(seed: int) -> tuple[Array, Array, Array, Array]:
    """Return time, positions, velocities and accelerations of a smooth motion."""
    rng, t = np.random.default_rng(seed), np.arange(2000) / 100.0
    w, c = rng.uniform(0.5, 3.0, (4, 6)), rng.uniform(0.0, 6.0, (4, 6))
    return t, *sines(t, w, c, 0.5)


def currents(
    seed: int, *, mass: float = 0.0, gains: Array = GAINS, noise: float = NOISE, **others: Any
) -> sdpid.Recording:
    """Return a log of currents, by Pinocchio's Newton-Euler recursion and a body on the flange."""
    model = arm().pin_model.copy()
    if mass:
        body = pin.Inertia(mass, COM, 0.004 * mass * np.diag([1.0, 1.2, 0.8]))
        frame = next(f for f in model.frames if f.name == "ee_link")
        model.inertias[6] += frame.placement.act(body)
    t, q, v, a = motion(seed)
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *each) for each in zip(q, v, a, strict=True)])
    rng = np.random.default_rng(seed + 100)
    current = tau / gains + 0.05 * np.tanh(v / 0.01) + 0.02 * v + 0.03
    current += noise * rng.standard_normal(q.shape)
    options = {"joint_names": arm().joint_names, "currents": True, **others}
    return sdpid.Recording(time=t, position=q, effort=current, **options)


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


WHOLE: dict[str, Any] = {"com": COM, "inertia": 0.004 * MASS * np.diag([1.0, 1.2, 0.8])}


def test_more_known_of_the_load_narrows_the_intervals() -> None:
    found = identified(currents(0), currents(1, mass=MASS), load=Load(mass=MASS, **WHOLE))
    assert np.all(np.abs(np.log(found.gains.gains / GAINS)) < 0.02)
    assert np.all(found.gains.standard_errors < 1.02 * plain().gains.standard_errors)


@pytest.mark.parametrize("known", [{}, WHOLE])
def test_gains_follow_the_mass_and_its_error(known: dict[str, Any]) -> None:
    given = currents(0), currents(1, mass=MASS)

    def found(share: float, error: float = 0.0) -> IdentifiedGains:
        load = Load(mass=share * MASS, mass_error=error * MASS, **known)
        return identified(*given, load=load, consistent=False)

    less, more, sure, unsure = found(0.99), found(1.01), found(1.0), found(1.0, 0.05)
    follows = np.log(more.gains.gains / less.gains.gains) / np.log(1.01 / 0.99)
    # Of a load that is known by its mass alone all gains are in proportion to it.
    assert bool(known) or np.allclose(follows, 1.0, atol=1e-5)
    added = unsure.gains.relative_covariance - sure.gains.relative_covariance
    np.testing.assert_allclose(added, 0.05**2 * np.outer(follows, follows), rtol=2e-3)
    assert bool(known) or unsure.gains.common_factor > 0.05
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


HUNG, ONES = {"mass": MASS}, np.ones(6)


@pytest.mark.parametrize(
    ("logs", "options", "error", "said"),
    [
        ([{}], {"load": None}, IdentifiabilityError, "only their ratios are shown"),
        ([{}, HUNG], {"load": None}, DataError, "say the mass"),
        ([{}], {}, DataError, "no recording with load"),
        ([{}, HUNG], {"load": [1.0, 2.0]}, DataError, "2 for 1 recordings"),
        ([{}, HUNG], {"known": {"elbow": 1.0}}, DataError, "no joint 'elbow'"),
        ([{}, HUNG], {"frame": "hand"}, ModelError, "no frame 'hand'"),
        ([{}, HUNG], {"shared": ("rotors",)}, DataError, "no friction term"),
        ([{}, HUNG], {"load": 60.0}, DataError, "heavier than the arm can tell"),
        ([{}, {"seed": 0}], {}, DataError, "1 without load and recording 1 with load are the same"),
        # Recordings that show no gains.
        ([{"currents": False}, HUNG], {}, DataError, "efforts are torques in N·m"),
        ([{"gains": ONES}, {**HUNG, "gains": ONES}], {}, DataError, "not currents: the described"),
        ([{}, {**HUNG, "gains": GAINS[[0, 3, 2, 1, 4, 5]]}], {}, DataError, "not of one arm"),
        ([{}, {}], {}, IdentifiabilityError, "are open.*check that it was mounted"),
        ([{"noise": 9.0}, {**HUNG, "noise": 9.0}], {}, IdentifiabilityError, "not show the gains"),
    ],
)
def test_what_shows_no_gains_is_told(
    logs: list[dict[str, Any]], options: dict[str, Any], error: type[Exception], said: str
) -> None:
    given = [currents(**{"seed": seed, **log}) for seed, log in enumerate(logs)]
    refuses(error, said, identified, *given, **options)


def test_gains_near_one_are_told() -> None:
    given = currents(0, gains=ONES), currents(1, gains=ONES, mass=MASS)
    taken = identified(*given, accept="effort_scale")
    assert any("all gains are near 1 N·m/A" in note for note in taken.notes)
    assert not any("near 1" in note for note in plain().notes)


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
    said = "those of turn are open: what they move"
    refuses(IdentifiabilityError, said, identify_drive_gains, robot, *logs, load=2.0, **options)
    whole = Load(mass=2.0, com=[0.4, 0.0, 0.0], inertia=np.diag([0.1, 0.1, 0.18]))
    found = identify_drive_gains(robot, *logs, load=whole, **options)
    assert found.gains.gains[0] == pytest.approx(2.0, rel=0.01)


def test_loads_that_cannot_be_are_told() -> None:
    flat = {"com": np.zeros(3), "inertia": np.diag([1.0, 1.0, 3.0])}
    for mass, given, said in (
        (0.0, {}, "give kg"),
        (1.0, {"mass_error": 2.0}, "weigh the load"),
        (1.0, {"com": [0.0, 1.0]}, "shape"),
        (1.0, {"inertia": np.eye(3)}, "needs com"),
        (1.0, flat, "no body"),
    ):
        refuses(DataError, said, sdpid.Load, mass=mass, **given)


# ---- The search for gains against SciPy's, and its derivatives against differences.


TWO_GAINS, LOAD, FIT_NOISE = np.array([3.0, 2.0]), 1.5, 0.05
LOAD_COM = (0.3, 0.05, 0.1)


def samples(seed: int, *, loaded: bool) -> Samples:
    """Return states at random with the currents that they need."""
    robot, rng = load_robot(ARM_URDF), np.random.default_rng(seed)
    q, v, a = (rng.uniform(-2.0, 2.0, (400, 2)) for _ in range(3))
    bodies = robot.prior.copy()
    if loaded:
        bodies[1] += Load(mass=LOAD, com=LOAD_COM, inertia=0.01 * np.eye(3)).theta
    torque = robot.inverse_dynamics(bodies.ravel(), q, v, a)
    current = torque / TWO_GAINS + 0.2 * np.sign(v) + 0.1 * v
    current += FIT_NOISE * rng.standard_normal(q.shape)
    return Samples(position=q, velocity=v, acceleration=a, effort=current, block=10)


@cache
def fit(com: tuple[float, ...] | None = LOAD_COM) -> GainFit:
    robot = load_robot(ARM_URDF)
    model = GainModel(
        robot=robot,
        terms=("coulomb", "viscous"),
        alike=(),
        samples=(samples(0, loaded=False), samples(1, loaded=True)),
        loads=(Load(mass=LOAD, com=com),),
        placed=np.eye(20)[:, 10:],
        free=np.ones(2, dtype=bool),
        description_error=None,
    )
    return replace(GainFit.of(model, [robot.prior] * 2), errors=np.full(2, FIT_NOISE**2))


@pytest.mark.parametrize("start", [np.zeros(2), np.array([2.0, -1.0])])
def test_the_search_ends_where_one_by_differences_does(start: Array) -> None:
    found = fit().search(start)
    other = least_squares(lambda x: fit().at(x)[1], np.log(TWO_GAINS), x_scale=0.1, xtol=1e-14)
    assert found.settled
    np.testing.assert_allclose(found.logs, other.x, atol=1e-7)
    assert found.cost == pytest.approx(2.0 * other.cost, rel=1e-9)


def test_a_load_that_may_lie_along_the_axis_leaves_the_scale_open() -> None:
    """Moved along the last axis a mass is as if on the link before: the load's mass is not seen."""
    logs = np.log(TWO_GAINS)
    _, _, slopes = fit(None).at(logs)
    _, singular, Vt = np.linalg.svd(slopes)
    assert singular[1] < 1e-9 * singular[0]
    np.testing.assert_allclose(Vt[1] / Vt[1, 0], 1.0, rtol=1e-6)
    refuses(IdentifiabilityError, "only their ratios are shown", require_shown, fit(None), logs)
    require_shown(fit(), logs)


def test_slopes_are_differences_at_the_optimum() -> None:
    """The slope of half the cost: what the projection leaves out is of second order in it."""
    at = fit().search(np.log(TWO_GAINS)).logs + np.array([0.02, -0.03])
    _, residual, slopes = fit().at(at)
    by_differences = approx_fprime(at, lambda x: 0.5 * float(np.sum(fit().at(x)[1] ** 2)), 1e-6)
    np.testing.assert_allclose(slopes.T @ residual, by_differences, rtol=1e-4)


def test_blocks_add_up_to_the_optimum() -> None:
    """One step of Gauss and Newton in all unknowns from the optimum ends there."""
    found = fit().search(np.zeros(2))
    blocks, T = score_blocks(fit(), found)
    step = T @ blocks.root @ (blocks.root.T @ blocks.target.sum(axis=0))
    np.testing.assert_allclose(step[:2], 0.0, atol=1e-7)
    # White noise: the sandwich agrees with the variance that it makes.
    slopes = fit().at(found.logs)[2]
    white = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    np.testing.assert_allclose(np.sqrt(np.diag(gain_errors(fit(), found)[0])), white, rtol=0.25)


def test_bodies_that_can_exist_cost_no_less() -> None:
    found = fit().search(np.zeros(2))
    bound = fit().consistent(found)
    assert bound.settled
    assert bound.cost >= found.cost * (1.0 - 1e-9)
    # The truth can exist, so little is asked of the gains.
    moved = np.abs(bound.logs - found.logs)
    assert np.all(moved < np.sqrt(np.diag(gain_errors(fit(), found)[0])))


# ---- Two pairs of recordings of a UR10e show the same gains, and weigh each other's load.


def test_pairs_agree(data_folder: Path, tmp_path: Path) -> None:
    folder = data_folder / "ur10e_innopolis"
    robot = sdpid.load_robot(folder / "ur10e.urdf")
    how: dict[str, Any] = {"joint_names": robot.joint_names, "currents": True}
    names = {"position": 2, "velocity": 8, "effort": 14}
    columns = {"time": 1, **{name: [*range(k, k + 6)] for name, k in names.items()}}
    # Rubbish before, a broken line at the end.
    lines = (folder / "20_02_19_15harm50secLoad.csv").read_text().splitlines()
    loaded = tmp_path / "loaded.csv"
    loaded.write_text("\n".join(lines[10:-1]) + "\n")
    pairs = (
        (folder / "20_02_19_15harm50sec.csv", loaded),
        (folder / "20_01_31-unload.csv", folder / "20_01_31-load.csv"),
    )
    one, two = (
        sdpid.identify_drive_gains(
            robot,
            *(sdpid.read_recording(path, columns=columns, **how) for path in pair),
            load=2.805,
            effects=("rotor_inertia", "load"),
            starts=2,
        ).gains
        for pair in pairs
    )
    shift = np.log(one.gains / two.gains)
    assert np.all(np.abs(shift[1:]) < 0.03)
    assert one.intervals()[0, 1] > two.intervals()[0, 0]
    # All gains are in proportion to the mass of the load.
    for own, sign in ((one, -1.0), (two, 1.0)):
        weights = np.linalg.inv(own.relative_covariance).sum(axis=0)
        off = sign * float(weights @ shift) / float(weights.sum())
        assert abs(off) < 0.02
