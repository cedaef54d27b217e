"""What is said of a model follows from what was put wrong."""

import gc
import re
import weakref
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.assurance.diagnostics.causes import joint_errors
from sdpid.assurance.diagnostics.held_out import DESCRIPTION, HeldOut, hold_out
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.constraints import Fixed, MirrorPair
from sdpid.errors import DataError, SdpidError
from sdpid.estimation.effects.kinds import Tried
from sdpid.experiment.inspection.inspect import REFUSED
from sdpid.experiment.inspection.kinds import Finding
from sdpid.output.report.headline import headline
from sdpid.output.report.kinds import KINDS, WARNINGS
from sdpid.output.report.report import report_html
from sdpid.output.report.subject import EXPLAINED, MARGIN, SMALL, Level, graded, grades
from sdpid.output.report.verdict import findings, motion, prediction_findings
from sdpid.output.robots.export_report import urdf_errors
from sdpid.robot.friction.model import FrictionModel
from sdpid.workflow.result import Identification
from tests.experiment.inspection.test_inspect import WRONG, simulated
from tests.helpers.identified import ARM, RATE, arm_theta, identified, moved
from tests.helpers.refusals import refuses
from tests.helpers.robots import LIFT, small_arm
from tests.helpers.runs import arm, recorded
from tests.helpers.studies import study
from tests.output.test_report import elements, flat

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


def kinds(found: Iterable[Any]) -> set[str]:
    return {each.kind for each in found}


def held(result: Identification, samples: sdpid.Samples) -> Identification:
    """Return the result as if other motion had been held out, of which its files know nothing."""
    return replace(result, held_out=hold_out(result.estimate, result.wls, samples))


def with_validation(result: Identification, samples: sdpid.Samples) -> Identification:
    result = held(result, samples)
    return replace(result, validation=result.held_out.fit, validation_samples=samples)


def wrong(joint: int, share: float, shape: Callable[[sdpid.Samples], Any]) -> sdpid.Samples:
    """Return another motion whose efforts are off by a share of their spread, times a shape."""
    fresh = moved(arm_theta(), 2)
    effort = np.array(fresh.effort)
    effort[:, joint] += share * effort[:, joint].std() * shape(fresh)
    return replace(fresh, effort=effort)


def noise(samples: sdpid.Samples) -> Any:
    return np.random.default_rng(0).standard_normal(samples.n_samples)


def grade(samples: sdpid.Samples, fit: Validation) -> Level:
    """Return the grade of the only joint, by one prediction alone."""
    (only,) = graded(samples, fit)
    return only.level


def trained_on(result: Identification, samples: sdpid.Samples, **fields: Any) -> Identification:
    """Return the result as if these had been its training samples."""
    problem = result.problem
    rows = replace(problem.rows, samples=samples)
    return replace(result, problem=replace(problem, rows=rows, **fields))


def states_of(velocity: Any, effort: Any, **fields: Any) -> sdpid.Samples:
    """Return samples with these velocities, whatever the other states."""
    states = {"position": velocity, "velocity": velocity, "acceleration": velocity}
    return sdpid.Samples(**states, effort=effort, **fields)


def test_a_good_model_is_trusted(good: Identification) -> None:
    said(good, "Trust it for the effort of every joint", "not used for the fit")
    said(good, "carries over")
    said(good, "proven in exact arithmetic")
    absent = ("The error goes", "weakly excited", "numerical limit", "Nothing was held out")
    others = ("contradict", "is held back", "one direction only", "is unknown", "mirror images")
    for words in (*absent, *others):
        unsaid(good, words)
    assert {f.level for f in findings(good)} <= {"good", "caution"}
    alone = replace(good, validation=None, validation_samples=None, held_out=None)
    said(alone, "Nothing was held out")
    said(alone, "its own training data")


