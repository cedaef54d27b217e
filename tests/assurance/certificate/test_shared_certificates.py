"""Certificates of the shared data sets and of the Denso, proven by a bare Python."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.assurance.certificate.certificate import Certificate
from sdpid.robot.inertia import Consistency
from sdpid.verifier import command
from sdpid.workflow.formulate import formulate
from tests.helpers.data import make_samples, random_links, random_theta

BOTH: tuple[Consistency, ...] = ("pseudo_inertia", "spatial_inertia")

# Robot and record of each set, and one friction model.
SETS: dict[str, tuple[str, str, tuple[Any, ...]]] = {
    "ur10_unisa": ("ur10.urdf", "ur10_exciting", ("coulomb",)),
    "panda_unisa": ("panda.urdf", "panda_exciting", ("coulomb",)),
    "kuka_lwr4plus": ("kuka_lwr4.urdf", "measurements_1", ("coulomb",)),
    "staubli_tx40": (
        "tx40.urdf",
        "tx40_rows_0_24750",
        (
            sdpid.friction.Coulomb(width=0.05),
            "rotor_inertia",
            sdpid.friction.Coupling("joint_5", "joint_6"),
        ),
    ),
    "kinova_gen3_dynamapp": (
        "gen3.urdf",
        "opti_traj_testing1",
        (sdpid.friction.Coulomb(width=0.02),),
    ),
}


def proven_alone(certificate: Certificate, path: Path) -> None:
    """Write a certificate and have a bare Python check it."""
    assert certificate.passed, certificate.summary()
    certificate.to_json(path)
    done = subprocess.run(
        [sys.executable, "-I", "-S", str(Path(command.__file__).parent), str(path)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1] == "PROVEN, but for what was not checked."
    assert f"cost less than {certificate.lower_bound!r}." in done.stdout


@pytest.mark.parametrize("name", list(SETS))
def test_real_recordings(name: str, data_folder: Path, tmp_path: Path) -> None:
    urdf, record, terms = SETS[name]
    robot = sdpid.load_robot(data_folder / name / urdf)
    log = sdpid.read_recording(data_folder / name / f"{record}.npz")
    for prior in (False, None, sdpid.Prior(kind="entropic")):
        problem = formulate(robot, log, friction=(*terms, "viscous", "offset"), prior=prior)
        for consistency in BOTH:
            estimate = sdpid.solve_sdp(problem.constrained(consistency=consistency))
            proven_alone(sdpid.certify(estimate), tmp_path / "c.json")


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize("kind", ["none", "pullback", "entropic"])
def test_the_arm_of_the_case_study(
    denso: sdpid.RobotModel, consistency: Consistency, kind: Any, tmp_path: Path
) -> None:
    """Noise that makes constraints active, and the margin of the paper."""
    rng = np.random.default_rng(0)
    theta = random_theta(denso, rng)
    theta[: 10 * denso.n_links] = random_links(rng, denso.n_links, points=1).ravel()
    samples = make_samples(denso, theta, rng, count=200, noise=0.1)
    bodies = random_links(rng, denso.n_links)
    prior = None if kind == "none" else sdpid.Prior(kind=kind, bodies=bodies)
    problem = sdpid.build_problem(
        denso,
        samples,
        consistency=consistency,
        constraints=sdpid.Constraints(margin=1e-3),
        prior=prior,
    )
    estimate = sdpid.solve_sdp(problem)
    proven_alone(sdpid.certify(estimate), tmp_path / "c.json")
