"""How small a lie is still found: a constant bias on one sensor at a time, on records the model has not seen.

    python measure.py

held-out.csv has ten runs of 8 hours. In each, one sensor gets a bias from hour 2 on, upwards and downwards:
20 trials per sensor and size. A trial is a success if that sensor is named as a liar and no other is. Sizes
are in standard deviations of the sensor's normal variation (`scale` in plant.toml). Takes two to three
minutes.

"Vouched for" is the share of the sensor's variation that a Kalman filter predicts without that sensor. The
last line is a lie of two sensors together.
"""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from securestate import KalmanFilter, Plant, SparseFusion
from securestate.reporting import summarise

HERE = Path(__file__).resolve().parent
SIZES = (0.1, 0.2, 0.3, 0.5, 1.0, 3.0)
START = 40  # samples: two hours

TOGETHER = ("XMEAS 7", "XMEAS 13")
BOTH = -10.0  # kPa gauge

Array = NDArray[np.float64]


def main() -> None:
    """Print one row per sensor, successes out of 20 for every size."""
    plant = Plant.load(HERE / "plant.toml")
    runs = [
        table[list(plant.channel_names)].to_numpy(dtype=np.float64)
        for _, table in pd.read_csv(HERE / "held-out.csv").groupby("run")
    ]
    estimator = SparseFusion(plant)
    honest = sum(not liars(estimator, y) for y in runs)
    print(f"Without a lie nobody is named in {honest} of {len(runs)} runs.\n")
    title = f"{'right name only, of ' + str(2 * len(runs)) + ', at a bias of':<36}"
    print(title, *(f"{size:>5}" for size in SIZES), "  vouched for")
    shares = [vouched(plant, runs, i) for i in range(plant.m)]
    for i in np.argsort(shares)[::-1]:
        right = [successes(estimator, runs, i, size) for size in SIZES]
        counts = " ".join(f"{count:>5}" for count in right)
        print(f"{plant.sensor_names[i]:<36} {counts} {max(shares[i], 0.0):>13.0%}", flush=True)
    print(f"\n{' and '.join(TOGETHER)}, both by {BOTH:g} kPa gauge; named in how many of {len(runs)} runs:")
    print("  " + ", ".join(f"{name} {count}" for name, count in together(estimator, runs).most_common()))


def vouched(plant: Plant, runs: list[Array], i: int) -> float:
    """Return the share of channel i's variation that the others predict, after the first two hours."""
    kalman, blind = KalmanFilter(plant), [y.copy() for y in runs]
    for y in blind:
        y[:, i] = np.nan
    predicted = [plant.denormalise(kalman.run(y).x @ plant.C.T)[START:, i] for y in blind]
    sent = np.concatenate([y[START:, i] for y in runs])
    left = np.sum((np.concatenate(predicted) - sent) ** 2)
    return float(1 - left / np.sum((sent - plant.offset[i]) ** 2))


def together(estimator: SparseFusion, runs: list[Array]) -> Counter[str]:
    """Count how often each sensor is named when two tell the same lie."""
    both = [estimator.plant.channel_names.index(channel) for channel in TOGETHER]
    named: Counter[str] = Counter()
    for y in runs:
        false = y.copy()
        false[START:, both] += BOTH
        named.update(liars(estimator, false))
    return named


def successes(estimator: SparseFusion, runs: list[Array], i: int, size: float) -> int:
    """Count the trials in which sensor i, and it alone, is named."""
    name = estimator.plant.sensor_names[i]
    return sum(liars(estimator, y) == (name,) for y in lied(estimator.plant, runs, i, size))


def lied(plant: Plant, runs: list[Array], i: int, size: float) -> Iterator[Array]:
    """Yield every run with a bias on channel i, upwards and downwards."""
    for y in runs:
        for sign in (1.0, -1.0):
            false = y.copy()
            false[START:, i] += sign * size * plant.scale[i]
            yield false


def liars(estimator: SparseFusion, y: Array) -> tuple[str, ...]:
    """Return the names in the verdict on one record."""
    return summarise(estimator.run(y, covariance=False)).liars


if __name__ == "__main__":
    main()
