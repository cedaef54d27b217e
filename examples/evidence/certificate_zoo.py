"""Write certificates of every kind: what an attack on the verifier starts from.

Eighteen small problems of robots that come with the package or with example-robot-data, at random
states and with noise from a seed: both consistencies and none, both kinds of prior, rows, cones and
equations, a local solver's result, parameters that are not feasible, data without noise and with
next to nothing else, a tree.

    python examples/evidence/certificate_zoo.py --out results

and those of two humanoids. Told are the size of each file and the processor time of
``python -I -S sdpid/verifier`` for it.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from study import Rows, Study

import sdpid
from sdpid import constraints as of
from sdpid import verifier

# States drawn for each problem, and their ranges (rad, rad/s, rad/s²).
SAMPLES, RANGES = 60, (1.5, 1.5, 5.0)

# Kinds that --quick leaves out: the larger robots.
LARGE = ("panda", "tree", "hull")


def problem(
    robot: str,
    *others: Any,
    seed: int = 0,
    noise: float = 1.0,
    consistency: Any = "pseudo_inertia",
    prior: sdpid.Prior | None = None,
    weighting: Any = "gls",
    **limits: float,
) -> Any:
    """Return a problem of a robot whose described links are moved at random.

    Conditions may be functions of the names of links.
    """
    model = sdpid.load_robot(robot)
    rng = np.random.default_rng(seed)
    q, v, a = (scale * rng.uniform(-1.0, 1.0, (SAMPLES, model.n)) for scale in RANGES)
    effort = model.regressor(q, v, a) @ np.asarray(model.prior).ravel()
    effort += rng.uniform(0.5, 2.0, model.n) * np.sign(v) + rng.uniform(0.1, 1.0, model.n) * v
    effort += noise * rng.standard_normal(effort.shape)
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
    demands = {"margin": 1e-4, "mass_max": 50.0, "theta_max": 200.0, **limits}
    others = tuple(each(model.link_names) if callable(each) else each for each in others)
    return sdpid.build_problem(
        model,
        samples,
        consistency=consistency,
        constraints=sdpid.Constraints(others=others, **demands),
        prior=prior,
        weighting=weighting,
    )


def certified(found: Any) -> dict[str, Any]:
    """Return the certificate of the global optimum."""
    return sdpid.certify(sdpid.solve_sdp(found)).to_dict()


def kind(*asked: Any, **how: Any) -> Callable[[], dict[str, Any]]:
    """Return what makes the certificate of a problem."""
    return lambda: certified(problem(*asked, **how))


def local() -> dict[str, Any]:
    """Return a certificate of a local solver that was stopped early: a gap that is not small."""
    found = problem("double_pendulum", seed=5)
    early = sdpid.solve_slsqp(found, max_iterations=3)
    return sdpid.certify(early, bound=sdpid.solve_sdp(found)).to_dict()


def outside() -> dict[str, Any]:
    """Return a certificate whose parameters are not feasible: the bound alone is proven."""
    found = problem("double_pendulum", seed=6)
    # Least squares under no consistency: parameters of this cost that no body has.
    free = sdpid.solve_sdp(found.constrained(consistency="none"))
    moved = type(free).of_theta(found, free.theta, method="unconstrained", status="moved")
    return sdpid.certify(moved, bound=sdpid.solve_sdp(found)).to_dict()


ZOO: dict[str, Callable[[], dict[str, Any]]] = {
    "pendulum": kind("double_pendulum", seed=7),
    "denso": kind("denso_vp6242", seed=8),
    "spatial": kind("ur5_robot", seed=9, consistency="spatial_inertia"),
    "none": kind("double_pendulum", seed=10, consistency="none"),
    "pullback": kind("ur5_robot", seed=11, prior=sdpid.Prior()),
    "log-det": kind("ur5_robot", seed=12, prior=sdpid.Prior(kind="entropic")),
    "small log-det": kind(
        "double_pendulum", seed=13, margin=0.0, prior=sdpid.Prior(kind="entropic")
    ),
    # A total mass, a box and an ellipsoid of mass.
    "rows": kind(
        "ur5_robot",
        of.TotalMass(17.0, tolerance=0.2),
        lambda links: of.CenterOfMassInBox(links[1], (-0.3, -0.3, 0.0), (0.3, 0.05, np.inf)),
        lambda links: of.MassInEllipsoid(links[2], (0.0, 0.0, 0.2), (0.1, 0.1, 0.3)),
        seed=1,
    ),
    "cones": kind(
        "ur5_robot",
        of.TotalMass(15.0, tolerance=1.0),
        lambda links: of.CenterOfMassInEllipsoid(links[1], (0.0, 0.0, 0.2), (0.05, 0.05, 0.1)),
        lambda links: of.CenterOfMassInEllipsoid(links[3], (0.0, 0.0, 0.0), (0.02, 0.05, 0.03)),
        seed=2,
        consistency="spatial_inertia",
    ),
    # The faces of a collision shape.
    "hull": kind("panda", lambda links: of.CenterOfMassInHull(links[2], tolerance=5e-3), seed=3),
    # Known parameters, a known link and a known place of mass.
    "equations": kind(
        "ur5_robot",
        of.Fixed({"m_2": 8.0, "Fv1": 0.5}),
        lambda links: of.FixedLink(links[-1]),
        lambda links: of.MirrorSymmetry(links[2], (0.0, 1.0, 0.0)),
        seed=4,
    ),
    "local": local,
    "outside": outside,
    "panda": kind("panda", seed=14),
    "tree": kind("solo", seed=15),
    "noise-free": kind("double_pendulum", seed=16, noise=0.0),
    "big floor": kind("double_pendulum", seed=17, noise=1e3),
    "eq18": kind("double_pendulum", seed=18, weighting="eq18"),
}


# More parameters than samples show: a prior.
LARGE_ROBOTS = {
    "iCub": kind("icub", seed=19, prior=sdpid.Prior()),
    "Talos, 6x6": kind(
        "talos_full_v2",
        seed=20,
        consistency="spatial_inertia",
        prior=sdpid.Prior(kind="entropic"),
    ),
}


def made(quick: bool = False) -> dict[str, dict[str, Any]]:
    """Return the certificates by name; quick: those of small robots and few conditions alone."""
    return {name: make() for name, make in ZOO.items() if not (quick and name in LARGE)}


def verified(path: Path) -> tuple[str, float]:
    """Return the last line of the stand-alone verifier, and its processor time in seconds."""
    folder = str(Path(verifier.__file__).parent)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-I", "-S", folder, str(path)], capture_output=True, text=True, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return (done.stdout.splitlines() or [done.stderr])[-1], seconds


def written(out: Path, name: str) -> Rows:
    """Write a certificate, verify it, and yield its row."""
    data = {**ZOO, **LARGE_ROBOTS}[name]()
    path = out / f"{name.replace(' ', '_')}.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    sizes = len(data["problem"]["lower"]), len(data["problem"]["rhs"])
    verdict, seconds = verified(path)
    yield *sizes, path.stat().st_size / 1e6, seconds, verdict


def main() -> None:
    """Write every certificate, and verify it."""
    small = [name for name in ZOO if name not in LARGE]
    study = Study(__doc__, quick={"kinds": small}, kinds=[*ZOO, *LARGE_ROBOTS])
    header = ("certificate", "p", "b", "MB", "seconds", "verdict")
    study.rows("certificate_zoo.csv", header, partial(written, study.out), study.kinds)


if __name__ == "__main__":
    main()
