"""The code of docs/guides/fleet.md runs, and gives what one machine gives."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from tests.docs.test_docs import code_of
from tests.helpers.runs import arm, recorded

# Whoever collects tests does not wait until it is imported.
LACKING = find_spec("distributed") is None
pytestmark = pytest.mark.skipif(LACKING, reason="the extra dask is not installed")


PROCESSING = sdpid.Processing(cutoff_hz=10.0)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return recordings of one arm, in files."""
    folder = tmp_path_factory.mktemp("fleet")
    for seed in range(3):
        recorded(seed, seconds=20.0 + seed).to_parquet(folder / f"{seed}.parquet")
    return sorted(folder.iterdir())


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    """Return the names that the page defines; workers get functions of no module by value."""
    names: dict[str, Any] = {"__name__": "fleet_of_the_docs"}
    exec(compile(code_of("guides/fleet.md"), "docs/guides/fleet.md", "exec"), names)
    return names


def test_one_problem_on_a_cluster(page: dict[str, Any], files: list[Path]) -> None:
    options: dict[str, Any] = {"weighting": "residual"}
    options["friction"] = ("coulomb", "viscous", "offset")
    here = sdpid.build_problem(arm(), files, processing=PROCESSING, **options)
    there = page["fit"](arm(), files)
    np.testing.assert_array_equal(there.problem.A, here.A)
    np.testing.assert_array_equal(there.theta, sdpid.solve_sdp(here).theta)


def test_a_task_a_robot_and_joblib(
    page: dict[str, Any], files: list[Path], dask_client: Any
) -> None:
    missing = files[0].with_name("missing.parquet")
    found = page["all_robots"](dask_client, arm(), [*files, missing])
    problem = sdpid.build_problem(arm(), files, processing=PROCESSING, weighting="residual")
    compared, bands = page["repeated"](sdpid.solve_sdp(problem))
    # The log that is missing costs its own robot only.
    assert len(found) == len(files)
    for file, each in zip(files, found, strict=True):
        alone = page["one_robot"](file, arm(), PROCESSING)
        np.testing.assert_array_equal(each["theta"], alone["theta"])
        np.testing.assert_array_equal(each["factor"][0], alone["factor"][0])
        assert each["certificate"]["sha256"] == alone["certificate"]["sha256"]
    again = sdpid.compare(problem, starts=2, seed=0, n_jobs=2)
    assert [row.cost for row in compared.rows] == [row.cost for row in again.rows]
    expected = sdpid.confidence_intervals(sdpid.solve_sdp(problem), method="bootstrap")
    np.testing.assert_array_equal(bands.lower, expected.lower)
    np.testing.assert_array_equal(bands.upper, expected.upper)
