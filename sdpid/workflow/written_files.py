"""Compare the files that a run wrote for others with its robot, its parameters and its rows.

Files are read as anybody reads them, and compared as arrays: with the robot that was loaded, with
the certified parameters, with friction computed by the package's own terms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import MissingExtraError, ModelError, SdpidError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.nearest_to_prior import distance_to_reference
from sdpid.estimation.sdp.solve import settled
from sdpid.output.robots import mjcf, urdf_errors
from sdpid.output.robots.friction_files import terms_data
from sdpid.output.robots.joint_friction import joint_attributes
from sdpid.output.robots.places import Kind
from sdpid.output.robots.tendons import tendons_markup
from sdpid.robot.description.level import base_turn
from sdpid.robot.description.xacro import is_xacro
from sdpid.robot.description.xml import read_description
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import LoadFriction
from sdpid.robot.friction.stored import term_from_dict
from sdpid.robot.friction.terms import Coulomb, RotorInertia, Viscous
from sdpid.robot.model.digest import close, other_kinematics
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from sdpid.verifier import certificate
from sdpid.verifier.reading import REFUSED, read_bytes, shown, text
from sdpid.verifier.result import Result
from sdpid.verifier.results import manifest
from sdpid.verifier.results.folder import CERTIFICATE, ROBOTS
from sdpid.verifier.results.friction_code import NAMES, WRITERS, described
from sdpid.verifier.results.markup import Node, parse
from sdpid.verifier.results.mjcf import RENAMED, ours
from sdpid.verifier.results.urdf import Urdf

# Descriptions of robots may be larger than proofs.
_LARGEST = 64 * 2**20

# Numbers of files are rounded once or twice, relative to their size, at least one.
_SAME = 1e-12

# Friction that is fitted anew comes from sums over rows, which other processors round otherwise.
_FITTED = 1e-6

# The nearest parameters are found to a solver's accuracy.
_NEAREST = 1e-2

# What attributes of joints hold, by coordinate of a robot.
_DESCRIBED: dict[Kind, Callable[[RobotModel], Array]] = {
    Coulomb: lambda robot: robot.described_friction()[1],
    Viscous: lambda robot: robot.described_friction()[0],
    RotorInertia: lambda robot: robot.described_armature(),
}


def check_files(folder: Path, problem: Problem | None, *, described: bool) -> Result:
    """Check robots and friction of a folder of results, and the choice among equal parameters.

    Parameters
    ----------
    folder : Path
        The folder, which the stand-alone verifier has read.
    problem : Problem or None
        The problem, made again of logs and robot; without it joints and friction of robots are not
        compared.
    described : bool
        Whether the problem's robot has the bodies of the run's description.
    """
    sealed = manifest.load(read_bytes(folder / manifest.NAME))
    data = certificate.load(read_bytes(folder / CERTIFICATE))
    names = [name for name in ROBOTS if name in sealed["files"]]
    if data["theta"] is None or not names:
        return Result(unchecked=(f"{', '.join(names)}: no parameters are certified",) * bool(names))
    theta, found, good = np.array(data["theta"], dtype=np.float64), Result(), []
    asked = data["origin"]["links"], data["problem"]["consistency"]
    for name in names:
        try:
            if name in NAMES:
                content = read_bytes(folder / name)
                wrong = list(_other_friction(content, NAMES[name], sealed["recipe"], data))
            else:
                wrong = list(robot_differences(folder / name, asked, theta, problem))
            good += [] if wrong else [name]
        except MissingExtraError as missing:
            found += Result(unchecked=(f"{name}: what it holds ({missing})",))
            continue
        except (OSError, SdpidError, *REFUSED) as cause:
            wrong = [f"cannot be compared: {cause}"]
        found += Result(problems=tuple(f"{name}: {each}" for each in wrong))
    found += Result(tuple(_in_words(good, problem)), (), tuple(_left(good, problem)))
    if problem is None or not described:
        return found
    return found + _choice(problem, theta, data["claims"]["lower_bound"])


def _in_words(names: list[str], problem: Problem | None) -> Iterator[str]:
    """Yield what the files hold that are as they should be."""
    joints = friction = ""
    if problem is not None:
        joints = "joints (types, axes, places, gears, limits) and gravity are the robot's, "
        friction = (
            "; friction and damping are the parameters or, where not all have a place, fitted to "
            f"the rows, to within {_FITTED:g}"
        )
    if robots := [name for name in names if name not in NAMES]:
        yield (
            f"{', '.join(robots)}: {joints}the inertia of every link is that of the certified "
            f"parameters, to within {_SAME:g}{friction}."
        )
    if code := [name for name in names if name in NAMES]:
        yield (
            f"{', '.join(code)}: parameters are the certificate's, widths, speeds and exponents "
            "the recipe's, and the code computes what the package's own terms do."
        )


def _left(names: list[str], problem: Problem | None) -> Iterator[str]:
    """Yield what of the robots is compared with nothing."""
    if robots := [name for name in names if name not in NAMES]:
        joints = "joints (places, axes, limits), gravity, friction (--data compares them), "
        text = f"that {joints if problem is None else ''}shapes and links that do not move are "
        yield f"{', '.join(robots)}: {text}the description's"


def _other_friction(
    content: bytes, suffix: str, recipe: Any, data: Mapping[str, Any]
) -> Iterator[str]:
    """Yield what of a file of friction is not of the recipe's terms and the parameters."""
    if recipe is None:
        raise ModelError("the manifest has no recipe, which has its terms")
    found, origin = described(content), data["origin"]
    terms = [term_from_dict(each) for each in recipe["friction"]]
    first, at = len(origin["joints"]) - len(found["joints"]), 10 * len(origin["links"])
    model = FrictionModel.from_terms(terms, origin["joints"], first=first)
    if [each.name for each in model.parameters] != origin["theta_names"][at:]:
        raise ModelError("the recipe's terms have other parameters than the certificate")
    wanted = {
        **{key: text(found[key], key) for key in ("schema", "software")},
        "version": found["version"],
        "certificate": data["sha256"],
        "robot": origin["robot"],
        **terms_data(model, data["theta"][at:]),
    }
    if other := [shown(key) for key in wanted.keys() | found if found.get(key) != wanted.get(key)]:
        yield f"{', '.join(sorted(other))} of its numbers are not as recipe and certificate say"
        return
    if content != WRITERS[suffix](found).encode("ascii"):
        yield "its code is not what follows from its numbers"
    for what, own, computed in _computed(found, model, np.array(data["theta"][at:])):
        size = max(1.0, float(np.abs(own).max(initial=0.0)))
        if not close(computed / size, own / size, _SAME):
            yield f"its {what} is not that of the recipe's terms"


