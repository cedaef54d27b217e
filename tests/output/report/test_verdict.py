"""What is said of a model follows from what was put wrong."""

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.assurance.diagnostics.held_out import hold_out
from sdpid.assurance.diagnostics.residuals import joint_errors
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.constraints import Fixed, MirrorPair
from sdpid.output.report.grades import SMALL, Level, graded
from sdpid.output.report.judged import errors_of
from sdpid.output.report.prediction_verdict import prediction_findings
from sdpid.output.report.verdict import _one_way, _unlike, findings
from sdpid.robot.friction.model import FrictionModel
from sdpid.workflow.result import Identification
from tests.helpers.identified import ARM, RATE, arm_theta, identified, moved
from tests.helpers.robots import LIFT, small_arm

FIRST, LAST = ARM.joint_names
ONE = small_arm(1)


@pytest.fixture(scope="module")
def good() -> Identification:
    theta = arm_theta()
    return identified(moved(theta, 1), moved(theta, 2))


def said(result: Identification, *words: str) -> str:
    """Return the one statement that has these words."""
    found = [text for text in result.verdict if all(word in text for word in words)]
    assert len(found) == 1, (words, result.verdict)
    return found[0]


def unsaid(result: Identification, *words: str) -> None:
    for text in result.verdict:
        assert not all(word in text for word in words), text


def with_validation(result: Identification, samples: sdpid.Samples) -> Identification:
    held_out = hold_out(result.estimate, result.wls, samples)
    return replace(result, validation=held_out.fit, validation_samples=samples, held_out=held_out)


def grade(samples: sdpid.Samples, fit: Validation) -> Level:
    """Return the grade of the only joint, by one prediction alone."""
    (only,) = graded(samples, fit)
    return only.level


def trained_on(result: Identification, samples: sdpid.Samples) -> Identification:
    """Return the result as if these had been its training samples."""
    problem = result.problem
    return replace(result, problem=replace(problem, rows=replace(problem.rows, samples=samples)))


def test_a_good_model_is_trusted(good: Identification) -> None:
    text = said(good, "Trust it for the effort of every joint")
    assert "not used for the fit" in text
    said(good, "carries over")
    said(good, "proven in exact arithmetic")
    for words in ("The error goes", "weakly excited", "numerical limit", "Nothing was held out"):
        unsaid(good, words)
    assert {f.level for f in findings(good)} <= {"good", "caution"}


def test_a_limit_that_contradicts_the_data_is_told_as_such(good: Identification) -> None:
    problem = good.problem
    largest = max(good.estimate.named()[name] for name in ("Fs1", "Fv1"))
    limits = problem.constraints.replace(friction_max=largest / 2.0)
    estimate = sdpid.solve_sdp(problem.constrained(constraints=limits))
    held = replace(good, problem=estimate.problem, estimate=estimate)
    assert f"at most {largest / 2.0:g}" in said(held, "numerical limit contradicts the data")
    unsaid(held, "do not determine")


def test_nothing_held_out_is_said(good: Identification) -> None:
    alone = replace(good, validation=None, validation_samples=None, held_out=None)
    said(alone, "Nothing was held out")
    said(alone, "its own training data")


def test_a_noisy_joint_is_not_trusted(good: Identification) -> None:
    fresh = moved(arm_theta(), 2)
    effort = np.array(fresh.effort)
    rng = np.random.default_rng(0)
    effort[:, 1] += 2.0 * effort[:, 1].std() * rng.standard_normal(len(effort))
    result = with_validation(good, replace(fresh, effort=effort))
    assert LAST in said(result, "Do not trust")
    assert LAST not in said(result, "Trust it for")
    said(result, "does not carry over", "times as much")


def test_a_joint_worse_than_its_mean(good: Identification) -> None:
    fresh = moved(arm_theta(), 2)
    effort = np.array(fresh.effort)
    effort[:, 1] += 10.0 * effort[:, 1].std()
    result = with_validation(good, replace(fresh, effort=effort))
    said(result, f"{LAST} (worse than a constant)")


