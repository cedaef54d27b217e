"""Findings about where efforts and forces come from: gains of drives, a floating base, contacts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.provenance import directions_told, provenance
from sdpid.errors import SdpidError
from sdpid.estimation.compression.contact_noise import contact_noise
from sdpid.estimation.gain_errors import gain_errors
from sdpid.estimation.posterior import Posterior
from sdpid.estimation.problem import Problem
from sdpid.output.report.grades import Finding, listed, percent
from sdpid.output.report.judged import Judged, judged

# A parameter is as good as its gains where more than half of its variance is theirs: no longer
# record halves it.
MOSTLY = 0.5


def gains_findings(result: Judged) -> Iterator[Finding]:
    """Say what errors of the gains do to the parameters, or that none are counted."""
    errors, rows = gain_errors(result.problem), result.problem.rows
    gains = None if rows is None else rows.samples.gains
    if gains is None:
        return
    if errors is None:
        yield Finding(
            "caution",
            "Efforts were made of currents by gains that are taken as exact: no interval counts "
            "their errors, and a common factor of the gains is one of every mass. 'sdpid gains' "
            "estimates gains with errors.",
        )
        return
    shares = gains.standard_errors / gains.gains
    ends = " to ".join(
        dict.fromkeys(f"{100.0 * share:.2g} %" for share in (shares.min(), shares.max()))
    )
    known = (
        f"Efforts were made of currents by gains that are known to {ends} (one standard error), "
        f"{100.0 * gains.common_factor:.2g} % of it in common, which moves every mass and inertia "
        "alike"
    )
    try:
        found = Posterior.of(result.estimate).share(errors, result.problem.base.matrix)
    except SdpidError:  # no covariance; a verdict must not cost the run
        found = np.zeros(0)
    most = np.argsort(-found)[: int(np.count_nonzero(found > MOSTLY))].tolist()
    if not most:
        yield Finding("good", f"{known}. Intervals count that; no parameter hangs on it mostly.")
        return
    names = result.problem.base.names
    yield Finding(
        "caution",
        f"{known}. It is most of what is not known of {len(most)} of {len(names)} base parameters: "
        f"{listed(names[i] for i in most)}. Better gains sharpen them, a longer record does not.",
    )


# A force on the base that is off by this share of the weight matters to no controller of balance:
# 0.5 N of a quadruped of 2.5 kg.
_FORCE = 0.02

# A number is told by the data where more than this share of its prior's uncertainty is gone.
_TOLD = 0.5

# Of the ten parameters of a link: those of its mass, center of mass, and moments about its axes.
_PARTS = {"mass": slice(0, 1), "center of mass": slice(1, 4), "inertia": slice(4, 10)}
_AXES = {"roll": 4, "pitch": 6, "yaw": 9}

# Errors of forces above this many stated deviations are more than a guess of these is off by.
_STATED = 2.0


def floating_findings(result: Judged) -> Iterator[Finding]:
    """Yield what the base's equations miss, and what the recordings tell of the links."""
    if not result.problem.robot.free_flyer or result.estimate.theta is None:
        return
    yield from _base(result, result.estimate.theta)
    yield from _forces(result.problem)
    yield from _shown(result)


def _base(result: Judged, theta: Array) -> Iterator[Finding]:
    """Say how well force and torque on the base are predicted, beside the weight."""
    errors, robot = judged(result)[1].floating, result.problem.robot
    if errors is None:
        return
    mass = float(theta[: 10 * robot.n_links : 10].sum())
    weight = mass * float(np.linalg.norm(robot.gravity))
    if not weight > 0.0:
        return
    share = errors.force / weight
    good = share <= _FORCE
    trust = "Trust it for" if good else "Do not rely on it for"
    yield Finding(
        "good" if good else "caution",
        f"{trust} the force on the base: {errors.force:.3g} N rms are missed, {percent(share)} of "
        f"the weight of {mass:.4g} kg (limit {percent(_FORCE)}), and {errors.torque:.3g} N.m. "
        "Forces of contacts that were not measured are those that suit it best.",
    )


def _forces(problem: Problem) -> Iterator[Finding]:
    """Say by how much measured forces are off as residuals show, beside what was stated."""
    rows = problem.require_rows("verdict")
    contacts = rows.samples.contacts
    if contacts is None or contacts.force_covariance is None or problem.weighting != "residual":
        return
    variance = np.diagonal(contacts.force_covariance, axis1=1, axis2=2)[:, :3]
    known = variance[np.isfinite(variance)]
    if not known.any():
        return
    stated = float(np.sqrt(known.mean()))
    found = float(np.sqrt(contact_noise(rows.with_force_scale(1.0))[2]))
    counts = "The residuals' number counts."
    if found <= 1.0:
        counts = (
            "The stated one counts: an error that all forces have alike, as of their scale, hardly "
            "shows in residuals."
        )
    yield Finding(
        "caution" if found > _STATED else "good",
        f"Measured contact forces are off by {found * stated:.2g} N as the residuals show, "
        f"{stated:.2g} N are stated (contact_force_std). {counts}",
    )


def _shown(result: Judged) -> Iterator[Finding]:
    """Say what recordings tell beyond the description, and what motion would tell more."""
    problem = result.problem
    told = directions_told(result.estimate)
    if told is None:
        return
    count, friction = problem.base.count, len(problem.friction.parameters)
    data = provenance(result.estimate).data[: 10 * problem.robot.n_links].reshape(-1, 10)
    dark = list(_dark(problem.robot.link_names, data))
    what = f" Mostly the description's: {'; '.join(dark)}." if dark else ""
    advice = list(_advice(result, data[0]))
    # Nothing is advised where every motion that helps was recorded: what is dark then stays so.
    more = f" More would tell: {'; '.join(advice)}." if advice else ""
    yield Finding(
        "caution" if dark else "good",
        f"The recordings tell more than was believed before them of {told} of {count} directions "
        f"of the base parameters, friction and drives ({friction}) included.{what}{more}",
    )


def _dark(links: tuple[str, ...], data: Array) -> Iterator[str]:
    """Yield the masses, centers of mass and inertias that the data hardly tell, and whose."""
    for name, part in _PARTS.items():
        found = [link for link, own in zip(links, data[:, part], strict=True) if own.mean() < _TOLD]
        if len(found) == len(links):
            yield f"{name} of every link"
        elif found:
            yield f"{name} of {listed(found)}"


def _advice(result: Judged, trunk: Array) -> Iterator[str]:
    """Yield motions that were not recorded and would tell more; `trunk` is the base's shares."""
    samples = result.problem.samples
    if samples.contacts is None:
        return
    root = result.problem.robot.link_names[0]
    # What holds the base still is a contact with moments; feet that lift are in the air.
    down = samples.contacts.down
    held = np.array([kind == "plane" for kind in samples.contacts.kind])
    hung = down[:, held].any(axis=1) & ~down[:, ~held].any(axis=1) if held.any() else None
    air = ~down.any(axis=1)
    free = air if hung is None else air | hung
    if not free.any():
        yield "hang it by its base (a contact of kind plane at its link) with all legs moving"
    if free.all():
        yield f"let it stand with a swaying base, or trot: nothing moves {root}"
        return
    loaded = down[~free]
    if bool(np.all(loaded.all(axis=0) == loaded.any(axis=0))):
        yield "let it trot, or lift its feet one by one: no foot ever left the ground"
    turns = [name for name, axis in _AXES.items() if trunk[axis] < _TOLD]
    if turns:
        yield f"turn the base more, in {listed(turns)}"
