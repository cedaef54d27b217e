"""Payloads are found from recordings with and without them, and intervals hold the truth."""

import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm

from sdpid import DriveGains, Prior, Recording, RobotModel, Samples, load_robot, solve_wls
from sdpid._common.arrays import Array
from sdpid.assurance.payload.identify import identify_payload
from sdpid.assurance.payload.payload import DescribedLinks, Payload, least_second_moment, quantities
from sdpid.assurance.payload.virtual_link import payload_intervals, payload_problem
from sdpid.errors import DataError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.posterior import FitErrors
from sdpid.estimation.problem import Problem, build_problem
from sdpid.robot.inertia import margin, point_masses, transform
from tests.helpers.data import FRICTION, make_samples, random_theta
from tests.helpers.motions import sines
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, planar_arm
from tests.helpers.small_robots import LOAD, MASS, SMALL

NOISE = 0.05  # N·m
TERMS = (*FRICTION, "offset")


@pytest.fixture(scope="module")
def arm() -> RobotModel:
    return load_robot("ur5_robot")


def load(points: int = 8) -> Array:
    """Return a payload of some 1.6 kg in the last joint's frame."""
    rng = np.random.default_rng(11)
    centers = rng.uniform(-0.08, 0.08, (points, 3)) + np.array([0.02, -0.01, 0.1])
    return point_masses(rng.uniform(0.1, 0.3, points), centers)


def with_payload(robot: RobotModel, theta: Array, payload: Array) -> Array:
    """Return parameters of an arm whose last link carries a payload."""
    out = theta.copy()
    out[10 * robot.n_links - 10 : 10 * robot.n_links] += payload
    return out


def pair(
    robot: RobotModel, payload: Array, *, seed: int = 0, count: int = 300
) -> tuple[Samples, Samples, Array]:
    """Return samples with and without a payload, and the arm's own parameters."""
    rng = np.random.default_rng(seed)
    theta = random_theta(robot, rng)
    given = {"count": count, "noise": NOISE, "block": 5}
    full = with_payload(robot, theta, payload)
    loaded, bare = (make_samples(robot, each, rng, **given) for each in (full, theta))
    return loaded, bare, theta


def holds(found: Payload, payload: Array) -> np.ndarray:
    truth = quantities(payload)
    return (found.lower <= truth) & (truth <= found.upper)


def posed(robot: RobotModel, loaded: Samples, bare: Samples) -> tuple[Problem, FitErrors]:
    """Return the problem of a payload at the last joint, and the errors of its fit."""
    problems = [build_problem(robot, samples) for samples in (loaded, bare)]
    columns, none = problems[0].base.matrix[:, 50:60], np.zeros(0, dtype=np.intp)
    return payload_problem(*problems, columns, none, None, mass_max=100.0, extent=1.0)[:2]


def test_a_known_payload_by_another_dynamics_algorithm(arm: RobotModel) -> None:
    import pinocchio as pin

    loaded, bare, theta = pair(arm, load())
    model = arm.with_inertias(theta)
    body = pin.Inertia.FromDynamicParameters(load())
    model.appendBodyToJoint(6, body, pin.SE3.Identity())
    data = model.createData()
    states = zip(loaded.position, loaded.velocity, loaded.acceleration, strict=True)
    effort = np.array([pin.rnea(model, data, q, v, a) for q, v, a in states])
    n = arm.n
    effort += np.sign(loaded.velocity) * theta[-2 * n : -n] + loaded.velocity * theta[-n:]
    effort += NOISE * np.random.default_rng(5).standard_normal(effort.shape)
    effort += np.arange(n)  # this day's zero errors of the sensors
    found = identify_payload(arm, replace(loaded, effort=effort), bare, friction=TERMS)
    assert holds(found, load()).all()
    assert found.shown
    assert found.mass == pytest.approx(load()[0], abs=0.01)
    assert found.com == pytest.approx(load()[1:4] / load()[0], abs=2e-3)
    assert np.all(found.upper - found.lower < [0.02, *[4e-3] * 3, *[6e-3] * 6])
    assert margin(found.theta, "pseudo_inertia") >= -1e-15
    assert found.cost < found.cost_without
    assert found.invisible == 0
    assert found.notes == ()


