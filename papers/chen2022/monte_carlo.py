"""What only a simulation tells: every estimator on one attacked record, Fig. 2, and the paper's claims."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from papers._report import Value
from papers._statistics import mean, prefixed, ratio
from papers.chen2022.setting import FORMS, Float, Setting
from securestate import (
    AdaptiveJointFilter,
    AdaptiveKalman,
    AugmentedKalman,
    Estimator,
    InnovationGate,
    JointFusion,
    KalmanFilter,
    ProtectedKalman,
)

WEAK = {"1": "weak 1", "2": "weak 2"}


@dataclass(frozen=True)
class Curves:
    """What the figures show.

    Attributes:
        attack: mean squared error of the estimate of theta_2 over k, by form and eta.
        state: mean squared error of the state over k, by estimator.
        x: the state of one run, (T, n), and `fused` its estimate.
    """

    attack: dict[tuple[str, float], Float]
    state: dict[str, Float]
    x: Float
    fused: Float


def estimators(setting: Setting) -> Iterator[tuple[str, Estimator, list[int] | None]]:
    """Name, estimator, and the sensors it hears if not all."""
    plant = setting.plant
    yield "no defence", KalmanFilter(plant), None
    yield "protected only", ProtectedKalman(plant), None
    yield "adaptive joint", AdaptiveJointFilter(plant), None
    for form in FORMS:
        yield f"{form}.fusion", setting.joint(form), None
        for number, weak in WEAK.items():
            yield f"{form}.local {number}", setting.joint(form, weak=weak), None
    yield "exact.adaptive", setting.adaptive(), None
    yield "exact.auto", JointFusion(setting.unprotected, protected="auto", detector="gate"), None
    yield "gate", InnovationGate(setting.unprotected), None
    yield "exact.average", setting.joint("exact", fusion="average"), None
    yield "exact.intersection", setting.joint("exact", fusion="covariance-intersection"), None
    for number, weak in WEAK.items():
        yield from _local(setting, number, setting.stack(weak))


def _local(setting: Setting, number: str, sensors: list[int]) -> Iterator[tuple[str, Estimator, list[int]]]:
    """The paper's two competitors, and the Kalman filter that ignores the weak sensor."""
    plant, choice = setting.plant.select(sensors), setting.config["baselines"]
    start, noise = choice["start"], choice["adaptive_noise"]
    for q in choice["attack_noise"]:
        augmented = AugmentedKalman(plant, attack_noise=q, attack_start=start)
        yield f"augmented {q:g}.local {number}", augmented, sensors
    for factor in choice["forgetting"]:
        zhang = AdaptiveKalman(plant, forgetting=factor, attack_noise=noise, attack_start=start)
        yield f"zhang {factor:g}.local {number}", zhang, sensors
    yield f"protected only.local {number}", ProtectedKalman(plant), sensors


def errors(setting: Setting) -> dict[str, Float]:
    """Squared error of the state of every estimator, (runs, T) each."""
    return {
        name: setting.square(setting.run(estimator, sensors))
        for name, estimator, sensors in estimators(setting)
    }


def table(squares: dict[str, Float]) -> dict[str, Value]:
    """Mean squared errors over k = 1 ... 100."""
    return prefixed("mse", {name: mean(square) for name, square in squares.items()})


def claims(setting: Setting, squares: dict[str, Float]) -> dict[str, Value]:
    """Ratios of mean squared errors that decide what the paper says of Figs. 4 and 5, and others."""
    found: dict[str, Value] = {}
    for form in FORMS:
        fused, locals_ = squares[f"{form}.fusion"], [squares[f"{form}.local {i}"] for i in WEAK]
        for number, local in zip(WEAK, locals_, strict=True):
            found[f"{form}.fusion over local {number}"] = ratio(fused, local)
        below = fused.mean(axis=0) < np.minimum(*(local.mean(axis=0) for local in locals_))
        found[f"{form}.below both"] = Value(float(below.mean()))
    for number in WEAK:
        local, choice = squares[f"printed.local {number}"], setting.config["baselines"]
        rivals = [f"augmented {q:g}" for q in choice["attack_noise"]]
        rivals += [f"zhang {forgetting:g}" for forgetting in choice["forgetting"]] + ["protected only"]
        for rival in rivals:
            found[f"local {number} over {rival}"] = ratio(local, squares[f"{rival}.local {number}"])
    at = [setting.config["simulation"]["impulse_at"] - 1]
    for rival in ("augmented 0", "zhang 0.95"):
        other = squares[f"{rival}.local 2"]
        found[f"local 2 over {rival} at impulse"] = ratio(squares["printed.local 2"][:, at], other[:, at])
    for name in ("printed.fusion", "exact.fusion", "exact.adaptive", "adaptive joint"):
        found[f"{name} over protected only"] = ratio(squares[name], squares["protected only"])
    found["auto over gate"] = ratio(squares["exact.auto"], squares["gate"])
    return prefixed("claim", found)


def theory(setting: Setting) -> dict[str, Value]:
    """The error that the Kalman filter of the protected sensors must have, whatever is injected."""
    y = setting.record.y[0]
    covariance = ProtectedKalman(setting.plant).run(y, prior=setting.prior).P
    assert covariance is not None
    return {"mse.protected only.exact": Value(float(np.trace(covariance, axis1=1, axis2=2).mean()))}


def fig2(setting: Setting) -> tuple[dict[tuple[str, float], Float], dict[str, Value]]:
    """Mean squared error of the estimate of theta_2 for every compensation factor."""
    choice, at = setting.config["fig2"], setting.config["simulation"]["impulse_at"] - 1
    channel = setting.plant.sensor_names.index("weak 2")
    quiet = np.arange(choice["from"] - 1, setting.config["simulation"]["steps"])
    quiet = quiet[quiet != at]
    curves: dict[tuple[str, float], Float] = {}
    found: dict[str, Value] = {}
    for form in FORMS:
        for eta in choice["eta"]:
            run = setting.run(setting.joint(form, eta, "weak 2"))
            square = (run.attack[..., channel] - setting.record.a[..., channel]) ** 2
            curves[form, eta] = square.mean(axis=0)
            for name, samples in {"quiet": quiet, "at": [at], "after": [at + 1]}.items():
                found[f"{form}.{eta:g}.{name}"] = mean(square[:, samples])
    return curves, prefixed("fig2", found)


def curves(setting: Setting, squares: dict[str, Float], attack: dict[tuple[str, float], Float]) -> Curves:
    """Everything the figures need."""
    state = {name: square.mean(axis=0) for name, square in squares.items()}
    fused = setting.run(setting.joint("printed")).x[0]
    return Curves(attack, state, setting.record.x[0], fused)
