"""Pieces on the workers of a local cluster: the same answer, also when a worker is killed."""

import os
import signal
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest

import sdpid
from sdpid import Processing, Recording, build_problem
from sdpid.errors import DataError, SolverError
from sdpid.estimation import problem as problem_module
from sdpid.estimation.compression import distributed_rows
from sdpid.estimation.compression.distributed_rows import DistributedSamples
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.problem import Problem
from tests.helpers.arm import ARM, BODIES, THETA
from tests.helpers.data import make_samples
from tests.helpers.motions import sines
from tests.helpers.refusals import refuses

PROCESSING = Processing(
    cutoff_hz=10.0, order=4, decimation=1, reversal_time=None, derivative="central4"
)
FRICTION = (sdpid.friction.Coulomb(width=0.02), sdpid.friction.SigmoidFriction(), "viscous")

# What the answers of one machine and of many may differ by, relative.
SAME = 1e-12


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return recordings of one arm, in files."""
    rng = np.random.default_rng(0)
    folder = tmp_path_factory.mktemp("pieces")
    made = []
    for number, count in enumerate((2900, 3500, 2700, 3100)):
        time = 0.005 * np.arange(count)
        waves = rng.uniform(0.2, 1.4, (4, 2)), rng.uniform(0, 6.3, (4, 2)), rng.normal(size=(4, 2))
        q, v, a = sines(time, 2 * np.pi * waves[0], *waves[1:])
        effort = ARM.inverse_dynamics(BODIES, q, v, a)
        effort = effort + 0.4 * np.tanh(v / 0.02) + 0.2 * v + 0.05 * rng.normal(size=q.shape)
        log = Recording(time=time, position=q, effort=effort, joint_names=ARM.joint_names)
        made.append(folder / f"run{number}.parquet")
        log.to_parquet(made[-1])
    return made


def built(pieces: Any, **options: Any) -> Problem:
    options = {"processing": PROCESSING, **options}
    client = options.pop("client", None)
    if client is not None:
        processing = options.pop("processing")
        pieces = DistributedSamples.read(client, ARM, pieces, processing=processing)
    return build_problem(
        ARM,
        pieces,
        friction=FRICTION,
        weighting="residual",
        prior=sdpid.Prior(bodies=BODIES),
        **options,
    )


def same(one: Problem, other: Problem) -> None:
    """Compare what two problems answer."""
    first, second = sdpid.solve_sdp(one), sdpid.solve_sdp(other)
    for name in ("base", "theta", "covariance"):
        expected = np.asarray(getattr(first, name))
        np.testing.assert_allclose(
            getattr(second, name), expected, rtol=0, atol=SAME * np.abs(expected).max()
        )
    assert second.cost == pytest.approx(first.cost, rel=SAME)
    one_file, other_file = sdpid.certify(first).to_dict(), sdpid.certify(second).to_dict()
    for key in ("samples", "rows", "rows_sha256"):
        assert one_file["origin"][key] == other_file["origin"][key]
    assert one.origin.profiled == other.origin.profiled


def kill_one(client: Any) -> None:
    """Kill a worker as the system does when memory runs out."""
    os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)


def test_one_processing_is_chosen_for_all(dask_client: Any, files: list[Path]) -> None:
    here = built(files, processing=None)
    there = built(files, processing=None, client=dask_client)
    said = [note for note in there.samples.notes if "the median of their cut-offs" in note]
    assert said
    assert said[0] in here.samples.notes
    counts = (there.n_samples, here.n_samples, here.samples.n_samples)
    assert there.samples.n_samples < 7000 < min(counts) == max(counts)
    assert there.n_rows == here.n_rows
    np.testing.assert_array_equal(there.A, here.A)


def test_a_killed_worker_loses_nothing(
    dask_client: Any, files: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    here = built(files)
    killed = []

    class Interrupted(Factor):
        @classmethod
        def of(cls, rows: Any, weighting: Any) -> Factor:
            # The pieces are read; now half of them are lost.
            kill_one(dask_client)
            killed.append(rows)
            return Factor.of(rows, weighting)

    monkeypatch.setattr(problem_module, "Factor", Interrupted)
    there = built(files, client=dask_client)
    assert killed
    same(here, there)
    kill_one(dask_client)
    # Standard errors look at the rows again.
    same(here, there)


def test_samples_in_memory_may_be_pieces_too(dask_client: Any) -> None:
    rng = np.random.default_rng(5)
    pieces = [make_samples(ARM, THETA, rng, count=k, noise=0.1) for k in (80, 120)]
    there = build_problem(ARM, DistributedSamples.read(dask_client, ARM, pieces))
    here = build_problem(ARM, pieces)
    np.testing.assert_array_equal(there.A, here.A)


def test_solvers_are_compared_on_the_cluster(dask_client: Any, files: list[Path]) -> None:
    there = built(files[:2], client=dask_client)
    with joblib.parallel_config(backend="dask"):
        found = sdpid.compare(there, starts=2, seed=0, local=("log_cholesky",))
    assert [row.solver for row in found.rows] == ["wls", "sdp", "log_cholesky", "log_cholesky"]
    assert all(estimate is not None and estimate.problem is there for estimate in found.estimates)


def test_what_needs_the_rows_here_says_so(dask_client: Any, files: list[Path]) -> None:
    there = built(files[:2], client=dask_client)
    refuses(DataError, "on the workers of a cluster", sdpid.solve_robust, there)
    refuses(DataError, "none to join", built, [], client=dask_client)
    with pytest.raises(DataError, match="no such file"):
        built([files[0].with_name("missing.parquet")], client=dask_client)


def test_a_cluster_without_workers_is_given_up(
    files: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
    monkeypatch.setattr(distributed_rows, "_LONELY", 0.5)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0") as cluster,
        distributed.Client(cluster) as alone,
        pytest.raises(SolverError, match="no worker has been left"),
    ):
        built(files, client=alone)
