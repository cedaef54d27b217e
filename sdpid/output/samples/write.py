"""A folder of drawn robots, written from texts that are read once: every file of it, or none.

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
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sdpid import __version__
from sdpid._common.arrays import Array
from sdpid._common.progress import progress
from sdpid._common.staging import RunFolder
from sdpid._common.tables import Table
from sdpid.assurance.descriptions.checks import check_numbers, consistent
from sdpid.errors import ExportError
from sdpid.estimation.compression.rows import motion_of
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.output.robots.export_report import PLACES as URDF_PLACES
from sdpid.output.robots.joint_friction import Kind, MeasuredRows, Places, nonnegative_fit
from sdpid.output.robots.mjcf import PLACES as MJCF_PLACES
from sdpid.output.robots.mjcf import Mjcf, open_source
from sdpid.output.robots.urdf import Urdf
from sdpid.output.robots.written_bodies import possible_body, source_text
from sdpid.output.samples.ranges import Ranges, in_frames, ranges_of
from sdpid.robot.description.bodies import NOTHING, DescribedBody, Inertial, exact_decimal
from sdpid.robot.description.mjcf import compiled
from sdpid.robot.description.xml import encode_xml, is_mjcf, read_description

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


RobotKind = Literal["urdf", "mjcf"]
KINDS: tuple[RobotKind, ...] = ("urdf", "mjcf")

# The manifest has a name of its own: that of a results folder would let a run take its files for
# those of an earlier one.
MANIFEST, RANGES, DRAWS = "samples.json", "ranges.json", "draws.csv"

# Files of robots, as earlier runs may have written more of them.
_ROBOT = re.compile(r"(robot_\d+|mean)\.(urdf|xml)")
_DIGITS = 4

# The reference of the ranges.
MEAN = "mean"

Source = str | os.PathLike[str] | None


class SampleWriter:
    """Writes the draws of an estimate; reads the sources once.

    Parameters
    ----------
    estimate : Estimate
        What the draws are of.
    thetas : ndarray, shape (draws, p)
        The draws.
    kinds : sequence of str
        Formats of the robots.
    source : str or path, optional
        URDF or MJCF to change in place of the robot's own.
    """

    def __init__(
        self, estimate: Estimate, thetas: Array, *, kinds: Sequence[str], source: Source = None
    ) -> None:
        problem = estimate.problem
        require_bodies(problem)
        assert estimate.theta is not None
        self.problem, self.thetas = problem, thetas
        self.everything = np.concatenate([thetas, thetas.mean(axis=0, keepdims=True)])
        width = max(_DIGITS, len(str(len(thetas))))
        self.names = [*(f"robot_{k + 1:0{width}d}" for k in range(len(thetas))), MEAN]
        self.patterns = _patterns(problem, kinds, source)
        self._found: dict[tuple[Kind, ...], dict[Kind, Array]] = {}
        self._center = estimate.theta

    def attributes(self, places: Mapping[Kind, str]) -> dict[str, Array]:
        """Return the attributes of the joints, (draws + 1, n) by name, those of the mean last."""
        key = tuple(places)
        if key not in self._found:
            what = f"robots of '{self.problem.robot.name}'"
            self._found[key] = drawn_attributes(
                self.problem, self._center, self.everything, places, what
            )
        return {places[kind]: values for kind, values in self._found[key].items()}

    def ranges(self, probability: float, made: Mapping[str, Any]) -> Ranges:
        """Return the ranges about the mean, in the frames of the last format's bodies."""
        from sdpid.output.robots.mjcf import PLACES

        links = self.problem.robot.n_links
        frames, names = np.tile(np.eye(4), (links, 1, 1)), list(self.problem.robot.link_names)
        if self.patterns:
            frames, names = self.patterns[-1].frames, list(self.patterns[-1].names)
        return ranges_of(
            self.problem,
            self.thetas,
            frames,
            names,
            self.attributes(PLACES),
            probability=probability,
            made=made,
        )

    def write(self, folder: Path) -> None:
        """Write the robots into an empty folder."""
        links = self.problem.robot.n_links
        own = self.everything[:, : 10 * links].reshape(-1, links, 10)
        joints = [
            _by_joint(self.problem, self.attributes(pattern.places), len(own))
            for pattern in self.patterns
        ]
        frames = [in_frames(own, pattern.frames) for pattern in self.patterns]
        with progress(len(own), "writing robots") as advance:
            # The mean comes first: it shows whether the source is of the same robot.
            for k in (len(own) - 1, *range(len(own) - 1)):
                name, bodies, written = self.names[k], None, []
                for pattern, values, moved in zip(self.patterns, joints, frames, strict=True):
                    if bodies is None or not np.array_equal(bodies, moved[k]):
                        bodies, written = moved[k], _audited(name, pattern, moved[k])
                    text = pattern.text(written, values[k])
                    if name == MEAN:
                        pattern.require_right(own[k])
                    pattern.require_loaded(text, name)
                    (folder / f"{name}{pattern.suffix}").write_bytes(encode_xml(text))
                advance(1)


