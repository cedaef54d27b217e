"""The code of docs/guides/fleet.md runs, and gives what one machine gives."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from tests.docs.test_docs import code_of
from tests.helpers.robots import small_arm

# Whoever collects tests does not wait until it is imported.
LACKING = find_spec("distributed") is None
pytestmark = [
    pytest.mark.xdist_group("dask"),
    pytest.mark.skipif(LACKING, reason="the extra dask is not installed"),
]

ARM = small_arm(2)
BODIES = np.tile([2.0, 0.1, 0.0, 0.1, 0.1, 0.0, 0.1, 0.0, 0.0, 0.1], (2, 1))
COUNTS = (1500, 1300, 1400)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return recordings of one arm, in files."""
    folder = tmp_path_factory.mktemp("fleet")
    rng = np.random.default_rng(3)
    made = []
    for number, count in enumerate(COUNTS):
        time = 0.005 * np.arange(count)
        w = rng.uniform(2.0, 7.0, (5, 1, 2))
        wave = w * time[:, None] + rng.uniform(0.0, 6.3, (5, 1, 2))
        size = rng.uniform(0.2, 0.6, (5, 1, 2))
        q = (size * np.sin(wave)).sum(axis=0)
        v = (size * w * np.cos(wave)).sum(axis=0)
        a = -(size * w**2 * np.sin(wave)).sum(axis=0)
        effort = ARM.inverse_dynamics(BODIES, q, v, a) + 0.3 * np.sign(v) + 0.2 * v
        effort += 0.05 * rng.standard_normal(q.shape)
        log = sdpid.Recording(time=time, position=q, effort=effort, joint_names=ARM.joint_names)
        made.append(folder / f"{number}.parquet")
        log.to_parquet(made[-1])
    return made


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    """Return the names that the page defines; workers get functions of no module by value."""
    names: dict[str, Any] = {"__name__": "fleet_of_the_docs"}
    exec(compile(code_of("guides/fleet.md"), "docs/guides/fleet.md", "exec"), names)
    return names


def test_one_problem_on_a_cluster(page: dict[str, Any], files: list[Path]) -> None:
    there = page["fit"](ARM, files)
    here = sdpid.solve_sdp(
        sdpid.build_problem(
            ARM,
            files,
            processing=sdpid.Processing(cutoff_hz=10.0),
            friction=("coulomb", "viscous", "offset"),
            weighting="residual",
        )
    )
    np.testing.assert_array_equal(there.problem.A, here.problem.A)
    np.testing.assert_array_equal(there.theta, here.theta)


def test_a_task_a_robot_and_joblib(
    page: dict[str, Any], files: list[Path], dask_client: Any
) -> None:
    processing = sdpid.Processing(cutoff_hz=10.0)
    missing = files[0].with_name("missing.parquet")
    found = page["all_robots"](dask_client, ARM, [*files, missing])
    problem = sdpid.build_problem(ARM, files, processing=processing, weighting="residual")
    compared, bands = page["repeated"](sdpid.solve_sdp(problem))
    # The log that is missing costs its own robot only.
    assert len(found) == len(files)
    for file, each in zip(files, found, strict=True):
        alone = page["one_robot"](file, ARM, processing)
        np.testing.assert_array_equal(each["theta"], alone["theta"])
        np.testing.assert_array_equal(each["factor"][0], alone["factor"][0])
        assert each["certificate"]["sha256"] == alone["certificate"]["sha256"]
    again = sdpid.compare(problem, starts=2, seed=0, n_jobs=2)
    assert [row.cost for row in compared.rows] == [row.cost for row in again.rows]
    expected = sdpid.confidence_intervals(sdpid.solve_sdp(problem), method="bootstrap")
    np.testing.assert_array_equal(bands.lower, expected.lower)
    np.testing.assert_array_equal(bands.upper, expected.upper)
