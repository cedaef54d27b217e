"""Several recordings in one fit, intervals by default, and what is said of them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import sdpid
from sdpid.assurance.diagnostics.causes import joint_errors
from sdpid.errors import DataError
from sdpid.experiment.preparation.prepare import agreed, chosen_processing, prepare, samples_of
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.trajectory.drawn import default_motion
from sdpid.plots.lines import TimeLine
from sdpid.workflow.formulate import CrossValidation, formulate
from sdpid.workflow.result import Identification
from tests.helpers.refusals import refuses
from tests.helpers.runs import arm, recorded


@pytest.fixture(scope="module")
def logs() -> list[sdpid.Recording]:
    return [recorded(1, speed=0.7), recorded(2), recorded(3, speed=1.5, seconds=15.0)]


@pytest.fixture(scope="module")
def result(logs: list[sdpid.Recording]) -> Identification:
    return sdpid.identify(arm(), logs[:2], validation=logs[2])


def test_a_gaits_cutoff_decides_beside_a_slow_motion(logs: list[sdpid.Recording]) -> None:
    choices = [sdpid.Processing(cutoff_hz=hz) for hz in (45.0, 15.0, 20.0)]
    for floating, several, chosen in (
        (True, choices[:2], 45.0),
        (False, choices[:2], 15.0),
        (True, choices, 20.0),
        (False, choices, 20.0),
    ):
        assert agreed(several, floating=floating)[0].cutoff_hz == chosen

    upright = np.tile([0.0, 0.0, 0.0, 1.0], (logs[0].n_samples, 1))
    base = sdpid.BaseMotion(orientation=upright, position=np.zeros((logs[0].n_samples, 3)))
    # Of cut-offs that are equal the second counts as the higher one.
    for log, number in ((logs[0], 1), (replace(logs[0], base=base), 2)):
        assert f"as suits recording {number}" in str(chosen_processing([log, log])[1])


def test_recordings_are_processed_alike_and_alone(
    logs: list[sdpid.Recording], result: Identification
) -> None:
    cutoffs = [default_processing(log).cutoff_hz for log in logs]
    assert cutoffs == sorted(cutoffs)
    # The median; of two the lower one.
    assert chosen_processing(logs)[0] == default_processing(logs[1])
    assert chosen_processing(logs[:2])[0] == default_processing(logs[0])
    assert chosen_processing(logs[:1]) == (default_processing(logs[0]), None)
    # Settings may be changed one by one.
    changed = chosen_processing(logs, {"order": 2})[0]
    assert changed == replace(default_processing(logs[1]), order=2)
    chosen = default_processing(logs[0])
    pieces = [samples_of(arm(), log, chosen) for log in logs[:2]]
    samples = result.problem.samples
    assert samples.starts == (0, pieces[0].n_samples)
    np.testing.assert_array_equal(samples.effort, np.concatenate([p.effort for p in pieces]))
    alone = samples_of(arm(), logs[2], replace(chosen, covariance=None))
    np.testing.assert_array_equal(result.validation_samples.effort, alone.effort)
    assert "as suits recording 1" in result.notes[0]
    assert result.certificate.passed
    assert result.validation.relative < 0.02


def test_what_cannot_be_fitted_is_refused(logs: list[sdpid.Recording]) -> None:
    whole, periodic = recorded(5), recorded(4, seconds=20.0, period=10.0)
    first = {"position": whole.position[:, :1], "effort": whole.effort[:, :1]}
    one = replace(whole, **first, joint_names=None)
    for given, options, words in (
        ([], {}, "at least one"),
        ([logs[0], periodic], {}, "recording 2 of 2 has a period.*period=None"),
        ([logs[0], one], {}, "1 joints"),
        (logs[0], {"processing": {"order": 0}}, "order"),
        (logs[0], {"intervals": "guess"}, "'guess'"),
        (logs[0], {"without_effort": ["wrist"]}, "has no joint wrist"),
        (logs[0], {"without_effort": arm().joint_names}, "names every joint"),
    ):
        refuses(DataError, words, sdpid.identify, arm(), given, **options)
    refuses(DataError, r"log: is 'base.csv'.*read_recording", sdpid.process, "base.csv")
    refuses(DataError, "seed: is -1", sdpid.simulate, arm(), seed=-1)
    refuses(DataError, "seed: is -1", sdpid.paper_excitation, "denso_vp6242", -1)


def test_intervals_come_by_default_and_are_written(result: Identification, tmp_path: Path) -> None:
    found = result.intervals
    assert found.method == "gauss_markov"
    result.save(tmp_path, figures=False)
    ends = zip(found.lower, found.upper, found.label, strict=True)
    given = dict(zip(found.names, ends, strict=True))
    base = result.problem.base
    for file, names in (("base_parameters", base.names), ("parameters", base.theta_names)):
        table = pd.read_csv(tmp_path / f"{file}.csv", index_col="parameter")
        assert [*table.index] == [*names]
        assert set(table.index[table["lower"].notna()]) == {*names} & {*given} != set()
        for name in {*names} & {*given}:
            # pandas before version 3 reads some of the last digits otherwise.
            *ends, label = table.loc[name, ["lower", "upper", "label"]]
            assert ends == pytest.approx(given[name][:2], rel=1e-12)
            assert label == given[name][2]
    content = json.loads((tmp_path / "result.json").read_text())
    assert content["intervals"]["method"] == "gauss_markov"
    assert len(content["intervals"]["parameters"]) == len(found)
    kept = json.loads((tmp_path / "parameters.json").read_text())
    assert kept["base"]["Fv1"]["interval"] == [*given["Fv1"][:2]]
    assert kept["standard"]["m_1"]["shares"]
    assert "gauss_markov" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "95 % intervals" in result.summary()


@pytest.mark.parametrize(
    "options",
    [{"intervals": "profile"}, *({"prior": sdpid.Prior(strength=each)} for each in (1.0, 1e9))],
)
def test_no_interval_excludes_the_estimate(
    logs: list[sdpid.Recording], options: dict[str, Any]
) -> None:
    result = sdpid.identify(arm(), logs[0], **options)
    found = result.intervals
    values = {**result.estimate.named_theta(), **result.estimate.named()}
    assert found.contains([values[name] for name in found.names]).all()
    assert result.intervals_note is None


def test_why_there_are_none_is_said(tmp_path: Path) -> None:
    short = recorded(1, seconds=6.0)
    result = sdpid.identify(arm(), short, intervals="profile", prior=sdpid.Prior(kind="entropic"))
    assert result.intervals is None
    assert "log-det" in result.intervals_note
    assert result.intervals_note in result.to_dict()["notes"]
    result.save(tmp_path, figures=False)
    assert "No intervals of the parameters" in (tmp_path / "report.html").read_text("utf-8")
    assert "lower" not in (tmp_path / "base_parameters.csv").read_text().splitlines()[0]
    assert sdpid.identify(arm(), short, intervals=False).intervals_note is None


def test_time_lines() -> None:
    line = TimeLine.of(np.array([5.0, 6.0, 7.0, 1.0, 3.0]), 5, (0, 3))
    assert line.label == "time [s], recordings behind each other"
    np.testing.assert_allclose(line.time, [0.0, 1.0, 2.0, 2.04, 2.08, 4.08])
    np.testing.assert_array_equal(line.broken(np.arange(5.0)), [0, 1, 2, np.nan, 3, 4])
    assert line.kept(np.zeros(5, dtype=bool)).tolist() == [False] * 3 + [True] + [False] * 2
    whole = TimeLine.of(None, 3, (0,))
    assert whole.label == "sample"
    np.testing.assert_array_equal(whole.broken(whole.time), [0.0, 1.0, 2.0])


def test_spectra_and_correlations_stay_within_pieces(logs: list[sdpid.Recording]) -> None:
    """Of a recording joined with itself they are those of the recording."""
    result = sdpid.identify(arm(), logs[0], intervals=False)
    one = result.problem.samples
    two = sdpid.Samples.join([one, one])
    for first, second in zip(
        joint_errors(one, sdpid.validate(result.estimate, one)),
        joint_errors(two, sdpid.validate(result.estimate, two)),
        strict=True,
    ):
        size = 1e-9 * first.error_density.max()
        np.testing.assert_allclose(second.error_density, first.error_density, atol=size)
        np.testing.assert_array_equal(second.frequency, first.frequency)
        count = len(first.autocorrelation)
        np.testing.assert_allclose(second.autocorrelation[:count], first.autocorrelation, atol=1e-9)


def test_joints_without_effort_are_left_out() -> None:
    """Their motion counts; the others' parameters are found as without them."""
    robot = sdpid.load_robot("ur_description/ur5_robot")
    motion = default_motion(robot, 1, period=10.0, periods=2)
    log = sdpid.simulate(robot, motion, seed=1, progress=False)
    effort = np.array(log.effort)
    effort[:, 4] = 0.7
    broken = replace(log, effort=effort, period=None, start=None, periods=None)
    name = robot.joint_names[4]
    result = sdpid.identify(robot, broken, without_effort=[name], validation=broken)
    assert result.certificate.passed
    # The noise is 1 % of the effort; filtered Coulomb steps at reversals add as much.
    assert result.training.relative < 0.02
    assert result.training.rows[4] == 0
    saved = result.to_dict()["training"]["joints"]
    assert saved[name] == {"rmse": None, "nrmse": None, "r2": None, "rows": 0}
    assert not any(name in each for each in result.notes if "never changes" in each)
    assert f"efforts of joint {name} are not used" in result.problem.samples.notes
    assert "every joint" not in result.to_dict()["verdict"][0]
    # With its effort the log is not explained.
    assert sdpid.identify(robot, broken, intervals=False).training.nrmse[4] > 0.1


