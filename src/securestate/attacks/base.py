"""What every adversary is: sensors, times, what it knows, and the signal it adds.

An adversary's type says what it knows, and its method receives nothing else:

* `SensorAttack`: the clean readings of the sensors it controls, from the first sample on, and their noise.
* `PlantAttack`: also the plant and its inputs.
* `OmniscientAttack`: also the true state, the measurement noise and the readings of all sensors.
* `ClosedLoopAttack`: also what the defender's filter expects at every sample, while it happens.

Adversaries add up: `a + b` injects the sum of what each would inject alone into the clean readings. A reading
that one of them suppresses (NaN) is missing whatever the others add.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Generic, TypeVar, final

import numpy as np
from numpy.random import Generator

from securestate._checks import describe
from securestate.attacks._arguments import whole
from securestate.attacks.knowledge import (
    Bool,
    Everything,
    Float,
    Knowledge,
    OwnSensors,
    PlantKnowledge,
    Scene,
)
from securestate.attacks.targets import Names, Targets, as_targets
from securestate.errors import InputError

View = TypeVar("View", bound="OwnSensors")


@dataclass(frozen=True, eq=False)
class Reaction:
    """A closed-loop adversary at work: what it injects at a sample, given what the defender expects there."""

    attack: ClosedLoopAttack
    view: Everything

    def __call__(self, k: int, expected: Float) -> Float:
        """The injection at sample k, (runs, m), sensor units; zero where not attacked.

        `expected` is offset + scale (C x[k|k-1] + D ut[k]), (runs, m), sensor units.
        """
        wanted = _checked(self.attack, self.attack.react(self.view, k, expected), expected.shape)
        return np.where(self.view.attacked[:, k, self.view.channel_sensor], wanted, 0.0)

    @property
    def gain(self) -> Float | None:
        """The factor in a = gain (y - expected) of an adversary like that, (runs, T, m); None of others."""
        if not isinstance(self.attack, ProportionalAttack):
            return None
        return np.where(self.view.attacked[..., self.view.channel_sensor], self.attack.gain, 0.0)


@dataclass(frozen=True, eq=False)
class Injection:
    """What adversaries do to clean trajectories.

    Attributes:
        a: sum of the injections known in advance, (runs, T, m), sensor units; NaN suppresses the reading.
        attacked: sensors under attack, (runs, T, N).
        reactions: injections that depend on the defender.
    """

    a: Float
    attacked: Bool
    reactions: tuple[Reaction, ...]


class Attack(ABC):
    """Base of all adversaries, single ones and sums."""

    @property
    @abstractmethod
    def parts(self) -> tuple[SingleAttack, ...]:
        """The single adversaries."""

    def __add__(self, other: Attack) -> Combination:
        """Both at once: their injections add up."""
        if not isinstance(other, Attack):
            return NotImplemented
        return Combination(self.parts + other.parts)

    @final
    def stage(self, scene: Scene) -> Injection:
        """Work out the injections into clean trajectories.

        Raises:
            InputError: a sensor that the plant lacks or protects, a size that does not fit its channels.
            DesignError: the plant does not allow this adversary; says why.
        """
        a = np.zeros_like(scene.y)
        attacked = np.zeros((*scene.y.shape[:2], scene.plant.n_sensors), dtype=np.bool_)
        reactions: list[Reaction] = []
        for number, part in enumerate(self.parts):
            own = part.act(scene, number)
            a += own.a
            attacked |= own.attacked
            reactions += own.reactions
        return Injection(a, attacked, tuple(reactions))


@final
@dataclass(frozen=True)
class Combination(Attack):
    """The sum of several adversaries; made by `+`."""

    members: tuple[SingleAttack, ...]

    @property
    def parts(self) -> tuple[SingleAttack, ...]:
        """The single adversaries."""
        return self.members


@dataclass(frozen=True, kw_only=True)
class SingleAttack(Attack):
    """One adversary.

    Args:
        on: which sensors: a name, an index from 0, a list of them, or `Targets` that are drawn.
        start: first sample under attack; 0 is the very first one.
        stop: first sample no longer under attack; None: to the end.
    """

    on: Targets | Names
    start: int = 0
    stop: int | None = None

    #: What this kind of adversary knows.
    knows: ClassVar[Knowledge]

    def __post_init__(self) -> None:
        start = whole("start", self.start, 0)
        stop = None if self.stop is None else whole("stop", self.stop, start + 1)
        self._keep(on=as_targets(self.on), start=start, stop=stop)

    def _keep(self, **checked: object) -> None:
        """Store checked fields; only while the object is made."""
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @property
    def parts(self) -> tuple[SingleAttack, ...]:
        """The single adversaries: this one."""
        return (self,)

    @abstractmethod
    def act(self, scene: Scene, number: int) -> Injection:
        """The injection of this adversary, the `number`-th of a sum."""


@dataclass(frozen=True, kw_only=True)
class OpenLoopAttack(SingleAttack, Generic[View]):
    """An adversary whose injection does not depend on the defender."""

    @abstractmethod
    def look(self, scene: Scene, own: OwnSensors, /) -> View:
        """What this kind of adversary knows of the scene."""

    @abstractmethod
    def inject(self, view: View) -> Float:
        """Injection at every sample, of a shape that broadcasts to (runs, T, m), sensor units.

        Entries where a sensor is not attacked are ignored; NaN suppresses the reading.
        """

    @final
    def act(self, scene: Scene, number: int) -> Injection:
        """See `SingleAttack.act`."""
        own = own_sensors(self, scene, number)
        signal = _checked(self, self.inject(self.look(scene, own)), own.shape)
        return Injection(np.where(own.attacked[..., own.channel_sensor], signal, 0.0), own.attacked, ())


@dataclass(frozen=True, kw_only=True)
class SensorAttack(OpenLoopAttack[OwnSensors]):
    """An adversary that knows its own sensors."""

    knows = Knowledge.OWN_SENSORS

    @final
    def look(self, _scene: Scene, own: OwnSensors, /) -> OwnSensors:
        """Its own sensors."""
        return own


@dataclass(frozen=True, kw_only=True)
class PlantAttack(OpenLoopAttack[PlantKnowledge]):
    """An adversary that knows the plant and its own sensors."""

    knows = Knowledge.PLANT

    @final
    def look(self, scene: Scene, own: OwnSensors, /) -> PlantKnowledge:
        """Its own sensors and the plant."""
        return PlantKnowledge(**vars(own), plant=scene.plant, u=scene.u)


@dataclass(frozen=True, kw_only=True)
class OmniscientAttack(OpenLoopAttack[Everything]):
    """An adversary that knows the plant, the state and the noise."""

    knows = Knowledge.EVERYTHING

    @final
    def look(self, scene: Scene, own: OwnSensors, /) -> Everything:
        """The whole scene."""
        return everything(scene, own)


@dataclass(frozen=True, kw_only=True)
class ClosedLoopAttack(SingleAttack):
    """An adversary that also knows, at every sample, what the defender expects its sensors to send."""

    knows = Knowledge.DEFENDER

    @abstractmethod
    def react(self, view: Everything, k: int, expected: Float) -> Float:
        """Injection at sample k, (runs, m), sensor units; `expected` as for `Reaction`."""

    @final
    def act(self, scene: Scene, number: int) -> Injection:
        """See `SingleAttack.act`."""
        own = own_sensors(self, scene, number)
        return Injection(np.zeros(own.shape), own.attacked, (Reaction(self, everything(scene, own)),))


@dataclass(frozen=True, kw_only=True)
class ProportionalAttack(ClosedLoopAttack):
    """A closed-loop adversary that answers in proportion: a = gain (y - expected), y the clean reading.

    The loop over time then runs in the kernels.
    """

    #: Factor of the difference.
    gain: ClassVar[float]

    @final
    def react(self, view: Everything, k: int, expected: Float) -> Float:
        """See `ClosedLoopAttack.react`."""
        return self.gain * (view.y[:, k] - expected)


def _checked(attack: SingleAttack, signal: Float, shape: tuple[int, ...]) -> Float:
    """An injection that fits and has no infinite number.

    Raises:
        InputError: names the adversary.
    """
    name = f"injection of {type(attack).__name__}"
    try:
        fitting = np.broadcast_to(np.asarray(signal, dtype=np.float64), shape)
    except (TypeError, ValueError):
        raise InputError(name, f"numbers of shape {shape}", describe(signal)) from None
    if np.isinf(fitting).any():
        raise InputError(name, "finite numbers, or NaN to suppress a reading", "an infinite one")
    return fitting


def own_sensors(attack: SingleAttack, scene: Scene, number: int) -> OwnSensors:
    """What the sensors that an adversary controls tell it."""
    plant, steps = scene.plant, scene.y.shape[1]
    rngs = cache(lambda: scene.rngs(number))
    stop = steps if attack.stop is None else min(attack.stop, steps)
    attacked = _attacked(attack, scene, stop, rngs)
    ever = np.asarray(attacked.any(axis=1))[:, plant.channel_sensor]
    return OwnSensors(
        y=np.where(ever[:, np.newaxis], scene.y, np.nan),
        attacked=attacked,
        start=attack.start,
        stop=stop,
        noise=plant.scale * np.sqrt(np.diag(plant.R)),
        channel_sensor=plant.channel_sensor,
        rngs=rngs,
    )


def _attacked(attack: SingleAttack, scene: Scene, stop: int, rngs: Callable[[], Sequence[Generator]]) -> Bool:
    """The sensors under attack, (runs, T, N)."""
    targets, (runs, steps, _) = as_targets(attack.on), scene.y.shape
    attacked = np.zeros((runs, steps, scene.plant.n_sensors), dtype=np.bool_)
    drawn = rngs() if targets.random else (None,)
    chosen = np.stack([targets.choose(scene.plant, steps, rng) for rng in drawn])
    attacked[:, attack.start : stop] = chosen[:, attack.start : stop]
    return attacked


def everything(scene: Scene, own: OwnSensors) -> Everything:
    """The whole scene, for the adversary with these sensors."""
    return Everything(**vars(own), plant=scene.plant, u=scene.u, x=scene.x, v=scene.v, all_y=scene.y)
