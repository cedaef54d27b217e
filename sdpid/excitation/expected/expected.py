"""`Expected`: what a run will buy, in numbers and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Shown, Table, plain, plain_dict
from sdpid.excitation.criterion.belief import ExpectedNoise
from sdpid.excitation.expected.open_directions import OpenDirection
from sdpid.robot.inertia import PARAMETER_NAMES
from sdpid.robot.model.base_parameters import BaseParameters
from sdpid.robot.model.model import RobotModel

# A parameter is known in words when its interval is this narrow beside what was known before.
_KNOWN = 0.1

# A parameter is mostly from the prior where this much of its variance is.
_FROM_PRIOR = 0.5

# An interval says nothing where it is this many times the value.
_SAYS_NOTHING = 10.0

# Columns of the table.
_HEADER = (
    *("parameter", "unit", "assumed", "standard error", "lower", "upper", "before"),
    "share of the prior",
)

# Columns of base parameters, in tables and plain values, that have the names of attributes.
_AS_CALLED = ("lower", "upper", "before", "prior_share")

# Parameters that a sentence lists.
_LISTED = 8

# The normal quantile of 95 % intervals.
NORMAL = 1.959963984540054


@dataclass(frozen=True, kw_only=True, eq=False)
class Band:
    """The expected band of predicted efforts on a motion.

    Attributes
    ----------
    motion : str
        Which motion, in words.
    effort : ndarray, shape (n,)
        Rms efforts by the nominal parameters, N·m.
    half_width : ndarray, shape (n,)
        Rms half width of the 95 % band of the model's prediction, N·m: errors of the parameters,
        not the noise of a measurement.
    before : ndarray, shape (n,)
        The same before the run.
    """

    motion: str
    effort: Array
    half_width: Array
    before: Array

    @property
    def share(self) -> float:
        """Half width of all joints together, as a share of their effort."""
        size = float(np.linalg.norm(self.effort))
        return float(np.linalg.norm(self.half_width)) / size if size > 0.0 else float("inf")


@dataclass(frozen=True, kw_only=True, eq=False)
class Duration:
    """What is known after a longer or shorter run.

    Attributes
    ----------
    repetitions : int
        How often the motion is run.
    seconds : float
        How long that takes, s.
    standard_errors : ndarray, shape (b,)
        Of the base parameters.
    masses : ndarray, shape (links,)
        Standard errors of the links' masses, kg.
    bands : tuple of float
        Share of the effort (see `Band.share`), one for each of the motions.
    """

    repetitions: int
    seconds: float
    standard_errors: Array
    masses: Array
    bands: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Expected(Shown):
    """What a run will buy.

    Attributes
    ----------
    robot : RobotModel
        The robot.
    base : BaseParameters
        The base parameters; of standard parameters those that have no influence on the efforts.
    values : ndarray, shape (b,)
        What they are taken to be, from the description or an earlier run.
    standard_errors : ndarray, shape (b,)
        What they will be known to, prior and earlier runs included.
    half_widths : ndarray, shape (b,)
        Of the 95 % intervals, were they not cut off.
    lower, upper : ndarray, shape (b,)
        Their ends, about the values assumed, cut off at declared limits: friction is not negative.
    before : ndarray, shape (b,)
        Standard errors before the run; infinite where nothing is known.
    prior_share : ndarray, shape (b,)
        Share of the prior in the variance.
    theta, theta_half_widths : ndarray, shape (p,)
        Values of the standard parameters, and half widths of 95 % intervals: infinite where run
        and prior leave them open.
    theta_prior_share : ndarray, shape (p,)
        Share of the prior in the variance.
    speeds : ndarray, shape (s,)
        Speeds of the friction curves, rad/s or m/s.
    friction, friction_half_widths : ndarray, shape (s, joints)
        Friction there, half of what reversing the motion changes, N·m; with 95 % half widths.
    bands : tuple of Band
        Efforts on typical motion.
    durations : tuple of Duration
        The curve over the duration of the run.
    open_directions : tuple of OpenDirection
        What stays open, and why.
    covariance : ndarray, shape (b, b)
        Of the base parameters.
    noise : ExpectedNoise
        What was expected of the efforts.
    seconds : float
        Duration of the run, s.
    notes : tuple of str
        What all of this rests on.
    """

    robot: RobotModel
    base: BaseParameters
    values: Array
    standard_errors: Array
    half_widths: Array
    lower: Array
    upper: Array
    before: Array
    prior_share: Array
    theta: Array
    theta_half_widths: Array
    theta_prior_share: Array
    speeds: Array
    friction: Array
    friction_half_widths: Array
    bands: tuple[Band, ...]
    durations: tuple[Duration, ...]
    open_directions: tuple[OpenDirection, ...]
    covariance: Array
    noise: ExpectedNoise
    seconds: float
    notes: tuple[str, ...] = ()

    _facts = ("base.names", "seconds, s", "open_directions")

    def sentences(self) -> tuple[str, ...]:
        """Return what the run will buy in words, the most important first."""
        out = [self._over_time(k) for k in range(len(self.bands))]
        out += [*self._outermost(), self._parameters()]
        if len(self.speeds):
            out.append(self._friction())
        out += self._open()
        if lost := self.base.eliminated:
            out.append(
                f"{len(lost)} of {len(self.base.theta_names)} standard parameters have no "
                f"influence on any effort, whatever the motion: {', '.join(lost[:6])}"
                f"{', …' if len(lost) > 6 else ''}"
            )
        return tuple(out)

    def _over_time(self, k: int) -> str:
        band = self.bands[k]
        size = max(float(np.linalg.norm(band.effort)), np.finfo(float).tiny)
        before = float(np.linalg.norm(band.before)) / size
        known = f" (before the run {_within(before)})" if before < _SAYS_NOTHING else ""
        return (
            f"efforts on {band.motion}: {self._times([d.bands[k] for d in self.durations])}{known}"
        )

    def _times(self, shares: Sequence[float]) -> str:
        """Return shares over the durations in words."""
        pairs = zip(self.durations, shares, strict=True)
        return ", ".join(f"after {d.seconds:.3g} s {_within(share)}" for d, share in pairs)

    def _outermost(self) -> list[str]:
        """Return how the mass of the outermost link that the run tells sharpens over time.

        Where it tells no single mass, that of the last base parameter of a link that is told.
        """
        masses, half = self.theta[::10], self.theta_half_widths[::10]
        count = len(self.robot.link_names)
        told = (self.theta_prior_share[::10][:count] < _FROM_PRIOR) & (
            half[:count] < masses[:count]
        )
        if told.any():
            link = int(np.flatnonzero(told)[-1])
            shares = [NORMAL * d.masses[link] / masses[link] for d in self.durations]
            return [f"mass of {self.robot.link_names[link]}: {self._times(shares)}"]
        known = (self.prior_share < _FROM_PRIOR) & (self.half_widths < np.abs(self.values))
        symbols = (name.rstrip("0123456789").removesuffix("r") for name in self.base.names)
        known &= np.array([symbol in PARAMETER_NAMES for symbol in symbols])
        if not known.any():
            return []
        k = int(np.flatnonzero(known)[-1])
        shares = [NORMAL * d.standard_errors[k] / abs(self.values[k]) for d in self.durations]
        return [f"{self._described(k)}: {self._times(shares)}"]

    def _described(self, k: int) -> str:
        """Return a base parameter in words."""
        name = self.base.names[k]
        symbol = name.rstrip("0123456789")
        link = self.robot.link_names[int(name[len(symbol) :]) - 1]
        kind = "first moment" if symbol.startswith("m") else "inertia"
        return f"{kind} {name} of {link} ({self.base.units[k]})"

    def _open(self) -> list[str]:
        """Return the open directions, those with one reason together."""
        reasons: dict[str, list[str]] = {}
        for each in self.open_directions:
            known = reasons.setdefault(each.reason, [])
            known += [name for name in each.parameters if name not in known]
        return [
            f"the run leaves open, more than not, {', '.join(names[:_LISTED])}"
            f"{', …' if len(names) > _LISTED else ''}: {reason}"
            for reason, names in reasons.items()
        ]

    def _parameters(self) -> str:
        count = len(self.base.names)
        lost = ~np.isfinite(self.standard_errors)
        believed = (self.prior_share > _FROM_PRIOR) & ~lost
        if np.isfinite(self.before).any():
            sharp = int(np.sum(self.standard_errors < _KNOWN * self.before))
            words = f"{sharp} of {count} base parameters will be known ten times as well as before"
        else:
            words = f"{count - int(lost.sum())} of {count} base parameters will be known"
        if believed.any():
            words += f"; {int(believed.sum())} rest on the description more than on the run"
        return f"{words}; {int(lost.sum())} stay open" if lost.any() else words

    def _friction(self) -> str:
        share = self.friction_half_widths / np.maximum(np.abs(self.friction), 1e-300)
        middle = len(self.speeds) // 2
        own = share[middle]
        worst = int(np.argmax(own))
        usual, most = _within(float(np.median(own))), _within(float(own[worst]))
        return (
            f"friction at {self.speeds[middle]:g} rad/s: {usual} (median over the joints), worst "
            f"{most} at {self.robot.joint_names[worst]}"
        )

    def _base(self) -> dict[str, Sequence[Any]]:
        """Return the columns of the base parameters."""
        return {
            "name": self.base.names,
            "unit": self.base.units,
            "value": self.values.tolist(),
            "standard_error": self.standard_errors.tolist(),
            **{each: getattr(self, each).tolist() for each in _AS_CALLED},
        }

    def table(self) -> Table:
        """Return one row a base parameter."""
        return Table.of_columns(dict(zip(_HEADER, self._base().values(), strict=True)))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: None where a number is not finite."""
        standard: dict[str, Sequence[Any]] = {
            "name": self.base.theta_names,
            "unit": self.base.theta_units,
            "value": self.theta.tolist(),
            "half_width": self.theta_half_widths.tolist(),
            "prior_share": self.theta_prior_share.tolist(),
        }
        content = {
            "seconds": self.seconds,
            "sentences": list(self.sentences()),
            "base_parameters": Table.of_columns(self._base()),
            "standard_parameters": Table.of_columns(standard),
            "friction": {
                "speed": self.speeds,
                "value": self.friction,
                "half_width": self.friction_half_widths,
            },
            "bands": [{**plain(band), "share": band.share} for band in self.bands],
            "durations": self.durations,
            "open_directions": self.open_directions,
            "no_influence": self.base.eliminated,
            "noise": self.noise,
            "notes": self.notes,
        }
        return plain_dict(content)


def _within(share: float) -> str:
    """Return a half width as a share, in percent with two digits."""
    if not share < _SAYS_NOTHING:
        return f"not even to {100.0 * _SAYS_NOTHING:g} %"
    return f"±{100.0 * share:.2g} %" if share < 1.0 else f"±{100.0 * share:.0f} %"