def biased(effort: float, error: float, *, moving: bool = True) -> tuple[sdpid.Samples, Validation]:
    """Return samples of a joint with a nearly constant effort, and a prediction that is off."""
    t = np.arange(400) / RATE
    v = np.sin(t)[:, None] if moving else np.full((400, 1), 0.01)
    efforts = effort + 0.01 * np.cos(3.0 * t)[:, None]
    samples = sdpid.Samples(position=v, velocity=v, acceleration=v, effort=efforts, time=t)
    return samples, Validation.of_prediction(("joint",), samples, efforts - error)


def test_worse_than_a_constant_is_never_trusted() -> None:
    samples, fit = biased(10.0, 0.2)
    assert fit.r2[0] < 0.0
    assert fit.nrmse[0] < SMALL
    assert grade(samples, fit) == "caution"
    (only,) = prediction_findings(ONE, samples, fit)
    assert only.level == "caution"
    assert "joint (worse than a constant, error 2 % of the effort)" in only.text
    assert "roughly right" not in only.text
    assert "Validate on a motion in which the effort varies" in only.text
    # An error that is large beside the effort as well is worse still.
    assert grade(*biased(10.0, 2.0)) == "bad"


@pytest.mark.parametrize(("speed", "moves"), [(0.018, True), (0.0005, False)])
def test_a_lift_moves_in_meters_per_second(speed: float, moves: bool) -> None:
    lift = sdpid.load_robot(LIFT)
    t = np.arange(400) / RATE
    v = np.outer(np.sin(t), [speed, 1.0])
    samples = sdpid.Samples(position=v, velocity=v, acceleration=v, effort=1.0 + v, time=t)
    fit = Validation.of_prediction(lift.joint_names, samples, 1.0 + v, robot=lift)
    assert fit.moving.rows.tolist() == [len(t) if moves else 0, len(t)]
    assert [each.moved for each in graded(samples, fit)] == [moves, True]
    text = " ".join(found.text for found in prediction_findings(lift, samples, fit))
    assert ("lift (never faster than 0.001 m/s)" in text) is not moves


@pytest.mark.parametrize("error", [0.0, 0.2])
def test_what_never_moved_is_not_trusted(error: float) -> None:
    samples, fit = biased(10.0, error, moving=False)
    assert grade(samples, fit) == "caution"
    (only,) = prediction_findings(ONE, samples, fit)
    assert only.level == "bad"
    assert "did not move" in only.text
    assert "joint" in only.text
    moving, fit = biased(10.0, error)
    assert "did not move" not in prediction_findings(ONE, moving, fit)[0].text


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        (np.sign, "direction of motion"),
        (lambda v: v, "in proportion to velocity"),
        (lambda v: np.cos(2.0 * v), "along a curve"),
    ],
)
def test_friction_that_changed_is_named(good: Identification, shape, words: str) -> None:
    fresh = moved(arm_theta(), 2)
    effort = np.array(fresh.effort)
    effort[:, 0] += 0.3 * effort[:, 0].std() * shape(fresh.velocity[:, 0])
    result = with_validation(good, replace(fresh, effort=effort))
    text = said(result, "The error goes", words)
    assert FIRST in text
    assert LAST not in text


def test_motion_beyond_the_training_is_named(good: Identification) -> None:
    result = with_validation(good, moved(arm_theta(), 2, speed=2.0))
    assert f"{FIRST} (velocity)" in said(result, "goes beyond the training motion")


def test_weak_directions_are_named() -> None:
    # So small a motion that gravity looks like an offset.
    result = identified(moved(arm_theta(), 1, amplitude=1e-3, noise=1e-4))
    assert "as good as arbitrary" in said(result, "weakly excited")


def test_constraints_that_cost_are_named(good: Identification) -> None:
    # Twice the friction that there is.
    friction = 2.0 * good.estimate.named()["Fv1"]
    constraints = sdpid.Constraints(others=(Fixed({"Fv1": friction}),))
    result = identified(good.problem.samples, constraints=constraints)
    assert "Fv1" in said(result, "The constraints contradict the data")
    unsaid(good, "contradict")