def test_a_limit_that_contradicts_the_data_is_told_as_such(good: Identification) -> None:
    problem = good.problem
    largest = max(good.estimate.named()[name] for name in ("Fs1", "Fv1"))
    limits = problem.constraints.replace(friction_max=largest / 2.0)
    estimate = sdpid.solve_sdp(problem.constrained(constraints=limits))
    held = replace(good, problem=estimate.problem, estimate=estimate)
    assert f"at most {largest / 2.0:g}" in said(held, "numerical limit contradicts the data")
    unsaid(held, "do not determine")


def test_a_noisy_joint_is_not_trusted(good: Identification) -> None:
    result = with_validation(good, wrong(1, 2.0, noise))
    assert LAST in said(result, "Do not trust")
    assert LAST not in said(result, "Trust it for")
    said(result, "does not carry over", "times as much")
    # Nor one that is worse than its mean.
    constant = with_validation(good, wrong(1, 10.0, lambda _: 1.0))
    said(constant, f"{LAST} (worse than a constant)")


def biased(effort: float, error: float, *, moving: bool = True) -> tuple[sdpid.Samples, Validation]:
    """Return samples of a joint with a nearly constant effort, and a prediction that is off."""
    t = np.arange(400) / RATE
    v = np.sin(t)[:, None] if moving else np.full((400, 1), 0.01)
    efforts = effort + 0.01 * np.cos(3.0 * t)[:, None]
    samples = states_of(v, efforts, time=t)
    return samples, Validation.of_prediction(ONE, samples, efforts - error)


def test_worse_than_a_constant_is_never_trusted() -> None:
    samples, fit = biased(10.0, 0.2)
    assert fit.r2[0] < 0.0
    assert fit.nrmse[0] < SMALL
    assert grade(samples, fit) == "caution"
    (only,) = prediction_findings(ONE, samples, fit)
    assert only.level == "caution"
    assert f"{ONE.joint_names[0]} (worse than a constant, error 2 % of the effort)" in only.text
    assert "roughly right" not in only.text
    assert "Validate on a motion in which the effort varies" in only.text
    # An error that is large beside the effort as well is worse still.
    assert grade(*biased(10.0, 2.0)) == "bad"


@pytest.mark.parametrize(("speed", "moves"), [(0.018, True), (0.0005, False)])
def test_a_lift_moves_in_meters_per_second(speed: float, moves: bool) -> None:
    lift = sdpid.load_robot(LIFT)
    t = np.arange(400) / RATE
    v = np.outer(np.sin(t), [speed, 1.0])
    samples = states_of(v, 1.0 + v, time=t)
    fit = Validation.of_prediction(lift, samples, 1.0 + v)
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
    result = with_validation(good, wrong(0, 0.3, lambda fresh: shape(fresh.velocity[:, 0])))
    text = said(result, "The error goes", words)
    assert FIRST in text
    assert LAST not in text


def test_weak_directions_and_motion_beyond_the_training_are_named(good: Identification) -> None:
    result = with_validation(good, moved(arm_theta(), 2, speed=2.0))
    assert f"{FIRST} (velocity)" in said(result, "goes beyond the training motion")
    # So small a motion that gravity looks like an offset.
    result = identified(moved(arm_theta(), 1, amplitude=1e-3, noise=1e-4))
    assert "as good as arbitrary" in said(result, "weakly excited")


def test_constraints_that_cost_are_named(good: Identification) -> None:
    # Twice the friction that there is.
    friction = 2.0 * good.estimate.named()["Fv1"]
    constraints = sdpid.Constraints(others=(Fixed({"Fv1": friction}),))
    result = identified(good.problem.samples, constraints=constraints)
    assert "Fv1" in said(result, "The constraints contradict the data")
    result = identified(good.problem.samples, constraints=sdpid.Constraints(mass_max=0.3))
    assert "at most 0.3 kg" in said(result, "Masses are as large as is allowed")


