"""What mixture fusion needs before any data: the steady state of every sensor's own filter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from securestate._steady_state import steady_state
from securestate.errors import DesignError
from securestate.plant import Plant, Sensor

Float = NDArray[np.float64]


def refuse_unsuitable(plant: Plant) -> None:
    """Refuse a plant that the method is not made for.

    Raises:
        DesignError: the plant varies in time, or the noise of two sensors is correlated; names them.
    """
    if plant.time_varying:
        raise DesignError("mixture fusion needs a time-invariant plant", "give constant A and C")
    apart = plant.channel_sensor[:, np.newaxis] != plant.channel_sensor
    correlated = np.argwhere(apart & (plant.R != 0))
    if len(correlated):
        one, other = (plant.sensor_names[plant.channel_sensor[channel]] for channel in correlated[0])
        raise DesignError(
            f"the noise of the sensors {one!r} and {other!r} is correlated, and mixture fusion weighs every"
            " sensor by itself",
            "make them one sensor with several channels, or give them independent noise",
        )


def local_priors(plant: Plant) -> Float:
    """P_i[k|k-1] in steady state of the filter that hears sensor i alone, (N, n, n).

    Raises:
        DesignError: a sensor has no such filter; names it.
    """
    return np.stack([_local_prior(plant, i) for i in range(plant.n_sensors)])


def _local_prior(plant: Plant, i: int) -> Float:
    own, name = plant.channels_of(i), plant.sensor_names[i]
    try:
        return steady_state(
            Plant(plant.A, plant.Q, [Sensor(name, C=plant.C[own], R=plant.R[own, own])])
        ).P_prior
    except DesignError as refusal:
        raise DesignError(
            f"sensor {name!r} alone cannot estimate the whole state: {refusal.reason}",
            "use InnovationMixture, which does not need it, or feedback=True",
        ) from None