def test_a_problem_takes_recordings_that_are_prepared(logs: list[sdpid.Recording]) -> None:
    prepared = prepare(arm(), logs)
    one, other = formulate(arm(), prepared), formulate(arm(), logs)
    np.testing.assert_array_equal(one.A, other.A)
    fresh = prepared.others(logs[0])
    assert fresh.processing == replace(prepared.processing, covariance=None)
    assert repr(prepared).startswith("Prepared(")


# Blocks held out in turn: nothing of them reaches the fit, and the figures add up.


FOLDS = 4


@pytest.fixture(scope="module")
def log() -> sdpid.Recording:
    return recorded(1, seconds=24.0)


@pytest.fixture(scope="module")
def crossed(log: sdpid.Recording) -> CrossValidation:
    return sdpid.cross_validate(arm(), log, folds=FOLDS)


def test_a_fold_is_what_it_says(log: sdpid.Recording, crossed: CrossValidation) -> None:
    """The second fold, made by hand."""
    a, b = log.n_samples // FOLDS, 2 * log.n_samples // FOLDS
    kept = [log.rows(slice(0, a)), log.rows(slice(b, log.n_samples))]
    processing = min((default_processing(each) for each in kept), key=lambda p: p.cutoff_hz)
    problem = formulate(arm(), kept, processing=processing)
    assert len(problem.samples.starts) == 2
    estimate = sdpid.solve_sdp(problem)
    fresh = samples_of(arm(), log.rows(slice(a, b)), processing)
    fold = crossed.folds[1]
    assert fold.name == "block 2 of 4"
    assert fold.processing == processing
    assert fold.training == pytest.approx(sdpid.validate(estimate).told.relative, rel=1e-6)
    expected = sdpid.validate(estimate, fresh).told
    np.testing.assert_allclose(fold.held_out.rmse, expected.rmse, rtol=1e-5)
    # Between training and held-out rows lies twice what either filter needs to forget its ends.
    time, held = problem.samples.time, fresh.time
    distance = np.abs(time[:, None] - held[None, :]).min()
    trimmed = held[0] - log.time[a]
    assert trimmed > 0.0
    assert distance >= 1.9 * trimmed


