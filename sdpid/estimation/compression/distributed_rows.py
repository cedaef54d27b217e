"""Samples that stay where they were read: on the workers of a Dask cluster.

Each recording is read and processed by the worker that keeps it. What a problem needs of the rows
are sums over recordings: they are computed where the recording is, sent here, and added in the
order of the recordings. So neither the number of workers nor the loss of one changes a bit of the
result: what was lost is read again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from operator import attrgetter, methodcaller
from typing import TYPE_CHECKING, Any, TypeVar

from sdpid._common.arrays import Array
from sdpid.errors import DataError, SolverError
from sdpid.estimation.compression.rows import RowSource
from sdpid.experiment.preparation.prepare import Piece, agreed, as_pieces, samples_of
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.readers.read import read_recording
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import BaseParameters
from sdpid.robot.model.model import RobotModel

if TYPE_CHECKING:
    from distributed import Client, Future

T = TypeVar("T")

# A cluster without a worker is looked at again after this many seconds, and then given up.
_LONELY = 60.0

# Samples that are brought here for plots, and for the speeds at which friction bends.
_BROUGHT = 4096


@dataclass(frozen=True, eq=False)
class DistributedSamples:
    """The samples of recordings on the workers of a cluster, for `sdpid.build_problem`.

    Attributes
    ----------
    client : dask.distributed.Client
        Of the cluster.
    robot : Future
        The robot, once for all. It is a task: data that are scattered are gone with their worker.
    pieces : tuple of Future
        The samples of every recording.
    counts : tuple of int
        Number of samples of each.
    samples : Samples
        An evenly thinned selection; its notes say of how many.
    """

    client: Client
    robot: Future[RobotModel]
    pieces: tuple[Future[Samples], ...]
    counts: tuple[int, ...]
    samples: Samples

    @classmethod
    def read(
        cls,
        client: Client,
        robot: RobotModel,
        recordings: Piece | Sequence[Piece],
        *,
        processing: Processing | None = None,
    ) -> DistributedSamples:
        """Have recordings read and processed by the workers.

        Parameters
        ----------
        client : dask.distributed.Client
            Of the cluster.
        robot : RobotModel
            Whose joints they have.
        recordings : Samples, Recording or path, or a sequence of these
            Files are read by the workers, which must see them.
        processing : Processing, optional
            Of recordings and files; by default one for all, that of the recording with the median
            cut-off.

        Raises
        ------
        DataError
            When there are no recordings, they cannot be joined, or each has a covariance of its
            own.
        SolverError
            When the cluster has no workers left.
        """
        given = as_pieces(recordings)
        if not given:
            raise DataError("samples: there are none to join.")
        there, why = client.submit(_same, robot, pure=False), None
        logs = [piece for piece in given if not isinstance(piece, Samples)]
        if processing is None and logs:
            choices = _asked(client, _choice, logs)
            processing, why = agreed(choices, floating=robot.free_flyer)
        futures = tuple(
            client.submit(samples_of, there, piece, processing, pure=False) for piece in given
        )
        counts = tuple(_asked(client, attrgetter("n_samples"), futures))
        step = max(sum(counts) // _BROUGHT, 1)
        found = _asked(client, methodcaller("every", step), futures)
        thin = Samples.join(found)
        if thin.covariance is not None and thin.covariance.ndim == 3:
            raise DataError(
                "samples: pieces have covariances of their own; on a cluster all share one (n, n), "
                "or have none."
            )
        note = f"{sum(counts)} samples of {len(counts)} recordings stay on the workers of a cluster"
        if step > 1:
            note += f"; here is one in {step}"
        notes = (*thin.notes, note) if why is None else (*thin.notes, why, note)
        return cls(client, there, futures, counts, replace(thin, notes=notes))

    @property
    def n_samples(self) -> int:
        """Number of samples of all recordings."""
        return sum(self.counts)

    def map(
        self,
        rows: RowSource,
        function: Callable[..., T],
        arguments: tuple[object, ...],
        sigma: Array | None,
    ) -> list[T]:
        """Apply a function to the rows of each recording; results are in their order.

        Raises
        ------
        DataError
            For a covariance a sample.
        """
        if sigma is not None and sigma.ndim == 3:
            raise DataError(
                "samples: a covariance a sample cannot be used with rows on a cluster; use the "
                "weighting 'gls' or 'residual'."
            )
        model = rows.friction, rows.base
        call = methodcaller("map", function, *arguments, sigma=sigma)
        found = _asked(self.client, _mapped, self.pieces, self.robot, model, call)
        return list(chain.from_iterable(found))


def _same(robot: RobotModel) -> RobotModel:
    return robot


def _choice(log: Any) -> Processing:
    return default_processing(log if isinstance(log, Recording) else read_recording(log))


def _mapped(
    samples: Samples,
    robot: RobotModel,
    model: tuple[FrictionModel, BaseParameters],
    call: Callable[[RowSource], list[T]],
) -> list[T]:
    """Apply a function to the rows of one recording, on its worker."""
    return call(RowSource(robot, *model, samples))


def _asked(client: Client, function: Callable[..., T], each: Iterable[Any], *rest: Any) -> list[T]:
    """Return the results of a function of several things on a cluster, in their order."""
    futures = [client.submit(function, one, *rest, pure=False) for one in each]
    import distributed

    try:
        while True:
            try:
                distributed.wait(futures, timeout=_LONELY)
                break
            except distributed.TimeoutError:
                # Without any worker nothing will ever come.
                if not client.nthreads():
                    raise SolverError(
                        f"cluster: no worker has been left for up to {_LONELY:g} s, and "
                        f"{len(futures)} pieces wait; see the workers' logs, and start new ones."
                    ) from None
        return list(client.gather(futures))
    except distributed.KilledWorker as cause:
        raise SolverError(
            f"cluster: the same task ended its worker again and again ({cause}); a recording may "
            "be too large for the workers' memory: give them more, or split it."
        ) from None