def test_friction_that_changed_between_the_recordings_does_no_harm(arm: RobotModel) -> None:
    loaded, bare, theta = pair(arm, load())
    changed, rng = theta.copy(), np.random.default_rng(6)
    changed[-2 * arm.n :] *= np.resize([1.3, 0.7, 1.2], 2 * arm.n)
    full = with_payload(arm, changed, load())
    loaded = make_samples(arm, full, rng, count=300, noise=NOISE, block=5)
    found = identify_payload(arm, loaded, bare, friction=TERMS)
    assert holds(found, load()).all()
    common = identify_payload(arm, loaded, bare, friction=TERMS, separate=("offset",))
    assert not holds(common, load())[:4].all()
    assert common.cost > 2.0 * found.cost


def test_a_point_is_found_at_the_edge_of_what_can_be(arm: RobotModel) -> None:
    point = load(points=1)
    loaded, bare, _ = pair(arm, point)
    found = identify_payload(arm, loaded, bare)
    assert found.mass == pytest.approx(point[0], abs=0.02)
    assert found.margin < 1e-4
    assert holds(found, point)[:4].all()
    # No smaller than matter of this mass can be, and the best fit of those: a ball of osmium.
    assert found.margin == pytest.approx(least_second_moment(found.mass), rel=1e-3)
    mass = 22_590.0 * 4.0 / 3.0 * np.pi * 0.03**3
    assert least_second_moment(mass) == pytest.approx(mass * 0.03**2 / 5.0)
    assert any("no measurement" in note for note in found.notes)


def test_the_arm_is_eliminated_exactly(arm: RobotModel) -> None:
    loaded, bare, _ = pair(arm, load())
    options = {"friction": FRICTION, "weighting": "gls"}
    found = identify_payload(arm, loaded, bare, separate=(), **options)  # type: ignore[arg-type]
    problem = build_problem(arm, bare, **options)  # type: ignore[arg-type]
    W = np.vstack([b for s in (bare, loaded) for _, b, _, _ in
                   replace(problem.rows, samples=s).chunks()])  # fmt: skip
    Y = arm.regressor(loaded.position, loaded.velocity, loaded.acceleration)[:, :, 50:]
    extra = np.concatenate([np.zeros((len(bare.effort), 6, 10)), Y])
    W, extra = W.reshape(-1, W.shape[2]), extra.reshape(-1, 10)
    effort = np.concatenate([bare.effort, loaded.effort]).ravel()

    def cost(theta: Array) -> float:
        left = effort - extra @ theta
        return float(np.sum((left - W @ np.linalg.lstsq(W, left, rcond=None)[0]) ** 2))

    assert found.cost == pytest.approx(cost(found.theta), rel=1e-9)
    assert found.cost_without == pytest.approx(cost(np.zeros(10)), rel=1e-9)
    best = np.linalg.lstsq(np.hstack([W, extra]), effort, rcond=None)[0][-10:]
    if margin(best, "pseudo_inertia") > 0.0:  # then no constraint is active
        assert found.theta == pytest.approx(best, abs=1e-6)


def test_intervals_hold_the_truth_as_often_as_they_say(arm: RobotModel) -> None:
    """Errors last for several samples, as those of filtered signals do."""
    rng = np.random.default_rng(1)
    theta = random_theta(arm, rng)
    rates, both = 2.0 * np.pi * np.array([[0.1], [0.2], [0.3], [0.5]]), []
    for values in (with_payload(arm, theta, load()), theta):
        size, phases = rng.uniform(-0.7, 0.7, (4, arm.n)), rng.uniform(0.0, 6.0, (4, arm.n))
        q, v, a = sines(0.05 * np.arange(300), rates, phases, size)
        effort = arm.inverse_dynamics(values, q, v, a)
        both.append(Samples(position=q, velocity=v, acceleration=a, effort=effort, block=12))
    inside = []
    for _ in range(30):
        noise = lfilter([1.0], [1.0, -0.8], 0.2 * rng.standard_normal((2, 300, arm.n)), axis=1)
        noisy = [replace(s, effort=s.effort + own) for s, own in zip(both, noise, strict=True)]
        found = identify_payload(arm, *noisy, friction=("viscous",), level=0.8)
        inside.append(holds(found, load())[:4])
    assert 0.7 <= np.mean(inside) <= 0.95