def _computed(
    data: Mapping[str, Any], model: FrictionModel, values: Array
) -> Iterator[tuple[str, Array, Array]]:
    """Yield efforts by the package's own terms, and by the code that follows from numbers."""
    rng, n = np.random.default_rng(0), len(model.joint_names)
    speeds = 10.0 ** rng.uniform(-4.0, 1.0, (90, n)) * rng.choice([-1.0, 1.0], (90, n))
    bends = model.characteristic_speeds()
    v = np.vstack([np.zeros(n), speeds, bends, -2.0 * bends])
    a, load = rng.standard_normal((2, *v.shape))
    # No code needs the names of others: what is run here is made of numbers alone.
    plain = {"robot": "", "software": "", "certificate": None, "joints": list(map(str, range(n)))}
    code: dict[str, Any] = {}
    exec(WRITERS[".py"]({**data, **plain}), code)
    every, none, held, at = replace(model, first=0), np.zeros_like(v), np.zeros_like(v), 0
    for term in model.terms:
        count = len(term.parameters(model.joint_names))
        if isinstance(term, LoadFriction):
            held += values[at : at + count] * np.abs(load) * term.sign(v, a)
        at += count
    rest = every.columns(none, none) @ values
    yield "friction", every.columns(v, none) @ values, code["friction"](v)
    yield "effort of drives", every.columns(none, a) @ values - rest, code["drive_inertia"](a)
    yield "friction of the load", held, code["load_friction"](v, load)


def robot_differences(
    path: Path, asked: tuple[Sequence[str], str], theta: Array, problem: Problem | None
) -> Iterator[str]:
    """Yield what of a robot's file is not of the parameters, the robot and the rows.

    Parameters
    ----------
    path : Path
        A URDF, or an MJCF that `write_mjcf` made, with the suffix ``.xml``.
    asked : tuple
        Names of the links, in the order of their parameters, and the consistency they have.
    theta : ndarray, shape (p,)
        The parameters.
    problem : Problem or None
        The problem; without it inertias alone are compared.

    Raises
    ------
    SdpidError, or one of REFUSED
        When the file cannot be read, or readers might see different robots in it.
    """
    links, consistency = asked
    bodies = dict(zip(links, theta[: 10 * len(links)].reshape(-1, 10), strict=True))
    content, description = read_bytes(path, _LARGEST), read_description(path)
    if compiled := path.suffix == ".xml":
        exact = ours(content)  # MuJoCo reads more, such as other files
        file = load_robot(description.text)
        bodies = {RENAMED.get(link, link): body for link, body in bodies.items()}
    else:
        if is_xacro(description):
            # Its expressions would be run; the folder may be anybody's.
            raise ModelError("it has macros, which no run writes")
        urdf = Urdf(content)
        root: Literal["free_flyer"] | None = "free_flyer" if urdf.root in links else None
        gravity = None if problem is None else problem.robot.gravity.tolist()
        file = load_robot(path, root=root, gravity=gravity)
        yield from (
            f"{odd}, which readers may take differently" for odd in urdf.odd(file.link_names)
        )
        for link in file.link_names:
            if not urdf.is_body(link, consistency):
                yield f"link {shown(link)} is no body: {consistency} does not hold"
    for link in sorted(bodies.keys() ^ {*file.link_names}):
        where = "the file" if link in bodies else "the certificate"
        yield f"link {shown(link)}: {where} has no such moving link"
    for link, body in zip(file.link_names, file.prior, strict=True):
        if link in bodies and not close(body, bodies[link], _SAME):
            yield f"link {shown(link)}: its inertia is not that of the certified parameters"
    if problem is None:
        return
    robot = _as_written(problem, theta, compiled=compiled)
    other = list(other_kinematics(robot, file, _SAME, loops=not compiled))
    yield from other
    if not other:
        yield from _other_attributes(problem, theta, file, exact if compiled else None)


