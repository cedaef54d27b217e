"""Elasticity of gears, from encoders on both of their sides."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError
from tests.helpers.elastic import DELAY, RATE, ROTORS, STIFFNESS, arm, found, log, rigid
from tests.helpers.refusals import refuses


@pytest.mark.slow
def test_stiffness_and_delay_are_within_their_intervals():
    held = []
    for seed in range(1, 13):
        one = found(seed)
        low, high = one.interval[:2].T
        held += ((low <= STIFFNESS[:2]) & (STIFFNESS[:2] <= high)).tolist()
        held.append(abs(one.delay_s[0] - DELAY) <= 2.1 * one.delay_error_s[0])
        held.append(np.isnan(one.stiffness[2]))
    assert np.mean(held) >= 0.85


def test_what_two_encoders_tell():
    one = found(1)
    np.testing.assert_allclose(one.stiffness[:2], STIFFNESS[:2], rtol=0.05)
    np.testing.assert_allclose(one.delay_s, DELAY, atol=5e-5)
    # A gear that gives way by nothing may be infinitely stiff.
    assert np.isnan([one.stiffness[2], *one.interval[2]]).all()
    assert one.compliance[2] >= 0.0
    assert one.terms == ((), (), ())
    other = log(7)
    assert one.errors(other).std(axis=0).max() < 1.5e-4
    blind = replace(other, link_position=None)
    np.testing.assert_allclose(one.deflection(blind), one.deflection(other), atol=1e-12)


def changed(**tables: Array) -> sdpid.Recording:
    return replace(log(1), **tables)


def tables() -> tuple[Array, Array]:
    both = log(1)
    assert both.link_position is not None
    return np.array(both.position), np.array(both.link_position)


def rounded() -> sdpid.Recording:
    """Return a recording whose last link repeats its motor, but for rounding."""
    motor, link = tables()
    link[:, 2] = np.round(motor[:, 2], 8)
    return changed(link_position=link)


def in_another_order() -> sdpid.Recording:
    (motor, link), order, both = tables(), [2, 0, 1], log(1)
    return sdpid.Recording(
        time=both.time,
        position=motor[:, order],
        effort=both.effort[:, order],
        link_position=link[:, order],
        joint_names=[both.names[j] for j in order],
    )


def with_gaps() -> sdpid.Recording:
    keep = np.ones(log(1).n_samples, dtype=bool)
    keep[[*range(1000, 1100), *range(1105, 1200), *range(3000, 3050)]] = False
    return log(1).rows(keep)


def jittered() -> sdpid.Recording:
    jitter = np.random.default_rng(0).uniform(-0.2, 0.2, log(1).n_samples) / RATE
    return changed(time=log(1).time + jitter)


def wrapped() -> sdpid.Recording:
    motor, link = tables()
    return changed(position=motor % (2.0 * np.pi), link_position=link % (2.0 * np.pi))


WAYS = {
    "rounded": (rounded, DELAY),
    "in another order": (in_another_order, DELAY),
    "with gaps": (with_gaps, DELAY),
    "jittered": (jittered, DELAY),
    "wrapped": (wrapped, DELAY),
    "in periods": (lambda: replace(log(1).rows(slice(0, 4000)), period=4.0, start=0.0), DELAY),
    "without noise": (lambda: log(1, noise=0.0), DELAY),
    "early": (lambda: log(1, late=-8e-3), -8e-3),
    "very late": (lambda: log(1, late=2e-2), 2e-2),
}


@pytest.mark.parametrize("way", WAYS)
def test_recordings_of_every_kind_tell_the_same(way: str):
    make, delay = WAYS[way]
    one = sdpid.identify_elasticity(rigid(), make(), ROTORS)
    np.testing.assert_allclose(one.stiffness[:2], STIFFNESS[:2], rtol=3e-3)
    np.testing.assert_allclose(one.delay_s[:2], delay, atol=1e-5)
    assert np.isnan(one.stiffness[2])
    assert np.isfinite(one.compliance[2]) == (way != "rounded")


def test_deflections_have_the_rows_of_the_recording():
    one, gaps = found(1), with_gaps()
    own = one.deflection(gaps)
    assert own.shape == gaps.position.shape
    # A stretch of five samples is too short to filter.
    alone = np.isnan(own).any(axis=1)
    assert np.flatnonzero(alone).tolist() == [*range(1000, 1005)]
    rows = np.searchsorted(log(1).time, gaps.time)
    missed = own - one.deflection(log(1))[rows]
    assert np.nanmedian(np.abs(missed)) < 5e-6
    # Near ends of stretches the filter is off.
    assert np.nanmax(np.abs(missed)) < 2e-3


def test_a_line_of_an_encoder_is_kept_where_recordings_that_are_left_out_keep_it():
    one, two = found(1, line=2e-3), found(1, 2, 3, line=2e-3)
    assert one.terms == ((), (), ())
    assert [[term.kind for term in terms] for terms in two.terms] == [[], ["line"], []]
    (term,) = two.terms[1]
    assert term.numbers[0] == pytest.approx(200.0, abs=0.05)
    assert np.linalg.norm(term.weights) == pytest.approx(2e-3, rel=0.05)
    other = log(7, line=2e-3)
    assert two.errors(other)[:, 1].std() < 0.25 * one.errors(other)[:, 1].std()


def test_a_curve_over_the_position_is_kept_and_ends_where_recordings_end():
    one, two = found(1, curve=5e-3), found(1, 2, curve=5e-3)
    assert one.terms == ((), (), ())
    assert [[term.kind for term in terms] for terms in two.terms] == [[], ["position"], []]
    other = log(7, curve=5e-3)
    assert two.errors(other)[:, 1].std() < 0.25 * one.errors(other)[:, 1].std()
    (term,) = two.terms[1]
    links = np.concatenate([np.asarray(log(k, curve=5e-3).link_position)[:, 1] for k in (1, 2)])
    low, high = term.numbers
    assert links.min() <= low < high <= links.max()
    outside = term.columns(np.array([low - 1.0, low, high, high + 1.0]), np.zeros(4))
    np.testing.assert_allclose(outside[[0, 3]], outside[[1, 2]])


def test_no_stiffness_is_given_that_recordings_which_are_left_out_do_not_confirm():
    firm = STIFFNESS.copy()
    firm[0] = np.inf
    other = log(2, stiffness=firm)
    two = sdpid.identify_elasticity(rigid(), [log(1), other], ROTORS)
    assert np.isfinite(found(1).stiffness).tolist() == [True, True, False]
    assert np.isfinite(two.stiffness).tolist() == [False, True, False]
    # What the recordings say together has an interval that does not reach zero.
    assert two.compliance[0] > 4.0 * two.compliance_error[0]
    assert "none told of joint_1" in two.in_words()


def test_rotors_that_the_motion_does_not_show_are_named():
    terms = ("coulomb", "viscous")
    plain = sdpid.identify(arm(), log(0), friction=terms, effects="none", intervals=False)
    without = sdpid.identify_elasticity(plain, log(1))
    assert without.conditional == arm().joint_names
    np.testing.assert_array_equal(without.rotor_inertia, 0.0)
    unknown = sdpid.identify_elasticity(rigid(), log(1), rotor_inertia=[np.nan, 0.2, np.nan])
    theta = rigid().estimate.named_theta()
    assert theta is not None
    assert unknown.rotor_inertia[1] == 0.2
    shown = [f"Ia{j + 1}" in rigid().estimate.problem.base.names for j in range(3)]
    expected = [theta[f"Ia{j + 1}"] if shown[j] else 0.0 for j in range(3)]
    np.testing.assert_allclose(unknown.rotor_inertia[[0, 2]], np.array(expected)[[0, 2]])


def test_it_is_shown_and_written(tmp_path: Path):
    one = found(1)
    one.save(tmp_path / "elasticity.json")
    kept = json.loads((tmp_path / "elasticity.json").read_text())
    assert kept["stiffness"][2] is None
    assert kept["stiffness"][0] == pytest.approx(one.stiffness[0])
    assert kept["joints"] == list(arm().joint_names)
    assert "stiffness, N·m/rad" in one._repr_html_()


def test_joints_with_one_encoder_are_left_out():
    both = log(1)
    assert both.link_position is not None
    links = np.array(both.link_position)
    links[:, 0] = both.position[:, 0]
    links[:, 2] = both.position[:, 1]
    one = sdpid.identify_elasticity(rigid(), replace(both, link_position=links), ROTORS)
    assert np.isfinite(one.compliance).tolist() == [False, True, False]
    found = sdpid.inspect_recording(replace(both, link_position=links)).findings
    assert {"link_late", "link_unlike"} <= {each.kind for each in found}
    # Joints at rest are like no other, and rounding makes no other encoder.
    motor, links = tables()
    rng = np.random.default_rng(0)
    motor[:, 0], links[:, 0] = 0.3 + 1e-5 * rng.standard_normal((2, len(motor)))
    links[:, 2] = np.round(motor[:, 2], 8)
    found = sdpid.inspect_recording(changed(position=motor, link_position=links)).findings
    assert "link_late" in (kinds := {each.kind for each in found})
    assert "link_unlike" not in kinds


REFUSED = [
    (lambda: sdpid.identify_elasticity(rigid(), []), "log: there are none; give at least one"),
    (lambda: sdpid.identify_elasticity(rigid(), 3), "log: is or holds"),
    (lambda: sdpid.identify_elasticity(3, log(1)), "estimate: is int; give what"),
    (
        lambda: sdpid.identify_elasticity(rigid(), replace(log(1), link_position=None)),
        "recording 1 has no positions of links",
    ),
    (
        lambda: sdpid.identify_elasticity(rigid(), replace(log(1), link_position=log(1).position)),
        "no joint has a second encoder",
    ),
    (
        lambda: sdpid.identify_elasticity(rigid(), log(1).rows(slice(0, 60))),
        "a recording has .* samples, in stretches without gaps; at least 200",
    ),
    (lambda: sdpid.identify_elasticity(rigid(), log(1), ["a"] * 3), "rotor_inertia: is"),  # type: ignore[arg-type]
    (
        lambda: sdpid.identify_elasticity(rigid(), log(1), rotor_inertia=[1.0, 2.0]),
        "rotor_inertia: is .* for each of the 3 joints",
    ),
    (lambda: sdpid.identify_elasticity(rigid(), log(1), rotor_inertia=-1.0), "not negative"),
]


@pytest.mark.parametrize(("call", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_what_is_refused(call: object, words: str):
    refuses(DataError, words, call)  # type: ignore[arg-type]


def test_joints_have_delays_of_their_own_where_recordings_ask_for_more():
    def mixed(seed: int) -> sdpid.Recording:
        one, other = log(seed), log(seed, late=6e-3)
        columns = (np.asarray(one.link_position)[:, :1], np.asarray(other.link_position)[:, 1:])
        return replace(one, link_position=np.hstack(columns))

    one = sdpid.identify_elasticity(rigid(), [mixed(1), mixed(2)], ROTORS)
    np.testing.assert_allclose(one.delay_s, [DELAY, 6e-3, 6e-3], atol=2e-5)
    words = one.in_words()
    assert words.startswith("elasticity: links' encoders late by 3 ± ")
    assert "ms, 6 ± " in words
    # From one recording a single delay is taken.
    alone = sdpid.identify_elasticity(rigid(), mixed(1), ROTORS)
    assert len({*alone.delay_s.tolist()}) == 1


def test_joints_that_stand_still_in_one_recording_keep_their_stiffness():
    """The others tell it; where the joint stands, its link gives way under what others do."""
    still = log(2, reach=np.array([0.3, 0.0, 0.3]))
    told = sdpid.identify_elasticity(rigid(), [log(1), still, log(3)], rotor_inertia=ROTORS)
    assert abs(told.stiffness[1] / STIFFNESS[1] - 1.0) < 0.02
