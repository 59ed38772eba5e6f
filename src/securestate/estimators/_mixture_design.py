"""What mixtures need before any data: independent noise, and each sensor's own filter for mixture fusion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from securestate._steady_state import steady_state
from securestate.errors import DesignError, InputError
from securestate.plant import Plant, Sensor

Float = NDArray[np.float64]


def refuse_shared_noise(plant: Plant) -> None:
    """Refuse a plant whose R correlates two sensors.

    Raises:
        DesignError: names the first two.
    """
    apart = plant.channel_sensor[:, np.newaxis] != plant.channel_sensor
    correlated = np.argwhere(apart & (plant.R != 0))
    if len(correlated):
        one, other = (plant.sensor_names[plant.channel_sensor[channel]] for channel in correlated[0])
        raise DesignError(
            f"the noise of the sensors {one!r} and {other!r} is correlated, and a mixture weighs every sensor"
            " by itself, given the state",
            "make them one sensor with several channels, or add their common noise as a state",
        )


def one_of(argument: str, value: object, choices: tuple[str, ...]) -> str:
    """One of some words.

    Raises:
        InputError: it is none of them.
    """
    if not isinstance(value, str) or value not in choices:
        raise InputError(argument, " or ".join(f'"{choice}"' for choice in choices), repr(value))
    return value


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
