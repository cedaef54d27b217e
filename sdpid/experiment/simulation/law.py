"""What a loop takes of a controller: efforts and their slopes, over many samples at once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, real_array
from sdpid._common.tables import Table, facts_html
from sdpid.errors import DataError


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

    @property
    @abstractmethod
    def gains(self) -> Gains:
        """Gains of the law, before a model turns accelerations into efforts."""

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
        return self._limited(
            self._law(
                *self._checked(
                    position,
                    velocity,
                    reference,
                    reference_velocity,
                    reference_acceleration,
                    integral,
                )
            )
        )

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

    def _limited(self, effort: Array) -> Array:
        return np.clip(effort, -self.gains.limit, self.gains.limit)

    def _freeze(self, *positive: str, zero: tuple[str, ...] = ()) -> None:
        """Check gains and limits, and make them arrays (n,)."""
        sizes = {}
        for name in (*positive, *zero, "effort_limit"):
            values = getattr(self, name)
            if values is None:
                continue
            array = real_array(values, f"{type(self).__name__}.{name}", ndim=1)
            if (array < 0.0).any() or (name not in zero and (array == 0.0).any()):
                raise DataError(
                    f"{type(self).__name__}: {name} is {array.tolist()}; give positive numbers, "
                    "one a joint."
                )
            object.__setattr__(self, name, frozen(array))
            sizes[name] = len(array)
        if len(set(sizes.values())) > 1:
            raise DataError(
                f"{type(self).__name__}: lengths differ: {sizes}; give one number a joint in each."
            )

    def _gains(self, kp: Array, kd: Array, ki: Array | None, feedforward: bool) -> Gains:
        limit: Array | None = getattr(self, "effort_limit", None)
        n = len(kp)
        return Gains(
            kp,
            kd,
            np.zeros(n) if ki is None else ki,
            np.full(n, float(feedforward)),
            np.full(n, np.inf) if limit is None else limit,
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