def test_links_that_are_believed_to_be_alike_and_are_not_are_named(good: Identification) -> None:
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    pair = MirrorPair(*ARM.link_names, reflection=mirror)
    prior = sdpid.Prior(bodies=arm_theta()[:20].reshape(2, 10), alike=pair, within=0.1)
    result = identified(good.problem.samples, prior=prior)
    # So short a chain moves as one of two bodies that are alike would, or nearly.
    unsaid(result, "believed to be mirror images")
    # The true ones are far from it.
    estimate = replace(result.estimate, theta=arm_theta())
    text = said(replace(result, estimate=estimate), "believed to be mirror images")
    assert f"{' and '.join(ARM.link_names)} (8.5 times)" in text
    unsaid(good, "believed to be mirror images")


def test_what_holds_a_joint_back_is_named_and_is_the_next_step(good: Identification) -> None:
    # Far more friction than the second joint has.
    fixed = Fixed({"Fs2": 3.0 + good.estimate.named()["Fs2"]})
    constraints = sdpid.Constraints(others=(fixed,))
    result = identified(good.problem.samples, moved(arm_theta(), 2), constraints=constraints)
    text = said(result, f"{LAST} is held back", "Fs2")
    free = result.held_out.baselines["least squares"].moving.rmse[1]
    assert f"of least squares {free:.3g}" in text
    unsaid(result, f"{FIRST} is held back")
    assert "held by" in result.headline.worst
    assert result.headline.step.startswith(f"find why {LAST} does not agree with")
    # Of a strong prior no constraint is to blame.
    theta = arm_theta()
    robot = replace(ARM, prior=3.0 * theta[:20].reshape(2, 10))
    strong = identified(
        good.problem.samples, moved(theta, 2), robot=robot, prior=sdpid.Prior(strength=1e8)
    )
    assert "weaken the prior" in said(strong, f"{LAST} is held back")


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
    samples = states_of(v, error, time=t, mask=mask)
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
    effort = np.random.default_rng(0).standard_normal((100, 2))
    fit = replace(good.training, effort_predicted=np.zeros((100, 2)))
    for each in joint_errors(states_of(0.0 * effort, effort), fit):
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
    found = prediction_findings(ARM, changed, sdpid.validate(good.estimate, changed))
    assert [each.level for each in found] == ["good", "bad", "caution"]


def one_way(samples: sdpid.Samples, joint: int, sign: float) -> sdpid.Samples:
    """Return samples in which a joint moves on in one direction only."""
    v = np.array(samples.velocity)
    v[:, joint] = sign * (np.abs(v[:, joint]) + 0.05)
    return replace(samples, velocity=v)


@pytest.mark.parametrize(("sign", "word"), [(1.0, "forwards"), (-1.0, "backwards")])
def test_a_joint_that_moves_one_way_only_is_named(
    good: Identification, sign: float, word: str
) -> None:
    samples = one_way(good.problem.samples, 0, sign)
    result = trained_on(good, samples)
    text = said(result, "one direction only", "extrapolation", "Coulomb friction and an offset")
    assert f"{FIRST} ({word})" in text
    assert LAST not in text
    # As held-out motion it says nothing about what was trained.
    unsaid(with_validation(good, one_way(moved(arm_theta(), 2), 0, sign)), "one direction only")


@pytest.mark.parametrize(
    ("back", "masked", "named"), [(0.019, False, True), (0.021, False, False), (0.021, True, True)]
)
def test_velocity_noise_is_no_motion_and_hidden_rows_do_not_count(
    good: Identification, *, back: float, masked: bool, named: bool
) -> None:
    samples = one_way(good.problem.samples, 1, 1.0)
    v, mask = np.array(samples.velocity), np.ones(samples.velocity.shape, dtype=bool)
    v[:5, 1], mask[:5, 1] = -back, not masked
    result = trained_on(good, replace(samples, velocity=v, mask=mask))
    if named:
        assert f"{LAST} (forwards)" in said(result, "one direction only")
    else:
        unsaid(result, "one direction only")


def test_friction_of_a_joint_without_rows_is_unknown(good: Identification) -> None:
    samples = good.problem.samples
    mask = np.tile([True, False], (samples.n_samples, 1))
    text = said(trained_on(good, replace(samples, mask=mask)), "is unknown")
    assert f"Friction of {LAST} is unknown" in text


