"""The second moments that Lemma 1 and Theorem 2 claim, beside those of runs of (6) with the same gains.

The injections are white with covariance eta I, as the derivation assumes: only the equations are judged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from papers._report import Value
from papers.chen2022.setting import FORMS, Float, Form, Setting
from securestate import simulate
from securestate.attacks import RandomNoise
from securestate.estimators.joint_fusion import JointMoments
from securestate.simulation import Trajectory

BATCHES = 10


@dataclass(frozen=True)
class Errors:
    """Errors of one local estimator at the last sample, (runs, .)."""

    x: Float
    phi: Float
    phihat: Float


def judged(setting: Setting) -> dict[str, Value]:
    """Claimed and simulated moments at the last sample, for both forms."""
    choice = setting.config["moments"]
    attack = RandomNoise(np.sqrt(choice["eta"]), on=["weak 1", "weak 2"])
    runs, steps = setting.scale["moments"], choice["steps"]
    drawn = simulate(setting.plant, steps, attack, seed=choice["seed"], runs=runs, prior=setting.prior)
    found: dict[str, Value] = {}
    for form in FORMS:
        found |= {f"moments.{form}.{name}": value for name, value in _form(setting, form, drawn).items()}
    return found


def _form(setting: Setting, form: Form, drawn: Trajectory) -> dict[str, Value]:
    steps = drawn.y.shape[1]
    claimed = setting.joint(form, setting.config["moments"]["eta"]).moments(steps, setting.prior)
    one, two = (
        _errors(setting, weak, claimed.K[i], claimed.Gamma[i], drawn)
        for i, weak in enumerate(setting.pairing)
    )
    n = setting.plant.n
    P12 = claimed.Sigma[-1][:n, n : 2 * n]
    return {
        "P1 claimed": Value(float(np.trace(claimed.Sigma[-1][:n, :n]))),
        "P1": _sample(np.sum(one.x**2, axis=1)),
        "P12 claimed": Value(float(np.trace(P12))),
        "P12": _sample(np.sum(one.x * two.x, axis=1)),
        "P12 off": _off(P12, one.x, two.x),
        "V claimed": Value(float(claimed.V[0][-1].item())),
        "V": _sample(one.phihat[:, 0] ** 2),
        "Y": _sample(one.phihat[:, 0] * (one.phi - one.phihat)[:, 0]),
        "P0 claimed": Value(float(np.trace(claimed.P0[-1]))),
        "P0": _sample(_fused(claimed, one.x, two.x)),
    }


def _errors(setting: Setting, weak: str, K: Float, Gamma: Float, drawn: Trajectory) -> Errors:
    """Run (6) of one local estimator with given gains."""
    plant, sensors = setting.plant, setting.stack(weak)
    n, y, theta = plant.n, drawn.y[..., sensors], drawn.a[..., sensors[0]]
    A = np.eye(n + 1)
    A[:n, :n] = plant.A
    C = np.hstack([plant.C[sensors], np.eye(len(sensors), 1)])
    X, phihat = np.zeros((len(y), n + 1)), np.zeros((len(y), 1))
    for k in range(y.shape[1]):
        X = X @ A.T if k else X
        X[:, n:] += phihat
        innovation = y[:, k] - X @ C.T
        X = X + innovation @ K[k].T
        phihat = phihat + innovation @ Gamma[k].T
    return Errors(drawn.x[:, -1] - X[:, :n], (theta[:, -1] - theta[:, -2])[:, np.newaxis], phihat)


def _fused(claimed: JointMoments, one: Float, two: Float) -> Float:
    """Squared error of (8), (runs,)."""
    return np.sum((np.hstack([one, two]) @ claimed.G[-1].T) ** 2, axis=1)


def _sample(samples: Float) -> Value:
    return Value(float(samples.mean()), float(samples.std(ddof=1) / np.sqrt(len(samples))))


def _off(P12: Float, one: Float, two: Float) -> Value:
    """Relative distance of P_12^x from the simulated one; its standard error from batches of runs."""
    simulated = one.T @ two / len(one)
    batches = [
        a.T @ b / len(a)
        for a, b in zip(np.array_split(one, BATCHES), np.array_split(two, BATCHES), strict=True)
    ]
    spread = np.sqrt(np.mean([np.linalg.norm(part - simulated) ** 2 for part in batches]) / BATCHES)
    size = np.linalg.norm(simulated)
    return Value(float(np.linalg.norm(P12 - simulated) / size), float(spread / size))
