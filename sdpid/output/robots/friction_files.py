"""Write friction as a small file of Python or C++: URDF has no place for most of it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.files import atomic_write_text
from sdpid.assurance.certificate.certificate import Certificate
from sdpid.errors import ExportError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.output.robots.friction_code import WRITERS
from sdpid.output.robots.friction_terms import KINDS, SCHEMA, VERSION
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.stored import term_to_dict
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import Coupling
from sdpid.robot.model.dynamics import RobotDynamics


def write_friction(
    estimate: Estimate | RobotDynamics,
    target: str | os.PathLike[str],
    *,
    certificate: Certificate | None = None,
) -> tuple[str, ...]:
    """Write friction, offsets, couplings and rotor inertias as Python or as a C++ header.

    The file needs nothing of sdpid: Python needs NumPy, the header C++11. Its ``friction`` is that
    of ``estimate.model()``; rotor inertias and friction of the load have functions of their own.

    Parameters
    ----------
    estimate : Estimate or RobotDynamics
        From any solver, or its model.
    target : str or path
        File to write, whole or not at all; the suffix, ``.py`` or ``.hpp``, is the language.
    certificate : Certificate, optional
        Of the estimate: its digest then stands in the file.

    Returns
    -------
    tuple of str
        What the file leaves out, in words: a tilt of the base. It says the tilted gravity.

    Raises
    ------
    ExportError
        For another suffix, a folder that cannot be written to, or a term of your own, whose code
        no file can hold.
    """
    path = Path(target)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise ExportError(
            f"{target}: friction is written as {' or '.join(WRITERS)}; choose such a name."
        )
    model = estimate if isinstance(estimate, RobotDynamics) else estimate.model()
    data = friction_data(model, certificate=certificate)
    atomic_write_text(path, writer(data))
    if not data["left_out"]:
        return ()
    gravity = ", ".join(f"{x:.5g}" for x in model.tilted_gravity)
    return (
        f"{path.stem}: the tilt of the base is not in it, since gravity is the links': take "
        f"({gravity}) m/s² as gravity in the base",
    )


def friction_data(
    model: RobotDynamics, *, certificate: Certificate | None = None
) -> dict[str, Any]:
    """Return terms and parameters as plain values, the content of `write_friction`.

    Raises
    ------
    ExportError
        For a term that the files have no form of.
    """
    from sdpid import __version__

    return {
        "schema": SCHEMA,
        "version": VERSION,
        "software": f"sdpid {__version__}",
        "certificate": None if certificate is None else certificate.to_dict()["sha256"],
        "robot": model.robot.name,
        **terms_data(model.terms, model.theta[10 * model.robot.n_links :].tolist()),
    }


def terms_data(model: FrictionModel, values: list[float]) -> dict[str, Any]:
    """Return joints, terms with their parameters, and terms that are left out, as plain values.

    Raises
    ------
    ExportError
        For a term that the files have no form of.
    """
    names, terms, left_out = model.joint_names, [], []
    for term, own in model.placed:
        if type(term) is Tilt:
            left_out.append(type(term).__name__)
        else:
            terms.append(_plain(term, names, values[own]))
    return {"joints": list(names), "terms": terms, "left_out": left_out}


def _plain(term: FrictionTerm, names: tuple[str, ...], values: list[float]) -> dict[str, Any]:
    """Return a term with one of each setting a joint."""
    kind = type(term).__name__
    try:
        settings = term_to_dict(term)
    except ModelError as cause:
        raise ExportError(
            f"friction: {kind} is a term of your own, and no file has its code; leave it out, or "
            "use estimate.model().friction."
        ) from cause
    found: dict[str, Any] = {"term": kind}
    count = len(names)
    if isinstance(term, Coupling):
        found["joints"], count = [names.index(term.first), names.index(term.second)], 1
    if isinstance(term, LoadFriction) and not term.share:
        settings |= {"share": 0.0, "velocity": 1.0}
    for key in KINDS[kind].settings:
        found[key] = np.broadcast_to(np.asarray(settings[key], float), (count,)).tolist()
    return {**found, "values": values}
