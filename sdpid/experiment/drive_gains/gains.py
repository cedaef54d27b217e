"""Drive gains with their covariance, and the file that keeps them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen, real_array, require_probability, shaped
from sdpid._common.files import Source, atomic_write_text, load_toml, printable, require_known
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.errors import DataError

# An eigenvalue of a covariance below minus this share of the largest is no rounding.
_ROUNDING = 1e-9

_KEYS = ("joint_names", "gains", "covariance", "freedom", "basis", "sources", "notes")
_UNIT = "N.m/A"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DriveGains(Shown):
    """Drive gains: the joint torque per ampere of each joint, with their errors.

    The torque of joint j is ``gains[j]`` times its current. A gain is torque constant × gear ratio
    × efficiency. Errors of the gains of several joints go together, and their largest common part
    is `common_factor`: it moves all torques, and so all masses and inertias, by one factor.

    Parameters
    ----------
    joint_names : sequence of str
        One name a joint.
    gains : (n,) array_like
        N·m/A (N/A for a prismatic joint), positive.
    covariance : (n, n) array_like, optional
        Covariance of the gains' errors, (N·m/A)²; by default zero: gains that are known.
    freedom : (n,) array_like, optional
        Degrees of freedom of each variance; by default infinite.
    basis : str, optional
        What the gains rest on, in words.
    sources : mapping of str to str, optional
        Names of the files that the gains were estimated from, and their SHA-256.
    notes : sequence of str, optional
        What was assumed, or is to be known.

    Attributes
    ----------
    source : Source or None
        The file that they were read from.

    Raises
    ------
    DataError
        When shapes do not agree, a gain is not positive, or the covariance is none.

    Examples
    --------
    >>> gains = sdpid.DriveGains(
    ...     joint_names=["hip", "knee"], gains=[10.0, 8.0], covariance=np.diag([0.04, 0.01])
    ... )
    >>> gains
    DriveGains(hip 10 ± 0.2, knee 8 ± 0.1 N·m/A)
    >>> gains.standard_errors, gains.intervals(0.95).round(2)
    (array([0.2, 0.1]), array([[ 9.62, 10.4 ],
           [ 7.81,  8.2 ]]))
    >>> gains.to_toml("gains.toml")
    >>> sdpid.DriveGains.from_toml("gains.toml").torque([[1.0, 2.0]])
    array([[10., 16.]])
    """

    _facts = ("basis", "common_factor")

    joint_names: tuple[str, ...]
    gains: Array
    covariance: Array = None  # type: ignore[assignment]  # zeros when built
    freedom: Array = None  # type: ignore[assignment]  # infinite when built
    basis: str = "given"
    sources: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    source: Source | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        names = _texts(self.joint_names, "joint_names")
        n = len(names)
        if n == 0 or len(set(names)) < n:
            raise DataError(f"gains: joint_names are {list(names)}; give each joint a name.")
        covariance = np.zeros((n, n)) if self.covariance is None else self.covariance
        freedom = np.full(n, np.inf) if self.freedom is None else self.freedom
        gains = shaped(self.gains, "gains: gains", (n,))
        covariance = shaped(covariance, "gains: covariance", (n, n))
        freedom = shaped(freedom, "gains: freedom", (n,), infinite=True)
        if not np.all(gains > 0.0):
            j = int(np.argmin(gains))
            raise DataError(
                f"gains: that of {names[j]} is {gains[j]:g} N·m/A; a gain is positive. Turn the "
                "sign of a joint's current where the log is read (effort_scale)."
            )
        if not np.all(freedom > 0.0):
            raise DataError(f"gains: freedom is {freedom.tolist()}; give {n} positive numbers.")
        covariance = frozen(0.5 * covariance + 0.5 * covariance.T)
        # By one gain after the other: their product may be too small for a number.
        with np.errstate(over="ignore"):
            relative = covariance / gains / gains[:, None]
        if not np.all(np.isfinite(relative)):
            raise DataError(
                "gains: covariance is too large beside gains of "
                f"{gains.min():.3g} to {gains.max():.3g} N·m/A; give it in (N·m/A)²."
            )
        eigenvalues = np.linalg.eigvalsh(relative)
        if eigenvalues[0] < -_ROUNDING * max(eigenvalues[-1], _ROUNDING):
            raise DataError(
                "gains: covariance is none: the smallest eigenvalue of the relative one is "
                f"{eigenvalues[0]:.3g}."
            )
        if not isinstance(self.basis, str):
            raise DataError(f"gains: basis is {self.basis!r:.80}, expected a text.")
        if not isinstance(sources := self.sources, Mapping):
            raise DataError(f"gains: sources are {sources!r:.80}, expected names and digests.")
        vars(self).update(
            joint_names=names,
            gains=gains,
            covariance=covariance,
            freedom=freedom,
            sources={str(key): str(value) for key, value in sources.items()},
            notes=_texts(self.notes, "notes"),
        )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def standard_errors(self) -> Array:
        """Standard error of each gain, (n,), N·m/A."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def relative_covariance(self) -> Array:
        """Covariance of the errors' shares of the gains, (n, n): of the gains' logarithms."""
        return np.asarray(self.covariance / self.gains / self.gains[:, None])

    @property
    def common_factor(self) -> float:
        """Standard deviation of the largest factor that the errors can have in common.

        The largest c for which c² times the matrix of ones can be taken off the relative
        covariance, so that a covariance is left.
        """
        values, vectors = np.linalg.eigh(self.relative_covariance)
        seen = values > _ROUNDING * max(values[-1], 0.0)
        along = vectors.T @ np.ones(self.n)
        if not seen.any() or np.any(np.abs(along[~seen]) > np.sqrt(_ROUNDING * self.n)):
            return 0.0
        return float(np.sum(along[seen] ** 2 / values[seen]) ** -0.5)

    def intervals(self, level: float = 0.95) -> Array:
        """Return lower and upper ends of each gain's interval, (n, 2), N·m/A.

        The gains' logarithms are taken to be distributed as Student's t, so no end is negative.

        Parameters
        ----------
        level : float, optional
            Probability of each interval.
        """
        from scipy.stats import t

        require_probability(level, "gains: level")
        quantile = np.asarray(t.ppf(0.5 * (1.0 + level), self.freedom))
        share = quantile * self.standard_errors / self.gains
        return np.stack([self.gains * np.exp(-share), self.gains * np.exp(share)], axis=1)

    def torque(self, current: Any) -> Array:
        """Return the joint torques (N, n) in N·m of currents (N, n) in A.

        Raises
        ------
        DataError
            When there is another number of columns.
        """
        values = real_array(current, "current", ndim=2)
        if values.shape[1] != self.n:
            raise DataError(
                f"current: has {values.shape[1]} columns; there are gains for {self.n} joints."
            )
        return np.asarray(values * self.gains)

    def of_joints(self, joint_names: Sequence[str]) -> DriveGains:
        """Return the gains of some joints, in a given order.

        Raises
        ------
        DataError
            When there is no gain for one of them.
        """
        missing = [name for name in joint_names if name not in self.joint_names]
        if missing:
            raise DataError(
                f"gains: none for {', '.join(missing)}; there are gains for "
                f"{', '.join(self.joint_names)}. Leave columns without a gain out "
                "(joint_names, --joint-names), or name the joints alike."
            )
        return self.picked(list(map(self.joint_names.index, joint_names)), joint_names)

    def picked(self, order: Sequence[int], joint_names: Sequence[str]) -> DriveGains:
        """Return some of the gains, by their numbers, under other names."""
        order = list(order)
        return self._from(
            self.source,
            joint_names=tuple(joint_names),
            gains=self.gains[order],
            covariance=self.covariance[np.ix_(order, order)],
            freedom=self.freedom[order],
        )

    def _from(self, source: Source | None, **changes: Any) -> DriveGains:
        """Return these gains, or some changed ones, as those of a file."""
        result = replace(self, **changes)
        object.__setattr__(result, "source", source)
        return result

    def renamed(self, joint_names: Sequence[str]) -> DriveGains:
        """Return the gains under other names of the joints."""
        return self.picked(range(self.n), joint_names)

    def same_errors(self, other: DriveGains) -> bool:
        """Return whether others are the same gains, and so have the same errors."""
        same_gains = np.array_equal(self.gains, other.gains)
        return same_gains and np.array_equal(self.covariance, other.covariance)

    def table(self, level: float = 0.95) -> Table:
        """Return one row a joint: gain, standard error in percent, interval.

        Parameters
        ----------
        level : float, optional
            Probability of each interval.
        """
        lower, upper = self.intervals(level).T
        columns: dict[str, Sequence[object]] = {
            "joint": self.joint_names,
            "gain (N·m/A)": self.gains.tolist(),
            "error (%)": (100.0 * self.standard_errors / self.gains).tolist(),
            "lower": lower.tolist(),
            "upper": upper.tolist(),
        }
        return Table.of_columns(columns, {"error (%)": ".2g"})

    def describe(self, level: float = 0.95) -> str:
        """Return the gains in words and numbers, one joint a line.

        Parameters
        ----------
        level : float, optional
            Probability of each interval.
        """
        title = f"drive gains, by {self.basis} ({100.0 * level:g} % intervals)"
        lines = [title, *self.table(level).text(4).splitlines(), *self.notes]
        # A file's names and notes are a stranger's, and may drive a terminal.
        return "\n".join(map(printable, lines))

    @property
    def in_words(self) -> str:
        """Where the gains come from and how well they are known, in a line."""
        errors = 100.0 * self.standard_errors / self.gains
        if not errors.any():
            known = "taken as exact"
        else:
            ends = dict.fromkeys(f"{each:.2g}" for each in (errors.min(), errors.max()))
            known = f"standard errors of {' to '.join(ends)} %"
            known += f", {100.0 * self.common_factor:.2g} % of it in common"
        named = "" if self.source is None else f"{self.source.name}, "
        return printable(f"{named}by {self.basis}: {known}")

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        read = self.source
        file = read and {"name": read.name, "bytes": read.size, "sha256": read.sha256}
        facts = ("standard_errors", "common_factor")
        return plain_dict(
            {"unit": _UNIT, "file": file} | {k: getattr(self, k) for k in (*_KEYS, *facts)}
        )

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write the gains to a TOML file, without loss, whole or not at all.

        Raises
        ------
        ExportError
            When the file cannot be written.
        """
        import tomli_w

        table: dict[str, Any] = {"unit": _UNIT}
        for key in _KEYS:
            value = getattr(self, key)
            table[key] = value.tolist() if isinstance(value, np.ndarray) else value
        title = "Drive gains: joint torque per current."
        heading = f"# {title} common_factor = {self.common_factor:.3g}\n"
        atomic_write_text(Path(path), heading + tomli_w.dumps(table))

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> DriveGains:
        """Read a file that `to_toml` wrote, or one of a user with ``joint_names`` and ``gains``.

        Raises
        ------
        DataError
            When it cannot be read, lacks an entry, has an unknown one, or holds no gains.
        """
        table = load_toml(path)
        unit = table.pop("unit", _UNIT)
        if unit != _UNIT:
            raise DataError(f"{path}: unit is {unit!r}, expected '{_UNIT}'.")
        if missing := [key for key in _KEYS[:2] if key not in table]:
            raise DataError(f"{path}: no {' and no '.join(missing)}; it is no file of gains.")
        require_known(table, ("unit", *_KEYS), str(path))
        try:
            return cls(**table)._from(Source.of(Path(path)))
        except (DataError, TypeError) as cause:
            raise DataError(f"{path}: {cause}") from None

    @classmethod
    def from_dict(cls, given: Mapping[str, Any]) -> DriveGains:
        """Return the gains of `to_dict`.

        Raises
        ------
        DataError
            When an entry is missing or of another kind.
        """
        try:
            values = {key: given[key] for key in _KEYS}
            values["freedom"] = [np.inf if each is None else each for each in values["freedom"]]
            source, file = None, given.get("file")
            if file is not None:
                name, size, digest = (file[key] for key in ("name", "bytes", "sha256"))
                source = Source(name=str(name), size=int(size), sha256=str(digest))
            return cls(**values)._from(source)
        except (KeyError, TypeError, ValueError, AttributeError) as cause:
            raise DataError(f"gains: are no gains of to_dict ({cause!r:.80}).") from None

    def __repr__(self) -> str:
        each = zip(self.joint_names, self.gains, self.standard_errors, strict=True)
        shown = [
            f"{printable(name[:_NAME])} {gain:.4g} ± {error:.2g}" for name, gain, error in each
        ]
        more = f", … {self.n - _SHOWN} more" if self.n > _SHOWN else ""
        return f"DriveGains({', '.join(shown[:_SHOWN])}{more} N·m/A)"

    def _tables(self) -> list[Table]:
        return [self.table()]


# How many joints a line shows, and how many characters of their names.
_SHOWN, _NAME = 3, 24


def _texts(values: Any, name: str) -> tuple[str, ...]:
    """Return a sequence of texts as a tuple."""
    if isinstance(values, str) or not all(isinstance(each, str) for each in values):
        raise DataError(f"gains: {name} is {values!r:.80}, expected a list of texts.")
    return tuple(values)