def test_links_that_are_believed_to_be_alike_and_are_not_are_named(good: Identification) -> None:
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    pair = MirrorPair(*ARM.link_names, reflection=mirror)
    prior = sdpid.Prior(bodies=arm_theta()[:20].reshape(2, 10), alike=pair, within=0.1)
    result = identified(good.problem.samples, prior=prior)
    # So short a chain moves as one of two bodies that are alike would, or nearly.
    assert not list(_unlike(result))
    # The true ones are far from it.
    (text,) = _unlike(replace(result, estimate=replace(result.estimate, theta=arm_theta())))
    assert f"{' and '.join(ARM.link_names)} (8.5 times)" in text.text
    assert not list(_unlike(good))


def test_what_holds_a_joint_back_is_named_and_is_the_next_step(good: Identification) -> None:
    # Far more friction than the second joint has.
    fixed = Fixed({"Fs2": 3.0 + good.estimate.named()["Fs2"]})
    constraints = sdpid.Constraints(others=(fixed,))
    result = identified(good.problem.samples, moved(arm_theta(), 2), constraints=constraints)
    text = said(result, f"{LAST} is held back", "Fs2")
    free = result.held_out.baselines["least squares"].moving.rmse[1]
    assert f"of least squares {free:.3g}" in text
    unsaid(result, f"{FIRST} is held back")
    unsaid(good, "is held back")
    assert "held by" in result.headline.worst
    assert result.headline.step.startswith(f"find why {LAST} does not agree with")
    # Of a strong prior no constraint is to blame.
    theta = arm_theta()
    robot = replace(ARM, prior=3.0 * theta[:20].reshape(2, 10))
    strong = identified(
        good.problem.samples, moved(theta, 2), robot=robot, prior=sdpid.Prior(strength=1e8)
    )
    assert "weaken the prior" in said(strong, f"{LAST} is held back")


def test_masses_at_their_limit_are_named() -> None:
    light = sdpid.Constraints(mass_max=0.3)
    result = identified(moved(arm_theta(), 1), constraints=light)
    assert "at most 0.3 kg" in said(result, "Masses are as large as is allowed")


def test_a_prior_that_holds_back_is_judged_on_other_motion() -> None:
    theta = arm_theta()
    robot = replace(ARM, prior=3.0 * theta[:20].reshape(2, 10))
    samples = moved(theta, 1, seconds=4.0, noise=0.05)
    strong = sdpid.Prior(strength=1e3)
    alone = identified(samples, robot=robot, prior=strong)
    said(alone, "hold the fit back", "On blocks held out it does not pay")
    said(replace(alone, held_out=None), "hold the fit back", "Only held-out data tell")
    fresh = identified(samples, moved(theta, 2), robot=robot, prior=strong)
    said(fresh, "hold the fit back", "On the validation data it does not pay")
    said(fresh, "standard parameters are the description's")


