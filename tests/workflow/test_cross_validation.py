"""Blocks held out in turn: nothing of them reaches the fit, and the figures add up."""

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError
from sdpid.experiment.preparation.for_robot import prepare
from sdpid.experiment.processing.choose import default_processing
from sdpid.workflow.cross_validation import CrossValidation
from sdpid.workflow.formulate import formulate
from tests.helpers.refusals import refuses
from tests.helpers.runs import arm, recorded

FOLDS = 4


@pytest.fixture(scope="module")
def log() -> sdpid.Recording:
    return recorded(1, seconds=24.0)


@pytest.fixture(scope="module")
def crossed(log: sdpid.Recording) -> CrossValidation:
    return sdpid.cross_validate(arm(), log, folds=FOLDS)


def part(log: sdpid.Recording, first: int, last: int) -> sdpid.Recording:
    rows = slice(first, last)
    return replace(log, time=log.time[rows], position=log.position[rows], effort=log.effort[rows])


def test_a_fold_is_what_it_says(log: sdpid.Recording, crossed: CrossValidation) -> None:
    """The second fold, made by hand."""
    a, b = log.n_samples // FOLDS, 2 * log.n_samples // FOLDS
    kept = [part(log, 0, a), part(log, b, log.n_samples)]
    processing = min((default_processing(each) for each in kept), key=lambda p: p.cutoff_hz)
    problem = formulate(arm(), kept, processing=processing)
    assert len(problem.samples.starts) == 2
    estimate = sdpid.solve_sdp(problem)
    fresh = prepare(arm(), part(log, a, b), processing)
    fold = crossed.folds[1]
    assert fold.name == "block 2 of 4"
    assert fold.processing == processing
    assert fold.training == pytest.approx(sdpid.validate(estimate).relative, rel=1e-6)
    expected = sdpid.validate(estimate, fresh)
    np.testing.assert_allclose(fold.held_out.rmse, expected.rmse, rtol=1e-5)
    # Between training and held-out rows lies twice what either filter needs to forget its ends.
    time, held = problem.samples.time, fresh.time
    distance = np.abs(time[:, None] - held[None, :]).min()
    trimmed = held[0] - log.time[a]
    assert trimmed > 0.0
    assert distance >= 1.9 * trimmed


def test_nothing_of_a_block_reaches_its_fit(log: sdpid.Recording) -> None:
    """Other efforts and positions in the last block change what is held out, not the fit."""
    cut = 3 * log.n_samples // FOLDS
    rng = np.random.default_rng(0)
    effort, position = np.array(log.effort), np.array(log.position)
    effort[cut:] += rng.standard_normal(effort[cut:].shape)
    position[cut:] *= 0.9
    other = replace(log, effort=effort, position=position)
    found = [sdpid.cross_validate(arm(), each, folds=FOLDS).folds[-1] for each in (log, other)]
    assert found[0].training == found[1].training
    assert found[0].processing == found[1].processing
    assert found[1].held_out.relative > 3.0 * found[0].held_out.relative


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
    assert "3 blocks of time held out in turn" in result.summary()
    words = " ".join(result.verdict)
    assert "3 blocks of time held out in turn" in words
    assert "Nothing was held out" not in words


def test_the_verdict_tells_when_blocks_are_not_predicted(log: sdpid.Recording) -> None:
    effort = np.array(log.effort)
    effort[: len(effort) // 3] *= 1.3
    words = " ".join(sdpid.identify(arm(), replace(log, effort=effort), folds=3).verdict)
    assert "It does not predict what it has not seen" in words


@pytest.mark.parametrize("folds", [0, 1, 2.5, True])
def test_folds_that_make_no_sense(log: sdpid.Recording, folds: int) -> None:
    refuses(DataError, "whole number of at least 2", sdpid.cross_validate, arm(), log, folds=folds)


def test_what_cannot_be_cross_validated(log: sdpid.Recording) -> None:
    refuses(DataError, "repeats one motion", sdpid.cross_validate, arm(), recorded(1, period=10.0))
    refuses(DataError, "at least two recordings", sdpid.cross_validate, arm(), log, by="recording")
    with pytest.raises(DataError, match="by is 'luck'"):
        sdpid.cross_validate(arm(), log, by="luck")  # type: ignore[arg-type]
    with pytest.raises(DataError, match=r"without block 1 of 200.*fewer folds"):
        sdpid.cross_validate(arm(), log, folds=200)