def test_without_friction_directions_do_not_matter(good: Identification) -> None:
    bare = FrictionModel.from_terms((), ARM.joint_names)
    result = trained_on(good, one_way(good.problem.samples, 0, 1.0), friction=bare)
    assert "one_way" not in kinds(motion(result._subject))


def test_all_pieces_count_for_directions(good: Identification) -> None:
    forwards, backwards = (one_way(moved(arm_theta(), 1), 0, s) for s in (1.0, -1.0))
    for pieces, named in (((forwards, backwards), False), ((forwards, forwards), True)):
        result = trained_on(good, sdpid.Samples.join(pieces))
        assert ("one_way" in kinds(motion(result._subject))) is named


def test_what_is_said_stays_outside_of_the_result(good: Identification) -> None:
    result = replace(good)
    before = set(vars(result))
    assert result.verdict == good.verdict
    assert headline(result).lines == headline(good).lines
    assert set(vars(result)) == before
    gone, enabled = weakref.ref(result), gc.isenabled()
    gc.disable()
    try:
        del result
        assert gone() is None
    finally:
        if enabled:
            gc.enable()


# ---- The terminal's lines say what the report's boxes say, on public recordings and on wrong logs.


# Description, log, and another recording where there is one.
RECORDS: dict[str, tuple[str, str, str | None]] = {
    "ur10_unisa": ("ur10.urdf", "ur10_exciting.npz", None),
    "panda_unisa": ("panda.urdf", "panda_exciting.npz", None),
    "kuka_lwr4plus": ("kuka_lwr4.urdf", "measurements_1.npz", "measurements_2.npz"),
    "staubli_tx40": ("tx40.urdf", "tx40_rows_0_24750.npz", None),
    "kinova_gen3_dynamapp": ("gen3.urdf", "opti_traj_testing1.npz", "opti_traj_testing2.npz"),
    "kr300": ("kr300.urdf", "run_A.npz", "run_B.npz"),
}
CURRENTS = [14.87, 13.26, 11.13, 10.62, 11.03, 11.47]


def number_of(text: str) -> float:
    return float(text.replace("−", "-").removesuffix(" %").replace("–", "nan"))


def unlike(result: Identification) -> Iterator[str]:
    """Yield what of the report the terminal has not, or has otherwise."""
    page, headline = report_html(result), result.headline
    lines = headline.lines
    # Red boxes of the verdict, in their words, and of the log.
    warned = {"Do not trust" + each.text: each.warning for each in findings(result)}
    warned = {re.sub(r"\s+", " ", text).strip(): words for text, words in warned.items()}
    for box in (flat(item) for item in elements(page, "li") if item.get("class") == "bad"):
        if box.startswith("accepted all the same"):
            if not any(str(each) in line for each in result.findings for line in headline.log):
                yield box
        elif not (warned.get(box) and any(line.endswith(warned[box]) for line in lines)):
            yield box
    for each in result.findings:
        told = each.severity == "note" or each.kind == "continued" or each.line() in headline.log
        if not told:
            yield each.line()
    tables = [(table, flat(table)) for table in elements(page, "table")]
    # One error in all places: the bars, the tile, JSON, and the line.
    if result.held_out is not None and result.held_out.fit.moving.rows.any():
        line = re.sub(r", no robot \([^)]*\)", "", lines[1])
        said = [float(share) for share in re.findall(r"([\d.e+-]+) %", line)]
        bars = [
            number_of(flat(row.find("{*}td")))
            for table, text in tables
            if "bars are logarithmic" in text
            for row in table.find("{*}tbody")
        ]
        held = result.to_dict()["held_out"]
        errors = [each["moving"] for name, each in held.items() if name not in ("by", "blocks")]
        own = [100.0 * each["relative_residual"] for each in errors]
        for what, found in (("line", said), ("bars", bars)):
            if found != pytest.approx(own, rel=6e-3):
                yield f"{what}: {found}, JSON {own}"
    (tile,) = [
        each.find("{*}dd")
        for each in elements(page, "div")
        if (name := each.find("{*}dt")) is not None and flat(name) == "training relative residual"
    ]
    if number_of(flat(tile)) != pytest.approx(100.0 * result.training.told.relative, rel=6e-3):
        yield f"training: {flat(tile)}"
    # Where least squares is no robot.
    share = re.search(r"M < 0 (all along|on ([\d.e+-]+) %)", lines[1])
    told = 0.0 if share is None else 100.0 if share[2] is None else float(share[2])
    (table,) = [table for table, text in tables if "Least eigenvalue" in text]
    row = next(r for r in table.iter("{*}tr") if flat(r).startswith("least squares"))
    shown = number_of(flat(row[-1]))
    if "least squares" in lines[1] and told != pytest.approx(shown, rel=6e-3):
        yield f"no robot: {told}, {flat(row)}"


