"""What only a simulation tells: Fig. 2, attacks on one sensor, their growth, how often Theorem 3 applies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from papers._report import Value
from papers.liu2020.setting import Setting
from securestate import SparseFusion


@dataclass(frozen=True)
class Curve:
    """Normalised mean squared error over γ for both scenarios of Fig. 2, and the oracle without sensor 1."""

    gamma: list[float]
    benign: list[Value]
    attacked: list[Value]
    oracle: float


def kalman(setting: Setting) -> dict[str, Value]:
    """The Kalman filter on the record, and its local decomposition beside it (Theorem 1)."""
    record = setting.record
    one, other = (setting.run(estimator, record.y) for estimator in (setting.paper(1e9), setting.kalman))
    return {
        "kalman": setting.nmse(setting.kalman, record.y),
        "theorem 1": Value(float(np.abs(one.x - other.x).max())),
        "theorem 1.fast": setting.mean(one.diagnostics["fast_path"]),
    }


def fig2(setting: Setting) -> tuple[Curve, dict[str, Value]]:
    """Both scenarios of Fig. 2 over γ, on the same samples for every γ."""
    record, choice = setting.record, setting.config["fig2"]
    lies = record.attacked(1, choice["attack"])
    benign, attacked = [], []
    for gamma in choice["gamma"]:
        estimator = setting.paper(gamma)
        benign.append(setting.nmse(estimator, record.y))
        attacked.append(setting.nmse(estimator, lies))
    curve = Curve(choice["gamma"], benign, attacked, _oracle(setting, 1))
    found = {f"fig2.benign.{gamma:g}": value for gamma, value in zip(curve.gamma, benign, strict=True)}
    found |= {f"fig2.attacked.{gamma:g}": value for gamma, value in zip(curve.gamma, attacked, strict=True)}
    errors = np.array([value.number for value in attacked])
    found["fig2.best gamma"] = Value(curve.gamma[int(errors.argmin())])
    found["fig2.excess at 0.75"] = Value(float(errors[curve.gamma.index(0.75)] / errors.min()))
    found["fig2.cost at 2"] = _cost(setting, setting.paper(2.0))
    return curve, found


def _cost(setting: Setting, estimator: SparseFusion) -> Value:
    """Mean squared error over that of the Kalman filter on the same samples, when nobody lies."""
    runs = [setting.run(one, setting.record.y) for one in (estimator, setting.kalman)]
    secure, kalman = (setting.square(run) for run in runs)
    return Value(
        setting.mean(secure).number / setting.mean(kalman).number,
        setting.mean(secure - kalman).error / setting.trace,
    )


def _oracle(setting: Setting, sensor: int) -> float:
    """Trace of P of the Kalman filter that never hears one sensor, over that of the one that hears all."""
    y = setting.record.without(sensor)[0, :500]
    covariance = setting.kalman.run(y, setting.record.u[0, :500]).P
    assert covariance is not None
    return float(np.trace(covariance[-1])) / setting.trace


def single_attacks(setting: Setting) -> dict[str, Value]:
    """Every sensor in turn adds the same amount at every step."""
    choice, record = setting.config["attacks"], setting.record
    gamma = choice["gamma_robust"]
    forms = {
        "paper": setting.paper(choice["gamma_paper"]),
        "group": SparseFusion(setting.plant, gamma=gamma, refit=False),
        "refit": SparseFusion(setting.plant, gamma=gamma),
        "default": SparseFusion(setting.plant),
    }
    found = {f"benign.{name}": _cost(setting, forms[name]) for name in ("refit", "default")}
    for sensor in range(1, setting.plant.n_sensors + 1):
        lies = record.attacked(sensor, choice["size"])
        for name, estimator in forms.items():
            found[f"attack.{name}.{sensor}"] = setting.nmse(estimator, lies)
        found[f"attack.oracle run.{sensor}"] = setting.nmse(setting.kalman, record.without(sensor))
        found[f"attack.oracle.{sensor}"] = Value(_oracle(setting, sensor))
    return found


def growth(setting: Setting) -> dict[str, Value]:
    """The two sensors that break the condition of Theorem 4, with attacks of growing size."""
    choice = setting.config["growth"]
    forms = {
        "paper": setting.paper(setting.config["attacks"]["gamma_paper"]),
        "default": SparseFusion(setting.plant),
    }
    return {
        f"growth.{name}.{sensor}.{size:g}": setting.nmse(estimator, setting.record.attacked(sensor, size))
        for name, estimator in forms.items()
        for sensor in choice["sensors"]
        for size in choice["sizes"]
    }


def theorem3(setting: Setting) -> dict[str, Value]:
    """How often (33) holds: the secure estimate is the Kalman estimate when nobody lies."""
    choice = setting.config["theorem3"]
    found = {f"theorem 3.share.{gamma:g}": _share(setting, setting.paper(gamma)) for gamma in choice["gamma"]}
    threshold = _threshold(setting, choice["probability"])
    found["theorem 3.threshold"] = threshold
    found["theorem 3.share at threshold"] = _share(setting, setting.paper(threshold.number))
    found["theorem 3.attack at threshold"] = _unprotected(setting, setting.paper(threshold.number))
    found["theorem 3.share.default"] = _share(setting, SparseFusion(setting.plant))
    return found


def _unprotected(setting: Setting, estimator: SparseFusion) -> Value:
    """Mean squared error under the attack of Fig. 2, over that of the Kalman filter which believes it."""
    lies = setting.record.attacked(1, setting.config["fig2"]["attack"])
    ours, believing = (setting.nmse(one, lies) for one in (estimator, setting.kalman))
    return Value(ours.number / believing.number, (ours.error + believing.error) / believing.number)


def _share(setting: Setting, estimator: SparseFusion) -> Value:
    return setting.mean(setting.run(estimator, setting.record.y).diagnostics["fast_path"])


def _threshold(setting: Setting, probability: float) -> Value:
    """γ with P(‖ν₀‖_∞ ≤ γ) = probability, from draws of ν₀ ~ N(0, N); its standard error from ten batches."""
    N = setting.paper(1.0).decomposition.N
    values, vectors = np.linalg.eigh(N)
    rng = np.random.default_rng(setting.config["simulation"]["seed"])
    draws = rng.standard_normal((setting.scale["draws"], len(N))) * np.sqrt(np.maximum(values, 0))
    largest = np.abs(draws @ vectors.T).max(axis=1)
    batches = [np.quantile(part, probability) for part in np.array_split(largest, 10)]
    return Value(float(np.quantile(largest, probability)), float(np.std(batches, ddof=1) / np.sqrt(10)))
