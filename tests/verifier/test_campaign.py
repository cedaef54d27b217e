"""The campaign of forgeries finds errors that are planted in the verifier, and none otherwise."""

import copy
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any

import pytest

from sdpid.verifier import bound, certificate
from sdpid.verifier.bound import Recomputed
from sdpid.verifier.certificate import Proof
from tests.helpers.studies import study

FORGERIES, ZOO = study("forgeries"), study("certificate_zoo")
JUDGE = study("certificate_judge").Judge()
SMALL = ("pendulum", "small log-det", "local", "big floor")

Patch = pytest.MonkeyPatch


@cache
def zoo() -> dict[str, Any]:
    """Return small certificates of every kind."""
    names = ZOO.sdpid.load_robot("double_pendulum").link_names
    cone = ZOO.of.CenterOfMassInEllipsoid(names[1], (0.0, 0.0, 0.2), (0.05, 0.05, 0.1))
    others = (ZOO.of.TotalMass(1.2, tolerance=0.1), cone)
    made = {name: ZOO.ZOO[name]() for name in SMALL}
    made["rows"] = ZOO.certified(ZOO.problem("double_pendulum", *others, seed=21))
    spatial = ZOO.problem("double_pendulum", seed=22, consistency="spatial_inertia")
    made["spatial"] = ZOO.certified(spatial)
    return made


def false(count: int, *kinds: str) -> list[Any]:
    """Return the forgeries of which something false was said."""
    found = FORGERIES.some(range(count), 0, zoo(), kinds or tuple(sorted(FORGERIES.MUTATIONS)))
    return [each for each in found if each.false]


def changed(name: str, how: Callable[[Any], None]) -> Callable[[Patch], None]:
    """Return what does something more after a method of the verifier."""
    of = Proof if name == "__init__" else Recomputed
    kept = getattr(of, name)

    def method(self: Any, *arguments: Any) -> None:
        kept(self, *arguments)
        how(self)

    return lambda patch: patch.setattr(of, name, method)


def no_violation(proof: Any) -> None:
    proof.violation = Fraction(0)


def higher_bound(proof: Any) -> None:
    proof.lower_bound += abs(proof.lower_bound) / 1000


def lower_cost(proof: Any) -> None:
    proof.data_cost *= Fraction(999, 1000)


PLANTED: dict[str, tuple[Callable[[Patch], None], tuple[str, ...]]] = {
    "Z may be anything": (
        lambda patch: patch.setattr(bound, "positive_semidefinite", lambda _: True),
        ("bent multipliers",),
    ),
    "links may be anything": (
        lambda patch: patch.setattr(certificate, "_wrong_margins", lambda *_: []),
        ("parameters", "claim"),
    ),
    "bounds on theta are not looked at": (
        lambda patch: patch.setattr(
            certificate,
            "infeasible",
            lambda *given: [each for each in _INFEASIBLE(*given) if "outside" not in each],
        ),
        ("bounds",),
    ),
    "a large tolerance": (
        lambda patch: patch.setattr(certificate, "TOLERANCE", Fraction(10)),
        ("added row",),
    ),
    "rows are not looked at": (changed("_rows", no_violation), ("added row",)),
    "a bound that is too high": (changed("__init__", higher_bound), ("last digits",)),
    "a cost that is too low": (changed("__init__", lower_cost), ("last digits",)),
}
_INFEASIBLE = certificate.infeasible


def test_nothing_false_is_said() -> None:
    assert false(30) == []


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_error_is_found(name: str, monkeypatch: Patch) -> None:
    plant, kinds = PLANTED[name]
    plant(monkeypatch)
    assert false(16, *kinds)


# ---- The judge ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*SMALL, "rows", "spatial"])
def test_what_is_true_is_judged_true(name: str) -> None:
    assert {verdict for verdict, _ in JUDGE(zoo()[name]).values()} == {"true"}


@pytest.mark.parametrize("name", [*SMALL, "rows", "spatial"])
@pytest.mark.parametrize(
    ("claim", "key", "better"),
    [("lower bound", "lower_bound", 1.001), ("cost", "cost", 0.999), ("gap", "gap", -1.0)],
)
def test_what_is_better_than_true_is_judged_false(
    name: str, claim: str, key: str, better: float
) -> None:
    data = copy.deepcopy(zoo()[name])
    data["claims"][key] *= better
    if name == "local" and claim == "lower bound":
        # Its own parameters are far above: others are found.
        assert data["claims"]["lower_bound"] < data["claims"]["cost"]
    assert JUDGE.claim(data, claim)[0] == "false"
