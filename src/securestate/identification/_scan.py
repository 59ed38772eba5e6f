"""The recursion x[k+1] = F x[k] + g[k] over segments of a record, without a Python step per sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@final
class Scan:
    """A plan for segments of given lengths, which lie one after the other in one array.

    Every segment is cut into blocks of about sqrt(N / 2) samples. All blocks advance together from zero; then
    the blocks of a segment are chained by the power of F, and all advance once more from where they start.
    """

    def __init__(self, lengths: Sequence[int]) -> None:
        self.total = int(sum(lengths))
        self.length = max(1, int(np.sqrt(self.total / 2)))
        blocks = [-(-n // self.length) for n in lengths]
        starts = np.concatenate([[0], np.cumsum(blocks)[:-1]]).astype(np.int64)
        self.blocks = int(sum(blocks))
        self.begins = np.zeros(self.blocks, dtype=np.bool_)
        self.begins[starts] = True
        parts = [start * self.length + np.arange(n) for start, n in zip(starts, lengths, strict=True)]
        self.place: Indices = np.concatenate(parts).astype(np.int64)

    def __call__(self, F: Array, g: Array) -> Array:
        """Return x[k] of every sample, (N, n); each segment starts from x = 0.

        Args:
            F: (n, n). g: of all segments, (N, n).
        """
        n = g.shape[1]
        padded = np.zeros((self.blocks * self.length, n))
        padded[self.place] = g
        driven = padded.reshape(self.blocks, self.length, n)
        moved = np.zeros((self.blocks, n))
        for k in range(self.length):
            moved = moved @ F.T + driven[:, k]
        power = np.linalg.matrix_power(F, self.length)
        first = np.zeros((self.blocks, n))
        for b in range(1, self.blocks):
            if not self.begins[b]:
                first[b] = power @ first[b - 1] + moved[b - 1]
        x = np.empty((self.blocks, self.length, n))
        for k in range(self.length):
            x[:, k] = first
            first = first @ F.T + driven[:, k]
        return np.asarray(x.reshape(-1, n)[self.place])


def scan(F: Array, g: Array) -> Array:
    """The same for one segment."""
    return Scan([len(g)])(F, g) if len(g) else np.zeros(g.shape)
