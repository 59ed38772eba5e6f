"""Ten minutes of the grid, with one falsified flow meter. The same numbers every time.

    python simulate.py FOLDER

writes clean.csv (what the sensors send and the inputs), attacked.csv (the same with the lie) and truth.csv
(the angles in degrees) into FOLDER.

* Scheduled injections, known to the control centre, swing by 10 % within ten minutes.
* What nobody has scheduled, and the noise of the sensors, are drawn with a fixed seed.
* From second 200 on the meter at bus 4 reads 5 MW too much for the line to bus 5. That is five standard
  deviations of its noise, on a line that carries 60 MW the other way.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from securestate import Plant

HERE = Path(__file__).resolve().parent
SEED = 14
SAMPLES = 600
SWING = 0.1  # of the scheduled injections
LIAR, START, SIZE = "flow 4-5", 200, 5.0  # channel, sample, MW

Array = NDArray[np.float64]


def scheduled(plant: Plant) -> Array:
    """Return the injections known to the control centre, (T, p), MW."""
    swing = 1 + SWING * np.sin(2 * np.pi * np.arange(SAMPLES) / SAMPLES)
    return plant.input_offset * swing[:, np.newaxis]


def simulate(plant: Plant, u: Array, random: np.random.Generator) -> tuple[Array, Array]:
    """Return the true state (T, n), normalised, and what honest sensors send (T, m), engineering units."""
    w = random.multivariate_normal(np.zeros(plant.n), plant.Q, size=SAMPLES, method="cholesky")
    v = random.standard_normal((SAMPLES, plant.m)) * np.sqrt(np.diag(plant.R))
    driven = plant.normalise_input(u) @ plant.B.T + w
    x = np.zeros((SAMPLES, plant.n))
    for k in range(SAMPLES - 1):
        x[k + 1] = plant.A @ x[k] + driven[k]
    return x, plant.denormalise(x @ plant.C.T + v)


def record(plant: Plant, y: Array, u: Array) -> pd.DataFrame:
    """Return one row per second: time, sensors, inputs."""
    table = pd.DataFrame(np.hstack([y, u]).round(6), columns=[*plant.channel_names, *plant.input_names])
    table.insert(0, "time", np.arange(SAMPLES))
    return table


def falsify(clean: pd.DataFrame) -> pd.DataFrame:
    """Return the record as the control centre receives it."""
    return clean.assign(**{LIAR: (clean[LIAR] + SIZE * (clean["time"] >= START)).round(6)})


def main(folder: Path) -> Path:
    """Write the three files and return the path of attacked.csv."""
    plant = Plant.load(HERE / "plant.toml")
    u = scheduled(plant)
    x, y = simulate(plant, u, np.random.default_rng(SEED))
    clean = record(plant, y, u)
    clean.to_csv(folder / "clean.csv", index=False)
    falsify(clean).to_csv(folder / "attacked.csv", index=False)
    pd.DataFrame(np.rad2deg(x), columns=list(plant.state_names)).to_csv(folder / "truth.csv", index=False)
    return folder / "attacked.csv"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    print(f"wrote {main(Path(sys.argv[1]))}")
