"""Rest is told from motion, and the errors of the two are kept apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdpid.assurance.diagnostics.rest import (
    REST_SECONDS,
    REST_SPEED,
    moving_rows,
    resting,
    resting_rows,
)
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.experiment.processing.samples import Samples

RATE = 100.0


def stopped(still: tuple[int, int]) -> Samples:
    """Return ten seconds of a joint that moves, but for samples in a range."""
    t = np.arange(1000) / RATE
    v = np.cos(2.0 * t)[:, None]
    v[slice(*still)] = 0.0
    return Samples(position=v, velocity=v, acceleration=v, effort=1.0 + v, time=t)


def test_a_stop_is_rest_and_a_reversal_is_not() -> None:
    samples = stopped((300, 400))
    assert np.flatnonzero(resting(samples)[:, 0]).tolist() == list(range(300, 400))
    # Reversals are slow too, and over at once.
    assert np.abs(samples.velocity).min(axis=0) < REST_SPEED
    short = round(REST_SECONDS * RATE) - 5
    assert not resting(stopped((300, 300 + short))).any()


def test_rest_ends_with_the_recording_and_needs_a_time() -> None:
    samples = stopped((300, 400))
    cut = replace(samples, starts=(0, 340))
    # Forty samples before the break are too short, sixty behind it are not.
    assert np.flatnonzero(resting(cut)[:, 0]).tolist() == list(range(340, 400))
    assert not resting(replace(samples, time=None)).any()


def test_rows_masked_around_a_reversal_belong_to_the_motion() -> None:
    samples = stopped((300, 400))
    turn = int(np.flatnonzero(np.diff(np.sign(samples.velocity[:, 0])))[0])
    mask = np.ones((1000, 1), dtype=bool)
    mask[turn - 5 : turn + 5] = False  # a reversal
    mask[300:400] = False  # rest
    mask[600:650] = False  # fast motion, with an effort that is wrong
    assert np.abs(samples.velocity[600:650]).min() > REST_SPEED
    moving = moving_rows(replace(samples, mask=mask))[:, 0]
    assert moving[turn - 5 : turn + 5].all()
    assert not moving[600:650].any()
    still = resting_rows(replace(samples, mask=mask))[:, 0]
    assert np.flatnonzero(still).tolist() == list(range(300, 400))


def test_errors_at_rest_do_not_spoil_those_in_motion() -> None:
    samples = stopped((300, 400))
    predicted = np.array(samples.effort)
    predicted[300:400] += 1.0
    fit = Validation.of_prediction(("joint",), samples, predicted)
    assert fit.resting is not None
    assert fit.moving.rmse[0] == 0.0
    assert fit.resting.rmse[0] == 1.0
    assert (fit.moving.rows[0], fit.resting.rows[0], fit.rows[0]) == (900, 100, 1000)
    assert fit.to_dict()["resting"] is not None
    # Rows masked for slowness are not fitted, and their error at rest is told all the same.
    mask = np.ones((1000, 1), dtype=bool)
    mask[300:400] = False
    masked = Validation.of_prediction(("joint",), replace(samples, mask=mask), predicted)
    assert masked.resting is not None
    assert masked.resting.rmse[0] == 1.0
    assert masked.rmse[0] == 0.0
    # A joint whose effort was not measured has none.
    wide = replace(
        samples,
        **{
            name: np.repeat(getattr(samples, name), 2, axis=1)
            for name in ("position", "velocity", "acceleration", "effort")
        },
        mask=np.column_stack([np.ones(1000, dtype=bool), np.zeros(1000, dtype=bool)]),
    )
    both = Validation.of_prediction(("a", "b"), wide, np.repeat(predicted, 2, axis=1))
    assert both.resting is not None
    assert both.resting.rows.tolist() == [100, 0]