def test_an_estimate_is_as_good_as_its_recording(arm: RobotModel) -> None:
    loaded, bare, _ = pair(arm, load())
    problem = build_problem(arm, bare, friction=FRICTION, weighting="residual")
    direct = identify_payload(arm, loaded, bare, friction=FRICTION)
    through = identify_payload("ur5_robot", loaded, solve_wls(problem))  # loaded anew, but alike
    assert through.theta == pytest.approx(direct.theta, abs=1e-7)
    assert through.lower == pytest.approx(direct.lower, abs=1e-4)
    believed = build_problem(
        arm, bare, friction=FRICTION, weighting="residual", prior=Prior(strength=0.01)
    )
    estimate = Estimate.of_theta(believed, np.zeros(believed.n_theta), method="any", status="")
    near = identify_payload(arm, loaded, estimate)
    assert near.theta == pytest.approx(direct.theta, abs=0.02)


def test_several_recordings_count_together_and_silent_joints_not_at_all() -> None:
    small = SMALL["without_effort"]
    loaded, bare = small.log(3, load=LOAD), small.log()
    fields = ("time", "position", "effort")
    halves = [
        replace(bare, **{name: getattr(bare, name)[part] for name in fields})
        for part in (slice(0, 500), slice(500, None))
    ]
    found = identify_payload(small.model, [loaded], halves)
    assert [each.kind for each in found.findings].count("effort_silent") == 3
    named = identify_payload(small.model, loaded, halves, without_effort=small.without_effort)
    assert found.theta == pytest.approx(named.theta, abs=1e-9)
    assert found.lower[0] <= MASS <= found.upper[0]
    # Half of what is known of the arm is less.
    half = identify_payload(small.model, loaded, halves[0])
    assert found.upper[0] - found.lower[0] < half.upper[0] - half.lower[0]


def test_a_known_arm(arm: RobotModel) -> None:
    loaded, _, theta = pair(arm, load())
    known = replace(arm, prior=theta[:60].reshape(6, 10))
    found = identify_payload(known, loaded, friction=TERMS)
    assert holds(found, load()).all()
    assert found.described == DescribedLinks(
        tolerance=pytest.approx(0.1, rel=1e-2), contradicted=False
    )
    assert "95 % intervals if the described links are right to 10 %" in found.describe()
    assert "--without" in found.notes[0]
    assert found.to_dict()["described"]["contradicted"] is False
    links = known.prior * np.array([[3.0], [0.3], [3.0], [0.3], [1.0], [1.0]])
    wrong = identify_payload(replace(arm, prior=links), loaded, friction=TERMS)
    assert wrong.described == DescribedLinks(tolerance=0.3, contradicted=True)
    assert "contradicts" in wrong.notes[0]
    believed = identify_payload(known, loaded, friction=TERMS, prior=Prior(strength=1e4))
    assert holds(believed, load()).all()
    assert believed.described is None
    # What is known better leaves less room.
    assert np.all((believed.upper - believed.lower)[:4] < (found.upper - found.lower)[:4])


@pytest.mark.parametrize("off", [0.1, 0.2])
def test_intervals_allow_for_a_description_that_is_off(arm: RobotModel, off: float) -> None:
    """The scatter of the recording alone is far too small; the scatter of links is not."""
    inside = []
    for seed in range(8):
        loaded, _, theta = pair(arm, load(), seed=seed)
        links = theta[:60].reshape(6, 10)
        scale = np.exp(off * np.random.default_rng(seed).standard_normal((6, 1)))
        described = replace(arm, prior=links / scale)
        found = identify_payload(described, loaded, friction=TERMS)
        inside.append(holds(found, load())[0])
    assert sum(inside) >= 7


