"""Units of the states in which the entries of A and C are about even, so that sizes can be compared."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Size that counts as none beside the largest.
ROUNDING = 1e-13


def balanced_units(A: Array, C: Array) -> Array:
    """Units of the states in which the entries of A and C are about even, (n,), powers of two.

        min over d and r of  w sum (log |a_ij| + d_j - d_i)^2 + sum (log |c_ij| + d_j + r_i)^2

    over the entries that are no rounding errors, off the diagonal of A: the units do not depend on those that
    A and C come in. What is a rounding error of A is judged in units in which C is even (w small). Powers of
    two change no digit.

    References:
        Curtis, Reid 1972, with a similarity for A.
    """
    a = np.abs(A)
    d = _even(a, np.abs(C), 1e-3)
    d = _even(a / np.exp(d)[:, None] * np.exp(d), np.abs(C) * np.exp(d), 1.0) + d
    units: Array = np.exp2(np.clip(np.round(d / np.log(2)), -400, 400))
    return units


def _even(a: Array, c: Array, w: float) -> Array:
    """Logarithms d of the units, by least squares."""
    a, c = _or_nothing(a, a.max(axis=1)), _or_nothing(c, c.max(axis=1, initial=0.0))
    np.fill_diagonal(a, 0.0)
    M_a, M_c = w * (a > 0), (c > 0).astype(np.float64)
    log_a, log_c = M_a * np.log(or_one(a)), np.log(or_one(c))
    per_row = 1 / np.maximum(M_c.sum(axis=1), 1.0)[:, None]
    log_c = M_c * (log_c - log_c.sum(axis=1, keepdims=True) * per_row)  # r_i eliminated
    normal = (
        np.diag((M_a + M_a.T).sum(axis=1)) - M_a - M_a.T + np.diag(M_c.sum(axis=0)) - M_c.T @ (per_row * M_c)
    )
    wanted = log_a.sum(axis=1) - log_a.sum(axis=0) - log_c.sum(axis=0)
    d: Array = np.clip(np.linalg.lstsq(normal, wanted, rcond=1e-10)[0], -300.0, 300.0)
    return d


def _or_nothing(sizes: Array, rows: Array) -> Array:
    """The sizes, with 0 for those that are rounding errors beside the largest of their row."""
    return np.where(sizes > ROUNDING * rows[:, None], sizes, 0.0)


def or_one(sizes: Array) -> Array:
    """The sizes, with 1 instead of 0."""
    return np.where(sizes > 0, sizes, 1.0)
