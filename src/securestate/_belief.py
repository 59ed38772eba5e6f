"""A belief about the state, checked on construction."""

from typing import final

from numpy.typing import ArrayLike

from securestate import _checks as check
from securestate._checks import Array
from securestate._value import Value
from securestate.errors import InputError, ShapeError


@final
class Belief(Value):
    """What is believed about the state before the first measurement: x[0] ~ N(x, P).

    Args:
        x: mean, shape (n,), normalised units.
        P: covariance, shape (n, n), symmetric positive semidefinite; None: the steady state of the filter.

    Raises:
        ShapeError: x is not a vector, or P does not fit it.
        InputError: not finite real numbers, or P is not a covariance.

    Examples:
        >>> Belief([0, 0])
        Belief(n=2, P=steady state)
    """

    x: Array
    P: Array | None

    def __init__(self, x: ArrayLike, P: ArrayLike | None = None) -> None:
        mean = check.real_array("x", x, InputError)
        if mean.ndim != 1 or not mean.size:
            raise ShapeError("x", "shape (n,)", f"shape {mean.shape}")
        self._fill(x=mean, P=None if P is None else _belief_covariance(P, len(mean)))

    def __repr__(self) -> str:
        return f"Belief(n={len(self.x)}, P={'steady state' if self.P is None else 'given'})"


def _belief_covariance(P: ArrayLike, n: int) -> Array:
    spread = check.shaped("P", P, (n, n), " to fit x", ShapeError)
    return check.positive_semidefinite("P", spread, InputError)
