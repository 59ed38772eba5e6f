"""A lie that mirrors a reading about what is expected of it: attack (26) of Zhu et al."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, final

import numpy as np
from numpy.typing import NDArray

from securestate._local_filters import LocalFilter, local_filters
from securestate.attacks._arguments import choice
from securestate.attacks.base import PlantAttack, ProportionalAttack
from securestate.attacks.knowledge import Float, PlantKnowledge

About = Literal["local", "clean-local"]

#: Largest innovation, in standard deviations of the noise, and largest state of a filter that diverges.
LARGEST, LARGEST_STATE = 1e100, 1e200


@final
@dataclass(frozen=True)
class Reflection(PlantAttack):
    """a = -2 (y - what the sensor's own filter expects), so that its innovation changes sign.

    Each sensor runs its own steady-state Kalman filter on the part of the state that it sees. It starts at
    the operating point at sample 0 and knows the inputs.

    Args:
        about: "local": the filter takes in what the sensor sends, so its own lies drive it. "clean-local": it
            goes on with the clean readings.
        on, start, stop: as for `SingleAttack`.

    Raises:
        InputError: `about` is neither.
        DesignError: when staged: the plant varies in time, or a sensor has no filter of its own.

    Notes:
        With "local" and the same sensors all the time the filter's error is multiplied by A (I + K C) at
        every sample; where that is unstable the lie grows without bound. It is held at 1e100 standard
        deviations of the noise, so that all numbers stay finite.

    References:
        Zhu et al. 2022, (26): "local". On a fixed set of sensors the two others are the ones to use.

    Examples:
        >>> Reflection("clean-local", on=[0, 3], start=30)
        Reflection(on=Fixed(sensors=(0, 3)), start=30, stop=None, about='clean-local')
    """

    about: About = "local"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._keep(about=choice("about", self.about, About))

    def inject(self, view: PlantKnowledge) -> Float:
        """See `OpenLoopAttack.inject`."""
        plant, innovation = view.plant, np.zeros(view.shape)
        y, u = plant.normalise(view.y), plant.normalise_input(view.u)
        used = np.flatnonzero(view.attacked.any(axis=(0, 1))).tolist()
        for sensors, filters in _alike(used, local_filters(plant, used)):
            channels = np.array([np.arange(plant.m)[plant.channels_of(i)] for i in sensors])
            lies = view.attacked[..., sensors] & (self.about == "local")
            limit = LARGEST * np.sqrt(np.diag(plant.R))[channels]
            own = y[..., channels], u, lies, limit[..., np.newaxis]
            innovation[:, : view.stop, channels] = _innovations(filters, *own, view.stop)
        return -2.0 * plant.scale * innovation


@final
@dataclass(frozen=True)
class DefenderReflection(ProportionalAttack):
    """a = -2 (y - what the defender's filter expects), at every sample while it happens.

    Args:
        on, start, stop: as for `SingleAttack`.

    References:
        After Zhu et al. 2022, (26), with the defender's prediction in place of the sensor's own.

    Examples:
        >>> DefenderReflection(on=[0, 3], start=30).knows
        <Knowledge.DEFENDER: 'everything, and what the defender expects'>
    """

    gain = -2.0


def _alike(
    sensors: list[int], filters: tuple[LocalFilter, ...]
) -> list[tuple[list[int], tuple[LocalFilter, ...]]]:
    """Sensors and filters in groups of equal sizes, so that a group advances in one product."""
    groups: dict[tuple[int, ...], list[int]] = {}
    for place, each in enumerate(filters):
        groups.setdefault(each.C.shape, []).append(place)
    return [
        ([sensors[place] for place in group], tuple(filters[place] for place in group))
        for group in groups.values()
    ]


def _innovations(
    filters: tuple[LocalFilter, ...],
    y: Float,
    u: Float,
    lies: NDArray[np.bool_],
    limit: Float,
    steps: int,
) -> Float:
    """Innovations y - C z - D u of G filters with c channels each, (runs, steps, G, c), normalised units.

        z[k+1] = A (z[k] + K e[k]) + B u[k],   e of the opposite sign where the sensor sends the mirror image

    Args:
        y: clean readings, (runs, T, G, c). u: inputs, (runs, T, p). lies: (runs, T, G). limit: (G, c, 1).
    """
    A, B, C, D, K = (np.stack([getattr(f, name) for f in filters]) for name in ("A", "B", "C", "D", "gain"))
    y, ut = np.nan_to_num(np.ascontiguousarray(y.transpose(1, 2, 3, 0))), u.transpose(1, 2, 0)
    sign = np.where(lies, -1.0, 1.0).transpose(1, 2, 0)[:, :, np.newaxis]
    e, z = np.empty((steps, *y.shape[1:])), np.zeros((len(filters), A.shape[1], y.shape[3]))
    for k in range(steps):
        e[k] = np.clip(y[k] - _product(C, z) - _product(D, ut[k : k + 1]), -limit, limit)
        z = _product(A, z + _product(K, sign[k] * e[k])) + _product(B, ut[k : k + 1])
        np.clip(z, -LARGEST_STATE, LARGEST_STATE, out=z)
    return e.transpose(3, 0, 1, 2)


def _product(M: Float, z: Float) -> Float:
    """M z for (G, a, b) and (G, b, runs); column by column, so that a run has the same bits in any batch."""
    total = np.zeros((len(M), M.shape[1], z.shape[2]))
    for j in range(M.shape[2]):
        total += M[:, :, j : j + 1] * z[:, j : j + 1]
    return total