def test_ends_of_the_center_of_mass_are_fiellers(arm: RobotModel) -> None:
    """A ratio of two normal quantities, where no constraint is active: its interval is known."""
    body = load() + np.array([0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.1, 0.0, 0.0, 0.1])
    sigma = np.array([0.1, *(1e-3,) * 3, *(1e-4,) * 6])
    problem, _ = posed(arm, *pair(arm, load())[:2])
    problem = replace(
        problem,
        base=replace(problem.base, matrix=np.eye(10)),
        A=np.diag(1.0 / sigma),
        rhs=body / sigma,
    )
    errors = FitErrors(np.diag(sigma), np.eye(10), lambda moved: np.full(len(moved), np.inf))
    found = payload_intervals(problem, body, errors, 0.95)
    squares = body**2 - norm.ppf(0.975) ** 2 * sigma**2
    for k in (1, 2, 3):
        # (h − c·m)² = r²·(var(h) + c²·var(m)), a quadratic equation in c.
        ends = np.roots([squares[0], -2.0 * body[0] * body[k], squares[k]])
        # Iterations end at changes of 1e-5.
        assert found[k] == pytest.approx(sorted(ends), rel=1e-5)


def test_nothing_and_less_than_nothing_are_nothing(arm: RobotModel) -> None:
    found = identify_payload(arm, *pair(arm, np.zeros(10))[:2])
    assert found.upper[0] < 0.05
    assert "without any payload" in found.describe()
    less = identify_payload(arm, *pair(arm, load())[1::-1])  # the other way round
    assert less.mass < 1e-3
    for each in (found, less):
        assert not each.shown
        assert each.lower[0] == 0.0
        json.dumps(each.to_dict(), allow_nan=False)
        assert "nan" not in each.describe()


def test_the_frame_of_the_flange(arm: RobotModel) -> None:
    loaded, bare, _ = pair(arm, load())
    at_joint = identify_payload(arm, loaded, bare)
    found = identify_payload(arm, loaded, bare, frame="ee_link", link="wrist_3_link")
    frame = next(f for f in arm.pin_model.frames if f.name == "ee_link")
    back = transform(found.theta, frame.placement.rotation, frame.placement.translation)
    assert back == pytest.approx(at_joint.theta, abs=1e-6)
    assert found.frame == "ee_link"
    plain = found.to_dict()
    assert plain["mass"] == found.mass
    assert plain["intervals"]["com_x"] == [found.lower[1], found.upper[1]]
    assert "wrist_3_link, in the frame ee_link" in found.describe()


def test_directions_that_nothing_shows_are_bounded_by_matter() -> None:
    robot = planar_arm()
    loaded, bare, _ = pair(robot, load(), seed=3, count=200)
    found = identify_payload(robot, loaded, bare)
    # Mass, two first moments, and the moment about the joints' direction.
    assert found.invisible == 6
    assert "6 of ten directions are invisible" in found.describe()
    assert holds(found, load()).all()
    assert found.upper[3] - found.lower[3] > 0.5
    assert np.all(np.isfinite(found.lower))
    assert np.all(np.isfinite(found.upper))


def gen3(folder: Path, run: int, effort: str = "tau") -> Recording:
    z = np.load(folder / "kinova_gen3_dynamapp" / f"opti_traj_testing{run}.npz")
    state = {"time": z["t"], "position": z["q"], "velocity": z["dq"], "effort": z[effort]}
    return Recording(**state, joint_names=z["joint_names"].tolist())


def test_the_load_of_the_gen3(data_folder: Path) -> None:
    robot = load_robot(data_folder / "kinova_gen3_dynamapp" / "gen3.urdf")

    def found(robot: RobotModel, run: int, effort: str) -> Payload:
        return identify_payload(robot, gen3(data_folder, run, effort), frame="end_effector_link")

    for effort in ("tau", "tau_current"):
        payload = found(robot, 1, effort)
        assert payload.shown
        assert 1.1 < payload.mass < 1.45
        # Behind the flange, within the wrist: it is rather the description's masses that are off,
        # as the recording says.
        assert payload.com[2] < -0.05
        assert payload.described.contradicted
    # Published masses of the arm, which in this description stand one link too far up.
    published = np.array([1.3773, 1.1636, 1.1636, 0.9302, 0.6781, 0.6781, 0.5])
    corrected = replace(robot, prior=robot.prior / robot.prior[:, :1] * published[:, None])
    ends = []
    for run, effort in product((1, 2), ("tau", "tau_current")):
        payload = found(corrected, run, effort)
        assert 0.5 < payload.mass < 0.8
        ends.append((payload.lower[0], payload.upper[0]))
    # All four agree.
    assert max(low for low, _ in ends) < min(high for _, high in ends)