@pytest.mark.parametrize("name", RECORDS)
def test_public_recordings(data_folder: Path, name: str) -> None:
    robot, log, validation = RECORDS[name]
    folder = data_folder / name
    others = None if validation is None else folder / validation
    result = sdpid.identify(folder / robot, folder / log, validation=others, intervals=False)
    assert list(unlike(result)) == []


def test_a_public_robot_on_legs(data_folder: Path) -> None:
    """Of the master arm and the hung quadruped, drives and efforts are not known."""
    folder = data_folder / "solo12_simulated"
    robot = sdpid.load_robot(folder / "solo12.urdf", root="free_flyer")
    log, other = (study("solo12_public").read(folder, name) for name in ("trot", "stand"))
    options = {"friction": (sdpid.friction.Coulomb(width=0.02), "viscous"), "effects": "none"}
    result = sdpid.identify(robot, log, validation=other, intervals=False, **options)
    assert list(unlike(result)) == []


def test_public_currents(data_folder: Path) -> None:
    folder = data_folder / "ur10e_innopolis"
    columns = {"time": 1, "position": [*range(2, 8)], "effort": [*range(14, 20)]}
    names = ("20_02_05-20sec_8harm.csv", "20_02_05-20sec_12harm.csv")
    log, other = (
        sdpid.read_recording(folder / name, columns=columns, gains=CURRENTS) for name in names
    )
    result = sdpid.identify(folder / "ur10e.urdf", log, validation=other, intervals=False)
    assert list(unlike(result)) == []


@pytest.mark.parametrize("name", WRONG)
def test_wrong_logs(name: str) -> None:
    robot = sdpid.load_robot("ur_description/ur5_robot")
    log = WRONG[name][0](simulated(robot, 1))
    kinds: list[str] = []
    while True:
        try:
            result = sdpid.identify(robot, log, accept=kinds, intervals=False, effects="none")
        except SdpidError as cause:
            # Refused: everybody is told, and nothing is written. Overruled by name it goes on.
            more = {kind for kind in REFUSED if f"--accept {kind}" in str(cause)} - {*kinds}
            if not more:
                assert WRONG[name][2] == "refuse"
                return
            kinds += more
        else:
            assert list(unlike(result)) == []
            return


# ---- The verdict in lines: what is missed, the worst joint, what not to do, the next step.


@pytest.fixture(scope="module")
def full() -> Identification:
    robot = replace(ARM, prior=1.1 * arm_theta()[:20].reshape(2, 10))
    return identified(moved(arm_theta(), 1), moved(arm_theta(), 2), robot=robot)


def test_other_motion_and_blocks_have_their_words(full: Identification) -> None:
    found = headline(full)
    assert "on recordings that were not fitted; the 95 % bands hold 9" in found.error
    assert found.step.startswith("none: use ")
    for words in ("your description", "friction fitted", "least squares", "this estimate"):
        assert words in found.baseline
    blocks = replace(full, validation=None, held_out=hold_out(full.estimate, full.wls, None))
    found = headline(blocks)
    assert "on 5 blocks held out in turn; other motion is not shown" in found.error
    assert "record another motion" in found.step
    nothing = headline(replace(blocks, held_out=None))
    assert "nothing could be held out" in nothing.error
    assert nothing.baseline is None
    assert nothing.lines[0].endswith("fitted, nothing else predicted")
    assert nothing.lines[1] == f"missed effort  {nothing.error}"


