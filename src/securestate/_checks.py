"""Checks of what a caller hands over. Each returns clean data or raises naming argument, expected, received.

Every check takes the argument's name and the exception to raise, so that one rule serves plants and beliefs.
"""

from collections.abc import Iterable, Sequence
from numbers import Integral

import numpy as np
from numpy.typing import NDArray

from securestate.errors import InputError

Array = NDArray[np.float64]
Error = type[InputError]

SYMMETRY = 1e-12  # relative asymmetry that is taken for rounding and averaged away


def describe(value: object) -> str:
    """Say briefly what came: the shape of an array, or the type and value of anything else."""
    if isinstance(value, np.ndarray) and value.ndim:
        return f"shape {value.shape}"
    text = repr(value)
    return f"{text if len(text) <= 60 else text[:57] + '...'} ({type(value).__name__})"


def real_array(argument: str, value: object, error: Error) -> Array:
    """Return finite real numbers as float64; booleans, text, complex numbers and ragged lists are refused."""
    if np.ma.isMaskedArray(value):
        raise error(argument, "an array without a mask", "a masked array")
    try:
        raw = np.asarray(value)
    except (ValueError, TypeError, OverflowError, RecursionError, RuntimeError) as reason:
        raise error(argument, "an array of real numbers", f"{type(value).__name__} ({reason})") from None
    if raw.dtype.kind not in "iuf":
        raise error(argument, "an array of real numbers", _wrong_kind(raw, value))
    with np.errstate(over="ignore"):
        numbers = raw.astype(np.float64)
    finite = np.isfinite(numbers)
    if not finite.all():
        where = tuple(int(i) for i in np.argwhere(~finite)[0])
        raise error(
            argument, "finite numbers", f"{numbers[where]} at {list(where)}" if where else str(numbers)
        )
    return numbers


def _wrong_kind(raw: NDArray[np.generic], value: object) -> str:
    kinds = {
        "b": "booleans",
        "c": "complex numbers",
        "U": "text",
        "S": "bytes",
        "M": "dates",
        "m": "durations",
    }
    return kinds.get(raw.dtype.kind, describe(value))


def shaped(argument: str, value: object, shape: tuple[int, ...], meaning: str, error: Error) -> Array:
    """Return finite real numbers of exactly this shape."""
    numbers = real_array(argument, value, error)
    if numbers.shape != shape:
        raise error(argument, f"shape {shape}{meaning}", f"shape {numbers.shape}")
    return numbers


def per_item(argument: str, value: object, count: int, what: str, error: Error) -> Array:
    """Return one number per item; a single number stands for all."""
    numbers = real_array(argument, value, error)
    if numbers.shape not in ((), (count,)):
        raise error(argument, f"one number or {count}, one per {what}", f"shape {numbers.shape}")
    return np.broadcast_to(numbers, (count,)).copy()


def positive_per_item(argument: str, value: object, count: int, what: str, error: Error) -> Array:
    """Return one number > 0 per item."""
    numbers = per_item(argument, value, count, what, error)
    if not np.all(numbers > 0):
        raise error(argument, "numbers > 0", str(numbers[numbers <= 0][0]))
    return numbers


def positive_number(argument: str, value: object, error: Error) -> float:
    """Return one finite number > 0."""
    number = real_array(argument, value, error)
    if number.ndim or number <= 0:
        raise error(argument, "one number > 0", describe(value))
    return float(number)


def symmetric(argument: str, matrix: Array, error: Error) -> Array:
    """Average away rounding up to `SYMMETRY` relative to the largest entry; refuse anything larger."""
    with np.errstate(over="ignore"):
        gap = np.abs(matrix - matrix.T)
    if np.any(gap > SYMMETRY * np.max(np.abs(matrix), initial=0.0)):
        i, j = sorted(int(k) for k in np.unravel_index(int(np.argmax(gap)), gap.shape))
        raise error(
            argument,
            "a symmetric matrix",
            f"{float(matrix[i, j])!r} at [{i}, {j}] but {float(matrix[j, i])!r} at [{j}, {i}]",
        )
    return matrix if not np.any(gap) else matrix / 2 + matrix.T / 2


