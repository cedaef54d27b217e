"""Base parameters: the independent combinations of standard parameters that determine the effort.

They are a property of the robot, not of a recording: found from the regressor at generic states
by one deterministic scan [gautier1990]_. Which of them a given recording excites is another
question (`sdpid.estimation.information`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask, frozen
from sdpid._common.tables import Shown
from sdpid.errors import IdentifiabilityError
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import SampledMotion
from sdpid.robot.inertia import PARAMETER_NAMES
from sdpid.robot.model.model import RobotModel

# The field's order of a link's parameters, as indices into Pinocchio's order.
_FIELD_ORDER = tuple(
    PARAMETER_NAMES.index(name)
    for name in ("xx", "xy", "xz", "yy", "yz", "zz", "mx", "my", "mz", "m")
)

# A column is dependent when its residual after projection on the kept columns is below this share.
# Rounding leaves some 1e-13; descriptions that write pi/2 as 1.5708 leave up to 1e-5, although
# their axes are meant to be parallel or perpendicular. The gap around it is reported.
DEPENDENT = 2e-5

# A column this small beside the largest of any kind is rounding.
_NOTHING = 2e-11

# Regrouping coefficients smaller than this (in the scaled columns) are zeros blurred by rounding.
ZERO = 1e-9

# Number of generic states: many times as many rows as parameters.
_STATES = 120

# Further ones for each speed that friction terms name: a few parameters a joint depend on it.
_STATES_OF_SPEED = 30

# Terms that remember see a state after a turn that is 10 to the power of these away, rad or m:
# as likely near as far.
_WAYS = (-4.0, 0.5)
_SEED = 20210621


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BaseParameters(Shown):
    """The base parameters of a robot with its friction terms.

    Attributes
    ----------
    names, units : tuple of str
        In the order of listing: link by link, a link's friction after its inertial parameters.
        The suffix ``r`` marks a parameter into which others are regrouped.
    matrix : ndarray, shape (b, p)
        B with ``base = B @ theta``, zeros exact.
    kept : ndarray of int, shape (b,)
        The column of theta that each base parameter leads with: the regressor of the base
        parameters is that of theta, restricted to these columns.
    theta_names, theta_units : tuple of str
        The standard parameters.
    singular_values : ndarray
        Of the regressor at generic states, columns scaled to unit norm, largest first.
    tolerance : float
        Columns of which the others leave a smaller fraction are called dependent.
    smallest_kept, largest_dropped : float
        The fractions on either side of the tolerance: the gap that decides the rank.

    Examples
    --------
    >>> base = problem.base
    >>> base.count, base.names[:3], base.units[:3]
    (48, ('zzr1', 'Fs1', 'Fv1'), ('kg.m2', 'N.m', 'N.m.s/rad'))
    >>> base.expression("xxr2")
    'xx_2 - yy_2 - 0.0441*m_3 - 0.0441*m_4 - 0.0441*m_5 - 0.0441*m_6'
    >>> bool(np.allclose(base.matrix @ estimate.theta, estimate.base))
    True
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    matrix: Array
    kept: Indices
    theta_names: tuple[str, ...]
    theta_units: tuple[str, ...]
    singular_values: Array
    tolerance: float
    smallest_kept: float
    largest_dropped: float

    _facts = ("count", "theta_names")

    @property
    def count(self) -> int:
        """Number of base parameters."""
        return len(self.names)

    @cached_property
    def eliminated(self) -> tuple[str, ...]:
        """Standard parameters that have no influence at all on the effort."""
        used = np.any(self.matrix != 0.0, axis=0)
        return tuple(name for name, u in zip(self.theta_names, used, strict=True) if not u)

    def expression(self, name: str) -> str:
        """Return the regrouping of one base parameter, such as ``xx_2 - yy_2 - 0.0441*m_3``.

        Raises
        ------
        KeyError
            When there is no base parameter of that name.
        """
        if name not in self.names:
            raise KeyError(f"no base parameter {name!r}; there are {', '.join(self.names)}")
        i = self.names.index(name)
        terms = [self.theta_names[self.kept[i]]]
        for j in np.setdiff1d(np.flatnonzero(self.matrix[i]), self.kept[i]):
            value = self.matrix[i, j]
            factor = "" if abs(abs(value) - 1.0) < ZERO else f"{abs(value):.6g}*"
            terms.append(f"{'-' if value < 0 else '+'} {factor}{self.theta_names[j]}")
        return " ".join(terms)

    def explain(self) -> str:
        """Return a sentence on how the rank was decided."""
        rank, total = self.count, len(self.theta_names)
        return (
            f"{rank} base parameters of {total} standard ones. Scanning the columns of the "
            f"regressor at {_STATES} generic states, the least independent column kept has "
            f"{self.smallest_kept:.1e} of its length outside the span of those before it, the "
            f"most independent one dropped {self.largest_dropped:.1e}; the tolerance is "
            f"{self.tolerance:.0e}. Singular values (unit columns) "
            f"{rank - 1}..{rank + 1}: "
            + ", ".join(f"{s:.1e}" for s in self.singular_values[rank - 2 : rank + 1])
            + "."
        )


