"""The joint motion at which friction columns are evaluated."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, Protocol

from sdpid._common.arrays import Array

# A function of joint velocities and accelerations, (M, n) each, to values (M, ...).
OfMotion = Callable[[Array, Array], Array]


class Filtered(Protocol):
    """The filter that the efforts passed, for functions of the velocity."""

    def __call__(self, function: OfMotion, key: Hashable | None = None) -> Array:
        """Return the function's values (K, ...), filtered as the efforts were.

        Parameters
        ----------
        function : callable
            Of velocities and accelerations at a rate and a band well above the filter's.
        key : hashable, optional
            Identifies the function; its values are kept for the next call.
        """


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """States of K samples.

    Attributes
    ----------
    position : ndarray, shape (K, n) or (K, nq)
        Configurations, rad or m.
    velocity, acceleration : ndarray, shape (K, joints)
        Of the joints that have friction, rad/s and rad/s².
    robot : RobotModel
        Whose joints these are.
    through_filter : callable or None
        How functions of the velocity pass the filter of the efforts. None where there was none:
        friction then is that at the samples' own velocities.
    """

    position: Array
    velocity: Array
    acceleration: Array
    robot: Any
    through_filter: Filtered | None = None

    def filtered(self, function: OfMotion, key: Hashable | None = None) -> Array:
        """Return a nonlinear function of the motion (K, ...), as it stands in the efforts.

        Efforts are filtered, and the filter smears what is steep in the velocity, such as the step
        of Coulomb friction. So the function is evaluated at a velocity of wider band, then passes
        the same filter.

        Parameters
        ----------
        function : callable
            Of velocities and accelerations (M, joints), to values (M, ...).
        key : hashable, optional
            Identifies the function, so that its values need not be computed again.
        """
        if self.through_filter is None:
            return function(self.velocity, self.acceleration)
        return self.through_filter(function, key)
