"""How many sensors see a direction, by brute force."""

from itertools import combinations
from math import comb
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: A plant as arrays: A, C, the sensor of every row of C, and a basis of each true eigenspace by its
#: eigenvalue.
Case = tuple[Array, Array, NDArray[np.int64], dict[complex, NDArray[Any]]]


def fewest_seeing(X: NDArray[Any], owner: NDArray[np.int64], sensors: int, zero: float = 1e-6) -> int:
    """Fewest sensors with X_i u != 0 over u != 0; X (rows, g), rows of size about 1.

    The direction that fewest see is blind to as many rows as possible, so it spans the null space of some g -
    1 of them, or there are not enough independent rows.
    """
    g = X.shape[1]
    if np.linalg.matrix_rank(X, tol=zero) < g:
        return 0
    chosen = np.array(list(combinations(range(len(X)), g - 1)), dtype=np.intp).reshape(
        comb(len(X), g - 1), g - 1
    )
    _, sizes, Vh = np.linalg.svd(np.concatenate([X[chosen], np.zeros((len(chosen), 1, g))], axis=1))
    independent = np.all(sizes[:, : g - 1] > zero, axis=1)
    seen = np.abs(Vh[independent, -1].conj() @ X.T) > zero
    return int((seen.astype(int) @ (owner[:, None] == np.arange(sensors)) > 0).sum(axis=1).min())


def random_case(rng: np.random.Generator, *, large_spaces: bool = False) -> Case:
    """A plant of up to 6 states and 10 sensors with repeated and complex eigenvalues, and Jordan blocks."""
    blocks, spaces = _blocks(rng, large_spaces)
    A = np.asarray(scipy.linalg.block_diag(*blocks), dtype=np.float64)
    n, sensors = len(A), int(rng.integers(1, 11))
    counts = rng.choice([1, 1, 1, 2], size=sensors)
    owner = np.repeat(np.arange(sensors), counts)
    C = rng.integers(-1, 2, (len(owner), n)) * rng.choice([1.0, 0.5], (len(owner), n))
    C[~C.any(axis=1), 0] = 1.0
    bases = {value: np.array(columns).T for value, columns in spaces.items()}
    if rng.random() < 0.5:
        T = rng.standard_normal((n, n)) + 2 * np.eye(n)
        A, C = T @ A @ np.linalg.inv(T), C @ np.linalg.inv(T)
        bases = {value: T @ V for value, V in bases.items()}
    return A, C, owner, bases


def _blocks(rng: np.random.Generator, large: bool) -> tuple[list[Array], dict[complex, list[NDArray[Any]]]]:
    n = int(rng.integers(1, 7))
    blocks: list[Array] = []
    spaces: dict[complex, list[NDArray[Any]]] = {}
    start = 0
    while start < n:
        left, kind = n - start, int(rng.integers(4))
        value: complex = 1.0 if large and rng.random() < 0.8 else float(rng.choice([1.0, 0.5, -1.2, 0.9]))
        vector = np.zeros(n, dtype=np.complex128)
        vector[start] = 1.0
        if kind == 0 and left >= 2:
            blocks.append(np.array([[0.6, 0.8], [-0.8, 0.6]]))
            value, vector[start + 1] = 0.6 + 0.8j, 1j
        elif kind == 1 and left >= 2 and not large:
            size = int(rng.integers(2, min(left, 3) + 1))
            blocks.append(np.real(value) * np.eye(size) + np.diag(np.ones(size - 1), 1))
        else:
            blocks.append(np.array([[np.real(value)]]))
        start += len(blocks[-1])
        spaces.setdefault(value, []).append(vector)
    return blocks, spaces


def count_of(case: Case, cut: float) -> float:
    """The least count over all true eigenvalues of at least this size; inf if there are none."""
    _, C, owner, bases = case
    counts = [
        fewest_seeing(C @ np.linalg.qr(V)[0], owner, int(owner.max()) + 1)
        for value, V in bases.items()
        if abs(value) >= cut
    ]
    return min(counts, default=np.inf)
