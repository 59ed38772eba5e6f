"""Protected sensors judge those that may lie: the four-bus grid of Chen, Weng, Ho and Yu 2022.

    python run.py [--out FOLDER]

FOLDER (default: out, beside this script) receives attacked.csv, truth.csv, and for each of the methods auto,
joint and adaptive-joint its estimates and its report; those of the last two show the protected sensors alone
beside it.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

import securestate as ss
from securestate.attacks import Bias, RandomNoise
from securestate.cli import execute
from securestate.cli.exits import Exit

HERE = Path(__file__).resolve().parent
PLANT = HERE / "plant.toml"
SEED, SAMPLES = 2022, 400
#: weak 1 sends noise of variance 5 from sample 100 to 199, weak 2 is 3 too high from sample 250 on.
ATTACK = RandomNoise(np.sqrt(5.0), on="weak 1", start=100, stop=200) + Bias(3.0, on="weak 2", start=250)
METHODS = {"auto": "SecureFilter", "joint": "JointFusion", "adaptive-joint": "AdaptiveJointFilter"}


def main() -> int:
    """Do the job; return 0, or the command line's exit code if it failed."""
    out = _folder()
    plant = ss.Plant.load(PLANT)
    truth = ss.simulate(plant, SAMPLES, ATTACK, runs=1, seed=SEED)
    pd.DataFrame(truth.y[0], columns=list(plant.channel_names)).to_csv(out / "attacked.csv", index=False)
    pd.DataFrame(truth.x[0], columns=list(plant.state_names)).to_csv(out / "truth.csv", index=False)
    errors = {}
    for method, name in METHODS.items():
        estimates, report = out / f"{method}.csv", out / f"{method}.html"
        command = ["estimate", "--plant", PLANT, "--data", out / "attacked.csv", "--method", method]
        code = execute([str(word) for word in [*command, "--out", estimates, "--report", report]])
        if code not in (Exit.CLEAN, Exit.SUSPECTED):
            return code
        print()
        table = pd.read_csv(estimates)
        errors[name] = table[[f"x.{state}" for state in plant.state_names]].to_numpy()
    for name, estimator in {
        "ProtectedKalman": ss.ProtectedKalman(plant),
        "KalmanFilter": ss.KalmanFilter(plant),
    }.items():
        errors[name] = estimator.run(truth.y[0]).x
    print("Mean squared error of the state:")
    for name, x in errors.items():
        print(f"  {name + ':':<21}{np.mean(np.sum((x - truth.x[0]) ** 2, axis=1)):.3f}")
    return 0


def _folder() -> Path:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=HERE / "out", help="folder for the results")
    folder: Path = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    return folder


if __name__ == "__main__":
    raise SystemExit(main())