def test_an_estimate_that_costs_more_and_is_worse_is_not_to_be_used(full: Identification) -> None:
    held_out = full.held_out
    assert held_out.beaten_by is None
    swapped = {**held_out.baselines, "least squares": held_out.fit}
    worse = replace(held_out, fit=held_out.baselines["description as it is"], baselines=swapped)
    assert worse.beaten_by == "least squares"
    warnings = headline(replace(full, held_out=worse)).warnings
    assert "use it: least squares predicts better what was held out" in warnings


class Bias(sdpid.friction.Offset):
    """A term of one's own, whose code no file has."""


def test_a_file_that_misses_more_than_the_estimate_is_not_recommended(full: Identification) -> None:
    # Offsets of a fifth of the effort, for which a URDF has no place.
    found = headline(full)
    errors = urdf_errors(full.estimate, full.validation_samples)
    assert errors is not None
    for words in (
        f"in motion on the validation recordings it misses efforts by {errors}",
        "the links of identified.urdf with identified_friction.py (.hpp) for its friction",
    ):
        assert words in found.file
    assert any("do not use identified.urdf" in line for line in found.lines)
    assert found.step.startswith("none: use estimate.model() or parameters.json")
    *terms, offset = full.problem.friction.terms
    assert type(offset) is sdpid.friction.Offset
    friction = replace(full.problem.friction, terms=(*terms, Bias()))
    advice = headline(replace(full, problem=replace(full.problem, friction=friction))).file
    assert "estimate.model()" in advice
    assert "identified_friction" not in advice
    theta = arm_theta()
    theta[[name.startswith("Fo") for name in full.problem.base.theta_names]] = 0.0
    without = headline(identified(moved(theta, 1), moved(theta, 2)))
    assert without.file is None
    assert without.step.startswith("none: use identified.urdf")


def test_the_worst_joint_its_cause_and_the_step(full: Identification) -> None:
    late = held(full, wrong(1, 0.5, lambda s: s.acceleration[:, 1] / s.acceleration[:, 1].std()))
    found = headline(late)
    assert found.worst.startswith(f"{LAST}, error ")
    assert "goes with acceleration" in found.worst
    assert "rotor inertia" in found.step
    assert f"(for {LAST})" in found.step
    # What the choice of effects left out is not proposed again.
    tried = Tried(name="rotor_inertia", chosen=False, words="", fall=0.006, least_fall=0.05)
    problem = full.problem.with_origin(effects=(tried,))
    step = headline(replace(late, problem=problem)).step
    assert "--effects" not in step
    assert "rotor_inertia was tried and lowers the cost by 0.6 % alone" in step
    # What is wrong with the recording comes first.
    units = Finding(severity="refuse", kind="units", message="it is", remedy="mend the units")
    flipped = replace(units, kind="effort_sign", remedy="flip its sign", joint=LAST)
    for each, step in ((units, "mend the units"), (flipped, f"flip its sign (for {LAST})")):
        assert headline(replace(late, findings=(each,))).step == step


def test_a_cause_of_another_joint_than_the_worst_is_told_with_its_share(
    full: Identification,
) -> None:
    parts = wrong(0, 0.4, lambda fresh: np.sin(fresh.position[:, 0])), wrong(1, 0.5, noise)
    both = np.column_stack([each.effort[:, j] for j, each in enumerate(parts)])
    found = headline(held(full, replace(moved(arm_theta(), 2), effort=both)))
    assert found.worst.startswith(f"{LAST}, error ")
    assert "its shape shows no cause" in found.worst
    assert re.search(rf"\(for {FIRST}, [\d.]+ % of all joints' squared errors\)", found.step)