def generic_states(robot: RobotModel, count: int, seed: int) -> tuple[Array, Array, Array]:
    """Return random states (q, v, a), at which columns are dependent only if they always are.

    Speeds and accelerations are of the size at which inertial and gravitational efforts are
    comparable on a robot of this length, so that the columns are well scaled.
    """
    rng = np.random.default_rng(seed)
    n = robot.n
    rate = np.sqrt(max(float(np.linalg.norm(robot.gravity)), 1.0) / characteristic_length(robot))
    q = rng.uniform(-np.pi, np.pi, (count, n))
    if robot.free_flyer:
        turn = rng.standard_normal((count, 4))
        turn /= np.linalg.norm(turn, axis=1, keepdims=True)
        q = np.hstack([q[:, :3], turn, q[:, 6:]])
    v = rate * rng.uniform(-1.5, 1.5, (count, n))
    a = rate**2 * rng.uniform(-1.5, 1.5, (count, n))
    # Motors move as much more as gears make the joints move less.
    q[:, robot.n_base - n :] *= robot.gears[robot.n_base :]
    return q, v * robot.gears, a * robot.gears


def characteristic_length(robot: RobotModel) -> float:
    """Return a length of the robot's size (m): the root mean square offset between joints."""
    placements = list(robot.pin_model.jointPlacements)[2:]
    offsets = np.array([np.linalg.norm(each.translation) for each in placements])
    apart = offsets[offsets > 1e-6]
    return float(np.sqrt(np.mean(np.square(apart)))) if apart.size else 1.0


def _scan_order(robot: RobotModel, friction: FrictionModel) -> Indices:
    links = [10 * i + k for i in range(robot.n_links) for k in _FIELD_ORDER]
    first = 10 * robot.n_links
    return np.array([*links, *range(first, first + len(friction.parameters))], dtype=np.intp)


