"""What to do so that an installation survives more liars: the fewest sensors to add, or to protect."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, final

import numpy as np

from securestate._checks import whole_number
from securestate._threads import one_blas_thread
from securestate._words import enumerate_names
from securestate.errors import InputError
from securestate.plant import Plant, Sensor
from securestate.resilience._protect import smallest_cover
from securestate.resilience._reinforce import fewest_changes
from securestate.resilience.eigenspaces import Array, Indices, Sight, sight
from securestate.resilience.limit import Limit, exposed
from securestate.resilience.margin import noise_scaled

Kind = Literal["copy", "measure", "protect", "add"]

#: What an engineer does, by kind.
_VERBS = {"copy": "duplicate", "measure": "measure", "protect": "protect", "add": "add"}


@final
@dataclass(frozen=True, eq=False)
class Option:
    """One way to survive more liars.

    Attributes:
        kind: "copy": a second sensor of the same kind at the same place; "measure": a new sensor of one
            state; "protect": nobody can tamper with it any more.
        items: names of sensors (copy, protect), of states (measure) or of what is added (add), and how often.
        fewest: whether it is proved that fewer of this kind do not do.
        plant: the plant with the change made. A copy has the noise of its original, a new sensor that of the
            present one that sees its state best.
    """

    kind: Kind
    items: tuple[tuple[str, int], ...]
    fewest: bool
    plant: Plant

    @property
    def total(self) -> int:
        """How many sensors are concerned."""
        return sum(times for _, times in self.items)

    def __str__(self) -> str:
        return self.told(len(self.items))

    def told(self, most: int) -> str:
        """What to do, with at most so many names."""
        named = [name if times == 1 else f"{name} {_often(times)}" for name, times in self.items]
        return f"{_VERBS[self.kind]} {enumerate_names(named, most)}"


def options(found: Limit, attacked: int, time_limit: float = 60.0) -> tuple[Option, ...]:
    """Ways to survive `attacked` liars over the modes of a limit, the one with fewest changes first.

    Args:
        found: the present limit.
        attacked: p, how many liars to survive.
        time_limit: seconds; kinds that are not settled by then are left out.

    Returns:
        At most one way of each kind, "add" only if it takes fewer than copies alone and new sensors alone;
        none if the limit is as high already or no such change can raise it.

    Raises:
        InputError: attacked is no whole number >= 0.
    """
    whole_number("attacked", attacked, 0, InputError)
    deadline = time.monotonic() + time_limit
    if found.unlimited or found.max_attacked >= attacked:
        return ()
    kinds: tuple[Kind, ...] = ("copy", "measure", "protect")
    with one_blas_thread():
        tried = {kind: _option(found, kind, attacked, (deadline - time.monotonic()) / 2) for kind in kinds}
        ways = [way for way in tried.values() if way is not None]
        alone = min((way.total for way in ways if way.kind != "protect"), default=2)
        both = None if alone < 2 else _option(found, "add", attacked, (deadline - time.monotonic()) / 2)
        if both is not None and both.total < alone:
            ways.append(both)
    return tuple(sorted(ways, key=lambda way: way.total))


def smallest_protection(found: Limit, time_limit: float = 30.0) -> tuple[tuple[str, ...], bool] | None:
    """The smallest set of sensors to protect, beside those that are, so that all others may lie.

    Returns:
        Their names and whether it is proved that no smaller set does; None if not even all sensors do.
    """
    sights = _open_sights(found, noise_scaled(found.plant), found.plant.channel_sensor, found.plant.n_sensors)
    if not sights:
        return (), True
    with one_blas_thread():
        cover = smallest_cover(sights, time_limit)
    if cover is None:
        return None
    names = tuple(found.plant.sensor_names[i] for i in cover.sensors)
    return names, cover.lower >= len(names)


def _option(found: Limit, kind: Kind, attacked: int, time_limit: float) -> Option | None:
    """The fewest changes of one kind; candidates are the N sensors and then, to be measured, the n states."""
    plant, goal = found.plant, 2 * attacked + 1
    n, N, X, owner = plant.n, plant.n_sensors, noise_scaled(plant), plant.channel_sensor
    free, states = ~plant.protected, np.zeros(0, dtype=bool)
    if kind in ("measure", "add"):
        X, owner = np.vstack([X, np.eye(n)]), np.concatenate([owner, np.arange(N, N + n)])
        states = np.ones(n, dtype=bool)
    weights = np.concatenate([free, 0 * states]).astype(np.float64)
    most = np.concatenate([free & (kind != "measure"), states]) * (1.0 if kind == "protect" else goal)
    gain = np.minimum(most, 1.0) * (goal if kind == "protect" else 1.0)
    change = fewest_changes(
        _open_sights(found, X, owner, len(weights)), weights, gain, most, goal, time_limit
    )
    if change is None or not change.times.any():
        return None
    after = _changed(plant, kind, change.times)
    return Option(kind, _items(plant, kind, change.times), change.lower >= change.times.sum(), after)


def _items(plant: Plant, kind: Kind, times: Indices) -> tuple[tuple[str, int], ...]:
    """What is changed by name, and how often."""
    states = plant.state_names
    if kind == "add":
        names = [f"second {name}" for name in plant.sensor_names] + [f"sensor of {name}" for name in states]
    else:
        names = [*plant.sensor_names, *states]
    return tuple((names[i], int(times[i])) for i in np.flatnonzero(times))


def _open_sights(found: Limit, X: Array, owner: Indices, sensors: int) -> list[Sight]:
    """What sensors that may lie see of what protected ones do not."""
    plant = found.plant
    protected = np.zeros(sensors, dtype=bool)
    protected[: plant.n_sensors] = plant.protected
    whole = [(mode.space, sight(mode.space, X, owner, sensors)) for mode in found.modes]
    return [
        left[1] for space, seen in whole if (left := exposed(space, seen, X, owner, protected)) is not None
    ]


def _changed(plant: Plant, kind: Kind, times: Indices) -> Plant:
    chosen = np.flatnonzero(times)
    if kind == "protect":
        return plant.with_protected(chosen.tolist())
    places = np.repeat(chosen, times[chosen]).tolist()
    extra = (_copy(plant, i) if i < plant.n_sensors else _gauge(plant, i - plant.n_sensors) for i in places)
    return plant.with_sensors(_distinct(extra, plant.sensor_names))


def _copy(plant: Plant, i: int) -> Sensor:
    own = plant.channels_of(i)
    sensor = plant.sensors[i]
    return sensor.replaced(
        name=f"{sensor.name} (copy)", R=plant.R[own, own], D=plant.D[own] if plant.n_inputs else None
    )


def _gauge(plant: Plant, state: int) -> Sensor:
    """A sensor of one state, as precise as the channel that sees it best, or as the state's own noise."""
    column, noise = plant.C[:, state], np.diag(plant.R)
    seen = np.flatnonzero(column)
    precise = noise[seen] / column[seen] ** 2 if len(seen) else np.array([plant.Q[state, state] or 1.0])
    return Sensor(f"{plant.state_names[state]} (new)", C=np.eye(plant.n)[state], R=float(precise.min()))


def _distinct(sensors: Iterable[Sensor], taken: Iterable[str]) -> list[Sensor]:
    """The sensors with names that nobody has: a second copy is numbered."""
    names, renamed = set(taken), []
    for sensor in sensors:
        name, k = sensor.name, 2
        while name in names:
            name, k = f"{sensor.name[:-1]} {k})", k + 1
        names.add(name)
        renamed.append(sensor if name == sensor.name else sensor.replaced(name=name))
    return renamed


def _often(times: int) -> str:
    return "twice" if times == 2 else f"{times} times"
