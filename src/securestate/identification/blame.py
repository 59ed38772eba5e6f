"""What a bad fit is put down to: some sensors, the plant, or what the record leaves open."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from securestate._words import enumerate_names
from securestate.estimators.kalman import KalmanFilter
from securestate.identification.forms import Segment
from securestate.identification.residuals import WARM_UP, anywhere
from securestate.identification.verdict import Grade, Problem
from securestate.plant import Plant

Array = NDArray[np.float64]

#: Sensors left out at most before a bad fit is put down to the plant, and how many are tried in each round.
BLAMED, TRIED = 3, 10

#: A fit is restored if errors are at most this many times as large as the model says.
RESTORED = 1.5

#: Samples of a segment that are used at most.
SAMPLES = 5000


def fewest_without(
    plant: Plant, record: Sequence[Segment], most: int, but: Sequence[str] = ()
) -> tuple[str, ...]:
    """The fewest sensors, at most `most`, found one after the other, without which the model fits.

    `but`: sensors that are not tried.
    """
    kept = [plant.sensor_names.index(name) for name in but]
    estimator = KalmanFilter(plant)
    record = [(y[:SAMPLES], u[:SAMPLES]) for y, u in record]
    out: list[int] = []
    while len(out) < most:
        tried = [i for i in _worst(estimator, out, record) if i not in kept]
        if not tried or len(out) + len(kept) + 1 >= plant.n_sensors:
            return ()
        sizes = {i: _size_without(estimator, [*out, i], record) for i in tried}
        out.append(min(sizes, key=lambda i: sizes[i]))
        if sizes[out[-1]] <= RESTORED:
            return tuple(plant.sensor_names[i] for i in sorted(out))
    return ()


def _worst(estimator: KalmanFilter, out: Sequence[int], record: Sequence[Segment]) -> list[int]:
    """The sensors with the largest errors while those of `out` are not heard."""
    plant = estimator.plant
    squares, number = np.zeros(plant.m), np.zeros(plant.m)
    for run in _runs(estimator, out, record):
        z = run[0]
        squares += np.nansum(z**2, axis=0)
        number += np.isfinite(z).sum(axis=0)
    mean = squares / np.maximum(number, 1)
    by_sensor = [float(mean[plant.channels_of(i)].max()) for i in range(plant.n_sensors)]
    order = sorted(range(plant.n_sensors), key=lambda i: -by_sensor[i])
    return [i for i in order if i not in out][:TRIED]


def _size_without(estimator: KalmanFilter, out: Sequence[int], record: Sequence[Segment]) -> float:
    nis, channels = 0.0, 0.0
    for _, run_nis, run_channels in _runs(estimator, out, record):
        nis += float(run_nis.sum())
        channels += float(run_channels.sum())
    return nis / max(channels, 1.0)


def _runs(
    estimator: KalmanFilter, out: Sequence[int], record: Sequence[Segment]
) -> Iterator[tuple[Array, Array, Array]]:
    """Standardised innovations, nis and channels of every segment while some sensors are not heard."""
    plant = estimator.plant
    for y, u in record:
        run = estimator.run(
            without(plant, y, out), u if plant.n_inputs else None, anywhere(plant), covariance=False
        )
        skip = min(WARM_UP, len(y) // 4)
        z = (run.innovation / run.innovation_std)[skip:]
        yield z, run.diagnostics["nis"][skip:], run.diagnostics["channels"][skip:]


def reason_of(blamed: Sequence[str], rival: Sequence[str], tried: int, sensors: int) -> Problem:
    """What a bad fit is put down to: some sensors, the plant, or what the record leaves open."""
    if rival:
        text = (
            f"The rest fits without {enumerate_names(blamed)}, and as well without {enumerate_names(rival)}: "
            "the record cannot tell who is wrong."
        )
    elif blamed and 2 * len(blamed) >= sensors:
        text = (
            f"Without {enumerate_names(blamed)} the rest fits, but that is half of the sensors or more: the "
            "record cannot tell who is wrong."
        )
    elif blamed:
        verb = "this sensor is" if len(blamed) == 1 else "these sensors are"
        text = f"Without {enumerate_names(blamed)} the rest fits: more likely {verb} wrong than the model."
    else:
        text = (
            f"Leaving out {'a sensor' if tried == 1 else f'up to {tried} sensors'} does not help: more "
            "likely the plant has changed, or was never what the model says, than that sensors lie."
        )
    return Problem(Grade.INADEQUATE, text)


def without(plant: Plant, y: Array, silent: Sequence[int]) -> Array:
    """Measurements without those of some sensors."""
    heard = y.copy() if silent else y
    for i in silent:
        heard[:, plant.channels_of(i)] = np.nan
    return heard