def positive_semidefinite(argument: str, matrix: Array, error: Error) -> Array:
    """Return a symmetric matrix with no eigenvalue below zero, rounding aside (10 n eps of the largest)."""
    clean = symmetric(argument, matrix, error)
    size = np.max(np.abs(clean), initial=0.0)
    if size == 0:
        return clean
    values = np.linalg.eigvalsh(clean / size)
    if values[0] < -10 * len(clean) * np.finfo(np.float64).eps * values[-1]:
        raise error(argument, "a positive semidefinite matrix", f"smallest eigenvalue {values[0] * size:.3g}")
    return clean


def positive_definite(argument: str, matrix: Array, error: Error) -> Array:
    """Return a symmetric positive definite matrix; judged free of units, on its correlation matrix."""
    variances = np.diag(matrix)
    if np.any(variances <= 0):
        i = int(np.argmax(variances <= 0))
        raise error(argument, "variances > 0 on the diagonal", f"{float(variances[i])!r} at [{i}, {i}]")
    spread = np.sqrt(variances)
    with np.errstate(over="ignore"):
        unitless = matrix / spread[:, None] / spread
    if np.any(np.abs(unitless) > 1 + SYMMETRY):
        raise error(argument, "a positive definite matrix", "a correlation outside -1..1")
    smallest = np.linalg.eigvalsh(symmetric(argument, unitless, error))[0]
    if smallest <= 10 * len(matrix) * np.finfo(np.float64).eps:
        raise error(
            argument, "a positive definite matrix", f"correlations with smallest eigenvalue {smallest:.3g}"
        )
    return matrix if np.array_equal(matrix, matrix.T) else matrix / 2 + matrix.T / 2


def covariance(argument: str, value: object, size: int, what: str, error: Error) -> Array:
    """Return a positive definite (size, size) matrix from one variance, variances or the matrix itself."""
    numbers = real_array(argument, value, error)
    if numbers.shape in ((), (size,)):
        numbers = np.diag(np.broadcast_to(numbers, (size,)))
    if numbers.shape != (size, size):
        raise error(argument, f"shape (), ({size},) or ({size}, {size}), {what}", f"shape {numbers.shape}")
    return positive_definite(argument, numbers, error)


def whole_number(argument: str, value: object, least: int, error: Error) -> int:
    """Return a whole number >= least; True and False are refused."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise error(argument, f"a whole number >= {least}", describe(value))
    return int(value)


def label(argument: str, value: object, error: Error, *, empty: bool = False) -> str:
    """Return a name: printable text without blanks at its ends."""
    if not isinstance(value, str):
        raise error(argument, "text", describe(value))
    if not value and not empty:
        raise error(argument, "text that is not empty", "''")
    if value != value.strip() or not value.isprintable():
        raise error(argument, "printable text without blanks at its ends", describe(str(value)))
    return str(value)


def labels(
    argument: str, values: object, count: int | None, error: Error, *, empty: bool = False
) -> tuple[str, ...]:
    """Return names, `count` of them where a count is known."""
    if isinstance(values, str | bytes) or not isinstance(values, Iterable):
        raise error(argument, "a list of text", describe(values))
    names = tuple(label(f"{argument}[{i}]", name, error, empty=empty) for i, name in enumerate(values))
    if count is not None and len(names) != count:
        raise error(argument, f"{count} names", f"{len(names)}")
    return names


def distinct(argument: str, names: Sequence[str], error: Error) -> None:
    """Refuse a name that occurs twice."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise error(argument, "names that differ", f"{name!r} twice")
        seen.add(name)


def yes_or_no(argument: str, value: object, error: Error) -> bool:
    """Return True or False; numbers are refused."""
    if not isinstance(value, bool | np.bool_):
        raise error(argument, "True or False", describe(value))
    return bool(value)