def test_errors_of_white_noise(good: Identification) -> None:
    K = 20_000
    rng = np.random.default_rng(4)
    t = np.arange(K) / 100.0
    v = np.stack([np.sin(3.0 * t), np.cos(2.0 * t)], axis=1)
    mask = np.ones((K, 2), dtype=bool)
    mask[: K // 2, 0] = False
    error = rng.standard_normal((K, 2))
    error[~mask] = 1e6
    samples = sdpid.Samples(position=v, velocity=v, acceleration=v, effort=error, time=t, mask=mask)
    fit = replace(good.training, effort_predicted=np.zeros((K, 2)))
    for each in joint_errors(samples, fit):
        assert each.autocorrelation[0] == pytest.approx(1.0)
        assert np.abs(each.autocorrelation[1:]).max() < 0.05
        assert each.share < 0.01
        assert each.independent > 0.8 * K / 2
        # The density holds the variance: one, over the frequencies up to half the rate.
        step = each.frequency[1]
        assert np.sum(each.error_density**2) * step == pytest.approx(1.0, rel=0.05)
        assert np.all(each.low < each.mean)
        assert np.all(each.mean < each.high)


def test_a_joint_that_stands_still_has_no_friction_curve(good: Identification) -> None:
    v = np.zeros((100, 2))
    effort = np.random.default_rng(0).standard_normal((100, 2))
    samples = sdpid.Samples(position=v, velocity=v, acceleration=v, effort=effort)
    fit = replace(good.training, effort_predicted=np.zeros((100, 2)))
    for each in joint_errors(samples, fit):
        assert len(each.velocity) == 0
        assert each.share == 0.0


def test_a_prediction_alone_is_judged(good: Identification) -> None:
    fresh = moved(arm_theta(), 3)
    (only,) = prediction_findings(ARM, fresh, sdpid.validate(good.estimate, fresh))
    assert only.level == "good"
    assert "every joint" in only.text
    assert "on this recording" in only.text
    effort = fresh.effort + [0.0, 1.0] * np.sign(fresh.velocity) * np.abs(fresh.effort).max()
    changed = replace(fresh, effort=effort)
    levels = [
        f.level for f in prediction_findings(ARM, changed, sdpid.validate(good.estimate, changed))
    ]
    assert levels == ["good", "bad", "caution"]


def one_way(samples: sdpid.Samples, joint: int, sign: float) -> sdpid.Samples:
    """Return samples in which a joint moves on in one direction only."""
    v = np.array(samples.velocity)
    v[:, joint] = sign * (np.abs(v[:, joint]) + 0.05)
    return replace(samples, velocity=v)


@pytest.mark.parametrize(("sign", "word"), [(1.0, "forwards"), (-1.0, "backwards")])
def test_a_joint_that_moves_one_way_only_is_named(
    good: Identification, sign: float, word: str
) -> None:
    unsaid(good, "one direction only")
    samples = one_way(good.problem.samples, 0, sign)
    result = trained_on(good, samples)
    text = said(result, "one direction only", "extrapolation", "Coulomb friction and an offset")
    assert f"{FIRST} ({word})" in text
    assert LAST not in text
    # As held-out motion it says nothing about what was trained.
    unsaid(with_validation(good, one_way(moved(arm_theta(), 2), 0, sign)), "one direction only")


def test_velocity_noise_is_no_motion_and_hidden_rows_do_not_count(
    good: Identification,
) -> None:
    samples = one_way(good.problem.samples, 1, 1.0)
    v = np.array(samples.velocity)
    v[:5, 1] = -0.019
    noisy = replace(samples, velocity=v)
    result = trained_on(good, noisy)
    assert f"{LAST} (forwards)" in said(result, "one direction only")
    v[:5, 1] = -0.021
    samples = replace(samples, velocity=v)
    unsaid(trained_on(good, samples), "one direction only")
    mask = np.ones(v.shape, dtype=bool)
    mask[:5, 1] = False
    samples = replace(samples, mask=mask)
    result = trained_on(good, samples)
    assert f"{LAST} (forwards)" in said(result, "one direction only")


def test_friction_of_a_joint_without_rows_is_unknown(good: Identification) -> None:
    unsaid(good, "is unknown")
    samples = good.problem.samples
    mask = np.tile([True, False], (samples.n_samples, 1))
    text = said(trained_on(good, replace(samples, mask=mask)), "is unknown")
    assert f"Friction of {LAST} is unknown" in text


def test_without_friction_directions_do_not_matter(good: Identification) -> None:
    problem = good.problem
    bare = FrictionModel.from_terms((), problem.robot.joint_names)
    samples = one_way(problem.samples, 0, 1.0)
    result = replace(
        good, problem=replace(problem, rows=replace(problem.rows, samples=samples), friction=bare)
    )
    assert not list(_one_way(result))


def test_all_pieces_count_for_directions(good: Identification) -> None:
    forwards, backwards = (one_way(moved(arm_theta(), 1), 0, s) for s in (1.0, -1.0))
    for pieces, named in (((forwards, backwards), False), ((forwards, forwards), True)):
        joined = sdpid.Samples.join(pieces)
        result = trained_on(good, joined)
        assert bool(list(_one_way(result))) is named


def test_errors_are_looked_at_once(good: Identification, monkeypatch: pytest.MonkeyPatch) -> None:
    fresh, wanted = replace(good), good.verdict
    first = errors_of(fresh)
    monkeypatch.setattr("sdpid.output.report.judged.joint_errors", None)
    assert errors_of(fresh) is first
    assert fresh.verdict == wanted
