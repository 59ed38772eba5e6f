"""How small a lie is named, and how often an honest sensor is: on records that the plant has not seen.

    python measure.py

The plant is learned from run d00 of history.csv and from data.csv. Of the ten other runs of history.csv, 8
hours each, five calibrate `BiasMonitor` for one false alarm a day, and the other five test it; then the other
way round. In a trial one sensor gets a bias for 40 samples, two hours, upwards or downwards, from hour 2, 4
or 6 on. It succeeds if that sensor is suspected within these samples and no other is. Sizes are in standard
deviations of the sensor's normal variation. The first hour of a run only tells a Kalman filter where the run
starts. The last lines are two sensors that tell the same lie, for sparse fusion. Takes about two minutes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from time import process_time

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_lyapunov

from securestate import Belief, BiasMonitor, Identified, KalmanFilter, Plant, SparseFusion, identify, judge
from securestate.reporting import summarise

HERE = Path(__file__).resolve().parent
SIZES = (0.25, 0.5, 1.0)
START, ONSETS, HELD = 20, (40, 80, 119), 40  # samples
DAY = 480  # samples

TOGETHER = ("XMEAS 7", "XMEAS 13")
BOTH = -10.0  # kPa gauge

Array = NDArray[np.float64]


def main() -> None:
    """Print false alarms, one row per sensor, and what two liars in concert achieve."""
    start = process_time()
    found, runs = learned(), clean_runs()
    plant = found.plant
    print(f"{found}\nLearned in {process_time() - start:.1f} s of processor time.\n")
    on_clean = judge(plant, [*runs])
    print(f"On the ten runs: {on_clean}\n")
    halves = (runs[::2], runs[1::2])
    folds = [(BiasMonitor(plant, run_length=DAY, calibrate_on=[*halves[1 - k]]), halves[k]) for k in range(2)]
    alarms = sum(episodes(watched(monitor, y)) for monitor, tested in folds for y in tested)
    days = runs.shape[0] * (runs.shape[1] - START) / DAY
    print(f"False alarms: {alarms} in {days:.1f} days, stated: one a day.\n")
    title = "named right, at a bias of"
    print(f"{title:<36}", *(f"{size:>6}" for size in SIZES), " vouched for")
    checked = [i for i in range(plant.m) if plant.verifiable[i]]
    shares = {i: np.array([success(folds, plant, i, size) for size in SIZES]) for i in checked}
    for i in checked:
        told = " ".join(f"{share:>6.0%}" for share in shares[i])
        print(f"{plant.sensor_names[i]:<36} {told} {found.verdict.sensors[i].explained:>12.0%}")
    print(f"{'all':<36}", " ".join(f"{share:>6.0%}" for share in np.mean(list(shares.values()), axis=0)))
    print(f"\n{' and '.join(TOGETHER)}, both by {BOTH:g} kPa gauge; named in how many of {len(runs)} runs:")
    print("  " + ", ".join(f"{name} {count}" for name, count in together(plant, runs).most_common()))


def learned() -> Identified:
    """The plant of the records that the tests do not use."""
    history, record = pd.read_csv(HERE / "history.csv"), pd.read_csv(HERE / "data.csv")
    channels = [name for name in record.columns if name != "time"]
    return identify([history.loc[history["run"] == "d00", channels], record[channels]], dt=180.0)


def clean_runs() -> Array:
    """The ten runs that are new to the plant, (runs, T, m)."""
    history = pd.read_csv(HERE / "history.csv")
    others = history[history["run"] != "d00"].groupby("run")
    return np.array([table.drop(columns=["run", "time"]).to_numpy(dtype=np.float64) for _, table in others])


def watched(monitor: BiasMonitor, y: Array) -> NDArray[np.bool_]:
    """Who is suspected when, from the second hour of one run on, (T - START, N)."""
    plant = monitor.plant
    anywhere = Belief(np.zeros(plant.n), solve_discrete_lyapunov(plant.A, plant.Q))
    first = KalmanFilter(plant).run(y[:START], prior=anywhere).x[-1]
    return monitor.run(y[START:], prior=Belief(plant.A @ first), covariance=False).suspected


def episodes(suspected: NDArray[np.bool_]) -> int:
    """How many times somebody begins to be suspected."""
    anyone = suspected.any(axis=1)
    return int(anyone[0]) + int(np.sum(anyone[1:] & ~anyone[:-1]))


def success(folds: Sequence[tuple[BiasMonitor, Array]], plant: Plant, i: int, size: float) -> float:
    """Share of trials in which sensor i, and it alone, is named while it lies."""
    right: list[bool] = []
    for monitor, runs in folds:
        for y, onset, sign in product(runs, ONSETS, (1.0, -1.0)):
            false = y[: onset + HELD].copy()
            false[onset:, i] += sign * size * plant.scale[i]
            named = watched(monitor, false)[onset - START :].any(axis=0)
            right.append(bool(named[i] and named.sum() == 1))
    return float(np.mean(right))


def together(plant: Plant, runs: Array) -> Counter[str]:
    """Count how often each sensor is named when two tell the same lie."""
    both = [plant.channel_names.index(channel) for channel in TOGETHER]
    estimator, named = SparseFusion(plant), Counter[str]()
    for y in runs:
        false = y.copy()
        false[ONSETS[0] :, both] += BOTH
        named.update(summarise(estimator.run(false, covariance=False)).liars)
    return named


if __name__ == "__main__":
    main()