def _as_written(problem: Problem, theta: Array, *, compiled: bool) -> RobotModel:
    """Return the robot as files have it where its base is tilted: gravity turned, or the base."""
    robot = problem.robot
    model = RobotDynamics(robot=robot, terms=problem.friction, theta=theta)
    if compiled:
        return robot.with_gravity(model.tilted_gravity)
    turn, turned = np.eye(4), robot.pin_model.copy()
    turn[:3, :3] = base_turn(robot.gravity, model.tilted_gravity)
    for i in range(1, turned.njoints):
        if not turned.parents[i]:
            place = turned.jointPlacements[i]
            turned.jointPlacements[i] = type(place)(turn) * place
    return replace(robot, pin_model=turned)


def _other_attributes(
    problem: Problem, theta: Array, file: RobotModel, exact: Node | None
) -> Iterator[str]:
    """Yield limits and friction of joints that are not those of the robot and of the rows."""
    robot, order = problem.robot, [file.joint_names.index(x) for x in problem.robot.joint_names]
    limits = ("velocity_limits",) * (exact is None) + ("position_limits", "effort_limits")
    for what in limits:
        wanted = np.array(getattr(robot, what)).reshape(robot.n, -1)
        if exact is not None:
            # MJCF has a place for ranges alone.
            none = np.array([-np.inf, np.inf])[-wanted.shape[1] :]
            lower = wanted[:, 0] if wanted.shape[1] == 2 else 0.0
            held = np.isfinite(wanted).all(axis=1) & (lower < wanted[:, -1])
            wanted = np.where(held[:, None], wanted, none)
        found = getattr(file, what)[order].reshape(robot.n, -1)
        for j in np.flatnonzero(np.any(found != wanted, axis=1)):
            name = shown(robot.joint_names[j])
            yield f"joint {name}: {what} are {found[j].tolist()}, not {wanted[j].tolist()}"
    places = urdf_errors.PLACES if exact is None else mjcf.PLACES
    own = joint_attributes(problem, theta, places, "the robot", tendons=exact is not None)
    for kind, attribute in places.items():
        stays = _DESCRIBED[kind](robot) if exact is None else np.zeros(robot.n)
        values = zip(robot.joint_names, stays, _DESCRIBED[kind](file)[order], strict=True)
        for joint, before, value in values:
            given = own.values.get(joint, {}).get(attribute, before)
            if not abs(value - given) <= _FITTED * max(abs(given), 1.0):
                yield f"joint {shown(joint)}: {attribute} is {value:.9g}, not {given:.9g}"
    if exact is not None:
        tendons = parse(tendons_markup(own.tendons)) if own.tendons else None
        if exact.only("tendon") != tendons:
            yield "its tendons are not those of the parameters"


def _choice(problem: Problem, theta: Array, bound: float) -> Result:
    """Check that parameters are, of those with the same efforts, the nearest to the description."""
    if problem.prior is not None or problem.consistency == "none":
        return Result()
    given = Estimate.of_theta(problem, theta, method="sdp", status="optimal", message="")
    moved = settled(given, bound).theta
    if moved is None or moved is given.theta:
        return Result(unchecked=("which of the parameters that cost the same were chosen",))
    own, least = (distance_to_reference(problem, each) for each in (theta, moved))
    far = f"{own:.6g} from the description, where others with the same efforts are {least:.6g}"
    if own <= (1.0 + _NEAREST) * least + _NEAREST:
        return Result((f"parameters: of those with the same efforts the nearest, {far}.",))
    return Result(problems=(f"parameters: they are not the nearest to the description: {far}",))
