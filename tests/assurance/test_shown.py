"""Results show themselves in a line, and as HTML in a notebook."""

import json
from collections.abc import Iterator
from html.parser import HTMLParser
from typing import Any

import numpy as np

import sdpid
from sdpid.estimation.duality.multipliers import Multipliers
from tests.helpers import world
from tests.helpers.arm import ARM, LIGHT, arm_problem
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.data import make_samples, random_theta
from tests.helpers.robots import small_arm

# Characters of a line that is still read.
LINE = 200


def results() -> Iterator[Any]:
    problem = arm_problem(LIGHT)
    estimate = sdpid.solve_sdp(problem)
    yield sdpid.certify(estimate)
    yield sdpid.validate(estimate)
    yield sdpid.confidence_intervals(estimate, method="gauss_markov")
    yield sdpid.cost_of_constraints(estimate)
    yield sdpid.audit_urdf(ARM_URDF)
    yield sdpid.audit_base_parameters(ARM, {"zz2": -1.0, "Fv1": 1.0}, 0.1)
    arm, rng = small_arm(2), np.random.default_rng(0)
    theta = random_theta(arm, rng)
    with_load, without = (make_samples(arm, theta, rng, noise=0.1, block=2) for _ in range(2))
    yield sdpid.identify_payload(arm, with_load, without, friction=("coulomb", "viscous"))


class Tags(HTMLParser):
    """Which tags are open."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_parts_are_shown_in_a_line() -> None:
    arm = small_arm(2)
    samples, _ = world.samples(arm, 0, noise=0.1, block=2)
    problem = sdpid.build_problem(arm, samples, friction=("coulomb", "viscous"))
    parts = (
        problem.feasible,
        problem.excitation,
        Multipliers.of_cost(problem, problem.rhs),
        sdpid.paper_excitation("denso_vp6242", 5, periods=2, period=20.0),
    )
    for part in parts:
        assert repr(part).startswith(type(part).__name__ + "(")
        assert "\n" not in repr(part)
        assert len(repr(part)) < LINE


def test_results_are_shown_in_a_line_and_as_html() -> None:
    for result in results():
        line, html = repr(result), result._repr_html_()
        assert line.startswith(type(result).__name__ + "(")
        assert "\n" not in line
        assert len(line) < LINE
        parser = Tags()
        parser.feed(html)
        assert parser.open == []
        assert "<td" in html
        json.dumps(result.to_dict(), allow_nan=False)