def _generic_rows(robot: RobotModel, friction: FrictionModel, seed: int) -> Array:
    q, v, a = generic_states(robot, _STATES, seed)
    slow = friction.characteristic_speeds()
    if len(slow):
        # A smooth sign or a Stribeck peak is a sign, or nothing, at generic speeds: states at
        # which it has its shape are generic ones run at its own speed.
        more = generic_states(robot, _STATES_OF_SPEED * len(slow), seed + 2)
        speeds = np.repeat(slow, _STATES_OF_SPEED, axis=0)
        rng = np.random.default_rng(seed + 3)
        more[1][:, robot.n_base :] = speeds * rng.uniform(-1.5, 1.5, speeds.shape)
        q, v, a = (np.concatenate(pair) for pair in zip((q, v, a), more, strict=True))
    first, rng = friction.first, np.random.default_rng(seed + 4)
    ways = rng.choice([-1.0, 1.0], v.shape) * 10.0 ** rng.uniform(*_WAYS, v.shape) * robot.gears
    turns = q.copy()
    turns[:, first - robot.n :] += ways[:, first:]

    def through_path(function: Callable[[Array], Array]) -> Array:
        # Every state is come to from a turn near it.
        return function(np.stack([turns, q], axis=1).reshape(-1, q.shape[1]))[1::2]

    motion = SampledMotion(
        position=q,
        velocity=v[:, first:],
        acceleration=a[:, first:],
        robot=robot,
        through_path=through_path,
    )
    columns = np.concatenate([robot.regressor(q, v, a), friction.columns_in(motion)], axis=2)
    return columns.reshape(-1, columns.shape[2])


def structural_base(robot: RobotModel, friction: FrictionModel) -> BaseParameters:
    """Find the base parameters of a robot with friction terms.

    Columns are scanned link by link in Pinocchio's order of links and the field's order of
    parameters (xx xy xz yy yz zz mx my mz m), friction last; a column independent of those
    kept before it is kept. For joints about z that is Khalil's choice [gautier1990]_.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    friction : FrictionModel
        Its friction and drive terms.

    Returns
    -------
    BaseParameters

    Raises
    ------
    IdentifiabilityError
        When no rank can be decided: the relation found at one set of states fails at another.
    """
    names = (*robot.parameter_names, *(p.name for p in friction.parameters))
    units = (*robot.parameter_units, *(p.unit for p in friction.parameters))
    W = _generic_rows(robot, friction, _SEED)
    order = _scan_order(robot, friction)
    norms = np.linalg.norm(W, axis=0)
    # A column much longer than rounding may still be nothing but the misalignment of axes that are
    # meant to be parallel: its length counts against that of the columns of its unit.
    size = np.array([max(norms[np.array(units) == unit]) for unit in units])
    visible = (norms > DEPENDENT * size) & (norms > _NOTHING * norms.max())
    scale = np.where(visible, norms, 1.0)
    R = np.asarray(np.linalg.qr((W / scale)[:, order], mode="r"))
    kept, coefficients, residues = _scan(R, visible[order])
    residues[~visible[order]] = (norms / np.where(size > 0.0, size, 1.0))[order][~visible[order]]
    K = np.zeros((int(kept.sum()), W.shape[1]))
    K[:, order[kept]] = np.eye(len(K))
    K[:, order[~kept]] = coefficients
    K[np.abs(K) < ZERO] = 0.0
    leading = order[kept]
    matrix = K * scale[None, :] / scale[leading][:, None]
    matrix[np.arange(len(matrix)), leading] = 1.0
    fresh = _generic_rows(robot, friction, _SEED + 1)
    error = np.abs(fresh[:, leading] @ matrix - fresh).max(axis=0)
    limit = 10.0 * DEPENDENT * max(float(np.abs(fresh).max()), 1.0)
    worst = int(np.argmax(error))
    if error[worst] > limit:
        raise IdentifiabilityError(
            f"base parameters of '{robot.name}': the regrouping of {names[worst]} fails by "
            f"{error[worst]:.1e} (limit {limit:.1e}) at fresh states; its axes are neither "
            "parallel nor independent to working accuracy. Check the description's angles."
        )
    listing = _listing(robot, friction, leading)
    matrix, leading = matrix[listing], leading[listing]
    leading.setflags(write=False)
    plain = [name.replace("_", "") for name in robot.parameter_names]
    plain += names[len(plain) :]
    # Expressions read well without entries that are integers but for rounding.
    rounded = np.round(matrix)
    matrix = np.where(np.abs(matrix - rounded) < ZERO, rounded, matrix)
    return BaseParameters(
        names=tuple(
            _name(plain[column], int(np.count_nonzero(row)))
            for row, column in zip(matrix, leading, strict=True)
        ),
        units=tuple(units[column] for column in leading),
        matrix=frozen(matrix),
        kept=leading,
        theta_names=names,
        theta_units=units,
        singular_values=frozen(np.linalg.svd(R, compute_uv=False)),
        tolerance=DEPENDENT,
        smallest_kept=float(residues[kept].min()),
        largest_dropped=float(residues[~kept].max(initial=0.0)),
    )


