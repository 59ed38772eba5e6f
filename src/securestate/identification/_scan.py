"""The recursion x[k+1] = F x[k] + g[k] over a whole record, without a Python step per sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def scan(F: Array, g: Array, start: Array | None = None) -> Array:
    """Return x[0], ..., x[N] of x[k+1] = F x[k] + g[k], shape (N + 1, n).

    The record is cut into about sqrt(N / 2) blocks. All blocks advance together from zero; then their ends
    are chained by the power of F, and all advance once more from where they really start.

    Args:
        F: (n, n). g: (N, n). start: x[0], (n,); None: zero.
    """
    N, n = g.shape
    if N == 0:
        return np.zeros((1, n)) if start is None else start[None, :].copy()
    length = max(1, int(np.sqrt(N / 2)))
    blocks = -(-N // length)
    padded = np.zeros((blocks * length, n))
    padded[:N] = g
    padded = padded.reshape(blocks, length, n)
    moved = np.zeros((blocks, n))
    for k in range(length):
        moved = moved @ F.T + padded[:, k]
    x = np.empty((blocks * length + 1, n))
    power = np.linalg.matrix_power(F, length)
    first = np.zeros((blocks, n)) if start is None else np.vstack([start, np.zeros((blocks - 1, n))])
    for b in range(1, blocks):
        first[b] = power @ first[b - 1] + moved[b - 1]
    whole = x[:-1].reshape(blocks, length, n)
    for k in range(length):
        whole[:, k] = first
        first = first @ F.T + padded[:, k]
    x[-1] = first[-1]
    return x[: N + 1]
