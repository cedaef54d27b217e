"""Cost, bound and gap of the rows of a log, from those of the compressed cost, without rounding.

With f_c the compressed cost, f_rows that of the rows as computed and f_true that of the robot's
equations, all theta of the box have

    (1 − relative)·f_c − absolute ≤ f_rows ≤ (1 + relative)·f_c + absolute,
    |√f_true − √f_rows| ≤ share·√f_rows + row_error(theta), at most row_error over the box.

The prior's cost is at least zero and the same in all three. docs/theory.md ("From the log to the
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
    cost : Fraction or None
        The given parameters cost at most this; None where there are none.
    lower_bound : Fraction
        No feasible parameters cost less.
    scale : Fraction
        The least cost that a gap is relative to.
    """

    cost: Fraction | None
    lower_bound: Fraction
    scale: Fraction

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
    cost = None
    if found.theta is not None and not found.broken:
        cost = (1 + share) * found.data_cost + constant + found.prior_cost
    return Totals(cost, (1 - share) * found.lower_bound - constant, found.scale)


def of_true_rows(
    found: Recomputed, rows: Totals, here: float, anywhere: float, share: float = 0.0
) -> Totals:
    """Return what is proven of the rows of the robot's equations.

    Parameters
    ----------
    found : Recomputed
        What is proven of the compressed cost.
    rows : Totals
        What is proven of the rows as computed.
    here, anywhere : float
        By how much the roots of the two costs of the data differ at most, at the given parameters
        and over the box.
    share : float
        How much more they may differ, relative to the root of the rows' cost.
    """
    cost = None
    if rows.cost is not None:
        data = rows.cost - found.prior_cost
        cost = ((1 + Fraction(share)) * root_above(data) + Fraction(here)) ** 2 + found.prior_cost
    # With the prior's cost under both roots, they are no further apart.
    below = root_below(max(rows.lower_bound, Fraction(0)))
    root = max(1 - Fraction(share), Fraction(0)) * below - Fraction(anywhere)
    least = max(root, Fraction(0)) ** 2
    return Totals(cost, least, rows.scale)
