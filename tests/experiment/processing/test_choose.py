"""What is chosen from a recording, why, and what stays as it was given."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
import sdpid.experiment.processing.motion as motion_module
from sdpid.errors import DataError
from sdpid.experiment.preparation.overview import overview
from sdpid.experiment.processing.choose import (
    choose_processing,
    default_processing,
)
from sdpid.experiment.processing.motion import motion_frequency, noise_limit
from tests.helpers.refusals import refuses

# The default for five real robots, on which docs/evidence/real_robots.md rests: cut-off in Hz and
# velocity,
# for the whole record. All have order 4, "central4" and a mask of a tenth of the cut-off's period.
DEFAULTS = {
    "ur10_unisa/ur10_exciting": (3.178581807729566, "differentiated"),
    "panda_unisa/panda_exciting": (3.0949029320985986, "measured"),
    "kuka_lwr4plus/measurements_1": (2.983950778897212, "differentiated"),
    "kuka_lwr4plus/measurements_2": (2.983892007320999, "differentiated"),
    "staubli_tx40/tx40_rows_0_24750": (22.727272727272723, "differentiated"),
    "kinova_gen3_dynamapp/opti_traj_testing1": (10.546298249314491, "differentiated"),
    "kinova_gen3_dynamapp/opti_traj_testing2": (21.79598953792502, "differentiated"),
}


def sweep(
    noise: float = 0.0, *, rate: float = 200.0, seconds: float = 40.0, seed: int = 0
) -> tuple[sdpid.Recording, np.ndarray]:
    """Return a record of five tones up to 2 Hz, and its exact accelerations."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(rate * seconds)) / rate
    omega = 2.0 * np.pi * np.array([0.3, 0.6, 1.0, 1.5, 2.0])
    phase = rng.uniform(0.0, 2.0 * np.pi, (5, 2))
    angle = time[:, None, None] * omega[:, None] + phase
    position = (np.sin(angle) / omega[:, None] ** 2).sum(axis=1)
    noisy = position + noise * rng.standard_normal(position.shape)
    log = sdpid.Recording(time=time, position=noisy, effort=noisy)
    return log, -np.sin(angle).sum(axis=1)


@pytest.mark.parametrize("name", DEFAULTS)
def test_the_default_of_five_real_robots(data_folder: Path, name: str) -> None:
    cutoff, velocity = DEFAULTS[name]
    log = sdpid.read_recording(data_folder / f"{name}.npz")
    chosen = default_processing(log)
    expected = sdpid.Processing(
        cutoff_hz=chosen.cutoff_hz,
        order=4,
        decimation=None,
        reversal_time=0.1 / chosen.cutoff_hz,
        kept_share=0.1,
        derivative="central4",
        velocity="measured" if velocity == "measured" else "differentiated",
    )
    assert chosen == expected
    assert expected.cutoff_hz == pytest.approx(cutoff, rel=1e-12)


def test_the_page_in_the_docs(data_folder: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "guides" / "processing.md").read_text(
        encoding="utf-8"
    )
    log = sdpid.read_recording(data_folder / "ur10_unisa" / "ur10_exciting.npz")
    assert "\n".join(choose_processing(log).reasons) in page


def test_the_choice_says_why() -> None:
    log, _ = sweep()
    choice = choose_processing(log)
    assert choice.motion_hz == motion_frequency(log)
    assert choice.rate_hz == pytest.approx(200.0)
    cutoff, velocity = choice.reasons
    assert cutoff.startswith(f"cutoff_hz {choice.processing.cutoff_hz:.4g}: 25 × motion, below")
    assert f"below {choice.motion_hz:.4g} Hz" in cutoff
    assert velocity == "velocity differentiated: none was recorded"
    # The bound by the rate, and that by the length.
    slow = replace(log, time=10.0 * log.time)
    fast = choose_processing(sweep(rate=20.0)[0])
    assert fast.processing.cutoff_hz == pytest.approx(20.0 / 7.5)
    assert fast.reasons[0].startswith(
        "cutoff_hz 2.667: 2/15 of the rate of 20 Hz, below 25 × motion"
    )
    assert choose_processing(slow).motion_hz == pytest.approx(choice.motion_hz / 10.0)
    # They end up in the notes of the samples.
    assert sdpid.process(log, choice.processing).notes[:2] == choice.reasons