def test_nothing_of_a_block_reaches_its_fit(log: sdpid.Recording, crossed: CrossValidation) -> None:
    """Other efforts and positions in the last block change what is held out, not the fit."""
    cut = 3 * log.n_samples // FOLDS
    effort, position = np.array(log.effort), np.array(log.position)
    effort[cut:] += np.random.default_rng(0).standard_normal(effort[cut:].shape)
    position[cut:] *= 0.9
    other = replace(log, effort=effort, position=position)
    first, second = crossed.folds[-1], sdpid.cross_validate(arm(), other, folds=FOLDS).folds[-1]
    assert first.training == second.training
    assert first.processing == second.processing
    assert second.held_out.relative > 3.0 * first.held_out.relative


def test_the_whole_is_the_sum_of_the_folds(crossed: CrossValidation) -> None:
    rows = np.array([fold.held_out.rows for fold in crossed.folds])
    square = np.array([fold.held_out.rmse**2 for fold in crossed.folds])
    np.testing.assert_allclose(crossed.rmse, np.sqrt((rows * square).sum(0) / rows.sum(0)))
    assert crossed.relatives.min() <= crossed.relative <= crossed.relatives.max()
    assert crossed.spread == pytest.approx(np.std(crossed.relatives, ddof=1))
    assert crossed.count == FOLDS
    assert crossed.relative < 0.02
    lines = crossed.table().splitlines()
    assert len(lines) == FOLDS + 3
    assert lines[-1].startswith("all")
    content = crossed.to_dict()
    assert content["relative_residual"] == crossed.relative
    assert [fold["held_out"] for fold in content["folds"]][-1] == "block 4 of 4"
    assert set(content["rmse"]) == set(arm().joint_names)
    assert len(repr(crossed)) < 200
    assert "block 4 of 4" in crossed._repr_html_()


