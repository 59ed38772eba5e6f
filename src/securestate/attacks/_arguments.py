"""Checks of what an adversary is made with. Each returns clean, hashable data or raises `InputError`."""

from collections.abc import Sequence
from typing import Any, get_args

import numpy as np

from securestate import _checks as check
from securestate.errors import InputError


def number(argument: str, value: object) -> float:
    """One finite number."""
    given = check.real_array(argument, value, InputError)
    if given.ndim:
        raise InputError(argument, "one number", check.describe(value))
    return float(given)


def positive(argument: str, value: object) -> float:
    """One finite number > 0."""
    return check.positive_number(argument, value, InputError)


def per_channel(argument: str, value: object) -> float | tuple[float, ...]:
    """One finite number, or a tuple of them."""
    given = check.real_array(argument, value, InputError)
    if given.ndim > 1 or not given.size:
        raise InputError(argument, "one number, or one per channel", check.describe(value))
    return tuple(given.tolist()) if given.ndim else float(given)


def not_negative(argument: str, value: object) -> float | tuple[float, ...]:
    """One finite number >= 0, or a tuple of them."""
    given = per_channel(argument, value)
    if np.min(given) < 0:
        raise InputError(argument, "numbers >= 0", str(value))
    return given


def covariance(argument: str, value: object) -> tuple[tuple[float, ...], ...]:
    """A positive semidefinite matrix, as a tuple of its rows."""
    given = check.real_array(argument, value, InputError)
    if given.ndim != 2 or given.shape[0] != given.shape[1] or not given.size:
        raise InputError(argument, "a square matrix", check.describe(given))
    return tuple(tuple(row) for row in check.positive_semidefinite(argument, given, InputError).tolist())


def interval(argument: str, value: object) -> tuple[float, float]:
    """A pair (low, high) of finite numbers, low <= high."""
    given = check.real_array(argument, value, InputError)
    if given.shape != (2,) or given[0] > given[1]:
        raise InputError(argument, "a pair (low, high) with low <= high", repr(value))
    return float(given[0]), float(given[1])


def probability(argument: str, value: object) -> float:
    """One number in [0, 1]."""
    given = number(argument, value)
    if not 0 <= given <= 1:
        raise InputError(argument, "a probability in [0, 1]", repr(value))
    return given


def whole(argument: str, value: object, least: int) -> int:
    """A whole number >= least."""
    return check.whole_number(argument, value, least, InputError)


def choice(argument: str, value: object, allowed: Any) -> str:
    """One of the texts of a `Literal`."""
    options: Sequence[str] = get_args(allowed)
    if not isinstance(value, str) or value not in options:
        raise InputError(argument, " or ".join(repr(option) for option in options), repr(value))
    return value
