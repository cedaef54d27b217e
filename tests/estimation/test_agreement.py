"""Two estimates of one robot agree as often as stated, and a changed robot is found out."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid import build_problem
from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.agreement.agreement import Agreement
from sdpid.estimation.agreement.compare import beliefs_in_common, shared_parameters
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.posterior import prior_rows
from tests.helpers import world
from tests.helpers.arm import ARM, BODIES, THETA
from tests.helpers.data import make_samples
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm

HEAVIER = THETA * np.repeat([1.0, 1.2, 1.0], [10, 10, 4])
PRIORS = {"no prior": None, "prior": sdpid.Prior(bodies=BODIES, strength=100.0)}


def drawn(seed: int, theta: Array = THETA, *, count: int = 100, **options: Any) -> sdpid.Samples:
    rng = np.random.default_rng(seed)
    return make_samples(ARM, theta, rng, count=count, noise=0.3, **options)


def estimated(samples: sdpid.Samples, **options: Any) -> Estimate:
    return sdpid.solve_sdp(build_problem(ARM, samples, weighting="residual", **options))


@pytest.fixture(scope="module")
def first() -> Estimate:
    return estimated(drawn(1))


@pytest.fixture(scope="module")
def other() -> Estimate:
    return estimated(drawn(2))


@pytest.mark.parametrize("prior", PRIORS)
def test_one_robot_agrees_and_a_heavier_link_does_not(prior: str, first: Estimate) -> None:
    options = {"prior": PRIORS[prior], "base": first.problem.base}
    pairs = 25
    agreed, tested, outside = 0, 0, 0
    for pair in range(pairs):
        one, two = (estimated(drawn(10 + 2 * pair + k), **options) for k in range(2))
        found = one.compare_to(two)
        agreed += found.agree is True
        tested += sum(each.agree is not None for each in found.differences)
        outside += len(found.outside)
        if pair < 4:
            changed = estimated(drawn(11 + 2 * pair, HEAVIER), **options)
            apart = one.compare_to(changed)
            assert apart.agree is False
            assert {"mx2", "my2"} & set(apart.outside)
            assert not {"Fs1", "Fv1"} & set(apart.outside)
    # Binomial with 95 %: at most 4 of 25, and 2 to 9 % of some 300, but for 3 in 1000.
    assert agreed >= pairs - 4
    assert tested == pairs * len(first.base)
    assert 0.02 < outside / tested < 0.09


def test_without_a_prior_covariances_add_up(first: Estimate, other: Estimate) -> None:
    found = first.compare_to(other)
    S = first.covariance + other.covariance
    d = other.base - first.base
    assert [each.name for each in found.differences] == list(first.problem.base.names)
    np.testing.assert_allclose([each.difference for each in found.differences], d)
    sizes = [each.standard_error for each in found.differences]
    np.testing.assert_allclose(sizes, np.sqrt(np.diag(S)), rtol=1e-6)
    assert found.statistic == pytest.approx(d @ np.linalg.solve(S, d), rel=1e-6)
    assert found.rank == len(d)
    # A result stands for its estimate.
    back = other.compare_to(SimpleNamespace(estimate=first))
    assert back.p == pytest.approx(found.p, rel=1e-6)
    assert [each.difference for each in back.differences] == [
        -each.difference for each in found.differences
    ]
    assert [each.motion for each in found.efforts] == ["first", "other"]
    exact = first.problem.predict(d)
    relative = np.linalg.norm(exact) / np.linalg.norm(first.problem.samples.effort)
    assert found.efforts[0].relative == pytest.approx(relative)


def test_a_prior_that_both_state_cancels(first: Estimate) -> None:
    """Where both rest on it alone they cannot differ, and nothing is tested."""
    belief = sdpid.Prior(bodies=BODIES, strength=1e8)
    one, two = (estimated(drawn(k), prior=belief, base=first.problem.base) for k in (1, 2))
    i, j = beliefs_in_common(one, two)
    assert i.tolist() == j.tolist() == list(range(len(prior_rows(one))))
    result = one.compare_to(two)
    found = {each.name: each for each in result.differences}
    assert found["Fs1"].agree is not None
    assert found["mx2"].agree is None
    assert found["mx2"].t is None
    assert result.rank == 4


def test_errors_of_the_same_gains_cancel() -> None:
    known: Any = {"joint_names": ARM.joint_names, "gains": [10.0, 4.0]}

    def sizes(*variances: float) -> Array:
        gains = [sdpid.DriveGains(**known, covariance=v * np.eye(2)) for v in variances]
        one, two = (estimated(replace(drawn(k + 1), gains=g)) for k, g in enumerate(gains))
        return np.array([each.standard_error for each in one.compare_to(two).differences])

    exact, same, other = sizes(0.0, 0.0), sizes(0.2, 0.2), sizes(0.2, 0.201)
    assert np.all(same < 1.1 * exact)
    assert np.max(other / same) > 5.0


def test_other_priors_are_told(first: Estimate) -> None:
    base = first.problem.base
    one = estimated(drawn(1), prior=sdpid.Prior(bodies=BODIES), base=base)
    two = estimated(drawn(2), prior=sdpid.Prior(bodies=2.0 * BODIES, kind="euclidean"), base=base)
    assert any("priors differ" in note for note in one.compare_to(two).notes)
    same = estimated(drawn(2), prior=sdpid.Prior(bodies=BODIES), base=base)
    assert one.compare_to(same).notes == ()


def no_test(found: Agreement) -> None:
    assert not found.independent
    assert found.p is None
    assert found.agree is None
    assert found.statistic is None
    assert all(each.t is None and each.standard_error is None for each in found.differences)
    assert all(each.first_error for each in found.differences)
    assert "not independent" in found.summary()
    assert "error of first" in found.table()


def test_estimates_that_share_data_are_not_tested(first: Estimate, other: Estimate) -> None:
    no_test(first.compare_to(sdpid.solve_wls(first.problem)))
    both = sdpid.Samples.join([first.problem.samples, drawn(3)])
    no_test(first.compare_to(estimated(both)))
    no_test(first.compare_to(other, independent=False))
    forced = first.compare_to(sdpid.solve_wls(first.problem), independent=True)
    assert forced.p is not None
    assert "as asked" in forced.summary()


def test_only_what_both_have_is_compared(first: Estimate) -> None:
    more = estimated(drawn(2), friction=("coulomb", "viscous", "offset", "rotor_inertia"))
    found = first.compare_to(more)
    assert found.only_other == ("Fo1", "Fo2")
    assert not found.only_first
    assert {each.name for each in found.differences} == set(first.problem.base.names)
    assert "zz2 holds Ia2 too in the other alone." in found.notes
    assert any("friction terms differ" in note for note in found.notes)
    base = first.problem.base
    matrix = base.matrix.copy()
    matrix[base.names.index("zzr1")] *= 2.0
    pairs, notes = shared_parameters(base, replace(base, matrix=matrix))
    assert set(range(base.count)) - set(pairs[:, 0]) == {base.names.index("zzr1")}
    assert notes == ["Regrouped differently, and not compared: zzr1."]


def test_given_parameters_are_exact(first: Estimate) -> None:
    theta = np.asarray(first.theta)
    given = Estimate.of_theta(first.problem, THETA, method="given", status="given")
    found = first.compare_to(given)
    assert found.agree
    sizes = [each.standard_error for each in found.differences]
    expected = np.sqrt(np.diag(first.covariance))
    np.testing.assert_allclose(sizes, expected, rtol=1e-6)
    far = Estimate.of_theta(first.problem, 1.3 * theta, method="given", status="given")
    assert first.compare_to(far).agree is False
    assert given.compare_to(far).p is None


def test_what_cannot_be_compared_is_said(first: Estimate) -> None:
    refuses(DataError, r"other is str 'b'; give an Estimate", first.compare_to, "b")
    alien = sdpid.solve_wls(world.problem(small_arm(3), noise=0.1))
    refuses(DataError, "compare estimates of one robot", first.compare_to, alien)
    base = replace(first.problem.base, matrix=2.0 * first.problem.base.matrix)
    twice = replace(first, problem=replace(first.problem, base=base))
    refuses(DataError, "are their kinematics the same", first.compare_to, twice)
    refuses(DataError, "level is 95", first.compare_to, first, level=95)
    bare = sdpid.solve_wls(first.problem.without_rows())
    refuses(DataError, "were not kept", first.compare_to, bare)


def test_results_as_frames_text_and_html(first: Estimate, other: Estimate) -> None:
    pytest.importorskip("pandas")
    found = first.compare_to(other)
    frame = found.to_frame()
    assert list(frame.index) == list(first.problem.base.names)
    assert frame["difference"].to_numpy() == pytest.approx(other.base - first.base)
    assert "p = " in found.table()
    assert found.to_dict()["agree"] is found.agree
    base = first.to_frame()
    assert list(base.columns) == ["unit", "value", "standard_error", "regrouping"]
    assert base.loc["xxr2", "regrouping"] == "xx_2 - yy_2"
    assert base["standard_error"].to_numpy() == pytest.approx(first.standard_errors)
    bare = sdpid.solve_wls(first.problem.without_rows()).to_frame()
    assert bare["standard_error"].isna().all()
    standard = first.to_frame("standard")
    assert standard["value"].to_numpy() == pytest.approx(first.theta)
    assert standard.loc["m_2", "unit"] == "kg"
    words, wls = "gives no standard parameters", sdpid.solve_wls(first.problem)
    refuses(DataError, words, wls.to_frame, "standard")
    refuses(DataError, "use 'base' or 'standard'", first.to_frame, "links")
