"""Which sensors an adversary controls, at every sample of every run."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from numbers import Integral
from typing import final

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from securestate.attacks._arguments import whole
from securestate.errors import InputError
from securestate.plant import Plant

Bool = NDArray[np.bool_]
Names = str | int | Sequence[str | int]


class Targets(ABC):
    """A rule that chooses the attacked sensors. Protected sensors are never chosen."""

    #: Whether the choice is random, so that it needs a generator per run.
    random: bool = True

    @abstractmethod
    def choose(self, plant: Plant, steps: int, rng: Generator | None, /) -> Bool:
        """The attacked sensors of one run, (steps, N).

        Raises:
            InputError: the plant lacks a sensor that is named, protects it, or has too few sensors.
        """


@final
@dataclass(frozen=True)
class Fixed(Targets):
    """The same named sensors (names, or indices from 0) at every sample of every run."""

    sensors: Names

    random = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensors", _names("sensors", self.sensors))

    def indices(self, plant: Plant) -> list[int]:
        """The sensors, counted from 0, in the order of the plant.

        Raises:
            InputError: the plant lacks a sensor that is named, or protects it.
        """
        return _indices("on", self.sensors, plant)

    def choose(self, plant: Plant, steps: int, _rng: Generator | None = None, /) -> Bool:
        """See `Targets.choose`; draws nothing."""
        chosen = np.zeros(plant.n_sensors, dtype=np.bool_)
        chosen[self.indices(plant)] = True
        return np.broadcast_to(chosen, (steps, plant.n_sensors))


@final
@dataclass(frozen=True)
class Cycle(Targets):
    """The given sets in turn, each for `every` samples, from sample 0 on; a set may be empty.

    Examples:
        >>> from securestate.plant import Sensor
        >>> plant = Plant([[1.0]], [[1.0]], [Sensor("a", C=[1.0], R=1.0), Sensor("b", C=[1.0], R=1.0)])
        >>> print(Cycle(["a", []], every=2).choose(plant, 5)[:, 0])
        [ True  True False False  True]
    """

    sets: Sequence[Names]
    every: int

    random = False

    def __post_init__(self) -> None:
        sets: object = self.sets
        if not isinstance(sets, list | tuple) or not sets:
            raise InputError("sets", "a list of sets of sensors", repr(sets))
        object.__setattr__(self, "sets", tuple(_names("sets", names, empty=True) for names in sets))
        object.__setattr__(self, "every", whole("every", self.every, 1))

    def choose(self, plant: Plant, steps: int, _rng: Generator | None = None, /) -> Bool:
        """See `Targets.choose`; draws nothing."""
        chosen = np.zeros((len(self.sets), plant.n_sensors), dtype=np.bool_)
        for row, names in zip(chosen, self.sets, strict=True):
            row[_indices("sets", names, plant)] = True
        return chosen[np.arange(steps) // self.every % len(self.sets)]


@dataclass(frozen=True)
class Random(Targets):
    """Sets that are drawn: `count` sensors, or a uniform number of them if it is a pair (low, high).

    `among` limits the choice to some sensors (names, or indices from 0); default: all that are not protected.
    """

    count: int | tuple[int, int]
    among: Names | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "count", _count(self.count))
        if self.among is not None:
            object.__setattr__(self, "among", _names("among", self.among))

    def _subsets(self, plant: Plant, rows: int, rng: Generator | None) -> Bool:
        """One subset per row, (rows, N): the sensors with the smallest of independent uniform numbers."""
        low, high = self.count if isinstance(self.count, tuple) else (self.count, self.count)
        pool = np.flatnonzero(~plant.protected)
        if self.among is not None:
            pool = np.array(_indices("among", self.among, plant), dtype=np.intp)
        if high > len(pool):
            raise InputError("count", f"at most {len(pool)}, the sensors there are to choose from", str(high))
        if rng is None:
            raise InputError("rng", "a numpy.random.Generator, because the sensors are drawn", "None")
        sizes = rng.integers(low, high + 1, rows)
        ranks = rng.random((rows, len(pool))).argsort(axis=1).argsort(axis=1)
        chosen = np.zeros((rows, plant.n_sensors), dtype=np.bool_)
        chosen[:, pool] = ranks < sizes[:, np.newaxis]
        return chosen


@final
@dataclass(frozen=True)
class Drawn(Random):
    """A set drawn once per run; `count` and `among` as for `Random`."""

    def choose(self, plant: Plant, steps: int, rng: Generator | None, /) -> Bool:
        """See `Targets.choose`."""
        return np.repeat(self._subsets(plant, 1, rng), steps, axis=0)


@final
@dataclass(frozen=True)
class Redrawn(Random):
    """A set drawn afresh at every sample; `count` and `among` as for `Random`.

    References:
        Zhu et al. 2022, dynamic attacks.
    """

    def choose(self, plant: Plant, steps: int, rng: Generator | None, /) -> Bool:
        """See `Targets.choose`."""
        return self._subsets(plant, steps, rng)


@final
@dataclass(frozen=True)
class Switching(Random):
    """A set drawn afresh every `every` samples; `count` and `among` as for `Random`."""

    every: int

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "every", whole("every", self.every, 1))

    def choose(self, plant: Plant, steps: int, rng: Generator | None, /) -> Bool:
        """See `Targets.choose`."""
        periods = -(-steps // self.every)
        return np.repeat(self._subsets(plant, periods, rng), self.every, axis=0)[:steps]


def as_targets(on: Targets | Names) -> Targets:
    """Return a rule; a name, an index or a list of them stands for `Fixed`.

    Raises:
        InputError: it is neither.
    """
    return on if isinstance(on, Targets) else Fixed(_names("on", on))


def _names(argument: str, given: object, *, empty: bool = False) -> tuple[str | int, ...]:
    """Names or indices, as a tuple."""
    names = (given,) if isinstance(given, str | Integral) else given
    if isinstance(names, Iterable):
        listed = tuple(names)
        named = all(isinstance(n, str | Integral) and not isinstance(n, bool) for n in listed)
        if named and (listed or empty):
            return tuple(n if isinstance(n, str) else int(n) for n in listed)
    raise InputError(argument, "sensor names, indices, or Targets such as Redrawn((1, 6))", repr(given))


def _indices(argument: str, names: Names, plant: Plant) -> list[int]:
    """Indices of the sensors named, in the order of the plant; refuses unknown and protected ones."""
    return sorted({_index(argument, name, plant) for name in _names(argument, names, empty=True)})


def _index(argument: str, name: str | int, plant: Plant) -> int:
    if isinstance(name, str):
        if name not in plant.sensor_names:
            raise InputError(argument, f"a sensor of the plant ({', '.join(plant.sensor_names)})", repr(name))
        name = plant.sensor_names.index(name)
    if not 0 <= name < plant.n_sensors:
        raise InputError(argument, f"an index in 0..{plant.n_sensors - 1}", str(name))
    if plant.protected[name]:
        raise InputError(argument, "sensors that are not protected", repr(plant.sensor_names[name]))
    return name


def _count(count: object) -> int | tuple[int, int]:
    """A whole number, or a pair (low, high) of them."""
    if not isinstance(count, tuple | list):
        return whole("count", count, 0)
    if len(count) != 2:
        raise InputError("count", "a whole number >= 0, or a pair (low, high) of them", repr(count))
    low = whole("count", count[0], 0)
    return low, whole("count", count[1], low)