def test_by_recording_and_in_blocks_of_several() -> None:
    logs = [recorded(1), recorded(2), recorded(3, damping=1.5)]
    crossed = sdpid.cross_validate(arm(), logs, by="recording")
    assert [fold.name for fold in crossed.folds] == [f"recording {i}" for i in (1, 2, 3)]
    # The one with another friction is the one that is not predicted.
    assert int(np.argmax(crossed.relatives)) == 2
    blocks = sdpid.cross_validate(arm(), logs[:2], folds=2)
    assert blocks.folds[0].held_out.rows.sum() > 0
    both = sdpid.cross_validate(arm(), [recorded(i, period=10.0) for i in (1, 2)], by="recording")
    assert both.count == 2


def test_it_is_part_of_an_identification(log: sdpid.Recording) -> None:
    result = sdpid.identify(arm(), log, folds=3, prior=False)
    assert result.cross_validation.count == 3
    assert result.to_dict()["cross_validation"]["relative_residual"] > 0.0
    words = " ".join(result.verdict)
    for told in (result.summary(), words):
        assert "3 blocks of time held out in turn" in told
    assert "Nothing was held out" not in words
    # Blocks that are not predicted.
    effort = np.array(log.effort)
    effort[: len(effort) // 3] *= 1.3
    words = " ".join(sdpid.identify(arm(), replace(log, effort=effort), folds=3).verdict)
    assert "It does not predict what it has not seen" in words


@pytest.mark.parametrize(
    ("options", "words"),
    [
        *(({"folds": folds}, "whole number of at least 2") for folds in (0, 1, 2.5, True)),
        ({"log": recorded(1, period=10.0)}, "repeats one motion"),
        ({"by": "recording"}, "at least two recordings"),
        ({"by": "luck"}, "by is 'luck'"),
        ({"folds": 200}, "without block 1 of 200.*fewer folds"),
        ({"folds": 601}, "1200 samples is too short for 601 blocks"),
    ],
)
def test_what_cannot_be_cross_validated(
    log: sdpid.Recording, options: dict[str, Any], words: str
) -> None:
    refuses(DataError, words, sdpid.cross_validate, arm(), **{"log": log, **options})


# Logs as data frames, joints without effort, and arguments of another kind.


def frame_of(log: sdpid.Recording) -> pd.DataFrame:
    tables = {"position": log.position, "effort": log.effort}
    columns = {
        f"{quantity}_{name}": table[:, j]
        for quantity, table in tables.items()
        for j, name in enumerate(log.names)
    }
    return pd.DataFrame({"time": log.time, **columns})


def test_a_data_frame_is_one_log() -> None:
    frame = frame_of(recorded(1))
    plain = formulate(arm(), recorded(1)).samples
    for given in (frame, [frame]):
        np.testing.assert_array_equal(formulate(arm(), given).samples.effort, plain.effort)


def test_a_joint_left_out_may_lack_every_effort() -> None:
    first, last = arm().joint_names
    frame = frame_of(recorded(1))
    frame[f"effort_{last}"] = np.nan
    words = "no value in any row; leave .* with without_effort="
    refuses(DataError, words, sdpid.read_recording, frame)
    refuses(DataError, "no value in any row", formulate, arm(), frame, without_effort=[first])
    problem = formulate(arm(), frame, without_effort=[last])
    expected = formulate(arm(), recorded(1), without_effort=[last])
    assert not problem.samples.mask[:, -1].any()
    np.testing.assert_array_equal(problem.samples.effort[:, :-1], expected.samples.effort[:, :-1])
    read = sdpid.read_recording(frame, without_effort=[last])
    assert not read.effort[:, -1].any()
