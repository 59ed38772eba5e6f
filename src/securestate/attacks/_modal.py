"""Lies along one mode of the plant."""

import numpy as np

from securestate.attacks.knowledge import Float
from securestate.resilience.detectability import Mode

#: Growth beyond which a lie is held, so that all numbers stay finite.
LARGEST = 1e100


def along_mode(mode: Mode, size: float, elapsed: Float) -> Float:
    """D = Re(size lambda^j v) after j = elapsed samples, (T, n); a mode that fades keeps its size.

    The powers are cumulative products, so that from one sample to the next d moves as the plant does, to
    rounding, however large it is. Before the start d is zero.
    """
    factor = mode.eigenvalue
    if abs(factor) < 1:
        factor = factor / abs(factor) if factor else 1.0
    j = elapsed[:, 0].astype(np.int64)
    last = max(int(j.max(initial=0)), 0)
    if abs(factor) > 1:
        last = min(last, int(np.log(LARGEST) / np.log(abs(factor))))
    powers = np.cumprod(np.append(1.0, np.full(last, factor, dtype=np.complex128)))
    moved = np.where(j >= 0, powers[np.clip(j, 0, last)], 0.0)
    d: Float = size * np.real(moved[:, np.newaxis] * mode.direction)
    return d
