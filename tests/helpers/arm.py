"""A small arm whose data no body explains, and conditions that each cost it something."""

from typing import Any

import numpy as np

import sdpid
from sdpid import constraints
from sdpid.estimation.constraints.condition import Condition
from sdpid.estimation.problem import Problem, build_problem
from sdpid.robot.inertia import Consistency
from tests.helpers.data import flat_links, make_samples, random_links, random_theta
from tests.helpers.robots import small_arm

BOTH: tuple[Consistency, ...] = ("pseudo_inertia", "spatial_inertia")
ARM = small_arm(2)
FIRST, LAST = ARM.link_names
MASS = 0.6

BODIES = random_links(np.random.default_rng(1), 2)
THETA = np.concatenate([BODIES.ravel(), np.random.default_rng(4).uniform(0.5, 2.0, 4)])
CUBE = np.stack(np.meshgrid(*[[-0.02, 0.01]] * 3), axis=-1).reshape(-1, 3)
TURNED = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))[0]
REFLECTION = np.diag([1.0, -1.0, 1.0, 1.0])
PAIR = constraints.MirrorPair(FIRST, LAST, reflection=REFLECTION)

# Without it, mass that nobody sees would make room for most conditions.
LIGHT = constraints.TotalMass(MASS, tolerance=0.1)
CONDITIONS: dict[str, tuple[Condition, ...]] = {
    "total": (LIGHT,),
    "group": (constraints.TotalMass(0.2, links=(LAST,)),),
    "box": (LIGHT, constraints.CenterOfMassInBox(LAST, (-0.02, 0.0, -np.inf), (0.02, 0.0, 0.01))),
    "ellipsoid": (
        LIGHT,
        constraints.CenterOfMassInEllipsoid(
            LAST, (0, 0.01, 0), (0.02, 0.05, 0.03), rotation=TURNED
        ),
    ),
    "all mass": (
        LIGHT,
        constraints.MassInEllipsoid(LAST, (0, 0.1, 0), (0.1, 0.2, 0.3), rotation=TURNED),
    ),
    "hull": (LIGHT, constraints.CenterOfMassInHull(LAST, CUBE)),
    "fixed": (constraints.Fixed({"m_2": 0.4, "Fv1": 0.5}),),
    "fixed link": (constraints.FixedLink(LAST, body=BODIES[0]),),
    "equal": (LIGHT, constraints.EqualLinks(FIRST, LAST)),
    "symmetric": (LIGHT, constraints.MirrorSymmetry(LAST, (0, 1, 1), (0, 0.02, 0))),
    "pair": (LIGHT, PAIR),
    "friction": (LIGHT, constraints.EqualFriction(*ARM.joint_names, within=0.2)),
}


def arm_problem(
    *others: Condition,
    consistency: Consistency = "pseudo_inertia",
    prior: sdpid.Prior | None = None,
    **numbers: Any,
) -> Problem:
    """Return a problem of links that are point masses, with much noise."""
    rng = np.random.default_rng(3)
    theta = random_theta(ARM, rng)
    theta[:20] = flat_links(rng, 2).ravel()
    samples = make_samples(ARM, theta, rng, noise=1.0)
    limits: dict[str, Any] = {"margin": 1e-3, "mass_max": 10.0, "theta_max": 20.0}
    limits = {**limits, "friction_max": 20.0, **numbers}
    constraints = sdpid.Constraints(others=others, **limits)
    return build_problem(
        ARM, samples, consistency=consistency, constraints=constraints, prior=prior
    )
