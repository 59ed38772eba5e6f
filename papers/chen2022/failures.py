"""Where the printed recursion stops being one of covariances: missing readings, and a factor that changes."""

from __future__ import annotations

import numpy as np

from papers._report import Value
from papers.chen2022.setting import FORMS, Float, Setting
from securestate import JointFusion, Status, simulate


def dropouts(setting: Setting) -> dict[str, Value]:
    """Share of runs that break down when readings are missing at random, and when it happens first."""
    choice, runs = setting.config["dropouts"], setting.scale["dropouts"]
    y = simulate(setting.plant, choice["steps"], seed=choice["seed"], runs=runs, prior=setting.prior).y
    rng = np.random.default_rng(choice["seed"])
    y = np.where(rng.random(y.shape) < choice["share"], np.nan, y)
    found: dict[str, Value] = {}
    for form in FORMS:
        for eta in choice["eta"]:
            broken = _broken(setting, setting.joint(form, eta), y)
            share = float(broken.any(axis=1).mean())
            found[f"dropouts.{form}.{eta:g}"] = Value(share, float(np.sqrt(share * (1 - share) / runs)))
            if share:
                found[f"dropouts.{form}.{eta:g}.first"] = _first(broken)
    return found


def _first(broken: np.ndarray) -> Value:
    """Mean k at which the runs that break down do so."""
    k = broken[broken.any(axis=1)].argmax(axis=1) + 1
    return Value(float(k.mean()), float(k.std(ddof=1) / np.sqrt(len(k))))


def _broken(setting: Setting, estimator: JointFusion, y: Float) -> np.ndarray:
    """Where the status says that a covariance is none any more, (runs, T)."""
    status = estimator.run(y, prior=setting.prior, covariance=False).status
    return status == Status.BROKEN_DOWN


def step(setting: Setting) -> dict[str, Value]:
    """The k at which the recursion breaks down when the factor falls, 0 if never; no chance in it."""
    choice = setting.config["step"]
    eta = np.repeat(choice["eta"], [choice["at"], choice["steps"] - choice["at"]])
    found: dict[str, Value] = {}
    for form in FORMS:
        estimator = JointFusion(
            setting.plant, eta=np.stack([eta, eta], axis=1), form=form, pairing=setting.pairing
        )
        broken = np.flatnonzero(estimator.moments(choice["steps"], setting.prior).broken)
        found[f"step.{form}"] = Value(float(broken[0] + 1) if len(broken) else 0.0)
    return found