def _scan(R: Array, visible: Mask) -> tuple[Mask, Array, Array]:
    """Keep the leftmost independent columns of R.

    Returns which are kept, the coefficients of the others in them, and the fraction of each
    column that those kept before it leave.
    """
    size, count = R.shape
    Q = np.zeros((size, min(size, count)))
    rank = 0
    kept: Mask = np.zeros(count, dtype=bool)
    residues = np.zeros(count)
    for j in range(count):
        if not visible[j]:
            continue
        rest = R[:, j].copy()
        # Projecting twice keeps the basis orthogonal to rounding ("twice is enough").
        for _ in range(2):
            rest -= Q[:, :rank] @ (Q[:, :rank].T @ rest)
        residues[j] = np.linalg.norm(rest) / np.linalg.norm(R[:, j])
        if residues[j] > DEPENDENT and rank < Q.shape[1]:
            kept[j] = True
            Q[:, rank] = rest / np.linalg.norm(rest)
            rank += 1
    basis = R[:, kept]
    coefficients = np.linalg.lstsq(basis, R[:, ~kept], rcond=None)[0]
    coefficients[:, ~visible[~kept]] = 0.0
    return kept, np.asarray(coefficients), residues


def _listing(robot: RobotModel, friction: FrictionModel, leading: Indices) -> list[int]:
    """Return the order of base parameters: by links, those of friction behind a link's own."""
    joints = {str(name): i - 1 for i, name in enumerate(robot.pin_model.names)}
    owners = [(column // 10, 0) for column in range(10 * robot.n_links)]
    owners += [(joints.get(friction.joint_names[p.joint], 0), 1) for p in friction.parameters]
    rank = np.argsort(_scan_order(robot, friction))
    return sorted(range(len(leading)), key=lambda k: (owners[leading[k]], rank[leading[k]]))


def _name(name: str, count: int) -> str:
    """Return the name of a base parameter of so many ones of theta, which leads: ``xxr2``."""
    symbol = name.rstrip("0123456789_")
    return f"{symbol}{'r' if count > 1 else ''}{name[len(symbol) :]}"


def kinematics_digest(robot: RobotModel) -> str:
    """Return the SHA-256 of a robot's joints, placements, axes, transmission, loops and gravity.

    Inertias, limits and shapes do not count. Robots of equal digest have the same regressor.
    """
    digest = hashlib.sha256("\n".join(robot.joint_names).encode("utf-8", "surrogatepass"))
    for values in (*robot.tree, robot.expansion, robot.offset):
        # Adding zero makes one of the two zeros.
        array = np.ascontiguousarray(np.asarray(values, dtype="<f8") + 0.0)
        digest.update(f"\n{array.shape}\n".encode())
        digest.update(array.data)
    for label, values in _loops(robot):
        digest.update(label.encode("utf-8", "surrogatepass"))
        digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()


def _loops(robot: RobotModel) -> Iterator[tuple[str, Array]]:
    """Yield the ends of loops and the joints without motors in words, and where they are."""
    for loop in robot.loops:
        for kind, name in ((f"\n{loop.kind}", loop.frame), ("", loop.against)):
            frame = robot.pin_model.frames[robot.frame_numbers[name]]
            place = np.asarray(frame.placement.homogeneous, "<f8") + 0.0
            yield f"{kind}\n{name} {frame.parentJoint}\n", place
    if robot.passive:
        yield "\n".join(("", *robot.passive)), np.array(robot.assembled, dtype="<f8")
