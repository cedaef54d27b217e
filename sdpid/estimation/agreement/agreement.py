"""`Agreement`: whether two estimates differ by more than their errors explain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from sdpid._common.tables import Shown, Table, plain


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One base parameter of two estimates.

    Attributes
    ----------
    name, unit : str
        The parameter.
    first, other : float
        Its values.
    difference : float
        `other` less `first`.
    first_error, other_error : float or None
        Standard error of either value, shares of priors included; None where neither data nor
        prior say anything of it.
    standard_error : float or None
        Of the difference; None where the estimates share data, where both rest on one prior
        alone, or where nothing is known of one of them.
    freedom : float or None
        Degrees of freedom of Student's t.
    t, p : float or None
        The difference over its standard error, and the probability of one as large by chance.
    agree : bool or None
        Whether zero is in the interval of the difference.
    """

    name: str
    unit: str
    first: float
    other: float
    difference: float
    first_error: float | None
    other_error: float | None
    standard_error: float | None = None
    freedom: float | None = None
    t: float | None = None
    p: float | None = None
    agree: bool | None = None


@dataclass(frozen=True, kw_only=True)
class EffortDifference:
    """What two estimates predict differently on one motion.

    Attributes
    ----------
    motion : str
        ``"first"`` or ``"other"``: whose samples they are.
    relative : float
        Norm of the differences over the norm of the measured efforts, on the rows in use.
    rms : tuple of float
        Root mean square difference of each joint, N·m.
    """

    motion: str
    relative: float
    rms: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, repr=False)
class Agreement(Shown):
    """Two estimates of one robot, and whether they agree.

    Attributes
    ----------
    differences : tuple of Difference
        Of the base parameters that both have, as the same functions of the standard parameters.
    only_first, only_other : tuple of str
        Base parameters that only one has, or that are regrouped differently.
    independent : bool
        Whether the errors are taken as independent. Estimates that share data are not: nothing is
        tested then.
    level : float
        Of the intervals.
    statistic : float or None
        Squared Mahalanobis distance of the differences, in the directions that are tested.
    rank : int
        Number of these directions.
    freedom : float or None
        Degrees of freedom of the variances in it.
    p : float or None
        Probability of a distance as large if both are estimates of one robot. None where nothing
        is tested.
    efforts : tuple of EffortDifference
        On the motion of each.
    joint_names : tuple of str
        The joints of `efforts`.
    notes : tuple of str
        What to know of the comparison, one sentence each.
    """

    differences: tuple[Difference, ...]
    only_first: tuple[str, ...]
    only_other: tuple[str, ...]
    independent: bool
    level: float
    statistic: float | None
    rank: int
    freedom: float | None
    p: float | None
    efforts: tuple[EffortDifference, ...]
    joint_names: tuple[str, ...]
    notes: tuple[str, ...] = ()

    _facts = ("agree", "p", "differences", "summary")

    @property
    def agree(self) -> bool | None:
        """Whether all differences together are as large as errors make them; None: not tested."""
        return None if self.p is None else self.p >= 1.0 - self.level

    @property
    def outside(self) -> tuple[str, ...]:
        """Names of the parameters whose intervals of the difference exclude zero."""
        return tuple(each.name for each in self.differences if each.agree is False)

    def _tables(self) -> Iterator[Table]:
        yield self._table()

    def summary(self) -> str:
        """Return the answer in a few sentences."""
        said = ["Whether the estimates agree is not tested."]
        if self.p is not None:
            said = [
                f"The estimates {'agree' if self.agree else 'differ by more than their errors'}: "
                f"the squared Mahalanobis distance of {self.rank} directions is "
                f"{self.statistic:.4g} (p = {self.p:.2g})."
            ]
        if tested := sum(each.agree is not None for each in self.differences):
            expected, names = (1.0 - self.level) * tested, self.outside
            more = " and more" if len(names) > 6 else ""
            listed = f" ({', '.join(names[:6])}{more})" if names else ""
            said.append(
                f"Of {tested} base parameters {len(names)}{listed} differ by more than "
                f"{100.0 * self.level:g} % intervals allow; {expected:.2g} would by chance."
            )
        efforts = [
            f"{100.0 * e.relative:.2g} % on the motion of the {e.motion}" for e in self.efforts
        ]
        if efforts:
            said.append(f"Predicted efforts differ by {' and '.join(efforts)} (rms).")
        return " ".join([*said, *self.notes])

    def _table(self) -> Table:
        """Return one row a parameter: with errors of each, or of the difference."""
        shown = {"parameter": "name", "unit": "unit"}
        shown |= {name: name for name in ("first", "other", "difference")}
        if self.independent:
            shown |= {"standard error": "standard_error", "t": "t", "p": "p"}
        else:
            shown |= {"error of first": "first_error", "error of other": "other_error"}
        columns: dict[str, list[object]] = {
            header: [getattr(each, name) for each in self.differences]
            for header, name in shown.items()
        }
        if self.independent:
            columns[""] = ["differs" if e.agree is False else "" for e in self.differences]
        return Table.of_columns(columns, {"t": ".2f", "p": ".2g"})

    def table(self) -> str:
        """Return aligned text, one line a parameter, and the answer below."""
        return f"{self._table().text()}\n\n{self.summary()}"

    def to_frame(self) -> Any:
        """Return one row a parameter as a pandas DataFrame."""
        import pandas

        frame = pandas.DataFrame([asdict(d) for d in self.differences])
        return frame.set_index("name") if len(frame) else frame

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        found: dict[str, Any] = {**plain(self), "agree": self.agree}
        return found