def test_friction_without_coulomb_or_viscous_terms_is_told(full: Identification) -> None:
    samples = moved(arm_theta(), 1)
    problem = sdpid.build_problem(ARM, samples, friction=("stribeck",), weighting="residual")
    result = identified(problem, moved(arm_theta(), 2))
    said(result, "No term describes Coulomb or viscous friction (terms: Stribeck)")
    assert headline(result).step.startswith("let Coulomb and viscous friction in")
    unsaid(full, "No term describes")


def test_the_error_at_rest_stands_apart(full: Identification) -> None:
    fresh = moved(arm_theta(), 2)
    v, effort = np.array(fresh.velocity), np.array(fresh.effort)
    v[:200, 0] = 0.0
    effort[:200, 0] += 5.0
    result = held(full, replace(fresh, velocity=v, effort=effort))
    assert "% at rest (10 % of the rows)" in headline(result).error
    assert "stiction" in said(result, "At rest")
    # Where nothing moves, nothing is said of motion.
    result = held(full, replace(fresh, velocity=0.0 * v))
    found = headline(result)
    assert "in motion" not in found.error
    assert "% at rest" in found.error
    assert found.baseline is None
    assert "did not move" in found.worst
    assert f"record {FIRST} moving" in found.step
    said(result, "Nothing moves on what was held out")
    unsaid(result, "carries over")


def test_bands_that_hold_too_little_are_called_too_narrow(full: Identification) -> None:
    assert "too narrow" not in headline(full).error
    louder = held(full, moved(arm_theta(), 2, noise=0.06))
    assert "less than 90 %: they are too narrow" in headline(louder).error


def test_every_red_box_of_the_report_is_a_line(full: Identification) -> None:
    degrees = Finding(severity="refuse", kind="units", message="it is in degrees", remedy="say so")
    flat = Finding(severity="warning", kind="frozen", message="it never changes", joint=LAST)
    resting = moved(arm_theta(), 2)
    held_out = replace(full.held_out, samples=resting, fit=full.held_out.baselines[DESCRIPTION])
    result = replace(full, held_out=held_out, findings=(degrees, flat))
    bad = [finding for finding in findings(result) if finding.level == "bad"]
    assert len(bad) >= 3
    short = headline(result)
    assert all(each.warning in short.warnings for each in bad)
    lines = [line for line in short.lines if line[15:] in short.warnings]
    assert len(lines) == len(short.warnings)
    assert [line.startswith("do not  ") for line in lines] == [True] + [False] * (len(lines) - 1)
    assert short.log == (degrees.line(), flat.line())
    assert not any(line.startswith("log") for line in headline(full).lines)


def test_bad_findings_say_what_not_to_do() -> None:
    assert len(KINDS["bad"]) >= 10
    assert KINDS["bad"].keys() <= WARNINGS.keys()
    every = [kind for rows in KINDS.values() for kind in rows]
    assert len(every) == len({*every})
    assert WARNINGS.keys() <= {*every}


def test_least_squares_that_is_no_robot_is_told(full: Identification) -> None:
    assert "no robot" not in headline(full).baseline
    theta = full.wls.some_theta.copy()
    theta[:20] *= -1.0
    turned = replace(full, wls=replace(full.wls, base=full.problem.base_of(theta)))
    assert "no robot (M < 0 all along)" in headline(turned).baseline


def test_what_the_data_showed_is_told_with_how_to_leave_it_out(full: Identification) -> None:
    assert headline(full).found is None
    tilt = Tried(name="tilt", chosen=True, words="a tilted base lowers the cost by 17 %", fall=0.17)
    asked = Tried(name="load", chosen=True, words="friction of the load: asked for")
    problem = full.problem.with_origin(effects=(tilt, asked))
    found = headline(replace(full, problem=problem)).found
    assert found == "a tilted base lowers the cost by 17 % (--effects none leaves it out)"