@pytest.mark.parametrize("rate", [80.0, 250.0, 1000.0])
@pytest.mark.parametrize("stored", [False, True])
def test_long_records_are_averaged_first(
    rate: float, stored: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, _ = sweep(1e-3, rate=rate, seconds=40.3)
    # A joint that stands still has no say, whatever its angle is rounded to.
    still = np.full(log.n_samples, 0.1)
    position = np.column_stack([log.position, still])
    log = replace(log, position=position, effort=position)
    expected = motion_frequency(replace(log, position=position[:, :2], effort=position[:, :2]))
    monkeypatch.setattr(motion_module, "_LONG", 1000)
    monkeypatch.setattr(motion_module, "_BLOCK", 777)
    if stored:
        log.to_parquet(tmp_path / "log.parquet")
        log = sdpid.read_recording(tmp_path / "log.parquet", stored=True)
        assert log.stored
    # The resolution of either is the inverse of the record's length.
    assert motion_frequency(log) == pytest.approx(expected, abs=1.5 / 40.3)
    quiet = replace(log, position=np.tile(still[:, None], 3))
    refuses(DataError, "no joint moves", motion_frequency, quiet)


def test_noise_of_joints_at_rest_has_no_say() -> None:
    """Five joints of six hold still: encoder noise would put the cut-off where nothing moves."""
    time = np.arange(4000) / 200.0
    rng = np.random.default_rng(0)
    moves = np.sin(2.0 * np.pi * 0.5 * time)
    still = 0.3 + 1e-4 * rng.standard_normal((time.size, 4))
    dragged = 5e-3 * moves[:, None] ** 9
    position = np.column_stack([moves, still, dragged])
    log = sdpid.Recording(time=time, position=position, effort=position)
    assert motion_frequency(log) == pytest.approx(0.5, abs=0.1)
    samples = sdpid.process(log)
    np.testing.assert_array_equal(samples.velocity[:, 1:5], 0.0)
    assert samples.velocity[:, 5].any()


def test_what_an_average_takes_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 40 Hz an average over 10 ms leaves 0.76 of the amplitude: 0.57 of the power."""
    time = np.arange(40000) / 1000.0
    # 92.6 % of the power is slow, 7.4 % fast; left as it was averaged the fast part has 4.4 %.
    slow, fast = np.sin(2.0 * np.pi * 2.0 * time), np.sin(2.0 * np.pi * 40.0 * time)
    position = (slow + np.sqrt(0.08) * fast)[:, None]
    log = sdpid.Recording(time=time, position=position, effort=position)
    assert motion_frequency(log) == pytest.approx(40.0, abs=0.1)
    monkeypatch.setattr(motion_module, "_LONG", 1000)
    assert motion_frequency(log) == pytest.approx(40.0, abs=0.1)


@pytest.mark.parametrize(
    ("given_", "expected"),
    [
        ({"cutoff_hz": 5.0}, "cutoff_hz 5: as given, for "),
        ({"velocity": "measured"}, "velocity measured: as given, for differentiated"),
        ({"order": 2, "filter": "bessel", "derivative": "savitzky_golay"}, None),
    ],
)
def test_what_is_given_stays(given_: dict[str, Any], expected: str | None) -> None:
    log, _ = sweep()
    log = replace(log, velocity=np.gradient(log.position, log.time, axis=0))
    choice = choose_processing(log, **given_)
    plain = choose_processing(log)
    for name, value in given_.items():
        assert getattr(choice.processing, name) == value
    assert choice.processing == replace(plain.processing, **given_)
    if expected is None:
        assert choice.reasons == plain.reasons
    else:
        assert any(reason.startswith(expected) for reason in choice.reasons)
    # Notes have later changes as well.
    changed = replace(plain.processing, **given_)
    assert sdpid.process(log, changed).notes[:2] == choice.reasons


def test_records_with_periods_say_their_covariance() -> None:
    log, _ = sweep(noise=1e-5)
    for periods, covariance in ((8, "period"), (2, "pooled"), (1, None)):
        choice = choose_processing(replace(log, period=5.0, start=0.0, periods=periods))
        assert choice.processing == sdpid.Processing(covariance=covariance)  # type: ignore[arg-type]
        assert choice.motion_hz is None
        assert choice.reasons[0].startswith(f"covariance {covariance}: {periods} period")


def test_what_cannot_be_chosen() -> None:
    log, _ = sweep()
    refuses(DataError, "cutoff_hz", choose_processing, log, cutoff_hz=-1.0)
    still = replace(log, position=np.ones_like(log.position))
    refuses(DataError, "no joint moves", choose_processing, still)


def test_the_overview_shows_the_choice() -> None:
    log, _ = sweep()
    facts = overview(log)
    assert facts["processing_chosen_for"] == "; ".join(choose_processing(log).reasons)
    assert "reasons" not in facts["processing"]
    assert facts["processing"]["filter"] == "butterworth"


def test_noise_of_accelerations_lowers_the_cutoff_of_a_floating_robot() -> None:
    noise, share, rate = 1e-4, 2e-4, 200.0
    log, acceleration = sweep(noise, rate=rate)
    limit = noise_limit(log, share)
    # Noise of positions below a frequency f has (2 pi f)^4/5 of its power in accelerations.
    power = noise**2 * (2.0 * np.pi * limit) ** 4 / 5.0 * limit / (rate / 2.0)
    assert power / np.median(acceleration.var(axis=0)) == pytest.approx(share, rel=0.1)
    assert noise_limit(sweep(0.0)[0], share) > 4.0 * limit
    turn = np.tile([0.0, 0.0, 0.0, 1.0], (log.n_samples, 1))
    base = sdpid.BaseMotion(orientation=turn, position=np.zeros((log.n_samples, 3)))
    motion = motion_frequency(log)
    assert 5.0 * motion < limit < 15.0 * motion
    assert choose_processing(replace(log, base=base)).processing.cutoff_hz == limit
    much = replace(sweep(3e-3)[0], base=base)
    assert choose_processing(much).processing.cutoff_hz == pytest.approx(5.0 * motion)
    assert choose_processing(log).processing.cutoff_hz > limit