def _audited(name: str, pattern: Pattern, bodies: Array) -> list[Inertial]:
    """Return the numbers of a robot's bodies, checked as `audit_urdf` does.

    Raises
    ------
    ExportError
        When one of them can be no body.
    """
    out = []
    for link, body in zip(pattern.names, bodies, strict=True):
        what = f"{name}{pattern.suffix}"
        out.append(possible_body(body, "pseudo_inertia", link, what))
        errors = [e for e in check_numbers(_as_read(link, out[-1])) if e.severity == "error"]
        if errors:
            raise ExportError(f"{what}: link '{link}': {errors[0].message}.")
    return out


def require_bodies(problem: Problem) -> None:
    """Refuse a problem whose draws need not be bodies.

    Raises
    ------
    ExportError
        With what to do.
    """
    if problem.consistency != "pseudo_inertia":
        raise ExportError(
            f"robots of '{problem.robot.name}': under consistency='{problem.consistency}' draws "
            "need be no bodies; solve with consistency='pseudo_inertia'."
        )


def write_samples(
    writer: SampleWriter,
    folder: str | os.PathLike[str],
    *,
    probability: float,
    made: Mapping[str, Any],
    diagnostics: Mapping[str, Any],
    report: Callable[[str], None] | None = None,
) -> tuple[Path, ...]:
    """Write robots, ranges and draws into a folder, with a manifest: all, or nothing.

    Raises
    ------
    ExportError
        When the folder cannot be written to, would lose a file that no such run wrote, or a robot
        cannot be written.
    """
    target = Path(folder)
    names = [name + pattern.suffix for pattern in writer.patterns for name in writer.names]
    run = run_folder(target, names)
    run.require_writable(target)
    note = report or (lambda _: None)
    for text in dict.fromkeys(each for pattern in writer.patterns for each in pattern.notes):
        note(text)

    def fill(stage: Path) -> dict[str, Any]:
        writer.write(stage)
        writer.ranges(probability, made).to_json(stage / RANGES)
        header = ("robot", *writer.problem.base.theta_names)
        rows = zip(writer.names, writer.everything.tolist(), strict=True)
        Table(header, tuple((name, *theta) for name, theta in rows)).write(stage / DRAWS)
        return {
            "schema": "sdpid-samples",
            "version": 1,
            "software": f"sdpid {__version__}",
            "made": dict(made),
            "number": len(writer.thetas),
            "diagnostics": dict(diagnostics),
        }

    return run.write(target, fill, note)


def run_folder(folder: Path, robots: Sequence[str] = ()) -> RunFolder:
    """Return what a run writes into a folder: robots, and what an earlier run listed there."""
    found = folder.iterdir() if folder.is_dir() else ()
    earlier = (path.name for path in found if _ROBOT.fullmatch(path.name))
    names = dict.fromkeys((*robots, RANGES, DRAWS))
    listed = RunFolder((*names, *earlier), MANIFEST, MANIFEST).listed(folder)
    # Options are in no file of their own.
    return RunFolder(tuple(names | listed), MANIFEST, config=MANIFEST, careful=True)


def _patterns(problem: Problem, kinds: Sequence[str], source: Source) -> list[Pattern]:
    """Return the texts of the formats, MJCF last.

    Raises
    ------
    ExportError
        For a format that is none, or an MJCF as the source of URDFs alone.
    """
    unknown = [kind for kind in kinds if kind not in KINDS]
    if isinstance(kinds, str) or unknown:
        raise ExportError(f"kinds: are {kinds!r}; give some of {', '.join(map(repr, KINDS))}.")
    mjcf = source is not None and is_mjcf(read_description(source).text, "source")
    if mjcf and "mjcf" not in kinds:
        raise ExportError("source: is an MJCF, no URDF can be made of it; ask for kinds=('mjcf',).")
    patterns: list[Pattern] = []
    if "urdf" in kinds:
        patterns.append(urdf_pattern(problem, None if mjcf else source))
    if "mjcf" in kinds:
        patterns.append(mjcf_pattern(problem, source))
    return patterns


def _by_joint(problem: Problem, attributes: Mapping[str, Array], count: int) -> list[Joints]:
    """Return the attributes of each robot by joint and name."""
    joints = problem.friction.joint_names
    return [
        {
            joint: {name: float(values[k, j]) for name, values in attributes.items()}
            for j, joint in enumerate(joints)
        }
        for k in range(count)
    ]


def _as_read(link: str, body: Inertial) -> DescribedBody:
    """Return a body as who reads the written decimals finds it."""
    return DescribedBody(
        name=link,
        described=True,
        moving=True,
        carrier=link,
        mass=body.mass,
        com=np.array(body.com),
        entries=tuple(exact_decimal(repr(x)) for x in body.moments),
    )
