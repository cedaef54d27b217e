"""Samples: settings, derivatives, contacts, delays and floating bases."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import sdpid
import sdpid.experiment.processing.motion as motion_module
from sdpid import Recording
from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.preparation.overview import overview
from sdpid.experiment.preparation.prepare import prepare, samples_of
from sdpid.experiment.processing.base import base_limit, unit
from sdpid.experiment.processing.choose import default_processing, with_changes
from sdpid.experiment.processing.contact_samples import ContactSamples
from sdpid.experiment.processing.filters import low_pass
from sdpid.experiment.processing.motion import motion_frequency, noise_limit
from sdpid.experiment.processing.process import on_time, process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.floating import BaseMotion
from tests.helpers.crawl import FEET as CRAWLING
from tests.helpers.crawl import RADIUS, Crawl, crawl
from tests.helpers.motions import sines
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
    omega = 2.0 * np.pi * np.array([0.3, 0.6, 1.0, 1.5, 2.0])[:, None]
    position, _, acceleration = sines(time, omega, rng.uniform(0.0, 2.0 * np.pi, (5, 2)), omega**-2)
    noisy = position + noise * rng.standard_normal(position.shape)
    return sdpid.Recording(time=time, position=noisy, effort=noisy), acceleration


@pytest.mark.parametrize("name", DEFAULTS)
def test_the_default_of_five_real_robots(data_folder: Path, name: str) -> None:
    cutoff, velocity = DEFAULTS[name]
    chosen = default_processing(sdpid.read_recording(data_folder / f"{name}.npz"))
    common = {"order": 4, "decimation": None, "kept_share": 0.1, "derivative": "central4"}
    mask = 0.1 / chosen.cutoff_hz
    expected = sdpid.Processing(
        cutoff_hz=chosen.cutoff_hz, velocity=velocity, reversal_time=mask, **common
    )
    assert chosen == expected
    assert chosen.cutoff_hz == pytest.approx(cutoff, rel=1e-12)
    if "ur10" in name:
        assert chosen.why == (
            "cutoff_hz 3.179: 25 × motion, below 2/15 of the rate of 125 Hz; 95 % of the motion "
            "lies below 0.1271 Hz",
            "velocity differentiated: sampled at 125 Hz, not below 100 Hz",
        )


def test_the_choice_says_why() -> None:
    log, _ = sweep()
    chosen = default_processing(log)
    motion = motion_frequency(log)
    cutoff, velocity = chosen.why
    assert cutoff.startswith(f"cutoff_hz {chosen.cutoff_hz:.4g}: 25 × motion, below")
    assert f"below {motion:.4g} Hz" in cutoff
    assert velocity == "velocity differentiated: none was recorded"
    assert chosen.cutoff_hz == pytest.approx(25.0 * motion)
    assert (chosen.order, chosen.derivative) == (4, "central4")
    assert chosen.reversal_time == pytest.approx(0.1 / chosen.cutoff_hz)
    # The bound by the rate, and that by the length.
    slow = replace(log, time=10.0 * log.time)
    fast = default_processing(sweep(rate=20.0)[0])
    assert fast.cutoff_hz == pytest.approx(20.0 / 7.5)
    bound = "cutoff_hz 2.667: 2/15 of the rate of 20 Hz, below 25 × motion"
    assert fast.why[0].startswith(bound)
    assert default_processing(slow).cutoff_hz == pytest.approx(chosen.cutoff_hz / 10.0)
    # They end up in the notes of the samples.
    assert sdpid.process(log, chosen).notes[:2] == chosen.why


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
    time = np.arange(40300) / 1000.0
    # 92.6 % of the power is slow, 7.4 % fast; left as it was averaged the fast part has 4.4 %.
    slow, fast = np.sin(2.0 * np.pi * 2.0 * time), np.sin(2.0 * np.pi * 40.0 * time)
    # A joint that stands still has no say, whatever its angle is rounded to.
    still = np.full(time.size, 0.1)
    position = np.column_stack([slow + np.sqrt(0.08) * fast, still])
    log = sdpid.Recording(time=time, position=position, effort=position)
    quiet = replace(log, position=np.column_stack([still, still]))
    for most in (1 << 18, 1000):
        monkeypatch.setattr(motion_module, "_LONG", most)
        assert motion_frequency(log) == pytest.approx(40.0, abs=0.1)
        for refused in (motion_frequency, default_processing):
            refuses(DataError, "no joint moves", refused, quiet)


def test_what_is_given_stays() -> None:
    log, _ = sweep()
    log = replace(log, velocity=np.gradient(log.position, log.time, axis=0))
    plain = default_processing(log)
    for given_, said in (
        ({"cutoff_hz": 5.0}, "cutoff_hz 5: as given, for "),
        ({"velocity": "measured"}, "velocity measured: as given, for differentiated"),
        ({"order": 2, "derivative": "central6"}, plain.why[0]),
    ):
        changed = with_changes(plain, given_)
        assert given_.items() <= vars(changed).items()
        assert any(reason.startswith(said) for reason in changed.why)
        assert sdpid.process(log, given_).notes[:2] == changed.why
    for periods, covariance in ((8, "period"), (2, "pooled"), (1, None)):
        chosen = default_processing(replace(log, period=5.0, start=0.0, periods=periods))
        assert chosen == sdpid.Processing(covariance=covariance)
        assert chosen.why[0].startswith(f"covariance {covariance}: {periods} period")
    facts = overview(log)
    assert facts["processing_chosen_for"] == "; ".join(plain.why)
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
    assert default_processing(replace(log, base=base)).cutoff_hz == limit
    much = replace(sweep(3e-3)[0], base=base)
    assert default_processing(much).cutoff_hz == pytest.approx(5.0 * motion)
    assert default_processing(log).cutoff_hz > limit


K, JOINTS = 5, 2


def fields(**changes: Any) -> dict[str, Any]:
    table = np.arange(float(K * JOINTS)).reshape(K, JOINTS)
    values = dict.fromkeys(("position", "velocity", "acceleration", "effort"), table)
    return values | changes


def test_samples_keep_what_they_are_given():
    plain = Samples(**fields())
    assert (plain.n, plain.n_samples, plain.n_rows, plain.block) == (2, 5, 10, 1)
    assert (plain.covariance, plain.mask, plain.notes, plain.names) == (None, None, (), ("1", "2"))
    assert repr(plain) == "Samples(5 samples, 2 joints, 10 rows used)"
    # The rows of a floating base are in the equation of motion, but they are not measured; its
    # configuration has more columns.
    mask = np.tile([False, True], (K, 1))
    given_ = {
        "position": np.zeros((K, 3)),
        "covariance": np.tile(np.eye(2), (K, 1, 1)),
        "mask": mask,
        "time": np.arange(5),
        "effort_periods": np.zeros((3, K, JOINTS)),
    }
    full = Samples(
        **fields(**given_, joint_names=["a", "b"], periods=3, block=2, notes=["filtered"])
    )
    assert (full.n_rows, full.joint_names, full.notes) == (5, ("a", "b"), ("filtered",))
    for name, value in given_.items():
        np.testing.assert_array_equal(getattr(full, name), value)
        assert not getattr(full, name).flags.writeable
    assert "mean of 3 periods" in repr(full)
    assert Samples(**fields(covariance=np.eye(2))).covariance.shape == (2, 2)


nan = np.full((K, JOINTS), np.nan)
BAD: list[tuple[dict[str, Any], str]] = [
    ({"acceleration": nan}, "acceleration: 10 of 10 values are not finite"),
    ({"position": np.zeros((4, 2))}, r"position: has shape \(4, 2\)"),
    ({"position": np.zeros((K, 1))}, "position: has shape"),
    ({"velocity": np.zeros((K, 3))}, r"velocity: has shape \(5, 3\), expected"),
    ({"effort": np.zeros((0, 2))}, "nothing to fit"),
    ({"velocity": None}, "velocity: is missing; give one column for each joint"),
    ({"time": np.zeros(3)}, r"time: has shape \(3,\), expected \(5,\): one time for each"),
    ({"joint_names": ("a",)}, "1 names"),
    ({"covariance": np.eye(3)}, "covariance: has shape"),
    ({"covariance": np.zeros((2, 2, 2))}, "covariance: has shape"),
    ({"covariance": [[1.0, 0.5], [0.4, 1.0]]}, "not symmetric"),
    ({"covariance": [[1.0, 0.0], [0.0, -1.0]]}, "joint 2 has a negative variance"),
    ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "not positive semidefinite"),
    ({"mask": np.ones(K, dtype=bool)}, "mask: has shape"),
    ({"mask": np.ones((K, JOINTS))}, "expected .* bool"),
    ({"mask": np.zeros((K, JOINTS), dtype=bool)}, "mask: leaves none of 10 rows"),
    ({"block": 0}, "block: is 0"),
    ({"block": float("nan")}, "block: is nan, expected a whole number"),
    ({"block": float("inf")}, "block: is inf, expected a whole number"),
    ({"block": "2"}, "block: is 2, expected a whole number"),
    ({"periods": 1.5}, "periods: is 1.5, expected a whole number"),
    ({"periods": 0}, "periods: is 0"),
    (
        {"periods": 2, "effort_periods": np.zeros((3, K, JOINTS))},
        "effort_periods: has shape",
    ),
    *(
        ({"starts": starts}, "rising sample numbers")
        for starts in ((1,), (), (0, 3, 3), (0, 5), (0, 4, 2))
    ),
]


def test_pieces_are_joined_in_order():
    first = Samples(**fields(time=np.arange(5.0), notes=["filtered", "short"], block=2))
    mask = np.ones((K, JOINTS), dtype=bool)
    mask[0, 0] = False
    second = Samples(
        **fields(effort=np.full((K, JOINTS), 9.0), time=np.arange(5.0), mask=mask, block=4),
        notes=["filtered"],
    )
    joined = Samples.join([first, second])
    assert joined.starts == (0, 5)
    assert joined.parts == (slice(0, 5), slice(5, 10))
    assert (joined.n_samples, joined.n_rows, joined.block) == (10, 19, 4)
    np.testing.assert_array_equal(joined.effort[5:], second.effort)
    np.testing.assert_array_equal(joined.time, [*range(5), *range(5)])
    assert joined.notes == ("filtered", "2 pieces joined", "piece 1: short")
    assert Samples.join([joined, first]).starts == (0, 5, 10)
    assert Samples.join([first]) is first
    assert "2 pieces" in repr(joined)
    # Covariances are kept sample by sample where they differ.
    one, other = (Samples(**fields(covariance=c * np.eye(2))) for c in (1.0, 4.0))
    assert Samples.join([one, one]).covariance.shape == (2, 2)
    covariance = Samples.join([one, other]).covariance
    np.testing.assert_array_equal(covariance[:, 0, 0], [1.0] * K + [4.0] * K)
    # A part may have no row that is used.
    mask = np.repeat([[False], [True]], (3, 2), axis=0) & np.ones(2, dtype=bool)
    first, second = Samples(**fields(mask=mask, starts=(0, 3))).pieces
    assert (first.n_rows, second.n_rows) == (0, 4)
    np.testing.assert_array_equal(Samples.join([first, second]).mask, mask)
    assert not first.mask.flags.writeable


APART: list[tuple[dict[str, Any], str]] = [
    ({"covariance": np.eye(2)}, "1 of 2 pieces have a covariance"),
    ({"joint_names": ("a", "b")}, "the joints of piece 2"),
    ({"periods": 3}, "averages over periods"),
    ({"position": np.zeros((K, 3))}, "position of piece 2 has 3 columns"),
]


# Friction columns that pass the filter of the efforts.


WIDTH = 0.01


def steep(velocity: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.tanh(velocity / WIDTH)


def log_of(rate: float = 500.0, seconds: float = 30.0, period: float | None = None):
    """Return a record whose efforts are nothing but steep friction of the exact velocity."""
    time = np.arange(round(rate * seconds)) / rate
    tones = 2.0 * np.pi * np.array([0.5, 0.7 if period is None else 1.0])
    rates, size = np.stack([tones, 0.5 * tones]), np.array([[1.0], [0.4]])
    position, velocity, _ = sines(time, rates, np.array([[0.0], [1.0]]), size)
    effort = steep(velocity, velocity)
    return sdpid.Recording(time=time, position=position, effort=effort, period=period)


def worst(samples: Samples, predicted: np.ndarray) -> float:
    return float(np.abs(samples.effort - predicted).max())


@pytest.mark.parametrize("rate", [200.0, 500.0, 2000.0])
def test_friction_stands_in_filtered_efforts_as_its_columns_do(rate: float) -> None:
    samples = process(log_of(rate), {"reversal_time": None})
    friction = samples.through_filter(steep, slice(None))
    smeared = worst(samples, steep(samples.velocity, samples.acceleration))
    # The reversal itself lies between two samples of the log: a hundredth of its step.
    assert worst(samples, friction) < 0.02 < 0.5 < smeared


def test_records_with_periods_and_recorded_velocities() -> None:
    periodic = log_of(1000.0, 24.0, period=4.0)
    samples = process(periodic, {"reversal_time": None, "covariance": None})
    assert worst(samples, samples.through_filter(steep, slice(None))) < 0.02
    log = log_of(80.0)
    velocity = np.gradient(log.position, log.time, axis=0, edge_order=2)
    samples = process(replace(log, velocity=velocity), {"velocity": "measured"})
    assert worst(samples, samples.through_filter(steep, slice(None))) < 0.1


def test_parts_are_those_of_the_whole() -> None:
    one, two = (process(log_of(200.0, seconds), {"cutoff_hz": 10.0}) for seconds in (30.0, 12.0))
    joined = Samples.join([one, two])
    whole = joined.through_filter(steep, slice(None), "steep")
    np.testing.assert_array_equal(whole[: one.n_samples], one.through_filter(steep, slice(None)))
    for which in (slice(100, 700), slice(one.n_samples - 5, one.n_samples + 9), slice(3, None, 7)):
        np.testing.assert_array_equal(joined.through_filter(steep, which, "steep"), whole[which])
    # The memory of the filter is cut off after 20 time constants, 2e-9 of a step.
    part = joined.between(400, one.n_samples + 500)
    friction = part.through_filter(steep, slice(None))
    np.testing.assert_allclose(friction, whole[400 : one.n_samples + 500], atol=1e-8)
    assert part.starts == (0, one.n_samples - 400)
    thin = joined.every(3)
    assert thin.time is not None
    places = np.searchsorted(one.time, thin.pieces[1].time)
    friction = thin.pieces[1].through_filter(steep, slice(None))
    np.testing.assert_allclose(friction, whole[places], atol=1e-8)
    refuses(DataError, "none from 9000", joined.between, 9000, 9100)


def test_without_the_filter_friction_is_that_of_the_samples() -> None:
    samples = process(log_of(), {"filter_friction": False})
    assert samples.wide is None
    expected = steep(samples.velocity, samples.acceleration)
    np.testing.assert_array_equal(samples.through_filter(steep, slice(None)), expected)
    refuses(DataError, "process all of them alike", Samples.join, [samples, process(log_of())])


def test_a_joint_that_hardly_moves_is_not_masked() -> None:
    log = log_of()
    position = np.array(log.position)
    position[:, 1] = 1.0 + 1e-3 * position[:, 1]
    samples = process(replace(log, position=position))
    assert 0.5 < samples.mask[:, 0].mean() < 1.0
    assert samples.mask[:, 1].all()
    assert any("not masked, since less than 10 % of the rows" in note for note in samples.notes)
    with pytest.raises(DataError, match="leaves no row of joint 2"):
        process(replace(log, position=position), {"kept_share": 0.0})


# Contacts of samples: checked, cut and joined with them.


FEET = ("left", "right")


def contacts(K: int = 12, **given: Any) -> ContactSamples:
    rng = np.random.default_rng(K)
    down = rng.random((K, 2)) < 0.5
    return ContactSamples(**{"frames": FEET, "down": down, **given})


def samples(K: int = 12, **given: Any) -> Samples:
    rng = np.random.default_rng(K + 1)
    states = {name: rng.normal(size=(K, 8)) for name in ("velocity", "acceleration", "effort")}
    return Samples(position=rng.normal(size=(K, 9)), contacts=contacts(K, **given), **states)


def test_parts_and_joins_keep_contacts() -> None:
    covariance = np.diag([1.0, 1.0, np.inf, 5.0, 5.0, 5.0])
    forces = np.random.default_rng(3).normal(size=(12, 2, 6))
    whole = samples(forces=forces, force_covariance=covariance)
    # Points transmit no moments, whatever is given.
    assert not whole.contacts.forces[:, :, 3:].any()
    assert not whole.contacts.force_covariance[:, 3:].any()
    parts = [whole.between(0, 5), whole.between(5, 12)]
    joined = Samples.join(parts)
    assert joined.contacts.forces is not None
    np.testing.assert_array_equal(joined.contacts.down, whole.contacts.down)
    np.testing.assert_array_equal(joined.contacts.forces, whole.contacts.forces)
    for piece, part in zip(joined.pieces, parts, strict=True):
        np.testing.assert_array_equal(piece.contacts.down, part.contacts.down)
    thin = whole.every(4).contacts
    np.testing.assert_array_equal(thin.down, whole.contacts.down[::4])
    assert "2 contacts" in repr(whole)
    assert "forces measured" in repr(thin)


WRENCHES = np.zeros((12, 2, 6))
# The first component is not measured, and goes with others that are.
UNKNOWN = np.where(np.arange(36).reshape(6, 6) == 0, np.inf, np.ones((6, 6)))


MEASURED = samples(forces=np.zeros((12, 2, 6)), force_covariance=np.eye(6))
CONTACTS: list[tuple[str, dict[str, Any]]] = [
    ("frames are .*, expected names", {"frames": ["left", ""]}),
    ("against is .*, expected a frame other", {"against": ["left", None]}),
    (r"down: has shape \(12, 3\)", {"down": np.zeros((12, 3), dtype=bool)}),
    ("down: holds 0.5, expected True or False", {"down": np.full((12, 2), 0.5)}),
    ("ball is not known", {"kind": "ball"}),
    (r"offset: has shape \(2,\)", {"offset": np.zeros(2)}),
    ("forces and force_covariance together", {"forces": WRENCHES}),
    (r"forces: has shape \(11, 2, 6\)", {"forces": WRENCHES[1:], "force_covariance": 0}),
    (r"covariance: has shape \(3, 3\)", {"forces": WRENCHES, "force_covariance": np.eye(3)}),
    ("least eigenvalue is -1", {"forces": WRENCHES, "force_covariance": -np.eye(6)}),
    ("finite and symmetric", {"forces": WRENCHES, "force_covariance": np.tri(6)}),
    ("is not measured; its other", {"forces": WRENCHES, "force_covariance": UNKNOWN}),
]
AT_POINT = "'left' is a point at .* in recording 2, and a point"
PLAIN, join = Samples(**fields()), Samples.join
REFUSED: list[tuple[str, Any]] = [
    *((words, partial(Samples, **fields(**changes))) for changes, words in BAD),
    *((words, partial(join, [PLAIN, Samples(**fields(**change))])) for change, words in APART),
    ("none to join", partial(join, [])),
    *((words, partial(contacts, **{"kind": "plane"} | changes)) for words, changes in CONTACTS),
    (AT_POINT, partial(join, [samples(), samples(offset=(0.0, 0.0, -0.02))])),
    ("'left' is a line at .* and a point", partial(join, [samples(), samples(kind="line")])),
    ("forces of 'left' are measured in one", partial(join, [samples(), MEASURED])),
    ("contacts: has 12 samples, expected 5", partial(replace, samples(5), contacts=contacts())),
]


@pytest.mark.parametrize(("words", "make"), REFUSED, ids=[words for words, _ in REFUSED])
def test_what_are_no_samples_is_refused(words: str, make: Any) -> None:
    refuses(DataError, words, make)


# Channels that were recorded late are taken at their time.


STEP = 0.002
# Whole and half steps, late and early.
DELAYS = {
    "effort_delay_s": 0.005,
    "imu_delay_s": -0.003,
    "base_delay_s": 0.004,
    "contacts_delay_s": 0.01,
}


def recorded(delays: dict[str, float]) -> Recording:
    """Return smooth channels, each as much later as is said."""
    time = STEP * np.arange(1000)

    def wave(name: str, columns: int) -> np.ndarray:
        late = time - delays.get(f"{name}_delay_s", 0.0)
        return np.sin(late[:, None] * np.linspace(3.0, 9.0, columns))

    turned = np.column_stack([0.3 * wave("base", 3), np.ones(len(time))])
    feet = wave("contacts", 2)
    return Recording(
        time=time,
        position=wave("joints", 2),
        effort=wave("effort", 2),
        base=sdpid.BaseMotion(
            orientation=turned / np.linalg.norm(turned, axis=1, keepdims=True),
            position=wave("base", 3),
            imu=sdpid.Imu(gyroscope=wave("imu", 3), accelerometer=wave("imu", 3)),
        ),
        contacts=sdpid.Contacts(frames=["a", "b"], down=feet > 0.2),
    )


def test_channels_are_those_of_a_recording_without_delays() -> None:
    found = on_time(recorded(DELAYS), sdpid.Processing(**DELAYS))
    # What no channel lacks: 10 ms at the end, 3 ms (of 2 ms steps) at the beginning.
    assert (found.time[0], found.time[-1]) == pytest.approx((0.004, 1.988))
    wanted = recorded({})
    rows = slice(2, 995)
    np.testing.assert_array_equal(found.position, wanted.position[rows])
    np.testing.assert_allclose(found.effort, wanted.effort[rows], atol=1e-8)
    base, other = found.base, wanted.base
    for name in ("orientation", "position"):
        np.testing.assert_allclose(getattr(base, name), getattr(other, name)[rows], atol=1e-8)
    np.testing.assert_allclose(base.imu.gyroscope, other.imu.gyroscope[rows], atol=1e-8)
    np.testing.assert_array_equal(found.contacts.down, wanted.contacts.down[rows])


def test_a_periodic_record_goes_on_with_its_beginning() -> None:
    time = 0.01 * np.arange(400)
    wave = np.sin(2.0 * np.pi * time)[:, None]
    late = np.sin(2.0 * np.pi * (time - 0.025))[:, None]
    log = Recording(time=time, position=wave, effort=late, period=1.0)
    found = on_time(log, sdpid.Processing(effort_delay_s=0.025))
    assert found.n_samples == 400
    np.testing.assert_allclose(found.effort, wave, atol=1e-6)


def test_process_takes_efforts_on_time_and_says_so() -> None:
    log = replace(recorded(DELAYS), base=None, contacts=None)
    samples = sdpid.process(log, {"effort_delay_s": 0.005, "imu_delay_s": 0.1})
    right = sdpid.process(replace(recorded({}), base=None, contacts=None))
    _, *rows = np.intersect1d(samples.time.round(6), right.time.round(6), return_indices=True)
    found, wanted = samples.effort[rows[0]][50:-50], right.effort[rows[1]][50:-50]
    np.testing.assert_allclose(found, wanted, atol=1e-5)
    assert "efforts recorded 5 ms too late: taken on time" in samples.notes
    refuses(DataError, "limit is a quarter", sdpid.process, log, {"effort_delay_s": 0.6})


# Recordings with a base: their states against those of the motion, and the equation of motion.


SETTINGS = {"cutoff_hz": 25.0, "order": 2, "decimation": 10, "reversal_time": None}


def rows(samples: sdpid.Samples, walk: Crawl) -> Array:
    return np.round(np.asarray(samples.time) / (walk.time[1] - walk.time[0])).astype(int)


@pytest.mark.parametrize("kind", ["imu", "twist", "own_twist", "pose"])
def test_every_source_gives_the_motion_of_the_base(kind: str) -> None:
    walk = crawl()
    samples = sdpid.process(walk.log(kind), SETTINGS)
    at = rows(samples, walk)
    assert (samples.position.shape[1], samples.velocity.shape[1]) == (19, 18)
    assert not samples.velocity[:, :3].any()
    assert not samples.effort[:, :6].any()
    # What the filter takes from motion of 1 to 2 Hz.
    assert np.abs(samples.velocity[:, 3:6] - walk.v[at, 3:6]).max() < 0.02
    assert np.abs(samples.acceleration[:, 3:6] - walk.a[at, 3:6]).max() < 0.2
    classical = walk.a[at, :3] + np.cross(walk.v[at, 3:6], walk.v[at, :3])
    assert np.abs(samples.acceleration[:, :3] - classical).max() < 0.05
    turned = np.abs(np.einsum("ki,ki->k", samples.position[:, 3:7], walk.q[at, 3:7]))
    assert turned.min() > 1.0 - 1e-5


def residuals(walk: Crawl, samples: sdpid.Samples, *, forces: bool, widened: bool = True) -> Array:
    """Return what is left of the equation of motion with the true parameters, by Pinocchio."""
    model = walk.robot.pin_model.copy()
    model.armature[:] = 0.0
    data = model.createData()
    frames = [model.getFrameId(name) for name in CRAWLING]
    contacts = samples.contacts
    assert contacts is not None
    down = contacts.down if widened else walk.down[rows(samples, walk)]
    left = []
    for k in range(samples.n_samples):
        q = samples.position[k]
        error = pin.rnea(model, data, q, samples.velocity[k], samples.acceleration[k])
        error = error - samples.effort[k]
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        J = [pin.getFrameJacobian(model, data, f, pin.LOCAL_WORLD_ALIGNED) for f in frames]
        feet = np.array([each[:3] - pin.skew(RADIUS) @ each[3:] for each in J])
        if forces:
            error = error - np.einsum("cij,ci->j", feet, contacts.forces[k, :, :3])
        else:
            basis = np.linalg.qr(feet[down[k]].reshape(-1, 18).T)[0]
            error = error - basis @ (basis.T @ error)
        left.append(error)
    return np.array(left)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_the_equation_of_motion_holds_between_filtered_channels() -> None:
    walk = crawl()
    samples = sdpid.process(walk.log(), {**SETTINGS, "contact_force_std": 0.0})
    size = rms(walk.effort[:, 6:])
    known = residuals(walk, samples, forces=True)
    # In N, N·m and N·m; of 25 N of weight and 0.63 N·m of effort.
    assert rms(known[:, :3]) < 0.002
    assert rms(known[:, 3:6]) < 0.005
    assert rms(known[:, 6:]) < 0.006 * size
    projected = rms(residuals(walk, samples, forces=False))
    assert projected < 0.003 * size
    # A filter remembers feet that have left the ground.
    assert rms(residuals(walk, samples, forces=False, widened=False)) > 20.0 * projected


def test_wrenches_are_moved_to_the_contact_point() -> None:
    walk = crawl()
    settings = {**SETTINGS, "contact_force_std": 1.0, "contact_moment_std": 0.1}
    plain = sdpid.process(walk.log(), settings).contacts
    moment = np.cross(RADIUS, walk.forces)
    wrenches = np.concatenate([walk.forces, moment], axis=-1)
    moved = sdpid.process(walk.log(forces=None, wrenches=wrenches), settings).contacts
    np.testing.assert_allclose(moved.forces, plain.forces, atol=1e-12)
    told = sdpid.process(walk.log(down=None), settings).contacts
    assert np.mean(told.down == plain.down) > 0.95


def test_what_a_sensor_shows_of_a_foot_in_the_air_is_left_out() -> None:
    walk = crawl()
    processing = sdpid.Processing(filter="finite", contact_force_std=0.2)
    shown = np.where(walk.down[:, :, None], walk.forces, [3.0, -2.0, 5.0])
    plain, offset = (
        samples_of(walk.robot, walk.log(forces=each), processing).contacts
        for each in (walk.forces, shown)
    )
    assert np.array_equal(plain.forces, offset.forces)


def test_a_time_around_landings_is_left_out() -> None:
    walk = crawl()
    samples = sdpid.process(walk.log(), {**SETTINGS, "impact_s": 0.01})
    landing = walk.time[1:][(walk.down[1:] & ~walk.down[:-1]).any(axis=1)]
    distance = np.abs(np.asarray(samples.time)[:, None] - landing).min(axis=1)
    assert samples.used[distance > 0.051].all()
    assert not samples.used[distance < 0.049].any()
    near = float(np.mean(distance < 0.05))
    all_of_them = {**SETTINGS, "impact_s": 0.01, "kept_share": 1.0 - 0.9 * near}
    assert sdpid.process(walk.log(), all_of_them).used.all()
    # Chosen by how many samples would go: of one landing few, of one every 50 ms most.
    once = np.tile(walk.time[:, None] > 0.5 * walk.time[-1], len(CRAWLING))
    often = np.tile(np.sin(2.0 * np.pi * walk.time[:, None] / 0.05) > 0.0, len(CRAWLING))
    for down, chosen in ((once, 0.0), (often, None)):
        found = default_processing(walk.log(down=down))
        assert found.impact_s == chosen
        assert any("sees a landing" in reason for reason in found.why)


def test_recordings_with_other_contacts_are_put_together() -> None:
    walk = crawl()
    log = walk.log()
    held = sdpid.Contacts(frames=["base_link"], kind="plane", down=np.ones((len(walk.time), 1)))
    for chosen in ({}, {"contact_force_std": 2.0}):
        processing = sdpid.Processing(filter="finite", **chosen)
        logs = [log, replace(log, contacts=held), replace(log, contacts=None)]
        standing, hanging, flying = (samples_of(walk.robot, each, processing) for each in logs)
        both = Samples.join([standing, hanging, flying]).contacts
        assert both.frames == (*CRAWLING, "base_link")
        K = standing.n_samples
        assert both.down[:, 4].tolist() == [False] * K + [True] * K + [False] * K
        assert not both.down[K:, :4].any()
        assert both.measured == bool(chosen)
        if both.force_covariance is not None:
            assert np.isinf(np.diagonal(both.force_covariance[4])).all()
            assert np.isfinite(both.force_covariance[:4]).all()


def test_what_does_not_fit_is_refused() -> None:
    walk = crawl()
    log, without = walk.log("pose"), walk.log("pose", forces=None)
    fused = sdpid.Processing(filter="finite", contact_force_std=0.2)
    gains = sdpid.DriveGains(joint_names=log.joint_names, gains=np.ones(log.n))
    for words, call, *given_ in (
        ("'butterworth', whose memory has no end", sdpid.process, log, {"filter": "butterworth"}),
        ("a recording with a base has none", sdpid.process, replace(log, period=1.0), fused),
        ("errors of drive gains are not known", sdpid.process, replace(log, gains=gains), fused),
        ("'imu', and the recording has no accel", sdpid.process, log, {"base_motion": "imu"}),
        ("'twist', and the recording has no ang", sdpid.process, log, {"base_motion": "twist"}),
        ("no contact forces", sdpid.process, without, {"contact_force_std": 1.0}),
        ("recording 2 of 2: contact_force_std: the", prepare, walk.robot, [log, without], fused),
        (r"fixed to the ground.*root='free_flyer'", samples_of, sdpid.load_robot("solo12"), log),
        ("no motion of the base", samples_of, walk.robot, replace(log, base=None, contacts=None)),
    ):
        refuses(DataError, words, call, *given_)
    # What is predicted needs no forces.
    predicted = prepare(walk.robot, log, fused).others(without).samples
    assert not predicted.contacts.measured


def test_a_finite_filter_sees_no_farther_than_it_says() -> None:
    for order in (1, 2, 3):
        finite = low_pass("finite", 20.0, order, 1000.0)
        assert finite.reach == 25 * order
        assert finite.gain(20.0, 1000.0)[0] == pytest.approx(0.5, abs=1e-6)
        pulse = np.zeros((301, 2))
        pulse[150] = 1.0
        seen = finite.apply(pulse)
        assert not seen[: 150 - finite.reach].any()
        np.testing.assert_allclose(seen.sum(axis=0), 1.0)
        np.testing.assert_allclose(seen, seen[::-1])


@pytest.mark.parametrize("frame", ["twist", "own_twist"])
@pytest.mark.parametrize(
    ("pose", "velocity"), [(3e-5, 3e-2), (3e-4, 1e-3), (1e-6, 1e-2), (1e-3, 1e-2)]
)
def test_accelerations_come_from_what_has_the_less_noise(frame: str, pose: float, velocity: float):
    walk, random = crawl(), np.random.default_rng(1)
    log = walk.log(frame)

    sizes = {
        "position": pose,
        "orientation": 0.5 * pose,
        "linear_velocity": velocity,
        "angular_velocity": velocity,
    }
    noisy = {
        name: table + sizes[name] * random.normal(size=table.shape)
        for name, table in log.base.channels.items()
    }
    base = replace(log.base, **noisy | {"orientation": unit(noisy["orientation"])})
    log = replace(log, base=base)
    found = {
        source: sdpid.process(log, {**SETTINGS, "base_motion": source})
        for source in ("auto", "twist", "pose")
    }
    at = rows(found["auto"], walk)
    classical = walk.a[at, :3] + np.cross(walk.v[at, 3:6], walk.v[at, :3])
    truth = np.hstack([classical, walk.a[at, 3:6]])
    for part in (slice(0, 3), slice(3, 6)):
        off = {k: rms(each.acceleration[:, part] - truth[:, part]) for k, each in found.items()}
        assert off["auto"] <= 1.01 * min(off["twist"], off["pose"]), off
    said = next(note for note in found["auto"].notes if "accelerations of the base" in note)
    assert "noise of" in said


# The noise of a pose bounds the cut-off where the base's accelerations are its differences.


def test_noise_of_the_pose_is_at_most_a_share_of_gravity_below_the_limit() -> None:
    rate, share = 1000.0, 2e-4
    rng = np.random.default_rng(1)
    position = 3e-4 * rng.normal(size=(2**15, 3))
    base = BaseMotion(orientation=np.tile([0.0, 0.0, 0.0, 1.0], (2**15, 1)), position=position)
    limit = base_limit(base, rate, share)
    frequency = np.fft.rfftfreq(2**15, 1.0 / rate)
    power = 2.0 * np.abs(np.fft.rfft(position, axis=0) / 2**15) ** 2
    below = ((2.0 * np.pi * frequency[:, None]) ** 4 * power)[frequency <= limit].sum()
    assert below == pytest.approx(share * 9.81**2, rel=0.15)


def test_a_base_without_an_accelerometer_is_filtered_more() -> None:
    log = sdpid.simulate_legged("solo12", "stand", duration=2.0).recording
    with_imu = default_processing(log)
    posed = default_processing(replace(log, base=replace(log.base, imu=None)))
    assert posed.cutoff_hz < 0.8 * with_imu.cutoff_hz
    assert "the base's acceleration" in posed.why[0]
    # What stands beside the pose does not help where it is not used, or is worse.
    chosen = default_processing(log, {"base_motion": "pose"})
    assert chosen.cutoff_hz == posed.cutoff_hz
    rng = np.random.default_rng(1)
    velocity = np.gradient(np.array(log.base.position), log.step, axis=0)
    base = BaseMotion(
        orientation=log.base.orientation,
        position=log.base.position,
        linear_velocity=velocity + rng.normal(size=velocity.shape),
        velocity_frame="world",
    )
    beside = default_processing(replace(log, base=base))
    assert beside.cutoff_hz == posed.cutoff_hz
    exact = replace(base, linear_velocity=np.zeros_like(velocity))
    assert default_processing(replace(log, base=exact)).cutoff_hz == with_imu.cutoff_hz
