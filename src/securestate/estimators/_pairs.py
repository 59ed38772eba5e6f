"""Pairs (T, b) that drive the local filters: T has the spectrum of M = A − K C A and (T, b) is controllable.

Two choices: the orthonormal pair of Takenaka and Malmquist (robust form) and the Jordan form with b = 1 of
the paper. Any choice gives the same Kalman filter (Theorem 1); they differ in conditioning.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from securestate.errors import DesignError

Float = NDArray[np.float64]

#: Eigenvalues closer than this (relative) may be one defective eigenvalue, split by rounding.
_CLUSTER = 1e-5


@dataclass(frozen=True)
class Pair:
    """The pair and the entries of a local state whose penalty is one 2-norm (complex pairs).

    Attributes:
        T: (n, n).
        b: (n,).
        groups: index arrays into the local state, one per penalty term.
    """

    T: Float
    b: Float
    groups: tuple[NDArray[np.int64], ...]


def takenaka_malmquist(M: Float) -> Pair:
    """Real pair with T Tᵀ + b bᵀ = I and the spectrum of M: a cascade of all-pass sections.

    No inverse is taken, so repeated and nearly repeated eigenvalues are harmless.

    Args:
        M: stable matrix, (n, n).
    References:
        Takenaka 1925, Malmquist 1926; Heuberger, Van den Hof, Wahlberg 2005, chapter 2.
    """
    n = len(M)
    T, b = np.zeros((n, n)), np.zeros(n)
    row, gain, k = np.zeros(n), 1.0, 0  # input of the next section = row · z + gain · u
    for a1, b1, c1, d1 in map(_all_pass, _sections(np.linalg.eigvals(M).astype(np.complex128))):
        s = slice(k, k + len(b1))
        T[s] = np.outer(b1, row)
        T[s, s] = a1
        b[s] = b1 * gain
        row *= d1
        row[s] = c1
        gain *= d1
        k = s.stop
    return Pair(T, b, (np.arange(n),))


def _sections(eigenvalues: NDArray[np.complex128]) -> list[complex]:
    """One representative per real eigenvalue or conjugate pair, slowest first."""
    real = [complex(z) for z in eigenvalues if z.imag == 0]
    upper = [complex(z) for z in eigenvalues if z.imag > 0]
    return sorted(real + upper, key=lambda z: (-abs(z), z.real, z.imag))


def _all_pass(z: complex) -> tuple[Float, Float, Float, float]:
    """Orthogonal realisation (a, b, c, d) of the all-pass section with pole z (and its conjugate)."""
    if z.imag == 0:
        s = np.sqrt((1 - z.real) * (1 + z.real))
        return np.array([[z.real]]), np.array([s]), np.array([s]), -z.real
    a, b = np.array([[2 * z.real, -(abs(z) ** 2)], [1.0, 0.0]]), np.array([1.0, 0.0])
    gramian = sl.solve_discrete_lyapunov(a, np.outer(b, b))
    L = np.linalg.cholesky((gramian + gramian.T) / 2)
    a, b = sl.solve_triangular(L, a @ L, lower=True), sl.solve_triangular(L, b, lower=True)
    last = np.linalg.svd(np.column_stack([a, b]))[2][-1]  # completes [a b] to an orthogonal matrix
    return a, b, last[:2], float(last[2])


def jordan(M: Float) -> Pair:
    """The paper's pair: T the Jordan form of M, b = 1; complex pairs as real 2 × 2 blocks with b = (√2, 0).

    The real blocks are a unitary change of coordinates on each conjugate pair, so |φ| of a pair becomes a
    2-norm over two entries (weight √2) and nothing else changes.

    Raises:
        DesignError: M is derogatory, so (T, b) cannot be controllable.
    """
    blocks = _jordan_blocks(M)
    n = len(M)
    T, b, groups, k = np.zeros((n, n)), np.zeros(n), [], 0
    for z, size in blocks:
        w = 1 if z.imag == 0 else 2
        for j in range(size):
            s = slice(k, k + w)
            T[s, s] = [[z.real]] if w == 1 else [[z.real, -z.imag], [z.imag, z.real]]
            if j + 1 < size:
                T[s, k + w : k + 2 * w] = np.eye(w)
            b[k] = np.sqrt(w)
            groups.append(np.arange(k, k + w))
            k += w
    return Pair(T, b, tuple(groups))


def _jordan_blocks(M: Float) -> list[tuple[complex, int]]:
    """(eigenvalue, size) per block, real eigenvalues ascending, then pairs with positive imaginary part."""
    eigenvalues = np.linalg.eigvals(M)
    scale = max(1.0, float(np.linalg.norm(M, 2)))
    left = sorted((complex(z) for z in eigenvalues), key=lambda z: (z.imag != 0, z.real, z.imag))
    blocks = []
    while left:
        cluster = [z for z in left if abs(z - left[0]) <= _CLUSTER * scale]
        left = [z for z in left if abs(z - left[0]) > _CLUSTER * scale]
        if len(cluster) == 1:
            blocks.append((cluster[0], 1))
            continue
        blocks += _cluster_blocks(M, cluster, scale)
    return [(z, size) for z, size in blocks if z.imag >= 0]


def _cluster_blocks(M: Float, cluster: list[complex], scale: float) -> list[tuple[complex, int]]:
    """One Jordan block if the cluster's mean is a defective eigenvalue, single blocks if distinct."""
    mean = complex(np.mean(cluster))
    if abs(mean.imag) <= _CLUSTER * scale:
        mean = complex(mean.real)
    s = np.linalg.svd(M - mean * np.eye(len(M)), compute_uv=False)
    multiplicity = int(np.sum(s <= 1e-9 * scale))
    if multiplicity > 1:
        raise DesignError(
            f"A − K C A is derogatory: {multiplicity} eigenvectors for eigenvalue {mean:.6g}; W is singular",
            'use form="robust", which needs no such assumption',
        )
    if multiplicity == 1:
        return [(mean, len(cluster))]
    return [(z, 1) for z in cluster]
