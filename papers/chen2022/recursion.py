"""What comes without chance: gains, traces and one run, beside an implementation written apart."""

from __future__ import annotations

import json

import numpy as np

from papers._report import Value
from papers.chen2022.setting import FOLDER, FORMS, Form, Setting
from securestate.estimators.joint_fusion import JointMoments

STEPS = (1, 2, 5, 10, 100, 1000)


def traces(setting: Setting) -> dict[str, Value]:
    """Traces of P_11, P_22, P_12 and P_0 at some k, and the distance of all gains from golden.json."""
    golden = json.loads((FOLDER / "golden.json").read_text(encoding="utf-8"))
    found: dict[str, Value] = {}
    for form in FORMS:
        moments = setting.joint(form).moments(STEPS[-1], setting.prior)
        for k in STEPS:
            for name, number in _traces(setting.plant.n, moments, k - 1).items():
                found[f"trace.{form}.{k}.{name}"] = Value(number)
        found[f"gains.{form}"] = Value(max(_distance(golden[f"{form}.k{k}"], moments, k - 1) for k in STEPS))
    return found


def _traces(n: int, moments: JointMoments, at: int) -> dict[str, float]:
    Sigma = moments.Sigma[at]
    blocks = {
        "P1": Sigma[:n, :n],
        "P2": Sigma[n : 2 * n, n : 2 * n],
        "P12": Sigma[:n, n : 2 * n],
        "P0": moments.P0[at],
    }
    return {name: float(np.trace(block)) for name, block in blocks.items()}


def _distance(golden: dict[str, list[list[float]]], moments: JointMoments, at: int) -> float:
    """Largest difference of K_i and Gamma_i from the golden ones."""
    ours = {f"K{i + 1}": moments.K[i][at] for i in range(2)}
    ours |= {f"Gamma{i + 1}": moments.Gamma[i][at] for i in range(2)}
    return max(float(np.abs(value - golden[name]).max()) for name, value in ours.items())


def settled(setting: Setting) -> dict[str, Value]:
    """The first k from which no gain differs from its limit by more than 1e-6."""
    moments = setting.joint("exact").moments(STEPS[-1], setting.prior)
    gains = [*moments.K, *moments.Gamma]
    far = np.max([np.abs(gain - gain[-1]).max(axis=(1, 2)) for gain in gains], axis=0) > 1e-6
    return {"gains.settled": Value(float(np.flatnonzero(far)[-1] + 2))}


def one_run(setting: Setting) -> dict[str, Value]:
    """Distance of one run's estimates from those in trace.csv."""
    with (FOLDER / "trace.csv").open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        values = dict(zip(names, np.loadtxt(file, delimiter=",").T, strict=True))
    y = np.stack([values[f"y{i}"] for i in range(1, 6)], axis=1)
    return {f"run.{form}": Value(_run_distance(setting, form, y, values)) for form in FORMS}


def _run_distance(setting: Setting, form: Form, y: np.ndarray, values: dict[str, np.ndarray]) -> float:
    run = setting.joint(form).run(y, prior=setting.prior)
    x = np.stack([values[f"{form}.x{i}"] for i in range(1, 5)], axis=1)
    theta = np.stack([values[f"{form}.theta{i}"] for i in (1, 2)], axis=1)
    return float(max(np.abs(run.x - x).max(), np.abs(run.attack[:, :2] - theta).max()))