def test_refusals(arm: RobotModel) -> None:
    loaded, bare, _ = pair(arm, load(), count=100)

    def refused(match: str, kind: type[Exception] = DataError, **options: object) -> None:
        refuses(kind, match, identify_payload, arm, loaded, bare, **options)

    refused("level is 1.5", level=1.5)
    refused("extent is -1", extent=-1.0)
    refused("no link 'hand'", ModelError, link="hand")
    refused("no frame 'hand' is fixed to link 'wrist_3_link'", ModelError, frame="hand")
    refused("'glue', which is no friction term.*load, tilt", separate=("glue",))
    refused("no likelihood", weighting="eq18")
    unsure, massless = Prior(strength="evidence"), replace(arm, prior=np.zeros((6, 10)))
    refuses(DataError, "give a strength", identify_payload, arm, loaded, prior=unsure)
    refuses(ModelError, "3 last links", identify_payload, load_robot(TREE), loaded, bare)
    refuses(ModelError, "gives links no mass", identify_payload, massless, loaded)
    refuses(DataError, "give a Recording", identify_payload, arm, 3.0)
    entropic = build_problem(arm, bare, weighting="residual", prior=Prior(kind="entropic"))
    estimate = Estimate.of_theta(entropic, np.zeros(entropic.n_theta), method="any", status="")
    refuses(DataError, "log-det prior", identify_payload, arm, loaded, estimate)
    words = r"estimate\.problem\.robot"
    refuses(DataError, words, identify_payload, "denso_vp6242", loaded, estimate)


def gains_of(robot: RobotModel, relative: Array) -> DriveGains:
    """Return gains with relative covariances."""
    given = {"joint_names": robot.joint_names, "gains": np.full(6, 10.0)}
    return DriveGains(**given, covariance=100.0 * relative, basis="a common factor")


def test_gains_move_the_payload_as_told(arm: RobotModel) -> None:
    """The rows move with the gains of both recordings at once; a common factor scales the mass."""
    loaded, bare, _ = pair(arm, load())
    gains = gains_of(arm, 0.01 * (np.eye(6) + 0.5))

    def turned(off: Array) -> tuple[Array, Array]:
        """Return the right side of the normal equations, and its slopes: rows may be turned."""
        samples = (replace(s, effort=s.effort * (1.0 + off), gains=gains) for s in (loaded, bare))
        problem, _ = posed(arm, *samples)
        (errors,) = problem.errors
        normal = problem.squared.matrix.T
        return normal @ problem.rhs, normal @ problem.A @ errors.moves

    here, slopes = turned(np.zeros(6))
    size = np.abs(here).max()
    for j in (0, 3):
        moved = (turned(1e-3 * np.eye(6)[j])[0] - here) / 1e-3
        np.testing.assert_allclose(slopes[:, j] / size, moved / size, atol=1e-6)
    np.testing.assert_allclose(slopes.sum(axis=1) / size, here / size, atol=1e-6)


def test_errors_of_gains_widen_intervals_and_are_told(arm: RobotModel) -> None:
    loaded, bare, _ = pair(arm, load())
    relative = 0.03
    gains = gains_of(arm, np.full((6, 6), relative**2))
    given = [replace(each, gains=gains) for each in (loaded, bare)]
    found = identify_payload(arm, *given)
    plain_found = identify_payload(arm, loaded, bare)
    assert plain_found.gains_share is None
    # A common factor of the efforts is one of the mass, and no shift of its center.
    half = 0.5 * (found.upper - found.lower)[0]
    own = 0.5 * (plain_found.upper - plain_found.lower)[0]
    assert half == pytest.approx(np.hypot(1.96 * relative * found.mass, own), rel=0.03)
    assert found.gains_share[0] > 0.9
    np.testing.assert_allclose(found.gains_share[1:4], 0.0, atol=1e-3)
    assert "from gains, %" in found.describe()
    assert "by a common factor: standard errors of 3 %, 3 % of it in common" in str(found.notes)
    assert found.to_dict()["gains_share"]["mass"] == found.gains_share[0]