def test_what_was_changed_about_the_log_is_told() -> None:
    pandas = pytest.importorskip("pandas")
    log = recorded(1)
    columns = {"time": np.rint(1e3 * log.time)}
    for name, q, effort in [*zip(log.names, log.position.T, log.effort.T, strict=True)][::-1]:
        columns |= {f"position_{name}": np.degrees(q), f"effort_{name}": effort}
    read = sdpid.read_recording(pandas.DataFrame(columns), units={"position": "deg"})
    late = {"effort_delay_s": 0.004}
    found = sdpid.identify(arm(), read, processing=late, intervals=False, effects="none")
    assert [line for line in found.headline.log if line.startswith("changed: ")] == [
        "changed: joints are taken in the robot's order, the columns are of b, a",
        "changed: time: time, taken for ms by the steps of its numbers",
        "changed: units: position in deg, converted",
        "changed: efforts recorded 4 ms too late: taken on time",
    ]


# ---- A joint is trusted on other motion by other motion, or by blocks with a margin.


@pytest.fixture(scope="module")
def alone() -> Identification:
    return identified(moved(arm_theta(), 1))


def with_error(result: Identification, share: float) -> HeldOut:
    """Return blocks whose error is this share of each joint's effort's spread."""
    held_out = result.held_out
    rng = np.random.default_rng(0)
    effort = held_out.samples.effort
    error = share * effort.std(axis=0) * rng.standard_normal(effort.shape)
    fit = Validation.of_prediction(result.problem.robot, held_out.samples, effort + error)
    return replace(held_out, fit=fit)


def test_blocks_need_a_margin_and_other_motion_does_not(alone: Identification) -> None:
    enough = float(np.sqrt(1.0 - EXPLAINED))
    for share, by, level, shown in (
        (0.9 * enough / MARGIN, "blocks", "good", True),
        (1.1 * enough / MARGIN, "blocks", "caution", False),
        (1.1 * enough, "blocks", "caution", True),
        (3.0 * enough, "blocks", "bad", True),
        (1.1 * enough / MARGIN, "recording", "good", True),
    ):
        held_out = replace(with_error(alone, share), by=by)
        found = grades(alone.estimate, alone.training, held_out)
        assert [(each.level, each.shown) for each in found] == 2 * [(level, shown)]
    # Nothing is trusted by its training alone.
    found = grades(alone.estimate, alone.training, None)
    assert [(each.level, each.shown) for each in found] == 2 * [("caution", False)]


def test_a_motion_that_leaves_others_open_is_not_trusted() -> None:
    """Its blocks are predicted well, and still other motion within its range is not known."""
    short = identified(moved(arm_theta(), 1, seconds=4.0, noise=20.0, block=10))
    assert short.held_out is not None
    found = grades(short.estimate, short.training, with_error(short, 0.0))
    assert {each.shown for each in found} == {False}


def test_a_joint_without_effort_has_no_grade(alone: Identification) -> None:
    samples = alone.problem.samples
    mask = np.ones(samples.effort.shape, dtype=bool)
    mask[:, 1] = False
    fit = sdpid.validate(alone.estimate, replace(samples, mask=mask))
    assert [each.joint for each in grades(alone.estimate, fit, None)] == [0]


# ---- The figure of all joints of a result.


def test_every_joint_has_effort_error_and_friction(good: Identification) -> None:
    pytest.importorskip("matplotlib")
    axes = good.plot(title="all joints")
    assert axes.shape == (2, 3)
    assert tuple(row[0].get_title(loc="left") for row in axes) == ARM.joint_names
    for row in axes:
        assert [line.get_label() for line in row[0].get_lines()] == ["measured", "predicted"]
        assert row[1].get_ylabel() == "error [N·m]"
        assert row[2].get_xlabel() == "velocity [rad/s]"
    # What was held out, not what was fitted.
    drawn = axes[0, 0].get_lines()[0].get_ydata()
    assert set(np.round(drawn, 9)) <= set(np.round(good.validation_samples.effort[:, 0], 9))
    # A notebook shows axes as their figure, but for a figure that belongs to others.
    assert axes._repr_png_().startswith(b"\x89PNG")
    assert not hasattr(good.plot(axes=np.array(axes)), "_repr_png_")
    refuses(DataError, "2 axes were given to draw in, 6 are needed", good.plot, axes=axes[0, :2])
