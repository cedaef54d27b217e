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
from sdpid import Recording
from sdpid.errors import DataError
from sdpid.experiment.preparation.overview import overview
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
from sdpid.experiment.processing.motion import joint_frequencies, power_density, white_noise
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.settings import Processing
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm

RATE = 1000.0
PERIOD = 2.0
ALL_ROWS = Processing(reversal_time=None, covariance=None)
STATES = ("position", "velocity", "acceleration", "effort")


@pytest.fixture(scope="module", autouse=True)
def short_parts() -> Any:
    """Filter records without periods in parts of less than a second: they must not show."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline, "CHUNK", 700)
        yield


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
) -> Recording:
    """Return a record of whole periods with a lead-in and a lead-out of the same motion."""
    count = round((periods * PERIOD + 2 * lead) * RATE)
    time = 7.0 + np.arange(count) / RATE
    rng = np.random.default_rng(seed)
    draw = lambda: noise * rng.standard_normal((count, joints))  # noqa: E731
    return Recording(
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
@pytest.mark.parametrize(
    ("order", "derivative", "velocity"),
    [
        (1, "central", "differentiated"),
        (3, "central4", "differentiated"),
        (2, "central6", "measured"),
    ],
)
def test_tones_come_out_filtered_and_exact_in_every_sample(
    lead: float, alike: bool, order: int, derivative: Any, velocity: Any
):
    motion, torque = Tones(0), Tones(100)
    log = periodic(lead=lead)
    log = replace(log, velocity=motion(log.time, 1.0, 1))
    changes = {"order": order, "derivative": derivative, "velocity": velocity}
    samples = process(log, replace(ALL_ROWS, filter_alike=alike, **changes))
    assert samples.n_samples == 200
    time = samples.time
    np.testing.assert_allclose(time, 7.0 + lead + 0.01 * np.arange(200), rtol=1e-14)
    once = gains(motion, order=order)
    first, second = difference_gains(motion, stencil(derivative))
    inner = once if alike else once**2
    rates = (inner * first, inner * second) if velocity != "measured" else (once, inner * first)
    # Rounding of positions near 1 rad, divided by the step: 2e-16 · 1e3, and by its square.
    expected = (motion(time, once), motion(time, rates[0], 1), motion(time, rates[1], 2))
    for name, wanted, tolerance in zip(
        STATES, (*expected, 10 * torque(time, once)), (1e-12, 1e-10, 1e-8, 1e-11), strict=True
    ):
        np.testing.assert_allclose(getattr(samples, name), wanted, rtol=0, atol=tolerance)
    # What differences lose: with second order (w h)²/6 of the fastest tone, here 6e-5.
    most = {"central": 1e-4, "central4": 1e-7, "central6": 1e-10}[derivative]
    assert np.abs([first - 1.0, second - 1.0]).max() < most
    how = {
        (True, velocity): f"order {order} at 15 Hz: all signals once",
        (False, "differentiated"): "position and torque once, velocity and acceleration twice",
        (False, "measured"): "position, velocity and torque once, acceleration twice",
    }
    assert any(how[alike, velocity] in note for note in samples.notes)


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
    log = Recording(time=time, position=motion(time), effort=torque(time))
    samples = process(log, replace(ALL_ROWS, trim_s=trim, derivative="central6", decimation=1))
    cut = 0.076 if trim is None else trim
    np.testing.assert_allclose(samples.time[[0, -1]], [cut, 5.999 - cut])
    gain = gains(motion)
    scale = np.abs(motion(time, 1.0, 2)).max()
    assert np.abs(samples.position - motion(samples.time, gain)).max() < 0.1 * tolerance
    assert np.abs(samples.effort - torque(samples.time, gain)).max() < 0.1 * tolerance
    error = samples.acceleration - motion(samples.time, gain, 2)
    assert np.abs(error).max() < max(tolerance, 2e-9) * scale
    assert (samples.covariance, samples.periods, samples.effort_periods) == (None, None, None)


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
    for name, values in zip(STATES, split, strict=True):
        scale = np.abs(values).max()
        expected = values.mean(axis=0)
        np.testing.assert_allclose(getattr(samples, name), expected, rtol=0, atol=1e-10 * scale)
    spread = split[3] - split[3].mean(axis=0)
    sigma = np.einsum("pki,pkj->kij", spread, spread) / 3
    np.testing.assert_allclose(samples.covariance, sigma, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(samples.effort_periods, split[3], rtol=0, atol=1e-10)
    assert samples.mask is None
    assert samples.periods == 4


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
    count, within = len(full), round(reach * RATE)
    turned = (full >= 0) != (np.roll(full, 1, axis=0) >= 0)
    turned[0] &= periods is not None
    expected = np.ones(full.shape, dtype=bool)
    for i, j in np.argwhere((np.abs(full) < speed) | turned | np.roll(turned, -1, axis=0)):
        near = np.arange(i - within, i + within + 1)
        expected[near % count if periods else near[(near >= 0) & (near < count)], j] = False
    expected = expected[trim : count - trim]
    if not expected.any(axis=0).all():
        refuses(DataError, "leaves no row of joint", process, log, setting)
        return
    np.testing.assert_array_equal(process(log, setting).mask, expected)


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


def test_covariance_of_the_periods():
    log = periodic(5, noise=0.5)
    samples = process(log)
    assert samples.block == 100
    assert any("mean of 5 periods of 2000 samples" in note for note in samples.notes)
    for k in (0, 17, 199):
        expected = np.cov(samples.effort_periods[:, k].T)
        np.testing.assert_allclose(samples.covariance[k], expected, rtol=1e-9)
    np.testing.assert_allclose(samples.effort_periods.mean(axis=0), samples.effort, rtol=1e-12)
    pooled = process(log, Processing(covariance="pooled")).covariance
    np.testing.assert_allclose(pooled, samples.covariance.mean(axis=0), rtol=1e-12)
    shrunk = process(log, Processing(shrinkage=0.3)).covariance
    np.testing.assert_allclose(shrunk, 0.7 * samples.covariance + 0.3 * pooled, rtol=1e-9)
    few = process(periodic(2, noise=0.5), Processing(shrinkage=0.1)).covariance
    assert np.linalg.eigvalsh(few).min() > 0
    assert process(periodic(1), ALL_ROWS).effort_periods is None
    assert any("repeats exactly" in note for note in process(periodic(3)).notes)


def test_the_default_is_what_identify_chooses():
    aperiodic = replace(periodic(3), period=None, start=None, periods=None)
    for each in (aperiodic, periodic(12, noise=0.5), periodic(2, noise=0.5), periodic(1)):
        own, chosen = process(each), process(each, default_processing(each))
        assert own.notes == chosen.notes
        np.testing.assert_array_equal(own.acceleration, chosen.acceleration)
        np.testing.assert_array_equal(own.used, chosen.used)


def changed(log: Recording, joint: Any, rows: Any, value: Any = None, **fields: Any) -> Recording:
    """Return a record in which a joint stands at some rows, or has jumped there by a value."""
    position = np.array(log.position)
    position[rows, joint] = 0.3 if value is None else position[rows, joint] + value
    return replace(log, position=position, **fields)


def without(log: Recording, rows: Any) -> Recording:
    return log.rows(np.isin(np.arange(log.n_samples), rows, invert=True))


SHORT = Recording(time=np.arange(50) / RATE, position=np.zeros((50, 1)), effort=np.zeros((50, 1)))
FAR = replace(periodic(3), position=np.degrees(periodic(3).position) * 2.0)
STANDING = changed(periodic(2), 1, slice(None), joint_names=("waist", "wrist"))
LOST = [500, 1500, 1501, 4000]
WRONG_SETTINGS = ({"cutof_hz": 10.0}, {"reasons": ()}, 10.0, "paper", {1: 2})


@pytest.mark.parametrize(
    ("words", "log", "processing"),
    [
        ("log: is 3; give a Recording", 3, None),
        ("looks like degrees", FAR, None),
        ("2 jumps by .* at sample 78 of .*: an outlier", changed(periodic(3), 1, 77, 20.0), None),
        # Whole turns, nearly, but far too many of them.
        (r"2 jumps by 1e\+12 rad at sample 78", changed(periodic(3), 1, 77, 1e12), None),
        (r"no row of joint wrist: .* 0.1 s away .* 0.02 rad/s.*reversal_time=None", STANDING, {}),
        (r"2 periods for 2 joints: .* at least 3 periods", periodic(2, noise=0.5), Processing()),
        ("has 1, a covariance needs at least 2", periodic(1), {"covariance": "pooled"}),
        ("of joint 1 do not repeat", replace(periodic(3), period=1.5, periods=4), None),
        ("velocity: the recording has none", periodic(2), {"velocity": "measured"}),
        ("500 Hz is not below half the sample rate of 1000", periodic(2), {"cutoff_hz": 500.0}),
        (r"lasts 0.049 s, and 0.076 s are cut off at either end", SHORT, ALL_ROWS),
        (
            r"gap of 0.016 s before row 1495 \(from 8.494 s to 8.51 s\)",
            without(periodic(3), [*LOST, *range(1495, 1510)]),
            ALL_ROWS,
        ),
        ("were lost; use timing='resample'", without(periodic(3), 500), {"timing": "nominal"}),
        *((r"processing: (.*is no setting|is)", periodic(3), wrong) for wrong in WRONG_SETTINGS),
    ],
)
def test_what_cannot_be_processed_is_refused(words: str, log: Any, processing: Any) -> None:
    refuses(DataError, words, process, log, processing)
    if processing in WRONG_SETTINGS:
        refuses(DataError, words, chosen_processing, [log], processing)


def test_what_looks_like_that_and_is_sound() -> None:
    # The limits of the robot say that its joints do turn that far.
    assert process(FAR, ALL_ROWS, position_limits=[(-1e3, 1e3)] * 2).n == 2
    # A step in the counter by whole turns is no outlier.
    alone = dict.fromkeys(("period", "start", "periods"))
    turned = changed(periodic(3), 1, slice(77, None), 6.0 * np.pi, **alone)
    assert process(turned).n == 2
    assert process(STANDING, ALL_ROWS).mask is None
    assert process(SHORT, replace(ALL_ROWS, trim_s=0.0)).n_samples == 5
    for cutoff, kept in ((10.0, 200), (25.0, 500), (5.0, 100), (200.0, 2000)):
        setting = replace(ALL_ROWS, decimation=None, cutoff_hz=cutoff)
        assert process(periodic(2), setting).n_samples == kept
    # Single samples that were lost are bridged; stamps since 1970 are uniform.
    whole = process(periodic(3), ALL_ROWS).acceleration
    bridged = process(without(periodic(3), LOST), ALL_ROWS)
    assert "resampled" in bridged.notes[0]
    np.testing.assert_allclose(bridged.acceleration, whole, rtol=0, atol=1e-5)
    log = periodic(3)
    late = process(replace(log, time=log.time + 1.7e9, start=log.start + 1.7e9), ALL_ROWS)
    assert not any("jitter" in note for note in late.notes)
    np.testing.assert_allclose(late.acceleration, whole, rtol=0, atol=1e-6)


OUT_OF_RANGE: dict[str, tuple[Any, ...]] = {
    "cutoff_hz": ("10", 1e-308, 0.0, np.nan),
    "order": (10**20, 2.5, None, 0),
    "decimation": ("2", 2.5),
    "reversal_time": (1e300, -1.0),
    "reversal_speed": (np.nan, -1.0),
    "trim_s": (True, np.inf),
    "shrinkage": (1.1, 1.5),
    **dict.fromkeys(("covariance", "velocity", "timing", "filter", "derivative"), ("x",)),
}


@pytest.mark.parametrize("name", OUT_OF_RANGE)
def test_settings_out_of_range_are_refused(name: str):
    for value in OUT_OF_RANGE[name]:
        words = rf"{name}: is .*, expected"
        refuses(DataError, words, Processing, **{name: value})
        refuses(DataError, words, chosen_processing, [periodic(3)], {name: value})


def test_settings_print_what_differs_from_the_defaults():
    assert repr(Processing()) == "Processing()"
    changed = Processing(cutoff_hz=8.0, trim_s=0.5)
    assert repr(changed) == "Processing(cutoff_hz=8.0, trim_s=0.5)"
    assert eval(repr(changed)) == changed


def jittered(kind: str, jitter: float, seed: int = 0) -> tuple[Recording, Tones]:
    """Regular samples with jittered stamps, or jittered samples with true stamps."""
    rng = np.random.default_rng(seed)
    regular = np.arange(4000) / RATE
    stamps = regular + rng.uniform(-jitter, jitter, regular.size) / RATE
    if kind == "drift":
        stamps = regular * (1.0 + 0.01 * regular)
    taken = regular if kind == "stamps" else stamps
    motion = Tones(seed)
    return Recording(time=stamps, position=motion(taken), effort=motion(taken)), motion


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


def sine(rate: float, hertz: float) -> Recording:
    """Return 20 s of two joints that turn as a sine."""
    time = np.arange(round(20.0 * rate)) / rate
    position = np.sin(2.0 * np.pi * hertz * time)[:, None] * np.ones(2)
    return Recording(time=time, position=position, effort=position)


@pytest.mark.parametrize(("rate", "expected"), [(30.0, "measured"), (200.0, "differentiated")])
def test_a_measured_velocity_serves_at_low_rates(rate: float, expected: str) -> None:
    log = sine(rate, 0.2)
    velocity = np.gradient(log.position, log.time, axis=0)
    assert default_processing(replace(log, velocity=velocity)).velocity == expected
    # What is no velocity of these positions does not serve.
    wrong = default_processing(replace(log, velocity=log.position))
    assert wrong.velocity == default_processing(log).velocity == "differentiated"


def test_friction_by_default() -> None:
    log = sine(100.0, 0.5)
    assert default_friction(replace(log, period=2.0)) == ("coulomb", "viscous")
    usual = default_friction(log)
    assert usual[0] == sdpid.friction.Coulomb(width=0.005)
    assert usual[1] == sdpid.friction.SigmoidFriction(velocity=None)
    assert usual[2:] == ("viscous", "offset")
    assert friction_of(log, None) == friction_of(log, ("default",)) == usual
    assert friction_of(log, ("default", "stribeck")) == (*usual, "stribeck")
    assert friction_of(log, ("viscous",)) == ("viscous",)


@pytest.mark.parametrize("case", TARGETS)
def test_held_out_motion_of_real_robots(data_folder: Path, case: str) -> None:
    runs, target = TARGETS[case]
    urdf = data_folder / f"{case}.urdf"
    logs = [sdpid.read_recording(urdf.parent / f"{run}.npz") for run in runs]
    log, other = logs[0], logs[-1]
    if len(logs) == 1:
        log = log.rows(slice(round(0.6 * log.n_samples)))
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


CLOCK = np.arange(2000) / 200.0


def test_noise_and_tones_of_a_motion():
    rng = np.random.default_rng(0)
    tone = np.sin(2.0 * np.pi * CLOCK)
    for sigma in (1e-4, 1e-2):
        noisy = tone + rng.normal(0.0, sigma, CLOCK.size)
        assert white_noise(noisy) == pytest.approx(sigma, rel=0.1)
    assert white_noise(tone) < 1e-5
    assert white_noise(np.zeros(3)) == 0.0
    column = 3.0 + np.sin(2.0 * np.pi * 2.0 * CLOCK) + 0.5 * np.sin(2.0 * np.pi * 8.0 * CLOCK)
    position = np.column_stack([column, np.ones_like(column)])
    (dominant, below), still = joint_frequencies(
        Recording(time=CLOCK, position=position, effort=position)
    )
    assert dominant == pytest.approx(2.0, abs=0.11)
    assert below == pytest.approx(8.0, abs=0.2)
    assert still is None


def test_gaps_are_counted():
    log = Recording(time=CLOCK, position=np.sin(CLOCK)[:, None], effort=np.sin(CLOCK)[:, None])
    assert overview(log)["gaps"] == 0
    found = overview(without(log, [100, 101, 102, 500, 501]))
    assert (found["gaps"], found["longest_step_row"]) == (2, 100)
    assert found["longest_step_s"] == pytest.approx(4.0 / 200.0)


# Another motion of a recording, aligned row by row with the measured one.


ARM = small_arm(2)


def moved(time: np.ndarray, slow: float = 1.0) -> np.ndarray:
    """Return a motion with a period of 2 s."""
    angle = np.pi * slow * time
    return np.stack([np.sin(angle) + 0.3 * np.sin(3.0 * angle), np.cos(2.0 * angle)], axis=1)


def recorded(time: np.ndarray, **fields: object) -> Recording:
    rng = np.random.default_rng(0)
    position = moved(time) + 1e-3 * rng.standard_normal((len(time), 2))
    effort = rng.standard_normal((len(time), 2))
    return Recording(
        time=time, position=position, effort=effort, joint_names=ARM.joint_names, **fields
    )


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
    logs: list, processing: sdpid.Processing | None
) -> None:
    records = [recorded(time, **fields) for time, fields in logs]
    prepared = prepare(ARM, records, processing)
    twin = Twin.of(ARM, records, prepared.processing, measured=prepared.samples)
    measured = twin.measured
    # The measured motion is its own twin, to the last bit.
    same = twin.samples([log.position for log in records])
    # Another motion, with efforts of its own, is what it would be on its own.
    motion = [1.1 * moved(log.time, 0.5 if log.period is None else 1.0) for log in records]
    efforts = [np.cos(q) for q in motion]
    other = twin.samples(motion, effort=efforts)
    alone = prepare(
        ARM,
        [
            replace(log, position=q, effort=e)
            for log, q, e in zip(records, motion, efforts, strict=True)
        ],
        prepared.processing,
    ).samples
    for name in STATES:
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


def test_a_measured_velocity_is_replaced_too() -> None:
    time = np.arange(900) / 30.0
    log = replace(recorded(time), velocity=np.gradient(moved(time), time, axis=0))
    twin = Twin.of(ARM, log)
    assert twin.processing.velocity == "measured"
    motion = moved(time, 0.5)
    rate = np.gradient(motion, time, axis=0, edge_order=2)
    given, splined = twin.samples(motion, velocity=rate), twin.samples(motion)
    assert np.abs(given.velocity - splined.velocity).max() < 0.02
    assert np.abs(splined.velocity - twin.measured.velocity).max() > 1.0


def test_what_does_not_belong_together_is_refused() -> None:
    log = recorded(CLOCK)
    samples, other = sdpid.process(log, {"cutoff_hz": 10.0}), {"cutoff_hz": 9.0, "decimation": 2}
    # As many samples, of another cut-off.
    trim = float(sdpid.process(log, other).time[0])
    alike = sdpid.process(log, {"cutoff_hz": 10.0, "decimation": 2, "trim_s": trim})
    words = r"recording: its position, processed.*same processing"
    refuses(DataError, words, Twin.of, ARM, log, other, measured=alike)
    words = r"is processed to .* samples, the problem's pieces have"
    refuses(DataError, words, Twin.of, ARM, log, {"decimation": 7}, measured=samples)
    twin = Twin.of(ARM, log, {"cutoff_hz": 10.0}, measured=samples)
    assert repr(twin).startswith("Twin(1 recordings of ")
    for wrong, words in (
        (np.zeros((10, 2)), r"position: has shape \(10, 2\), expected \(2000, 2\)"),
        ([log.position, log.position], "position: has 2 arrays for 1 recordings"),
        (np.full((2000, 2), np.nan), "position"),
    ):
        refuses(DataError, words, twin.samples, wrong)


@pytest.mark.parametrize("size", [127, 256])
@pytest.mark.parametrize("centered", [False, True])
def test_power_density_is_that_of_scipy(size: int, centered: bool) -> None:
    values = 0.5 + np.random.default_rng(0).normal(size=1000)
    detrend: Any = "constant" if centered else False
    expected = signal.welch(values, RATE, nperseg=size, detrend=detrend)
    found = power_density(values, RATE, size, centered=centered)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-15)
