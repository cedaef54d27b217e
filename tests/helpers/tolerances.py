"""Tolerances of the tests, each with its reason, and the comparison that takes them."""

import numpy as np

from sdpid._common.arrays import Array

# Forward kinematics: a product of at most eight transforms with entries of order one loses a
# few dozen roundings of 2e-16.
KINEMATICS = 1e-12

# Regressor and inverse dynamics, relative to the largest effort: both are sums over links of
# products of a few transforms, in a different order.
DYNAMICS = 1e-10

# Algebra of single bodies, relative to the body's largest entry.
ALGEBRA = 1e-12

# Regrouping at fresh states, relative to the largest effort: the coefficients come from a
# least-squares fit of 120 states and are only as good as the conditioning of that fit.
REGROUPING = 1e-8

# Base parameters from exact data, relative to the largest of the same unit: what was promised.
EXACT = 1e-6

# Cost against a brute-force sum over raw rows, relative to the weighted squared efforts: the
# factorization loses a few hundred roundings.
COST = 1e-10

# Costs of two solvers on the same problem, relative.
SAME_OPTIMUM = 1e-6

# SLSQP stops when its scaled cost changes by less than 1e-12 of the squared efforts. Near an
# optimum the cost is quadratic, so parameters are known to the square root of that, times the
# conditioning of the problem; a thousandfold allowance covers the small arms of the tests.
LOCAL_PARAMETERS = 1e-3


def assert_same(actual: Array, expected: Array, tolerance: float = DYNAMICS) -> None:
    """Assert that arrays differ by no more than a share of the largest entry, or of one."""
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * scale)
