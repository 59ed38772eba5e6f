"""Immutable values: attributes set once, compared by content, never hashed."""

from typing import Any, ClassVar, NoReturn, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", bound=np.generic)


def freeze(array: NDArray[Scalar]) -> NDArray[Scalar]:
    """Return a read-only, C-contiguous copy of an array."""
    copy = np.array(array, order="C", copy=True)
    copy.setflags(write=False)
    return copy


class Value:
    """Base of the immutable nouns: frozen attributes, ``==`` by content, copied and pickled whole."""

    _not_compared: ClassVar[frozenset[str]] = frozenset()

    def _fill(self, **attributes: object) -> None:
        """Set every attribute, once; arrays become read-only copies."""
        for name, value in attributes.items():
            kept = freeze(value) if isinstance(value, np.ndarray) else value
            object.__setattr__(self, name, kept)

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"{type(self).__name__} is immutable: make a new one to change {name!r}")

    def __delattr__(self, name: str) -> NoReturn:
        raise AttributeError(f"{type(self).__name__} is immutable: {name!r} cannot be deleted")

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        mine, theirs = self._content(), other._content()
        return all(_same(value, theirs[name]) for name, value in mine.items())

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (type(self), dict(vars(self)))

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        return self

    def _content(self) -> dict[str, object]:
        return {name: value for name, value in vars(self).items() if name not in self._not_compared}


def _same(first: object, second: object) -> bool:
    if isinstance(first, np.ndarray) and isinstance(second, np.ndarray):
        return np.array_equal(first, second, equal_nan=first.dtype.kind == "f")
    return type(first) is type(second) and first == second


def _rebuild(kind: type[Value], attributes: dict[str, object]) -> Value:
    value = kind.__new__(kind)
    value._fill(**attributes)
    return value
