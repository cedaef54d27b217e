"""Texts of robots from which many are written: read once, each robot by its numbers alone.

In every robot the link that a joint moves has the whole body that moves with it, and the inertials
of links fixed to it are zero: readers that merge fixed links and those that keep them then see the
same bodies, and ranges for them hold in both.

Where every friction term has an attribute of joints, these are the drawn numbers. Else each draw is
fitted as a single robot is (`sdpid.output.robots.joint_friction`), with one difference: what the
estimate leaves unexplained of the recorded efforts stands for what a draw does, so that the rows
are read once.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.descriptions.checks import consistent
from sdpid.estimation.compression.rows import motion_of
from sdpid.estimation.problem import Problem
from sdpid.output.robots.export_report import PLACES as URDF_PLACES
from sdpid.output.robots.joint_friction import Kind, MeasuredRows, Places, nonnegative_fit
from sdpid.output.robots.mjcf import PLACES as MJCF_PLACES
from sdpid.output.robots.mjcf import Mjcf, open_source
from sdpid.output.robots.urdf import Urdf
from sdpid.output.robots.written_bodies import source_text
from sdpid.robot.description.bodies import NOTHING, Inertial
from sdpid.robot.description.mjcf import compiled

# What the joints of one robot have: numbers by attribute, by joint.
Joints = Mapping[str, Mapping[str, float]]


class Pattern:
    """A robot's text with places for inertials and for attributes of joints.

    Parameters
    ----------
    file : Urdf or Mjcf
        The text that is changed.
    suffix : str
        Of the names of files.
    places : mapping
        The attributes that joints have, by term.
    notes : tuple of str
        What else differs from the source.

    Attributes
    ----------
    names : sequence of str
        The bodies that the joints move.
    frames : ndarray, shape (links, 4, 4)
        The joints' frames in those of the bodies.
    """

    def __init__(
        self, file: Urdf | Mjcf, suffix: str, places: Mapping[Kind, str], notes: tuple[str, ...]
    ) -> None:
        self._file, self.suffix, self.places, self.notes = file, suffix, places, notes
        self.names = [file.name(k) for k in file.carriers]
        self.frames = np.tile(np.eye(4), (len(self.names), 1, 1))
        if isinstance(file, Mjcf):
            self.frames = np.array([file.frame(k) for k in range(len(self.names))])
        for k in _inside(file):
            file.write(k, NOTHING)

    def text(self, bodies: Sequence[Inertial], joints: Joints) -> str:
        """Return the text of a robot."""
        for carrier, body in zip(self._file.carriers, bodies, strict=True):
            self._file.write(carrier, body)
        self._file.write_joints(joints)
        return self._file.text()

    def require_right(self, bodies: Array) -> None:
        """Refuse a text, the last one, that does not have the efforts of the bodies."""
        self._file.read_back(bodies)

    def require_loaded(self, text: str, name: str) -> None:
        """Refuse an MJCF that MuJoCo does not load; one with meshes would take seconds.

        URDFs differ only in the inertials, and those are audited.
        """
        if isinstance(self._file, Mjcf) and self._file.ours:
            compiled(text, None, f"{self._file.what} ({name})")


def urdf_pattern(problem: Problem, source: str | os.PathLike[str] | None) -> Pattern:
    """Return a URDF with places for damping and friction of joints."""
    robot = problem.robot
    file = Urdf(robot, source_text(robot, source, f"URDF of '{robot.name}'"))
    inside = _inside(file)
    impossible = [
        k
        for k, body in enumerate(file.bodies)
        if not body.moving and k not in (*file.carriers, *inside) and consistent(body) is False
    ]
    for k in impossible:
        file.write(k, NOTHING)
    note = (
        "links that do not move, with inertials in the description that no body can have, now "
        f"zero: {', '.join(file.name(k) for k in impossible)}"
    )
    return Pattern(file, ".urdf", URDF_PLACES, (note,) if impossible else ())


def mjcf_pattern(problem: Problem, source: str | os.PathLike[str] | None) -> Pattern:
    """Return an MJCF with places for damping, dry friction and armature of joints."""
    robot = problem.robot
    file, notes = open_source(robot, source, f"MJCF of '{robot.name}'")
    return Pattern(file, ".xml", MJCF_PLACES, notes)


def _inside(file: Urdf | Mjcf) -> list[int]:
    """Return the bodies that are part of those that joints move."""
    children = (file.children(carrier) for carrier in file.carriers)
    return [k for each in children for k, child in each.items() if np.any(child.body)]


# Rows at a time: columns of all terms take some 2 kB each.
_CHUNK = 20_000


def drawn_attributes(
    problem: Problem, center: Array, thetas: Array, attributes: Mapping[Kind, str], what: str
) -> dict[Kind, Array]:
    """Return the attributes' values (draws, n), by term.

    Parameters
    ----------
    problem : Problem
        Terms and samples.
    center : ndarray, shape (p,)
        The estimate that the draws are of.
    thetas : ndarray, shape (draws, p)
        The draws.
    attributes : mapping
        The attribute for the parameter of a term.
    what : str
        Name of the written robots in messages.

    Raises
    ------
    ExportError
        When a drawn number that is to be written is negative.
    """
    places = Places(problem, center, attributes)
    each = [Places(problem, theta, attributes) for theta in thetas]
    if problem.rows is None or not (places.of("curve") or places.of("lost")):
        for drawn in each:
            drawn.require_nonnegative(what)
    nominal = [drawn.at_nominal_speeds() for drawn in each]
    values = {kind: np.stack([found[kind] for found in nominal]) for kind in places.kinds}
    if problem.rows is not None and values and (places.of("curve") or places.of("lost")):
        rows = MeasuredRows(problem, center, places)
        friction = thetas[:, 10 * problem.robot.n_links :]
        change = friction - center[10 * problem.robot.n_links :]
        for j, (factor, target, slope) in _reduced(rows, places).items():
            fits = [nonnegative_fit(factor, target + slope @ each) for each in change]
            for kind, column in zip(places.kinds, np.transpose(fits), strict=True):
                values[kind][:, j] = column
    return values


def _reduced(rows: MeasuredRows, places: Places) -> dict[int, tuple[Array, Array, Array]]:
    """Return each joint's equations by few rows: factor, target, and its slope in friction.

    With the factorization Q·R of a joint's columns, ``R·x = Q^T·target`` has the same solutions.
    """
    problem = rows.problem
    systems = {int(j): rows.system(int(j)) for j in np.flatnonzero(rows.shown)}
    factors = {j: np.linalg.qr(system.columns) for j, system in systems.items()}
    slopes = {
        j: np.zeros((R.shape[0], len(problem.friction.parameters))) for j, (_, R) in factors.items()
    }
    samples, first = problem.samples, problem.friction.first
    past = dict.fromkeys(systems, 0)
    for start in range(0, samples.n_samples, _CHUNK):
        part = slice(start, min(start + _CHUNK, samples.n_samples))
        columns = problem.friction.columns_in(motion_of(problem.robot, samples, part, first=first))
        for j, (Q, _) in factors.items():
            own = columns[rows.used[part, j], first + j]
            here = slice(past[j], past[j] + len(own))
            slopes[j] += (Q[here] * systems[j].weight[here, None]).T @ own
            past[j] = here.stop
    kept = {j: _kept(problem, places, system.taken_out) for j, system in systems.items()}
    return {j: (R, Q.T @ systems[j].target, slopes[j] * kept[j]) for j, (Q, R) in factors.items()}


def _kept(problem: Problem, places: Places, taken_out: Sequence[float]) -> Array:
    """Return for each friction parameter the share of its effort that attributes stand in for."""
    shares = dict(zip((part.names for part in places.of("lost")), taken_out, strict=True))
    joints = problem.friction.joint_names
    names = [tuple(p.name for p in term.parameters(joints)) for term in problem.friction.terms]
    return np.concatenate([np.full(len(own), 1.0 - shares.get(own, 0.0)) for own in names])
