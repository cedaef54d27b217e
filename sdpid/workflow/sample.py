"""Draw consistent robots from the posterior of an estimate, to simulate and to learn with."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, require_probability
from sdpid._common.tables import Shown, Table
from sdpid.assurance.certificate.certificate import Certificate, certify
from sdpid.assurance.sampling.draw import Draws, draw
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.output.samples.ranges import Ranges
from sdpid.output.samples.write import RobotKind, SampleWriter, write_samples
from sdpid.robot.model.dynamics import RobotDynamics

# All draws are kept in memory, some times over: of a seven-axis arm these take gigabytes.
_MOST = 1_000_000

# Share of the draws within each range.
PROBABILITY = 0.95

# Weighted efforts of an optimum that is found again, on another machine or with other libraries,
# differ by less than this share.
_SAME = 1e-5

# In place of efforts that are all zero.
_TINY = 1e-300


def sample_parameters(estimate: Any, n: int, seed: int = 0) -> ParameterSamples:
    """Draw consistent robots from the posterior of an estimate under its constraints.

    Every draw obeys all constraints of the problem: each of its links can be a body. What neither
    the data nor the prior says is as wide as the constraints leave it. See docs/guides/sampling.md
    for what the spread of draws promises, docs/theory/sampling.md for the method.

    Parameters
    ----------
    estimate : Estimate, Identification or Certificate
        The estimate, with standard parameters; of the others the one that is certified.
    n : int
        Number of draws, up to a million.
    seed : int, optional
        The same seed gives the same draws.

    Returns
    -------
    ParameterSamples

    Raises
    ------
    DataError
        When `n` or `seed` is no such number, or there is no posterior to draw from.

    Examples
    --------
    >>> known = [sdpid.constraints.FixedLink(link, estimate.theta[10 * i : 10 * i + 10])
    ...          for i, link in enumerate(robot.link_names[:-1])]
    >>> limits = sdpid.Constraints(others=tuple(known))  # all links but the last
    >>> last = sdpid.solve_sdp(problem.constrained(constraints=limits))
    >>> draws = sdpid.sample_parameters(last, 20, seed=0)
    >>> draws.theta.shape
    (20, 72)
    >>> all(model.theta[50] > 0.0 for model in draws.models())
    True
    """
    proof = (
        estimate if isinstance(estimate, Certificate) else getattr(estimate, "certificate", None)
    )
    found = getattr(proof, "certified", estimate)
    if not isinstance(found, Estimate):
        raise DataError(
            f"estimate: is {type(estimate).__name__}; give what solve_sdp or identify returned."
        )
    _require_whole("n", n, 1, _MOST)
    _require_whole("seed", seed, 0)
    return ParameterSamples(
        estimate=found,
        draws=draw(found, int(n), seed=int(seed)),
        seed=int(seed),
        certificate=proof.to_dict()["sha256"] if isinstance(proof, Certificate) else None,
    )


def optimum(problem: Problem) -> Certificate:
    """Return the certified optimum of a problem, made as `identify` makes it."""
    return certify(solve_sdp(problem))


def require_same(estimate: Estimate, given: Mapping[str, float], file: str) -> None:
    """Refuse an estimate whose efforts are not those of the parameters that a run wrote.

    Parameters
    ----------
    estimate : Estimate
        Of the run, made again.
    given : mapping of str to float
        What the run wrote, by name.
    file : str
        Where it is.

    Raises
    ------
    DataError
        With the difference and the limit.
    """
    problem = estimate.problem
    names = problem.base.theta_names
    if set(given) != set(names):
        other = sorted(set(given) ^ set(names))
        raise DataError(
            f"{file}: the run, made again, has other parameters ({', '.join(other[:4])}, ...); "
            "its robot or its options have changed since: identify again."
        )
    written = problem.base_of([given[name] for name in names])
    size = float(np.linalg.norm(problem.A @ written))
    apart = float(np.linalg.norm(problem.A @ (estimate.base - written))) / max(size, _TINY)
    if not apart <= _SAME:
        raise DataError(
            f"{file}: the run, made again, predicts efforts that differ by {apart:.2g} of them "
            f"from those of these parameters, at most {_SAME:g} is rounding; its log, its robot "
            "or its options have changed since: identify again."
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ParameterSamples(Shown):
    """Robots drawn from the posterior of an estimate.

    Attributes
    ----------
    estimate : Estimate
        What they are draws of.
    draws : Draws
        The draws, and how well the chains that made them mixed.
    seed : int
        What they were drawn with.
    certificate : str or None
        Digest of the estimate's certificate, where there is one.

    Examples
    --------
    >>> known = [sdpid.constraints.FixedLink(link, estimate.theta[10 * i : 10 * i + 10])
    ...          for i, link in enumerate(robot.link_names[:-1])]
    >>> limits = sdpid.Constraints(others=tuple(known))  # all links but the last
    >>> last = sdpid.solve_sdp(problem.constrained(constraints=limits))
    >>> draws = sdpid.sample_parameters(last, 10, seed=0)
    >>> draws.theta.shape, draws.base.shape
    ((10, 72), (10, 48))
    >>> files = draws.save("robots")
    """

    estimate: Estimate
    draws: Draws
    seed: int
    certificate: str | None = None

    def __len__(self) -> int:
        """Return the number of draws."""
        return len(self.draws.theta)

    def _shown(self) -> dict[str, object]:
        facts: dict[str, object] = {
            "robot": self.estimate.problem.robot.name,
            "draws": len(self),
            "seed": self.seed,
            "least effective sample size": float(np.min(self.draws.effective_sizes)),
            "largest split R-hat": float(np.max(self.draws.r_hat)),
        }
        return facts | {f"note {k}": note for k, note in enumerate(self.notes, 1)}

    def _tables(self) -> Iterator[Table]:
        low, middle, high = np.quantile(self.base, [0.025, 0.5, 0.975], axis=0)
        base = self.estimate.problem.base
        yield Table.of_columns(
            {
                "base parameter": base.names,
                "unit": base.units,
                "2.5 %": low.tolist(),
                "median": middle.tolist(),
                "97.5 %": high.tolist(),
            }
        )

    @property
    def theta(self) -> Array:
        """Standard parameters of every draw, (n, p)."""
        return self.draws.theta

    @property
    def base(self) -> Array:
        """Base parameters of every draw, (n, b)."""
        return self.draws.base

    @property
    def notes(self) -> tuple[str, ...]:
        """What there is to say of the draws."""
        return self.draws.notes

    def models(self) -> Iterator[RobotDynamics]:
        """Yield the robot of each draw, to compute with."""
        problem = self.estimate.problem
        for theta in self.theta:
            yield RobotDynamics(robot=problem.robot, terms=problem.friction, theta=theta)

    def to_frame(self) -> Any:
        """Return the draws as a pandas DataFrame, one row each."""
        import pandas

        return pandas.DataFrame(self.theta, columns=list(self.estimate.problem.base.theta_names))

    def ranges(self, probability: float = PROBABILITY) -> Ranges:
        """Return ranges for domain randomization, relative to the mean of the draws.

        Prefer the draws themselves: ranges lose the correlation of the parameters, and
        `Ranges.widened` says what that costs.

        Parameters
        ----------
        probability : float, optional
            Share of the draws within each range.
        """
        require_probability(probability, "probability")
        writer = SampleWriter(self.estimate, self.theta, kinds=())
        return writer.ranges(probability, self._made())

    def save(
        self,
        folder: str | os.PathLike[str],
        kinds: Sequence[RobotKind] = ("urdf",),
        *,
        source: str | os.PathLike[str] | None = None,
        probability: float = PROBABILITY,
        report: Callable[[str], None] | None = None,
    ) -> tuple[Path, ...]:
        """Write every draw as a robot, ranges, and a manifest into a folder: all, or nothing.

        The folder gets ``robot_0001.urdf`` and so on, ``mean.urdf`` (the mean of the draws, which
        the ranges are relative to), ``ranges.json``, ``draws.csv`` and ``samples.json``. Of every
        robot each number is audited as `audit_urdf` does; MuJoCo loads every MJCF that is made
        from a URDF. The body that moves with a joint is written at the link that the joint moves,
        and the inertials of links fixed to it are zero.

        Parameters
        ----------
        folder : path
            Created when it is not there. Robots of an earlier run in it are replaced or removed.
        kinds : sequence of {"urdf", "mjcf"}, optional
            Formats of the robots; MJCF takes the extra ``sim``.
        source : str or path, optional
            URDF or MJCF to change; by default the URDF that the robot was loaded from.
        probability : float, optional
            Share of the draws within each range.
        report : callable, optional
            Called with a sentence for what differs from the source beside numbers of moving links,
            and for each file of an earlier run that was changed and stays.

        Returns
        -------
        tuple of Path
            The files.

        Raises
        ------
        ExportError
            When the folder cannot be written to, would lose a file that no such run wrote, or the
            robots cannot be written.
        """
        require_probability(probability, "probability")
        writer = SampleWriter(self.estimate, self.theta, kinds=kinds, source=source)
        return write_samples(
            writer,
            folder,
            probability=probability,
            made=self._made(),
            diagnostics=self.diagnostics,
            report=report,
        )

    @cached_property
    def diagnostics(self) -> Mapping[str, Any]:
        """How well the chains mixed: the worst parameters' numbers, and notes."""
        names = self.estimate.problem.base.theta_names
        sizes, r_hat = self.draws.effective_sizes, self.draws.r_hat
        return {
            "least_effective_size": float(np.min(sizes)),
            "least_of": names[int(np.argmin(sizes))],
            "largest_r_hat": float(np.max(r_hat)),
            "largest_of": names[int(np.argmax(r_hat))],
            "notes": list(self.notes),
        }

    def _made(self) -> dict[str, Any]:
        """Return what the draws were made of."""
        estimate = self.estimate
        assert estimate.theta is not None
        return {
            "robot": estimate.problem.robot.name,
            "method": estimate.method,
            "seed": self.seed,
            # Of the estimate's standard parameters as little-endian doubles.
            "parameters_sha256": hashlib.sha256(estimate.theta.astype("<f8").tobytes()).hexdigest(),
            "certificate": self.certificate,
        }


def _require_whole(name: str, number: Any, least: int, most: int | None = None) -> None:
    """Refuse a number that is not whole, less than the least or more than the most."""
    whole = isinstance(number, Integral) and not isinstance(number, bool)
    if not whole or int(number) < least or (most is not None and int(number) > most):
        upto = "on" if most is None else f"to {most}"
        raise DataError(f"{name}: is {number!r}; give a whole number from {least} {upto}.")
