"""Put lies into readings that were recorded, not simulated."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from securestate.attacks.base import Attack
from securestate.attacks.knowledge import Knowledge, Scene
from securestate.errors import InputError
from securestate.estimators.base import check_inputs, check_measurements
from securestate.plant import Plant
from securestate.simulation.simulate import ADVERSARY, streams_of

Float = NDArray[np.float64]

#: What an adversary may know where nobody knows the true state.
POSSIBLE = (Knowledge.OWN_SENSORS, Knowledge.PLANT)


class Falsified(NamedTuple):
    """Readings as they arrive, what was added, and to which sensors; leading axes are those of the record.

    y, a: (..., T, m), sensor units; NaN where a reading was missing or suppressed. attacked: (..., T, N).
    """

    y: Float
    a: Float
    attacked: NDArray[np.bool_]


def falsify(
    plant: Plant, y: ArrayLike, attack: Attack, *, seed: int | Generator, u: ArrayLike | None = None
) -> Falsified:
    """Let an adversary falsify a clean record.

    Args:
        plant: whose sensors recorded it.
        y: clean readings, (T, m) or (runs, T, m), sensor units, or a table with the names of the channels.
        attack: one that knows its own sensors, or these and the plant; the true state is not in a record.
        seed: of the adversary's random numbers, as for `simulate`.
        u: inputs, (T, p) or (runs, T, p), file units; needed if and only if the plant has inputs.
    Raises:
        InputError: the adversary needs to know more, or an argument has the wrong shape.
    Examples:
        >>> from securestate.attacks import Bias
        >>> from securestate.plant import Sensor
        >>> plant = Plant([[0.9]], [[1.0]], [Sensor("a", C=[1.0], R=1.0), Sensor("b", C=[1.0], R=1.0)])
        >>> print(falsify(plant, [[0.1, 0.2], [0.3, 0.4]], Bias(5.0, on="b", start=1), seed=1).y)
        [[0.1 0.2]
         [0.3 5.4]]
    """
    if not isinstance(attack, Attack):
        raise InputError("attack", "an Attack from securestate.attacks", type(attack).__name__)
    for part in attack.parts:
        if part.knows not in POSSIBLE:
            raise InputError(
                "attack", "adversaries that know what a record holds", f"{type(part).__name__}, {part.knows}"
            )
    batch = np.ndim(y) == 3
    clean = check_measurements(y, plant, ("runs", "T") if batch else ("T",))
    inputs = check_inputs(u, plant, clean.shape)
    runs = clean if batch else clean[np.newaxis]
    streams, (count, steps, _) = streams_of(seed, 0, len(runs)), runs.shape
    scene = Scene(
        plant=plant,
        x=np.full((count, steps, plant.n), np.nan),
        u=np.broadcast_to(inputs, (count, steps, plant.n_inputs)),
        v=np.full(runs.shape, np.nan),
        y=runs,
        rngs=lambda number: streams(ADVERSARY, number),
    )
    injection = attack.stage(scene)
    found = Falsified(runs + injection.a, injection.a, injection.attacked)
    return found if batch else Falsified(*(array[0] for array in found))
