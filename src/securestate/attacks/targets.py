"""Which sensors an adversary controls, at every sample of every run."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from securestate.errors import InputError
from securestate.plant import Plant

Bool = NDArray[np.bool_]
Names = str | int | Sequence[str | int]


class Targets(ABC):
    """A rule that chooses the attacked sensors. Protected sensors are never chosen."""

    #: Whether the choice is random, so that it needs a generator per run.
    random: bool = True

    @abstractmethod
    def choose(self, plant: Plant, steps: int, rng: Generator | None) -> Bool:
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

    def choose(self, plant: Plant, steps: int, rng: Generator | None = None) -> Bool:
        """See `Targets.choose`; draws nothing."""
        chosen = np.zeros(plant.n_sensors, dtype=np.bool_)
        chosen[_indices("on", self.sensors, plant)] = True
        return np.broadcast_to(chosen, (steps, plant.n_sensors))


@final
@dataclass(frozen=True)
class Drawn(Targets):
    """A set drawn once per run: `count` sensors, or a uniform number of them if it is a pair (low, high).

    `among` limits the choice to some sensors (names, or indices from 0); default: all that are not protected.
    """

    count: int | tuple[int, int]
    among: Names | None = None

    def __post_init__(self) -> None:
        _check_count(self.count)

    def choose(self, plant: Plant, steps: int, rng: Generator | None) -> Bool:
        """See `Targets.choose`."""
        return np.repeat(_subsets(self, plant, 1, rng), steps, axis=0)


@final
@dataclass(frozen=True)
class Redrawn(Targets):
    """A set drawn afresh at every sample, as in Zhu et al. 2022; `count` and `among` as for `Drawn`."""

    count: int | tuple[int, int]
    among: Names | None = None

    def __post_init__(self) -> None:
        _check_count(self.count)

    def choose(self, plant: Plant, steps: int, rng: Generator | None) -> Bool:
        """See `Targets.choose`."""
        return _subsets(self, plant, steps, rng)


@final
@dataclass(frozen=True)
class Switching(Targets):
    """A set drawn afresh every `every` samples; `count` and `among` as for `Drawn`."""

    count: int | tuple[int, int]
    every: int
    among: Names | None = None

    def __post_init__(self) -> None:
        _check_count(self.count)
        if isinstance(self.every, bool) or not isinstance(self.every, int) or self.every < 1:
            raise InputError("every", "a whole number of samples >= 1", repr(self.every))

    def choose(self, plant: Plant, steps: int, rng: Generator | None) -> Bool:
        """See `Targets.choose`."""
        periods = -(-steps // self.every)
        return np.repeat(_subsets(self, plant, periods, rng), self.every, axis=0)[:steps]


def as_targets(on: Targets | Names) -> Targets:
    """Return a rule; a name, an index or a list of them stands for `Fixed`.

    Raises:
        InputError: it is neither.
    """
    if isinstance(on, Targets):
        return on
    if isinstance(on, str) or (isinstance(on, int) and not isinstance(on, bool)):
        return Fixed((on,))
    if isinstance(on, Iterable):
        names = tuple(on)
        if names and all(isinstance(n, str | int) and not isinstance(n, bool) for n in names):
            return Fixed(names)
    raise InputError("on", "sensor names, indices, or Targets such as Redrawn((1, 6))", repr(on))


def _subsets(rule: Drawn | Redrawn | Switching, plant: Plant, rows: int, rng: Generator | None) -> Bool:
    """One random subset per row, (rows, N): the sensors with the smallest of independent uniform numbers."""
    low, high = rule.count if isinstance(rule.count, tuple) else (rule.count, rule.count)
    pool = _pool(rule.among, plant)
    if high > len(pool):
        raise InputError("count", f"at most {len(pool)}, the sensors there are to choose from", str(high))
    if rng is None:
        raise InputError("rng", "a numpy.random.Generator, because the sensors are drawn", "None")
    sizes = rng.integers(low, high + 1, rows)
    ranks = rng.random((rows, len(pool))).argsort(axis=1).argsort(axis=1)
    chosen = np.zeros((rows, plant.n_sensors), dtype=np.bool_)
    chosen[:, pool] = ranks < sizes[:, np.newaxis]
    return chosen


def _pool(among: Names | None, plant: Plant) -> NDArray[np.intp]:
    if among is None:
        return np.flatnonzero(~plant.protected)
    return np.array(sorted(set(_indices("among", among, plant))), dtype=np.intp)


def _indices(argument: str, names: Names, plant: Plant) -> list[int]:
    """Indices of the sensors named; refuses unknown and protected ones."""
    wanted = (names,) if isinstance(names, str | int) else tuple(names)
    found = []
    for name in wanted:
        if isinstance(name, str):
            if name not in plant.sensor_names:
                raise InputError(
                    argument, f"a sensor of the plant ({', '.join(plant.sensor_names)})", repr(name)
                )
            name = plant.sensor_names.index(name)
        if not 0 <= name < plant.n_sensors:
            raise InputError(argument, f"an index in 0..{plant.n_sensors - 1}", str(name))
        if plant.protected[name]:
            raise InputError(argument, "sensors that are not protected", repr(plant.sensor_names[name]))
        found.append(int(name))
    return found


def _check_count(count: object) -> None:
    low, high = count if isinstance(count, tuple) and len(count) == 2 else (count, count)
    whole = all(isinstance(c, int) and not isinstance(c, bool) for c in (low, high))
    if not whole or not 0 <= low <= high:  # type: ignore[operator]
        raise InputError("count", "a whole number >= 0, or a pair (low, high) of them", repr(count))
