"""Refit friction and offsets to a new recording, with the rigid part of an estimate kept."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import frozen
from sdpid.errors import DataError
from sdpid.estimation.constraints.equalities import Fixed
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.inspection.inspect import kinds_accepted
from sdpid.experiment.preparation.prepare import Logs, ProcessingOf, prepare
from sdpid.workflow.formulate import Formulation

# Units of parameters that belong to the rigid part beside the links: rotors and gravity's
# direction. Everything else of a joint changes with temperature, wear and zero errors.
_RIGID_UNITS = ("kg.m2", "rad")


def adapt(
    estimate: Estimate,
    log: Logs,
    *,
    processing: ProcessingOf = None,
    without_effort: Iterable[str] = (),
    accept: str | Iterable[str] = (),
) -> Estimate:
    """Refit friction and offsets alone to a new recording.

    Friction changes with temperature, load and wear, and sensors' zeros drift, where links do not:
    on recorded robots friction fitted anew halves the error on another day's recording. The
    parameters of the links, rotor inertias and gravity's direction stay exactly as they are; so do
    the shapes of the friction terms. All others are fitted again, with the usual weak belief that
    friction is small.

    Parameters
    ----------
    estimate : Estimate
        With standard parameters, such as those of `solve_sdp`.
    log : Recording or path, or a sequence of these
        What was measured on the same robot.
    processing : Processing or mapping, optional
        As for `identify`.
    without_effort : iterable of str, optional
        As for `identify`; the friction of these joints is the believed one, which is none.
    accept : str or iterable of str, optional
        As for `identify`: kinds of findings that do not refuse a recording.

    Returns
    -------
    Estimate
        The optimum over friction and offsets, of a problem that can be certified.

    Raises
    ------
    DataError
        When the estimate has no standard parameters or breaks its own constraints, or the
        recording cannot be used.
    SolverError
        When the program ends without an optimum.

    Examples
    --------
    >>> warm = sdpid.adapt(estimate, log)  # log: a run on another day
    >>> warm.status
    'optimal'
    >>> bool(np.array_equal(warm.theta[:60], estimate.theta[:60]))  # the links are the same
    True
    """
    old = estimate.problem
    if estimate.theta is None:
        raise DataError(
            f"adapt: the estimate ({estimate.method}) has no standard parameters to keep; give one "
            "of solve_sdp."
        )
    if not estimate.feasible:
        raise DataError(
            f"adapt: the estimate ({estimate.method}) breaks its constraints by "
            f"{estimate.violation:.1e}; give one of solve_sdp."
        )
    prepared = prepare(
        old.robot,
        log,
        processing,
        without_effort=without_effort,
        accept=kinds_accepted(accept),
    )
    links = 10 * old.robot.n_links
    units = np.array(old.base.theta_units)
    rigid = np.isin(units, _RIGID_UNITS)
    rigid[:links] = True
    kept = {old.base.theta_names[i]: float(estimate.theta[i]) for i in np.flatnonzero(rigid)}
    constraints = old.constraints.replace(others=(*old.constraints.others, Fixed(kept)))
    formulation = Formulation(
        friction=old.friction.terms,
        consistency=old.consistency,
        constraints=constraints,
        prior=Prior(bodies=estimate.theta[:links].reshape(-1, 10)),
        effects="none",
    )
    problem = formulation.problem(old.robot, prepared)
    found = solve_sdp(problem)
    assert found.theta is not None
    # Equations hold up to rounding; what was not fitted again is the same number.
    theta = np.where(rigid, estimate.theta, found.theta)
    return replace(found, theta=frozen(theta), base=frozen(problem.base_of(theta)))
