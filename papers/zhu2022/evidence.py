"""Why Algorithm 1 does what it does: what can be computed or counted about its parts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from papers._report import Value
from papers._statistics import Float, mean, prefixed
from papers.zhu2022 import em
from papers.zhu2022.methods import mixture
from papers.zhu2022.setting import Setting
from securestate import KalmanFilter, Plant, simulate
from securestate.attacks import NoiseLinear, Redrawn


def exact(setting: Setting) -> dict[str, Value]:
    """Numbers that each plant has without simulating it, averaged over plants."""
    plants = [setting.draw(number) for number in range(setting.scale["plants"])]
    parts = [_correlation(plant) for plant in plants]
    gains = [_gains(plant) for plant in plants]
    return {
        "evidence.correlation": mean(np.array(parts)[:, np.newaxis]),
        "evidence.swapped": mean(1 - np.array([before for before, _ in gains])[:, np.newaxis]),
        "evidence.kept": mean(1 - np.array([after for _, after in gains])[:, np.newaxis]),
    }


def _correlation(plant: Plant) -> float:
    """Mean correlation of the errors of two honest local filters; the process noise is common to them."""
    local = em.Local.of(plant)
    keeps = 1 - local.gain * local.C
    both = np.outer(keeps, keeps)
    covariance = both * plant.Q[0, 0] / (1 - plant.A[0, 0] ** 2 * both)
    correlation = covariance / np.sqrt(np.outer(local.P, local.P))
    return float(correlation[~np.eye(len(keeps), dtype=bool)].mean())


def _gains(plant: Plant) -> tuple[float, float]:
    """Sum of the gains on the state if (22d) believes nobody while (22c) believes all, and if both do."""
    steady = KalmanFilter(plant).steady
    assert steady is not None
    information = float(np.sum(plant.C[:, 0] ** 2 / np.diag(plant.R)))
    return float(steady.P_prior[0, 0]) * information, float(steady.P_posterior[0, 0]) * information


@dataclass(frozen=True)
class Counts:
    """What happens to the fits of one plant, as shares of its samples."""

    switched: float
    collapsed: float
    falls: float
    falls_precise: float


def counted(setting: Setting) -> dict[str, Value]:
    """How often labels switch, Sigma_2 collapses, the likelihood falls; by the number of attacked sensors."""
    found: dict[str, Value] = {}
    for attacked in setting.config["evidence"]["attacked"]:
        counts = setting.each(partial(_count, setting, attacked), range(setting.scale["evidence"]))
        for name in Counts.__annotations__:
            shares = np.array([getattr(count, name) for count in counts])
            found[f"{name}.{attacked}"] = mean(shares[:, np.newaxis])
    return prefixed("evidence", found)


def _count(setting: Setting, attacked: int, number: int) -> Counts:
    choice, (X, P) = setting.config["evidence"], _estimates(setting, attacked, number)
    printed = em.fit(X, P, choice["init"], choice["cap"])
    precise = em.fit(X, P, choice["init"], choice["cap"], precise=True)
    return Counts(
        switched=float(np.mean(printed.attacked > 0.5)),
        collapsed=float(np.mean(printed.variance < choice["collapsed"] * P.mean())),
        falls=float(printed.falls.mean()),
        falls_precise=float(precise.falls.mean()),
    )


def _estimates(setting: Setting, attacked: int, number: int) -> tuple[Float, Float]:
    """Local estimates of one plant at every scored sample, (T, N), and their variances, (N,).

    Each is attacked for the first time, by (25): the filters heard clean readings until then.
    """
    plant = setting.draw(number)
    attack = NoiseLinear(on=Redrawn(attacked), start=setting.start) if attacked else None
    trajectory = simulate(plant, setting.steps, attack, seed=setting.seed, first_run=number)
    local = em.Local.of(plant)
    X = local.update(local.predict(trajectory.clean[0]), trajectory.y[0])
    return X[setting.start :], local.P


def same_beliefs(setting: Setting) -> dict[str, Value]:
    """Whether the package's beliefs are those of the plain lines, on a run under (25)."""
    plant, start = setting.draw(0), setting.start
    trajectory = simulate(plant, setting.steps, setting.attacks["25"], seed=setting.seed)
    local = em.Local.of(plant)
    X = local.update(local.predict(trajectory.y[0]), trajectory.y[0])[start:]
    found = {}
    for init in ("split", "median", "mean"):
        plain = em.fit(X, local.P, init, setting.config["starts"]["cap"])
        design = mixture(setting, None, init=init, cap=setting.config["starts"]["cap"])
        run, _ = trajectory.confront(design(plant))
        found[f"evidence.same.{init}"] = Value(float(np.abs(run.trust[0, start:] - plain.belief).max()))
    return found
