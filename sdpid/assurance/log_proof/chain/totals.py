"""Cost, bound and gap of the rows of a log, from those of the compressed cost, without rounding.

With f_c the compressed cost, f_rows that of the rows as computed and f_true that of the robot's
equations, all theta of the box have

    (1 − relative)·f_c − absolute ≤ f_rows ≤ (1 + relative)·f_c + absolute,
    |√f_true − √f_rows| ≤ share·√f_rows + row_error(theta), at most row_error over the box.

The prior's cost is at least zero and the same in all three. docs/theory ("From the log to the
bound") has the proofs.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from sdpid.verifier.bound import Recomputed
from sdpid.verifier.exact import root_above, root_below


@dataclass(frozen=True)
class Totals:
    """What is proven of one cost.

    Attributes
    ----------
    data : Fraction or None
        The rows cost at most this at the given parameters; None where there are none within their
        bounds.
    prior : Fraction
        The prior costs at most this there.
    lower_bound : Fraction
        Rows and prior together cost no less at any feasible parameters.
    scale : Fraction
        The least cost that a gap is relative to.
    """

    data: Fraction | None
    prior: Fraction
    lower_bound: Fraction
    scale: Fraction

    @property
    def cost(self) -> Fraction | None:
        """What rows and prior together cost at most at the given parameters."""
        return None if self.data is None else self.data + self.prior

    @property
    def gap(self) -> Fraction | None:
        """(cost − lower bound) relative to the cost; None without parameters."""
        if self.cost is None:
            return None
        size = max(self.cost, self.scale)
        return (self.cost - self.lower_bound) / size if size else Fraction(0)


def of_rows(found: Recomputed, relative: float, absolute: float) -> Totals:
    """Return what is proven of the rows as computed.

    Parameters
    ----------
    found : Recomputed
        What is proven of the compressed cost.
    relative, absolute : float
        How near it is to that of the rows, relative below one.
    """
    share, constant = Fraction(relative), Fraction(absolute)
    data = None
    if found.theta is not None and not found.broken:
        box = zip(found.lower, found.theta, found.upper, strict=True)
        # Nothing is known of how near the two costs are outside the bounds.
        if all(low <= value <= high for low, value, high in box):
            data = (1 + share) * found.data_cost + constant
    # A cost is no less than its floor, and no less than zero.
    least = max(found.lower_bound, Fraction(found.problem["floor"]))
    bound = max((1 - share) * least - constant, Fraction(0))
    return Totals(data, found.prior_cost, bound, found.scale)


def of_true_rows(rows: Totals, here: float, anywhere: float, share: float = 0.0) -> Totals:
    """Return what is proven of the rows of the robot's equations.

    Parameters
    ----------
    rows : Totals
        What is proven of the rows as computed.
    here, anywhere : float
        By how much the roots of the two costs of the data differ at most, at the given parameters
        and over the box.
    share : float
        How much more they may differ, relative to the root of the rows' cost.
    """
    data = None
    if rows.data is not None:
        data = ((1 + Fraction(share)) * root_above(rows.data) + Fraction(here)) ** 2
    # With the prior's cost under both roots, they are no further apart.
    below = root_below(rows.lower_bound)
    root = max(1 - Fraction(share), Fraction(0)) * below - Fraction(anywhere)
    least = max(root, Fraction(0)) ** 2
    return Totals(data, rows.prior, least, rows.scale)
