"""What a loop takes of a controller: efforts and their slopes, over many samples at once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, real_array
from sdpid._common.tables import Table, facts_html
from sdpid.errors import DataError


def keep_per_joint(
    owner: Any,
    what: str,
    names: Collection[str],
    *,
    signed: Collection[str] = (),
    not_negative: Collection[str] = (),
) -> None:
    """Check fields of a frozen dataclass, one number a joint, positive unless said, and keep them.

    Those that are None are left alone.
    """
    sizes = {}
    for name in names:
        if (values := getattr(owner, name)) is None:
            continue
        array = real_array(values, f"{what}.{name}", ndim=1)
        zero = name not in not_negative and (array == 0.0).any()
        if name not in signed and (zero or (array < 0.0).any()):
            raise DataError(
                f"{what}: {name} is {array.tolist()}; give positive numbers, one a joint."
            )
        object.__setattr__(owner, name, frozen(array))
        sizes[name] = len(array)
    if len(set(sizes.values())) > 1:
        raise DataError(f"{what}: lengths differ: {sizes}; give one number a joint in each.")


class Controller(ABC):
    """What turns positions and velocities, measured and desired, into efforts.

    Those of `sdpid.controllers` run in the compiled loop; a class of your own that derives from
    this one works too, at the speed of Python.

    Examples
    --------
    >>> law = sdpid.controllers.PD(np.full(6, 400.0), np.full(6, 40.0))
    >>> isinstance(law, sdpid.controllers.Controller)
    True
    """

    @property
    @abstractmethod
    def n(self) -> int:
        """Number of joints."""

    @abstractmethod
    def effort(
        self,
        position: ArrayLike,
        velocity: ArrayLike,
        reference: ArrayLike,
        reference_velocity: ArrayLike,
        reference_acceleration: ArrayLike | None = None,
        integral: ArrayLike | None = None,
    ) -> Array:
        """Return the efforts (K, n) at K samples, in N·m or N."""

    @abstractmethod
    def slopes(
        self,
        position: ArrayLike,
        velocity: ArrayLike,
        reference: ArrayLike,
        reference_velocity: ArrayLike,
        reference_acceleration: ArrayLike | None = None,
        integral: ArrayLike | None = None,
    ) -> tuple[Array, Array]:
        """Return d effort / d position and d effort / d velocity, (K, n, n) each."""


class Gains(NamedTuple):
    """Gains (n,) of ``kp·(q_d − q) + kd·(feedforward·v_d − v) + ki·∫(q_d − q)``, and limits."""

    proportional: Array
    derivative: Array
    integral: Array
    feedforward: Array
    limit: Array


@dataclass(frozen=True, eq=False, repr=False)
class Law(Controller):
    """What the controllers of `sdpid.controllers` share: they are linear in the tracking error."""

    # Names of gains that are positive, and of those that may be zero.
    _positive: ClassVar[tuple[str, ...]] = ("kp",)
    _not_negative: ClassVar[tuple[str, ...]] = ("kd",)

    def __post_init__(self) -> None:
        names = (*self._positive, *self._not_negative, "effort_limit")
        keep_per_joint(self, type(self).__name__, names, not_negative=self._not_negative)

    @property
    def gains(self) -> Gains:
        """Gains of the law, before a model turns accelerations into efforts."""
        own = self._settings()
        limit, n = own.get("effort_limit"), len(own["kp"])
        return Gains(
            proportional=own["kp"],
            derivative=own["kd"],
            integral=own.get("ki", np.zeros(n)),
            feedforward=np.full(n, float(own.get("feedforward", True))),
            limit=np.full(n, np.inf) if limit is None else limit,
        )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.gains.proportional)

    @property
    def integrates(self) -> bool:
        """Whether the law needs the integral of the position error."""
        return bool(self.gains.integral.any())

    def effort(
        self,
        position: ArrayLike,
        velocity: ArrayLike,
        reference: ArrayLike,
        reference_velocity: ArrayLike,
        reference_acceleration: ArrayLike | None = None,
        integral: ArrayLike | None = None,
    ) -> Array:
        """Return the efforts (K, n) at K samples.

        Parameters
        ----------
        position, velocity : array_like, shape (K, n)
            What the controller sees.
        reference, reference_velocity : array_like, shape (K, n)
            What it is told to do.
        reference_acceleration : array_like, shape (K, n), optional
            For computed torque.
        integral : array_like, shape (K, n), optional
            Integral of the position error, rad·s; needed where there is an integral gain.
        """
        given = self._checked(
            position, velocity, reference, reference_velocity, reference_acceleration, integral
        )
        return np.clip(self._law(*given), -self.gains.limit, self.gains.limit)

    def slopes(
        self,
        position: ArrayLike,
        velocity: ArrayLike,
        reference: ArrayLike,
        reference_velocity: ArrayLike,
        reference_acceleration: ArrayLike | None = None,
        integral: ArrayLike | None = None,
    ) -> tuple[Array, Array]:
        """Return d effort / d position and d effort / d velocity, (K, n, n) each.

        They are zero where the effort is at its limit. Parameters are those of `effort`.
        """
        given = self._checked(
            position, velocity, reference, reference_velocity, reference_acceleration, integral
        )
        free = (np.abs(self._law(*given)) < self.gains.limit)[..., None]
        by_position, by_velocity = self._slopes(*given)
        return by_position * free, by_velocity * free

    def _checked(self, *arrays: ArrayLike | None) -> tuple[Array, ...]:
        """Return the arguments as arrays (K, n); what is missing and not needed is zero."""
        names = "position velocity reference reference_velocity reference_acceleration integral"
        found: list[Array] = []
        for values, name in zip(arrays, names.split(), strict=True):
            if values is None:
                if name == "integral" and self.integrates:
                    raise DataError(
                        f"{type(self).__name__}: integral is missing; give the integral of the "
                        "position error, (K, n) in rad·s."
                    )
                found.append(np.zeros_like(found[0]))
                continue
            array = real_array(values, name, ndim=2)
            if array.shape[1] != self.n or (found and len(array) != len(found[0])):
                rows = len(found[0]) if found else len(array)
                raise DataError(
                    f"{name}: shape {array.shape}, expected {(rows, self.n)}: one row a sample, "
                    "one column a joint of the controller."
                )
            found.append(array)
        return tuple(found)

    def _command(self, q: Array, qd: Array, vd: Array, integral: Array) -> Array:
        """Return what the law gives but for its feedback of velocity."""
        g = self.gains
        return np.asarray(
            g.proportional * (qd - q) + g.derivative * g.feedforward * vd + g.integral * integral
        )

    def _law(self, q: Array, v: Array, qd: Array, vd: Array, ad: Array, integral: Array) -> Array:
        """Return the efforts before limits."""
        return self._command(q, qd, vd, integral) - self.gains.derivative * v

    def _slopes(
        self, q: Array, v: Array, qd: Array, vd: Array, ad: Array, integral: Array
    ) -> tuple[Array, Array]:
        """Return the slopes before limits."""
        shape = (len(q), self.n, self.n)
        g = self.gains
        return (
            np.broadcast_to(np.diag(-g.proportional), shape),
            np.broadcast_to(np.diag(-g.derivative), shape),
        )

    def _settings(self) -> dict[str, Any]:
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def __repr__(self) -> str:
        parts = [f"{self.n} joints"]
        for name, value in self._settings().items():
            if isinstance(value, np.ndarray):
                low, high = float(value.min()), float(value.max())
                span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
                parts.append(f"{name} {span}")
        return f"{type(self).__name__}({', '.join(parts)})"

    def _repr_html_(self) -> str:
        settings = self._settings()
        columns: dict[str, list[Any]] = {"joint": [j + 1 for j in range(self.n)]}
        columns |= {k: v.tolist() for k, v in settings.items() if isinstance(v, np.ndarray)}
        facts = {
            k: v if isinstance(v, bool) else repr(v)
            for k, v in settings.items()
            if not isinstance(v, np.ndarray) and v is not None
        }
        return facts_html(type(self).__name__, facts, Table.of_columns(columns))
