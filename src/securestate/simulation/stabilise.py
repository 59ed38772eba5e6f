"""Keep the state of an unstable plant bounded, without changing the estimation problem.

Open loop, x grows as |lambda|^k, and double precision has lost the estimate when that reaches 1e16. An input
that every estimator is told cancels out of the estimation error, so a feedback from the true state bounds x
and changes nothing else.
"""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from securestate.errors import DesignError
from securestate.plant import Plant

Float = NDArray[np.float64]

#: A mode grows if its size is larger than this.
UNSTABLE = 1 + 1e-6
#: Growth over all samples that costs no accuracy worth speaking of.
HARMLESS = 1e6
#: Name of the inputs that `stabilised` adds.
NAME = "stabilising"


def stabilised(plant: Plant) -> Plant:
    """The same plant, able to be simulated for any length: it gets a known input per state if it needs one.

    A plant without growing modes, or with inputs that can hold them, is returned as it is.

    Raises:
        DesignError: the plant varies in time.

    Examples:
        >>> from securestate.plant import Sensor
        >>> stabilised(Plant([[2.0]], [[1.0]], [Sensor("a", C=[1.0], R=1.0)])).input_names
        ('stabilising x1',)
    """
    if plant.time_varying:
        raise DesignError(
            "a time-varying plant cannot be stabilised", "simulate it as it is, over fewer samples"
        )
    if growth(plant) <= UNSTABLE or feedback_gain(plant) is not None:
        return plant
    extra = np.eye(plant.n)
    return Plant(
        plant.A,
        plant.Q,
        [sensor.replaced(D=None) for sensor in plant.sensors],
        B=np.hstack([plant.B, extra]),
        D=np.hstack([plant.D, np.zeros((plant.m, plant.n))]),
        R=None if all(sensor.R is not None for sensor in plant.sensors) else plant.R,
        dt=plant.dt,
        state_names=plant.state_names,
        input_names=(*plant.input_names, *(f"{NAME} {state}" for state in plant.state_names)),
        input_offset=np.append(plant.input_offset, np.zeros(plant.n)),
        input_scale=np.append(plant.input_scale, np.ones(plant.n)),
        name=plant.name,
    )


def growth(plant: Plant) -> float:
    """Largest |eigenvalue| of A; 1 for a plant that varies in time."""
    return 1.0 if plant.time_varying else float(np.abs(np.linalg.eigvals(plant.A)).max())


def feedback_for(plant: Plant, steps: int) -> Float | None:
    """-L (p, n) of a feedback u = -L x that bounds the state; None if the state stays small enough without.

    Raises:
        DesignError: the state would outgrow the numbers and no input can hold it.
    """
    size = growth(plant)
    if size <= UNSTABLE:
        return None
    gain = feedback_gain(plant)
    if gain is None and steps * np.log(size) > np.log(HARMLESS):
        raise DesignError(
            f"A has an eigenvalue of size {size:.6g} that no input can hold: within {steps} samples the "
            f"state grows {size:.6g}^{steps} times, and double precision loses the estimate",
            "simulate securestate.simulation.stabilised(plant), which adds a known input, and design the "
            "estimators for that plant",
        )
    return gain


def feedback_gain(plant: Plant) -> Float | None:
    """-L of the linear-quadratic regulator with unit weights; None if the inputs cannot hold every mode."""
    if not plant.n_inputs:
        return None
    A, B = plant.A, plant.B
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            X = linalg.solve_discrete_are(A, B, np.eye(plant.n), np.eye(plant.n_inputs))
            gain = -linalg.solve(np.eye(plant.n_inputs) + B.T @ X @ B, B.T @ X @ A, assume_a="pos")
    except (linalg.LinAlgError, ValueError):
        return None
    if not np.all(np.isfinite(gain)) or np.abs(np.linalg.eigvals(A + B @ gain)).max() >= 1.0:
        return None
    return np.ascontiguousarray(gain, dtype=np.float64)
