"""The margin of an estimator that explains readings by as little lying as possible.

Such an estimator minimises a sum of penalties, one per sensor. If the honest sensors together object to a
direction u more than the liars can gain by it, no lie of any size moves the estimate far:

    rho = max over u != 0 of  sum over attacked i of |G_i u|  /  sum over the others of |G_i u|   < 1.

Above 1 a lie that follows the worst u moves the estimate in proportion to its size.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, final

import numpy as np

from securestate._checks import whole_number
from securestate._threads import one_blas_thread
from securestate.errors import InputError
from securestate.plant import Plant
from securestate.resilience._share import Attacked, Norms, Share, largest_share
from securestate.resilience.eigenspaces import Array
from securestate.resilience.lie import Lie, lie_along
from securestate.resilience.margin import noise_scaled

#: A direction whose penalties are below this share of the largest is one that no sensor objects to.
UNSEEN = 1e-9


@final
@dataclass(frozen=True, eq=False)
class Penalties:
    """What an estimator makes sensors pay for a direction u of the modes without a prior.

    Attributes:
        blocks: H_b, (r_b, d); sensor i pays the sum of ||H_b u||_2 over its blocks.
        owner: the sensor of every block.
        V: (n, d), the state moves by V u.
    """

    blocks: tuple[Array, ...]
    owner: tuple[int, ...]
    V: Array


@final
@dataclass(frozen=True, eq=False)
class FusionMargin:
    """Whether the estimate stays bounded whatever some sensors inject.

    Attributes:
        attacked: how many sensors lie.
        lower, upper: bounds of rho, >= 0, `inf` if nobody honest objects.
        sensors: the worst set found, by name.
        lie: what they should say; None if no mode needs a prior and nothing moves without bound.
        factor: a second bound of rho from above, by a factorisation instead of a search: below 1 it proves
            "secure" independently.
    """

    attacked: int
    lower: float
    upper: float
    sensors: tuple[str, ...]
    lie: Lie | None
    factor: float = 0.0

    @property
    def verdict(self) -> Literal["secure", "insecure", "undecided"]:
        """secure: rho < 1 for certain; insecure: `lie` breaks it; undecided: the bounds enclose 1."""
        return "secure" if self.upper < 1 else "insecure" if self.lower >= 1 else "undecided"

    def __str__(self) -> str:
        exact = self.upper - self.lower <= 2e-3 * max(1.0, self.lower) or np.isinf(self.lower)
        value = f"{self.lower:.3g}" if exact else f"{self.lower:.3g} to {self.upper:.3g}"
        return f"{self.verdict} against {self.attacked} (rho {value})"


def fusion_margin(
    plant: Plant,
    penalties: Penalties,
    attacked: int | Iterable[str],
    *,
    gap: float = 1e-3,
    time_limit: float = 60.0,
    decide: bool = False,
) -> FusionMargin:
    """Bounds of rho for any `attacked` unprotected sensors, or for the named ones.

    Args:
        plant: whose sensors they are.
        penalties: of the estimator.
        attacked: how many sensors lie, or the names of those that do.
        gap: relative error of rho at which the exact search stops.
        time_limit: seconds; after that the bounds are what they are.
        decide: stop as soon as it is known whether rho < 1.

    Raises:
        InputError: attacked is no whole number >= 0 and no names of sensors.
    """
    with one_blas_thread():
        return _margin(plant, penalties, _attacked(plant, attacked), gap, time_limit, decide)


def _margin(
    plant: Plant, penalties: Penalties, who: Attacked, gap: float, time_limit: float, decide: bool
) -> FusionMargin:
    if not penalties.V.shape[1] or who.count == 0:
        return FusionMargin(who.count, 0.0, 0.0, (), None)
    X = noise_scaled(plant)
    free, costly = _by_cost(penalties, X @ penalties.V)
    share = _gratis(plant, X @ penalties.V @ free, free, who)
    if share is None:
        blocks = tuple(block @ costly for block in penalties.blocks)
        norms = Norms.of(blocks, penalties.owner, plant.n_sensors)
        inner = largest_share(norms, who, gap=gap, time_limit=time_limit, decide=decide)
        share = Share(inner.lower, inner.upper, costly @ inner.direction, inner.sensors, inner.factor)
    sensors = tuple(int(i) for i in share.sensors)
    lie = lie_along(plant, X, sensors, penalties.V @ share.direction, penalties.V)
    rho = [_rho(kappa) for kappa in (share.lower, share.upper, share.factor)]
    return FusionMargin(who.count, rho[0], rho[1], lie.sensors, lie, rho[2])


def _attacked(plant: Plant, attacked: int | Iterable[str]) -> Attacked:
    if isinstance(attacked, (int, np.integer)):
        count = whole_number("attacked", attacked, 0, InputError)
        return Attacked(~plant.protected, min(count, int((~plant.protected).sum())))
    names = (attacked,) if isinstance(attacked, str) else tuple(attacked)
    for name in names:
        if name not in plant.sensor_names:
            raise InputError("attacked", "names of sensors of the plant, or how many lie", repr(name))
    return Attacked.exactly([plant.sensor_names.index(name) for name in names], plant.n_sensors)


def _by_cost(penalties: Penalties, seen: Array) -> tuple[Array, Array]:
    """Directions that cost no sensor anything, and the others, as columns.

    Args:
        seen: what the channels see of V, (m, d), in standard deviations: the measure of what is nothing.
    """
    d = penalties.V.shape[1]
    stacked = np.vstack([np.zeros((d, d)), *penalties.blocks])
    lengths = np.linalg.norm(seen, axis=0)
    units = np.where(lengths > 0, lengths, 1.0)
    _, shares, Wh = np.linalg.svd(stacked / units, full_matrices=False)
    costs = shares > UNSEEN * max(1.0, shares[0])
    return (Wh[~costs] / units).T, (Wh[costs] / units).T


def _gratis(plant: Plant, seen: Array, free: Array, who: Attacked) -> Share | None:
    """The lie that costs nobody anything and that a sensor which may lie can tell; None if there is none.

    Args:
        seen: what the channels see of the free directions, (m, k).
        free: these directions, (d, k).
    """
    loudness = np.zeros(plant.n_sensors)
    np.add.at(loudness, plant.channel_sensor, (seen**2).sum(axis=1))
    loudest = who.loudest(loudness[None])[0]
    if not free.shape[1] or loudness[loudest[0]] <= UNSEEN * loudness.max():
        return None
    own = seen[plant.channels_of(int(loudest[0]))]
    direction: Array = free @ np.linalg.svd(own)[2][0]
    return Share(1.0, 1.0, direction, np.sort(loudest))


def _rho(kappa: float) -> float:
    return np.inf if kappa >= 1 else kappa / (1 - kappa)
