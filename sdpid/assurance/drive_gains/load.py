"""A load of which something is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, frozen, is_number, real_array
from sdpid._common.tables import Settings
from sdpid.errors import DataError
from sdpid.robot.inertia import margin, theta_from_physical


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Load(Settings):
    """A load of known mass, and where known its center of mass and inertia.

    Parameters
    ----------
    mass : float
        kg.
    mass_error : float, optional
        Standard error of the mass, kg: it becomes one of all gains together.
    com : (3,) array_like, optional
        Center of mass in the frame in which the load is given, m. By default it is estimated.
    inertia : (3, 3) array_like, optional
        Inertia about the center of mass along the axes of that frame, kg·m²; only beside `com`.
        By default it is estimated.

    Raises
    ------
    DataError
        When a number makes no sense, or no body can have them together.

    Examples
    --------
    >>> sdpid.Load(mass=2.805)
    Load(mass=2.805)
    >>> sdpid.Load(mass=2.0, com=[0.0, 0.0, 0.05], mass_error=0.001)
    Load(mass=2.0, mass_error=0.001, com=array (3,))
    """

    mass: float
    mass_error: float = 0.0
    com: Array | None = None
    inertia: Array | None = None

    def __post_init__(self) -> None:
        for name in ("mass", "mass_error"):
            value = getattr(self, name)
            if not is_number(value) or not 0.0 <= value < np.inf or (name, value) == ("mass", 0):
                raise DataError(f"load: {name} is {value!r:.80}; give kg.")
            object.__setattr__(self, name, float(value))
        if self.mass_error >= self.mass:
            raise DataError(
                f"load: mass_error {self.mass_error:g} kg is not below the mass {self.mass:g} kg; "
                "weigh the load."
            )
        for name, shape in (("com", (3,)), ("inertia", (3, 3))):
            if getattr(self, name) is not None:
                array = frozen(real_array(getattr(self, name), f"load: {name}", ndim=len(shape)))
                if array.shape != shape:
                    raise DataError(f"load: {name} has shape {array.shape}, expected {shape}.")
                object.__setattr__(self, name, array)
        if self.inertia is None:
            return
        if self.com is None:
            raise DataError("load: an inertia about the center of mass needs com.")
        if not np.allclose(self.inertia, self.inertia.T):
            raise DataError("load: inertia is not symmetric.")
        if not margin(self.theta, "pseudo_inertia") >= 0.0:
            raise DataError(
                f"load: no body of {self.mass:g} kg has this inertia: its principal moments "
                f"are {np.linalg.eigvalsh(self.inertia).tolist()} kg·m², and none may be more "
                "than the sum of the others."
            )

    @property
    def theta(self) -> Array:
        """The ten parameters about the frame's origin, what is not known as at the origin."""
        com = np.zeros(3) if self.com is None else self.com
        inertia = np.zeros((3, 3)) if self.inertia is None else self.inertia
        return theta_from_physical(self.mass, com, inertia)

    @property
    def first_unknown(self) -> int:
        """How many of the ten parameters are known: 1, 4 or 10."""
        return 1 if self.com is None else 4 if self.inertia is None else 10
