"""Arrays to compact text and back: quantised, packed, ready to stand in an HTML file."""

from __future__ import annotations

import base64
import gzip
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MISSING = -32768
"""The code of NaN."""

CODES = 65534
"""Steps between the smallest and the largest code of a column."""


@dataclass(frozen=True)
class Block:
    """A (rows, columns) table as text. A value is offset + step * code; it is off by at most half a step.

    The text is base64 of gzip of two byte planes, low then high, of the int16 codes, one column after the
    other; with `delta` a code is the difference (modulo 2^16) from the one before it. Code -32768 is NaN.
    """

    rows: int
    columns: int
    delta: bool
    offset: tuple[float, ...]
    step: tuple[float, ...]
    text: str


def pack(
    values: NDArray[np.float64], finest: NDArray[np.float64] | float = 0.0, *, delta: bool = False
) -> Block:
    """Pack a (rows, columns) table; not finite values become NaN.

    Args:
        finest: per column or for all, the step that is fine enough; finer ones only make the text longer.
            A column whose range needs a coarser step gets range / 65534.
        delta: store differences; shorter for smooth columns, longer for noise.
    Examples:
        >>> block = pack(np.array([[0.0, 1.0], [np.nan, 3.0]]), 0.01)
        >>> unpack(block)
        array([[ 0.,  1.],
               [nan,  3.]])
    """
    table = np.ascontiguousarray(np.where(np.isfinite(values), values, np.nan).T)
    low, high = _bounds(table)
    step = _steps(low, high, finest)
    offset = low + step * np.rint((high - low) / (2 * step))
    codes = np.rint((table - offset[:, None]) / step[:, None])
    packed = np.where(np.isnan(codes), MISSING, codes).astype(np.int16)
    if delta:
        packed = np.diff(packed, axis=1, prepend=np.int16(0))
    rows, columns = values.shape
    return Block(rows, columns, delta, tuple(offset.tolist()), tuple(step.tolist()), _planes_text(packed))


def unpack(block: Block) -> NDArray[np.float64]:
    """The (rows, columns) table of a block, as the report's script sees it."""
    planes = (
        np.frombuffer(gzip.decompress(base64.b64decode(block.text)), np.uint8)
        .astype(np.uint16)
        .reshape(2, -1)
    )
    codes = (planes[0] | planes[1] << 8).view(np.int16).reshape(block.columns, block.rows)
    if block.delta:
        codes = np.cumsum(codes, axis=1, dtype=np.int16)
    values = np.asarray(block.offset)[:, None] + np.asarray(block.step)[:, None] * codes
    return np.where(codes == MISSING, np.nan, values).T


def pack_bytes(data: bytes) -> str:
    """Bytes as base64 of gzip; the same bytes always give the same text."""
    return base64.b64encode(gzip.compress(data, compresslevel=4, mtime=0)).decode("ascii")


def _planes_text(codes: NDArray[np.int16]) -> str:
    little = np.ascontiguousarray(codes, dtype="<i2").view(np.uint8).reshape(-1, 2)
    return pack_bytes(little.T.tobytes())


def _bounds(table: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest finite value of every row; 0, 0 for a row without any."""
    present = ~np.isnan(table)
    low = np.min(table, axis=1, where=present, initial=np.inf)
    high = np.max(table, axis=1, where=present, initial=-np.inf)
    empty = ~present.any(axis=1)
    return np.where(empty, 0.0, low), np.where(empty, 0.0, high)


def _steps(
    low: NDArray[np.float64], high: NDArray[np.float64], finest: NDArray[np.float64] | float
) -> NDArray[np.float64]:
    """A step per column: `finest` where the range allows it, and never zero."""
    step = np.maximum((high - low) / CODES, np.nan_to_num(np.broadcast_to(finest, low.shape)))
    return np.where(step > 0, step, 1.0)
