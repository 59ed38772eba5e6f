"""The estimators that are compared, as functions from a plant to an estimator."""

from __future__ import annotations

from functools import partial
from typing import Any

from papers.zhu2022.setting import Design, Setting
from securestate import (
    ChiSquareFilter,
    InnovationGate,
    InnovationMixture,
    KalmanFilter,
    MixtureFusion,
    OracleFilter,
)

#: The smallest change that mends Algorithm 1: nothing is remembered, (18) maximises, Sigma_2 is bounded.
REPAIRS: dict[str, Any] = {"init": "median", "mean": "precision", "floor": "prior", "feedback": True}

PLAIN: dict[str, Any] = {"kappa": 4.0, "forgetting": 0.97, "memory": "doubt", "merge": False}

#: As it comes; and its two forms with the settings of the independent program in expected.json.
INNOVATION: dict[str, Design] = {
    "innovation": InnovationMixture,
    "innovation plain": partial(InnovationMixture, **PLAIN),
    "innovation belief": partial(InnovationMixture, form="belief", **PLAIN),
}


def mixture(setting: Setting, epsilon: float | None, **choice: Any) -> Design:
    """Algorithm 1; gammahat in (22d) unless literal."""
    settings = {"cap": setting.config["mixture"]["cap"]} | choice
    return partial(MixtureFusion, epsilon=epsilon, start=setting.start, **settings)


def thresholds(setting: Setting) -> dict[str, float | None]:
    """No compensator, and the thresholds of Figs. 5 and 6, by name."""
    return {"none": None} | {f"{epsilon:g}": epsilon for epsilon in setting.config["mixture"]["epsilon"]}


def table(setting: Setting) -> dict[str, Design]:
    """Every row of the table of mean squared errors."""
    return {
        "oracle": OracleFilter,
        "kalman": KalmanFilter,
        "chi2 sensor": ChiSquareFilter,
        "chi2 central": partial(ChiSquareFilter, scope="central"),
        "chi2 drop worst": partial(ChiSquareFilter, scope="central", on_alarm="drop-worst"),
        "gate": InnovationGate,
        **{f"mixture {name}": mixture(setting, epsilon) for name, epsilon in thresholds(setting).items()},
        "literal": mixture(setting, 0.45, literal=True),
        **{f"median {name}": mixture(setting, thresholds(setting)[name], init="median") for name in MEDIAN},
        "repaired": mixture(setting, None, **REPAIRS),
        "repaired 0.5": mixture(setting, 0.5, **REPAIRS),
        **INNOVATION,
    }


#: Thresholds that the table shows for the median start.
MEDIAN = ("none", "0.45", "0.65")


def starts(setting: Setting) -> dict[str, Design]:
    """Every start of mu_1 with every threshold."""
    choice = setting.config["starts"]
    return {
        f"{init} {name}": mixture(setting, epsilon, init=init, cap=choice["cap"])
        for init in choice["init"]
        for name, epsilon in thresholds(setting).items()
    }


def partly(setting: Setting) -> dict[str, Design]:
    """Those that meet sensors which see one axis each."""
    names = (
        "oracle",
        "kalman",
        "chi2 sensor",
        "gate",
        "mixture none",
        "mixture 0.45",
        "mixture 0.65",
        "repaired",
    )
    everything = table(setting)
    return {name: everything[name] for name in names} | INNOVATION
