"""Samples made of recordings, and what is chosen for a robot and its recordings."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import signal

import sdpid
from sdpid.errors import DataError
from sdpid.experiment.preparation.overview import gaps
from sdpid.experiment.preparation.prepare import (
    chosen_processing,
    default_friction,
    friction_of,
    prepare,
    samples_of,
)
from sdpid.experiment.preparation.twin import Twin
from sdpid.experiment.processing import pipeline
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.filters import Weights, low_pass, stencil
from sdpid.experiment.processing.motion import joint_frequencies, white_noise
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.gaps import make_grid
from sdpid.experiment.recording.recording import Recording, rows_of
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm

RATE = 1000.0
PERIOD = 2.0
ALL_ROWS = Processing(reversal_time=None, covariance=None)


class Tones:
    """A sum of sinusoids a joint, with exact derivatives and exact response to a filter."""

    def __init__(self, seed: int, joints: int = 2, period: float = PERIOD) -> None:
        rng = np.random.default_rng(seed)
        self.omega = 2 * np.pi / period * np.arange(1, 7)
        self.amplitude = rng.uniform(0.1, 0.5, (self.omega.size, joints))
        self.phase = rng.uniform(0, 2 * np.pi, (self.omega.size, joints))
        self.offset = rng.uniform(-1, 1, joints)

    def __call__(self, time: np.ndarray, gain: Any = 1.0, order: int = 0) -> np.ndarray:
        amplitude = self.amplitude * np.broadcast_to(gain, self.omega.shape)[:, None]
        amplitude = amplitude * self.omega[:, None] ** order
        angle = time[:, None, None] * self.omega[:, None] + self.phase + order * np.pi / 2
        return (amplitude * np.sin(angle)).sum(axis=1) + (self.offset if order == 0 else 0.0)


def periodic(
    periods: int = 3, *, lead: float = 0.0, seed: int = 0, noise: float = 0.0, joints: int = 2
) -> sdpid.Recording:
    """Return a record of whole periods with a lead-in and a lead-out of the same motion."""
    count = round((periods * PERIOD + 2 * lead) * RATE)
    time = 7.0 + np.arange(count) / RATE
    rng = np.random.default_rng(seed)
    draw = lambda: noise * rng.standard_normal((count, joints))  # noqa: E731
    return sdpid.Recording(
        time=time,
        position=Tones(seed, joints)(time) + draw(),
        effort=10.0 * Tones(seed + 100, joints)(time) + draw(),
        period=PERIOD,
        start=7.0 + lead,
        periods=periods,
    )


def gains(tones: Tones, rate: float = RATE, **changes: Any) -> np.ndarray:
    """Gains of one zero-phase pass of the default filter, or of a changed one."""
    setting = Processing(**changes)
    return setting.low_pass(rate).gain(tones.omega / (2 * np.pi), rate)


def difference_gains(tones: Tones, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
    """Gains of the differences against the true derivatives at each frequency."""
    places = np.arange(-weights.margin, weights.margin + 1)
    angle = tones.omega[:, None] / RATE * places
    first = (weights.first * np.sin(angle)).sum(axis=1) * RATE / tones.omega
    second = (weights.second * np.cos(angle)).sum(axis=1) * RATE**2 / -(tones.omega**2)
    return first, second


@pytest.mark.parametrize("lead", [0.0, 0.1, 1.5])
@pytest.mark.parametrize("alike", [True, False])
@pytest.mark.parametrize(("order", "derivative"), [(1, "central"), (3, "central4")])
def test_tones_come_out_filtered_and_exact_in_every_sample(
    lead: float, alike: bool, order: int, derivative: Any
):
    log = periodic(lead=lead)
    motion, torque = Tones(0), Tones(100)
    setting = replace(ALL_ROWS, filter_alike=alike, order=order, derivative=derivative)
    samples = process(log, setting)
    assert samples.n_samples == 200
    np.testing.assert_allclose(samples.time, 7.0 + lead + 0.01 * np.arange(200), rtol=1e-14)
    once = gains(motion, order=order)
    inner = once if alike else once**2
    first, second = difference_gains(motion, stencil(derivative))
    time = samples.time
    np.testing.assert_allclose(samples.position, motion(time, once), atol=1e-12)
    np.testing.assert_allclose(samples.effort, 10 * torque(time, once), atol=1e-11)
    np.testing.assert_allclose(samples.velocity, motion(time, inner * first, 1), atol=1e-10)
    # Rounding of positions near 1 rad, divided by the squared step: 2e-16 · 1e6.
    np.testing.assert_allclose(samples.acceleration, motion(time, inner * second, 2), atol=1e-8)


def test_derivatives_are_those_of_the_filtered_signal():
    motion = Tones(0)
    samples = process(periodic(), replace(ALL_ROWS, derivative="central6"))
    gain = gains(motion)
    np.testing.assert_allclose(samples.velocity, motion(samples.time, gain, 1), atol=1e-10)
    np.testing.assert_allclose(samples.acceleration, motion(samples.time, gain, 2), atol=1e-8)
    # The default's second-order differences lose (w h)²/6, here 6e-5 of the fastest tone.
    samples = process(periodic(), ALL_ROWS)
    np.testing.assert_allclose(samples.velocity, motion(samples.time, gain, 1), rtol=0, atol=2e-3)


def test_a_step_through_the_filter():
    step = np.repeat([0.0, 1.0, 0.0], 4000)  # and back: nothing is left but what decays
    found = (once := low_pass("butterworth", 10.0, 4, RATE)).apply(step)
    assert found.max() - 1.0 == pytest.approx(0.068, rel=0.02)
    # What trimming five time constants and a pad of `reach` samples rely on.
    assert np.abs(found[: 4000 - round(5 * once.time_constant)]).max() < 2e-3
    assert np.abs(found[: 4000 - once.reach]).max() < 1e-19
    assert once.gain(10.0, RATE) == pytest.approx(0.5, rel=1e-9)
    # Many numbers are filtered by scipy.signal.
    assert np.allclose(once.apply(np.repeat(step[:, None], 70, axis=1)).T, found, atol=1e-12)


@pytest.mark.parametrize(("trim", "tolerance"), [(None, 5e-2), (0.151, 1e-3), (0.75, 1e-9)])
def test_without_periods_the_ends_are_trimmed(trim: float | None, tolerance: float):
    time = np.arange(6000) / RATE
    motion, torque = Tones(5), Tones(6)
    log = sdpid.Recording(time=time, position=motion(time), effort=torque(time))
    samples = process(log, replace(ALL_ROWS, trim_s=trim, derivative="central6", decimation=1))
    cut = 0.076 if trim is None else trim
    assert samples.time[0] == pytest.approx(cut)
    assert samples.time[-1] == pytest.approx(5.999 - cut)
    gain = gains(motion)
    scale = np.abs(motion(time, 1.0, 2)).max()
    assert np.abs(samples.position - motion(samples.time, gain)).max() < 0.1 * tolerance
    assert np.abs(samples.effort - torque(samples.time, gain)).max() < 0.1 * tolerance
    error = samples.acceleration - motion(samples.time, gain, 2)
    assert np.abs(error).max() < max(tolerance, 2e-9) * scale
    assert (samples.covariance, samples.periods, samples.effort_periods) == (None, None, None)


def test_pieces_do_not_show(monkeypatch: pytest.MonkeyPatch):
    time = np.arange(6000) / RATE
    rng = np.random.default_rng(0)
    log = sdpid.Recording(
        time=time,
        position=Tones(5)(time) + 1e-4 * rng.standard_normal((6000, 2)),
        effort=rng.standard_normal((6000, 2)),
    )
    whole = process(log, Processing(decimation=7))
    monkeypatch.setattr(pipeline, "CHUNK", 500)
    pieces = process(log, Processing(decimation=7))
    for name in ("position", "velocity", "acceleration", "effort"):
        np.testing.assert_allclose(getattr(pieces, name), getattr(whole, name), rtol=0, atol=1e-7)
    np.testing.assert_array_equal(pieces.mask, whole.mask)


def test_paper_is_the_literal_chain():
    """III-C step by step on the whole record, in the paper's order, with SciPy's filtfilt."""
    log = periodic(4, lead=3.0, noise=0.01)
    samples = process(log, Processing.paper())

    b, a = signal.butter(1, 10.0, fs=RATE)

    def low_pass(values: np.ndarray) -> np.ndarray:
        return signal.filtfilt(b, a, values, axis=0)

    torque = low_pass(log.effort)
    position = low_pass(log.position)
    velocity, acceleration = np.zeros_like(position), np.zeros_like(position)
    velocity[1:-1] = (position[2:] - position[:-2]) * RATE / 2
    acceleration[1:-1] = (position[2:] - 2 * position[1:-1] + position[:-2]) * RATE**2
    chain = [position, low_pass(velocity), low_pass(acceleration), torque]
    # Rest and connection phases go, periods are split off, averaged, and decimated.
    split = [values[3000:-3000].reshape(4, 2000, 2)[:, ::10] for values in chain]
    for name, values in zip(("position", "velocity", "acceleration", "effort"), split, strict=True):
        scale = np.abs(values).max()
        expected = values.mean(axis=0)
        np.testing.assert_allclose(getattr(samples, name), expected, rtol=0, atol=1e-10 * scale)
    spread = split[3] - split[3].mean(axis=0)
    sigma = np.einsum("pki,pkj->kij", spread, spread) / 3
    np.testing.assert_allclose(samples.covariance, sigma, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(samples.effort_periods, split[3], rtol=0, atol=1e-10)
    assert samples.mask is None
    assert samples.periods == 4


def test_defaults():
    settings_ = Processing()
    assert (settings_.cutoff_hz, settings_.order, settings_.decimation) == (15.0, 2, 10)
    assert settings_.filter_alike
    samples = process(periodic(4, noise=0.01))
    assert samples.mask is not None
    assert 0 < samples.n_rows < samples.effort.size
    assert samples.covariance.shape == (200, 2, 2)
    assert samples.block == 100
    assert any("mean of 4 periods of 2000 samples" in note for note in samples.notes)


@settings(max_examples=10, deadline=None)
@given(periods=st.integers(1, 5), seed=st.integers(0, 99))
def test_averaging_and_filtering_commute(periods: int, seed: int):
    log = periodic(periods, seed=seed, noise=0.01)
    fold = lambda values: values.reshape(periods, -1, 2).mean(axis=0)  # noqa: E731
    mean = sdpid.Recording(
        time=log.time[:2000],
        position=fold(log.position),
        effort=fold(log.effort),
        period=PERIOD,
    )
    setting = Processing(covariance=None, reversal_time=0.01)
    samples, expected = process(log, setting), process(mean, setting)
    for name, tolerance in (("position", 1e-12), ("velocity", 1e-9), ("acceleration", 1e-6)):
        a, b = getattr(samples, name), getattr(expected, name)
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)
    np.testing.assert_allclose(samples.effort, expected.effort, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(samples.mask, expected.mask)


@settings(max_examples=10, deadline=None)
@given(shift=st.integers(0, 199), alike=st.booleans())
def test_a_periodic_record_may_begin_anywhere(shift: int, alike: bool):
    log = periodic(2, noise=0.0)
    rolled = replace(
        log,
        position=np.roll(log.position, -10 * shift, axis=0),
        effort=np.roll(log.effort, -10 * shift, axis=0),
    )
    setting = Processing(covariance=None, filter_alike=alike)
    samples, moved = process(log, setting), process(rolled, setting)
    for name in ("position", "effort", "mask"):
        expected = np.roll(getattr(samples, name), -shift, axis=0)
        np.testing.assert_allclose(getattr(moved, name), expected, rtol=0, atol=1e-11)
    expected = np.roll(samples.acceleration, -shift, axis=0)
    np.testing.assert_allclose(moved.acceleration, expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize("periods", [None, 2])
@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 99),
    speed=st.sampled_from([0.0, 0.02, 0.3]),
    reach=st.sampled_from([0.0, 0.004, 0.05, 0.1]),
)
# Joint 1 reverses between the last row that is kept and the first that is trimmed.
@example(seed=67, speed=0.0, reach=0.0)
def test_mask_by_its_definition(periods: int | None, seed: int, speed: float, reach: float):
    log = periodic(2, seed=seed)
    if periods is None:
        log = replace(log, period=None, start=None, periods=None)
    setting = Processing(
        covariance=None,
        decimation=1,
        reversal_speed=speed,
        reversal_time=None,
        trim_s=None if periods else 0.0,
    )
    full = process(log, setting).velocity
    trim = 0 if periods else 400
    setting = replace(setting, reversal_time=reach, trim_s=None if periods else 0.4)
    count = full.shape[0]
    within = round(reach * RATE)
    expected = np.ones((count, log.n), dtype=bool)
    for j in range(log.n):
        sign = full[:, j] >= 0
        for i in range(count):
            after, before = (i + 1) % count, (i - 1) % count
            turns = sign[i] != sign[after] and (periods or i + 1 < count)
            turned = sign[i] != sign[before] and (periods or i > 0)
            if abs(full[i, j]) < speed or turns or turned:
                near = np.arange(i - within, i + within + 1)
                near = near % count if periods else near[(near >= 0) & (near < count)]
                expected[near, j] = False
    expected = expected[trim : count - trim]
    if not expected.any(axis=0).all():
        refuses(DataError, "leaves no row of joint", process, log, setting)
        return
    np.testing.assert_array_equal(process(log, setting).mask, expected)


def test_a_joint_at_rest_is_named():
    log = periodic(2)
    position = log.position.copy()
    position[:, 1] = 0.3
    log = replace(log, position=position, joint_names=("waist", "wrist"))
    with pytest.raises(
        DataError,
        match=r"no row of joint wrist: .* 0.1 s away .* below 0.02 rad/s.*reversal_time=None",
    ):
        process(log, Processing(covariance=None))
    assert process(log, ALL_ROWS).mask is None


def test_a_coulomb_step_is_forgotten_where_rows_are_used():
    log = periodic(2)
    sign = np.sign(Tones(0)(log.time, 1.0, 1))
    samples = process(replace(log, effort=sign), Processing(covariance=None))
    error = np.abs(samples.effort - np.sign(samples.velocity))
    assert 0 < samples.n_rows < error.size
    # The step is 2 and the mask spans 6.7 time constants of the filter: exp(-6.7) = 1.2e-3. A
    # second pass would leave 4 times as much.
    assert error[samples.mask].max() < 2e-3
    assert error[~samples.mask].max() > 0.5


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, "order 2 at 15 Hz: all signals once"),
        ({"filter_alike": False}, "position and torque once, velocity and acceleration twice"),
        (
            {"filter_alike": False, "velocity": "measured"},
            "position, velocity and torque once, acceleration twice",
        ),
    ],
)
def test_notes_say_how_often_what_was_filtered(changes: dict[str, Any], expected: str):
    log = periodic(2)
    log = replace(log, velocity=Tones(0)(log.time, 1.0, 1))
    assert any(expected in note for note in process(log, replace(ALL_ROWS, **changes)).notes)


def test_covariance_of_the_periods():
    log = periodic(5, noise=0.5)
    samples = process(log)
    for k in (0, 17, 199):
        expected = np.cov(samples.effort_periods[:, k].T)
        np.testing.assert_allclose(samples.covariance[k], expected, rtol=1e-9)
    np.testing.assert_allclose(samples.effort_periods.mean(axis=0), samples.effort, rtol=1e-12)
    pooled = process(log, Processing(covariance="pooled")).covariance
    np.testing.assert_allclose(pooled, samples.covariance.mean(axis=0), rtol=1e-12)
    shrunk = process(log, Processing(shrinkage=0.3)).covariance
    np.testing.assert_allclose(shrunk, 0.7 * samples.covariance + 0.3 * pooled, rtol=1e-9)
    assert process(log, Processing(covariance=None)).covariance is None


def test_too_few_periods_for_a_covariance():
    log = periodic(2, noise=0.5)
    refuses(DataError, r"2 periods for 2 joints: .* at least 3 periods", process, log, Processing())
    shrunk = process(log, Processing(shrinkage=0.1)).covariance
    assert np.linalg.eigvalsh(shrunk).min() > 0
    assert process(log, Processing(covariance="pooled")).covariance.shape == (2, 2)
    single = periodic(1)
    with pytest.raises(DataError, match="has 1, a covariance needs at least 2"):
        process(single, Processing(covariance="pooled"))
    assert process(single, ALL_ROWS).effort_periods is None


def test_the_default_is_what_identify_chooses():
    rng = np.random.default_rng(1)
    time = np.arange(4000) / 200.0
    position = np.sin(2.0 * np.pi * time[:, None] * np.array([0.3, 0.5])) + 1.0
    log = sdpid.Recording(time=time, position=position, effort=rng.normal(size=position.shape))
    for each in (log, periodic(12, noise=0.5), periodic(2, noise=0.5), periodic(1)):
        own, chosen = process(each), process(each, default_processing(each))
        assert own.notes == chosen.notes
        np.testing.assert_array_equal(own.acceleration, chosen.acceleration)
        assert (own.mask is None) == (chosen.mask is None)
    short, long = process(log).mask, process(log, Processing()).mask
    assert 0.0 < 1.0 - short.mean() < 0.5 * (1.0 - long.mean())


def test_degrees_are_refused():
    log = periodic(3)
    far = replace(log, position=np.degrees(log.position) * 2.0)
    refuses(DataError, "looks like degrees", process, far)
    # The limits of the robot say that its joints do turn that far.
    assert process(far, ALL_ROWS, position_limits=[(-1e3, 1e3)] * 2).n == 2


@pytest.mark.parametrize("size", [20.0, 1e4, 1e12])
def test_an_outlier_is_named(size: float):
    log = periodic(3)
    position = log.position.copy()
    position[77, 1] += size
    with pytest.raises(DataError, match=r"joint 2 jumps by .* at sample 78 of .*: an outlier"):
        process(replace(log, position=position))
    # A step in the counter by whole turns is no outlier.
    position[77:, 1] = log.position[77:, 1] + 6.0 * np.pi
    assert process(replace(log, position=position, period=None, start=None, periods=None)).n == 2


@pytest.mark.parametrize(
    "changes",
    [
        *({"cutoff_hz": value} for value in ("10", 1e-308, 0.0, np.nan)),
        *({"order": value} for value in (10**20, 2.5, None, 0)),
        *({"decimation": value} for value in ("2", 2.5)),
        *({"reversal_time": value} for value in (1e300, -1.0)),
        *({"reversal_speed": value} for value in (np.nan, -1.0)),
        *({"trim_s": value} for value in (True, np.inf)),
        *({"shrinkage": value} for value in (1.1, 1.5)),
        {"covariance": "all"},
        *({name: "x"} for name in ("velocity", "timing", "filter", "derivative")),
    ],
)
def test_settings_out_of_range_are_refused(changes: dict):
    (name,) = changes
    refuses(DataError, rf"{name}: is .*, expected", Processing, **changes)
    refuses(DataError, rf"{name}: is .*, expected", chosen_processing, [periodic(3)], changes)


def test_settings_print_what_differs_from_the_defaults():
    assert repr(Processing()) == "Processing()"
    changed = Processing(cutoff_hz=8.0, trim_s=0.5)
    assert repr(changed) == "Processing(cutoff_hz=8.0, trim_s=0.5)"
    assert eval(repr(changed)) == changed


@pytest.mark.parametrize("wrong", [{"cutof_hz": 10.0}, {"reasons": ()}, 10.0, "paper", {1: 2}])
def test_what_is_no_setting_is_refused(wrong: object):
    refuses(DataError, r"processing: (has no setting|is)", chosen_processing, [periodic(3)], wrong)
    refuses(DataError, r"processing: (has no setting|is)", process, periodic(3), wrong)


def test_noise_free_periods_are_noticed():
    assert any("repeats exactly" in note for note in process(periodic(3)).notes)


def test_periods_that_do_not_repeat():
    log = periodic(3)
    with pytest.raises(DataError, match="periods of joint 1 do not repeat"):
        process(replace(log, period=1.5, periods=4), Processing(covariance=None))


def test_joints_do_not_mix():
    log = periodic(3, noise=0.1)
    swapped = replace(log, position=log.position[:, ::-1], effort=log.effort[:, ::-1])
    setting = Processing(covariance=None)
    samples, other = process(log, setting), process(swapped, setting)
    for name in ("position", "velocity", "acceleration", "effort", "mask"):
        np.testing.assert_array_equal(getattr(samples, name)[:, ::-1], getattr(other, name))


@pytest.mark.parametrize("alike", [True, False])
def test_measured_velocity(alike: bool):
    log = periodic(2)
    motion = Tones(0)
    log = replace(log, velocity=motion(log.time, 1.0, 1))
    setting = replace(ALL_ROWS, velocity="measured", filter_alike=alike, derivative="central6")
    samples = process(log, setting)
    once = gains(motion)
    np.testing.assert_allclose(samples.velocity, motion(samples.time, once, 1), atol=1e-11)
    expected = motion(samples.time, once if alike else once**2, 2)
    np.testing.assert_allclose(samples.acceleration, expected, atol=1e-8)
    refuses(DataError, "velocity: the recording has none", process, periodic(2), setting)


def test_decimation_by_the_papers_rule():
    for cutoff, kept in ((10.0, 200), (25.0, 500), (5.0, 100), (200.0, 2000)):
        setting = replace(ALL_ROWS, decimation=None, cutoff_hz=cutoff)
        assert process(periodic(2), setting).n_samples == kept


def test_cutoff_and_length_are_checked():
    with pytest.raises(DataError, match="500 Hz is not below half the sample rate of 1000 Hz"):
        process(periodic(2), replace(ALL_ROWS, cutoff_hz=500.0))
    still = np.zeros((50, 1))
    short = sdpid.Recording(time=np.arange(50) / RATE, position=still, effort=still)
    with pytest.raises(DataError, match=r"lasts 0.049 s, and 0.076 s are cut off at either end"):
        process(short, ALL_ROWS)
    assert process(short, replace(ALL_ROWS, trim_s=0.0)).n_samples == 5


def jittered(kind: str, jitter: float, seed: int = 0) -> tuple[sdpid.Recording, Tones]:
    """Regular samples with jittered stamps, or jittered samples with true stamps."""
    rng = np.random.default_rng(seed)
    regular = np.arange(4000) / RATE
    stamps = regular + rng.uniform(-jitter, jitter, regular.size) / RATE
    if kind == "drift":
        stamps = regular * (1.0 + 0.01 * regular)
    taken = regular if kind == "stamps" else stamps
    motion = Tones(seed)
    return sdpid.Recording(time=stamps, position=motion(taken), effort=motion(taken)), motion


@pytest.mark.parametrize(("kind", "resampled"), [("stamps", 0), ("samples", 1), ("drift", 1)])
def test_timing_is_decided_by_what_the_motion_says(kind: str, resampled: int):
    log, motion = jittered(kind, 0.3)
    samples = process(log, replace(ALL_ROWS, trim_s=0.8, derivative="central6"))
    assert ("resampled" if resampled else "taken as regular") in samples.notes[0]
    gain = gains(motion, log.rate_hz)
    expected = motion(samples.time, gain, 1)
    # The nominal clock begins with its first stamp, which may be late by 0.3 ms.
    late = 0.0 if resampled else 3e-4
    bounds = [np.abs(motion(samples.time, 1.0, order)).max() for order in (1, 2)]
    error = samples.position - motion(samples.time, gain)
    assert np.abs(error).max() < 1e-4 + late * bounds[0]
    assert np.abs(samples.velocity - expected).max() < 5e-3 + late * bounds[1]


def test_timing_as_asked():
    log, motion = jittered("samples", 0.3)
    resampled = process(log, replace(ALL_ROWS, timing="resample", trim_s=0.8))
    nominal = process(log, replace(ALL_ROWS, timing="nominal", trim_s=0.8))
    gain = gains(motion, log.rate_hz)
    errors = [
        np.abs(samples.acceleration - motion(samples.time, gain, 2)).max()
        for samples in (resampled, nominal)
    ]
    assert 10 * errors[0] < errors[1]


def test_lost_samples_are_bridged_and_gaps_are_not():
    log = periodic(3)
    keep = np.ones(log.n_samples, dtype=bool)
    keep[[500, 1500, 1501, 4000]] = False
    bridged = process(rows_of(log, keep), ALL_ROWS)
    assert "resampled" in bridged.notes[0]
    whole = process(log, ALL_ROWS)
    np.testing.assert_allclose(bridged.acceleration, whole.acceleration, rtol=0, atol=1e-5)
    keep[1495:1510] = False
    with pytest.raises(
        DataError, match=r"gap of 0.016 s before row 1495 \(from 8.494 s to 8.51 s\)"
    ):
        process(rows_of(log, keep), ALL_ROWS)
    keep = np.ones(log.n_samples, dtype=bool)
    keep[500] = False
    with pytest.raises(DataError, match="samples were lost; use timing='resample'"):
        process(rows_of(log, keep), replace(ALL_ROWS, timing="nominal"))


def test_stamps_since_1970_are_uniform():
    log = periodic(3)
    shifted = replace(log, time=log.time + 1.7e9, start=log.start + 1.7e9)
    samples, expected = process(shifted, ALL_ROWS), process(log, ALL_ROWS)
    assert not any("jitter" in note for note in samples.notes)
    np.testing.assert_allclose(samples.acceleration, expected.acceleration, rtol=0, atol=1e-6)


REAL = {
    "kuka_lwr4plus/measurements_1.npz": ("taken as regular, 200", 200.0),
    "kuka_lwr4plus/measurements_2.npz": ("taken as regular, 200", 200.0),
    "panda_unisa/panda_exciting.npz": ("taken as regular, 29.99", 30.0),
    "ur10_unisa/ur10_exciting.npz": (None, 125.0),
}


@pytest.mark.parametrize("name", REAL)
def test_real_logs(data_folder: Path, name: str):
    note, rate = REAL[name]
    log = sdpid.read_recording(data_folder / name)
    grid = make_grid(log)
    assert (grid.note is None) if note is None else (note in grid.note)
    setting = Processing(cutoff_hz=4.0, order=4, decimation=1, covariance=None, trim_s=0.5)
    samples = process(log, setting)
    assert samples.periods is None
    assert samples.mask.mean(axis=0).min() > 0.2
    assert samples.block >= rate * 0.99
    inner = slice(round(0.5 * rate), -round(0.5 * rate))
    error = samples.velocity - log.velocity[inner][: samples.n_samples]
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(log.velocity**2))


@pytest.mark.parametrize("place", [0.4, -3.0])
def test_a_joint_that_stands_still_has_no_velocity(place: float) -> None:
    log = periodic()
    position = np.array(log.position)
    position[:, 0] = place
    standing = sdpid.Recording(time=log.time, position=position, effort=log.effort)
    samples = process(standing)
    np.testing.assert_allclose(samples.position[:, 0], place, rtol=1e-9)
    assert not samples.velocity[:, 0].any()
    assert not samples.acceleration[:, 0].any()
    assert samples.velocity[:, 1].any()


# Recordings prepared for a robot: what is chosen for them, and other motions beside them.


# Relative residual in % that default settings must reach on motion that was not trained on.
TARGETS = {
    "ur10_unisa/ur10": (("ur10_exciting",), 7.7),
    "panda_unisa/panda": (("panda_exciting",), 1.80),
    "kuka_lwr4plus/kuka_lwr4": (("measurements_1", "measurements_2"), 2.7),
    "staubli_tx40/tx40": (("tx40_rows_0_24750",), 7.0),
    "kinova_gen3_dynamapp/gen3": (("opti_traj_testing1", "opti_traj_testing2"), 16.0),
}

# The user's own knowledge: the TX40's efforts are those of motors, two of which share joints.
WRIST = ("rotor_inertia", sdpid.friction.Coupling("joint_5", "joint_6", width=0.05))


def sine(rate: float, seconds: float, hertz: float, joints: int = 2) -> sdpid.Recording:
    time = np.arange(round(rate * seconds)) / rate
    position = np.sin(2.0 * np.pi * hertz * time)[:, None] * np.ones(joints)
    return sdpid.Recording(time=time, position=position, effort=position)


def test_the_cut_off_follows_the_motion() -> None:
    slow = default_processing(sine(1000.0, 20.0, 0.5))
    # 95 % of a windowed sine lie below its frequency and one or two steps of the spectrum, 0.05 Hz.
    assert 25.0 * 0.5 <= slow.cutoff_hz <= 25.0 * 0.61
    assert (slow.order, slow.derivative, slow.velocity) == (4, "central4", "differentiated")
    assert slow.reversal_time == pytest.approx(0.1 / slow.cutoff_hz)
    fast = default_processing(sine(1000.0, 20.0, 10.0))
    assert fast.cutoff_hz == pytest.approx(1000.0 / 7.5)


def test_default_among_friction_terms_stands_for_the_default_ones() -> None:
    log = sine(100.0, 10.0, 0.5)
    usual = default_friction(log)
    assert friction_of(log, None) == friction_of(log, ("default",)) == usual
    assert friction_of(log, ("default", "stribeck")) == (*usual, "stribeck")
    assert friction_of(log, ("viscous",)) == ("viscous",)


@pytest.mark.parametrize(("rate", "expected"), [(30.0, "measured"), (200.0, "differentiated")])
def test_a_measured_velocity_serves_at_low_rates(rate: float, expected: str) -> None:
    log = sine(rate, 20.0, 0.2)
    velocity = np.gradient(log.position, log.time, axis=0)
    assert default_processing(replace(log, velocity=velocity)).velocity == expected
    # What is no velocity of these positions does not serve.
    wrong = default_processing(replace(log, velocity=log.position))
    assert wrong.velocity == "differentiated"
    assert default_processing(log).velocity == "differentiated"


def test_friction_of_records_with_and_without_periods() -> None:
    log = sine(100.0, 10.0, 0.5)
    assert default_friction(replace(log, period=2.0)) == ("coulomb", "viscous")
    sign, sigmoid, *others = default_friction(log)
    assert sign == sdpid.friction.Coulomb(width=0.005)
    assert sigmoid == sdpid.friction.SigmoidFriction(velocity=None)
    assert others == ["viscous", "offset"]


def test_a_joint_that_rests_does_not_stop_the_default() -> None:
    robot = sdpid.load_robot("denso_vp6242")
    robot = replace(robot, prior=np.tile([3.0, 0, 0, 0.3, 0.1, 0, 0.1, 0, 0, 0.1], (6, 1)))
    time = np.arange(0.0, 20.0, 0.01)
    phase = time[:, None] * np.array([1.0, 1.3, 1.7, 0.0, 2.1, 2.6])
    state = np.sin(phase), np.gradient(np.sin(phase), 0.01, axis=0)
    effort = robot.inverse_dynamics(robot.prior, *state, np.gradient(state[1], 0.01, axis=0))
    effort += 2.0 * np.tanh(state[1] / 0.3)
    log = sdpid.Recording(time=time, position=state[0], effort=effort)
    result = sdpid.identify(robot, log)
    assert result.certificate.passed
    assert result.training.relative < 0.01


@pytest.mark.parametrize("case", TARGETS)
def test_held_out_motion_of_real_robots(data_folder: Path, case: str) -> None:
    runs, target = TARGETS[case]
    urdf = data_folder / f"{case}.urdf"
    logs = [sdpid.read_recording(urdf.parent / f"{run}.npz") for run in runs]
    log, other = logs[0], logs[-1]
    if len(logs) == 1:
        log = rows_of(log, slice(round(0.6 * log.n_samples)))
    robot = sdpid.load_robot(urdf)
    friction = (*default_friction(log), *(WRIST if "tx40" in case else ()))
    # Everything is chosen from, and only from, what is trained on.
    result = sdpid.identify(robot, log, friction=friction)
    fresh = samples_of(robot, other, default_processing(log))
    if len(logs) == 1:
        assert fresh.time is not None
        begin = int(np.searchsorted(fresh.time, log.time[-1], side="right"))
        fresh = fresh.between(begin, fresh.n_samples)
    assert result.certificate.passed
    assert 100.0 * sdpid.validate(result.estimate, fresh).relative <= target


LOW_RATE = 200.0
LOW_T = np.arange(2000) / LOW_RATE


def test_noise_is_told_from_motion():
    rng = np.random.default_rng(0)
    motion = np.sin(2.0 * np.pi * LOW_T)
    for sigma in (1e-4, 1e-2):
        assert white_noise(motion + rng.normal(0.0, sigma, LOW_T.size)) == pytest.approx(
            sigma, rel=0.1
        )
    assert white_noise(motion) < 1e-5
    assert white_noise(np.zeros(3)) == 0.0


def test_spectrum_of_two_tones():
    column = 3.0 + np.sin(2.0 * np.pi * 2.0 * LOW_T) + 0.5 * np.sin(2.0 * np.pi * 8.0 * LOW_T)
    position = np.column_stack([column, np.ones_like(column)])
    log = Recording(time=LOW_T, position=position, effort=position)
    (dominant, below), still = joint_frequencies(log)
    assert dominant == pytest.approx(2.0, abs=0.11)
    assert below == pytest.approx(8.0, abs=0.2)
    assert still is None


def test_gaps_are_counted():
    log = Recording(time=LOW_T, position=np.sin(LOW_T)[:, None], effort=np.sin(LOW_T)[:, None])
    assert gaps(log)["gaps"] == 0
    keep = np.ones(LOW_T.size, dtype=bool)
    keep[100:103] = keep[500:502] = False
    found = gaps(rows_of(log, keep))
    assert (found["gaps"], found["longest_step_row"]) == (2, 100)
    assert found["longest_step_s"] == pytest.approx(4.0 / LOW_RATE)


# Another motion of a recording, aligned row by row with the measured one.


@pytest.fixture(scope="module")
def arm() -> sdpid.RobotModel:
    return small_arm(2)


def moved(time: np.ndarray, slow: float = 1.0) -> np.ndarray:
    """Return a motion with a period of 2 s."""
    angle = np.pi * slow * time
    return np.stack([np.sin(angle) + 0.3 * np.sin(3.0 * angle), np.cos(2.0 * angle)], axis=1)


def recorded(time: np.ndarray, arm: sdpid.RobotModel, **fields: object) -> sdpid.Recording:
    rng = np.random.default_rng(0)
    position = moved(time) + 1e-3 * rng.standard_normal((len(time), 2))
    names = arm.joint_names
    effort = rng.standard_normal((len(time), 2))
    return sdpid.Recording(time=time, position=position, effort=effort, joint_names=names, **fields)


CLOCK = np.arange(2000) / 200.0
JITTERY = CLOCK + 5e-4 * np.random.default_rng(1).uniform(-1.0, 1.0, CLOCK.size)


@pytest.mark.parametrize(
    ("logs", "processing"),
    [
        pytest.param([(CLOCK, {"period": 2.0})], None, id="periods"),
        pytest.param([(CLOCK, {"period": 2.0})], sdpid.Processing.paper(), id="paper"),
        pytest.param([(CLOCK, {})], None, id="one record"),
        # The second piece is too short to be filtered.
        pytest.param([(np.delete(CLOCK, np.r_[600:640, 660:700]), {})], None, id="gaps"),
        pytest.param([(CLOCK, {}), (JITTERY[:1500], {})], {"cutoff_hz": 12.0}, id="several"),
        pytest.param(
            [(JITTERY, {})], sdpid.Processing(timing="resample", decimation=3), id="interpolated"
        ),
    ],
)
def test_a_twin_is_what_processing_that_motion_gives(
    arm: sdpid.RobotModel, logs: list, processing: sdpid.Processing | None
) -> None:
    records = [recorded(time, arm, **fields) for time, fields in logs]
    prepared = prepare(arm, records, processing)
    twin = Twin.of(arm, records, prepared.processing, measured=prepared.samples)
    measured = twin.measured
    # The measured motion is its own twin, to the last bit.
    same = twin.samples([log.position for log in records])
    # Another motion, with efforts of its own, is what it would be on its own.
    motion = [1.1 * moved(log.time, 0.5 if log.period is None else 1.0) for log in records]
    efforts = [np.cos(q) for q in motion]
    other = twin.samples(motion, effort=efforts)
    alone = prepare(
        arm,
        [
            replace(log, position=q, effort=e)
            for log, q, e in zip(records, motion, efforts, strict=True)
        ],
        prepared.processing,
    ).samples
    for name in ("position", "velocity", "acceleration", "effort"):
        np.testing.assert_array_equal(getattr(same, name), getattr(measured, name))
        np.testing.assert_allclose(getattr(other, name), getattr(alone, name), atol=1e-12)
    if measured.wide is not None:
        for mine, theirs in zip(other.wide, alone.wide, strict=True):
            np.testing.assert_allclose(mine.velocity, theirs.velocity, atol=1e-12)
    # What is not motion is the measurement's.
    for name in ("mask", "covariance", "time", "block", "starts", "periods", "notes"):
        np.testing.assert_array_equal(getattr(other, name), getattr(measured, name))
    assert (same.effort_periods is None) == (measured.effort_periods is None)
    assert other.effort_periods is None


def test_a_measured_velocity_is_replaced_too(arm: sdpid.RobotModel) -> None:
    time = np.arange(900) / 30.0
    log = replace(recorded(time, arm), velocity=np.gradient(moved(time), time, axis=0))
    twin = Twin.of(arm, log)
    assert twin.processing.velocity == "measured"
    motion = moved(time, 0.5)
    rate = np.gradient(motion, time, axis=0, edge_order=2)
    given, splined = twin.samples(motion, velocity=rate), twin.samples(motion)
    assert np.abs(given.velocity - splined.velocity).max() < 0.02
    assert np.abs(splined.velocity - twin.measured.velocity).max() > 1.0


def test_what_does_not_belong_together_is_refused(arm: sdpid.RobotModel) -> None:
    log = recorded(CLOCK, arm)
    samples = sdpid.process(log, {"cutoff_hz": 10.0})
    with pytest.raises(DataError, match=r"recording: its position, processed.*same processing"):
        Twin.of(arm, log, {"cutoff_hz": 9.0, "decimation": 2}, measured=of_another_cut_off(log))
    with pytest.raises(DataError, match=r"is processed to .* samples, the problem's pieces have"):
        Twin.of(arm, log, {"decimation": 7}, measured=samples)
    twin = Twin.of(arm, log, {"cutoff_hz": 10.0}, measured=samples)
    assert repr(twin).startswith("Twin(1 recordings of ")
    with pytest.raises(DataError, match=r"position: has shape \(10, 2\), expected \(2000, 2\)"):
        twin.samples(np.zeros((10, 2)))
    with pytest.raises(DataError, match="position: has 2 arrays for 1 recordings"):
        twin.samples([log.position, log.position])
    refuses(DataError, "position", twin.samples, np.full((2000, 2), np.nan))


def of_another_cut_off(log: sdpid.Recording) -> sdpid.Samples:
    """Return samples of another cut-off with as many samples."""
    trimmed = sdpid.process(log, {"cutoff_hz": 9.0, "decimation": 2})
    trim = float(trimmed.time[0])
    return sdpid.process(log, {"cutoff_hz": 10.0, "decimation": 2, "trim_s": trim})
