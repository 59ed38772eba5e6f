"""What only a simulation tells: every estimator under every attack, each run with a plant of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from papers._report import Value
from papers._statistics import Float, mean, prefixed, ratio
from papers.zhu2022 import methods
from papers.zhu2022.setting import Setting, confront, stacked
from securestate import simulate

#: Squared error of every estimator under every attack, (runs, T) each.
Squares = dict[tuple[str, str], Float]

#: From this mean squared error on a run counts as lost.
LOST = 1e6

#: Estimators that no run loses when the attacker mirrors readings about what they expect (26f).
STEADY = (
    "oracle",
    "kalman",
    "chi2 sensor",
    "mixture 0.45",
    "mixture 0.65",
    "repaired",
    *methods.INNOVATION,
)

#: Pairs of estimators, by attack, whose ratio of mean squared errors decides a claim.
CLAIMS = {
    "25": [
        ("mixture 0.45", "mixture none"),
        ("mixture 0.45", "mixture 0.15"),
        ("mixture 0.45", "mixture 0.95"),
        ("mixture 0.65", "mixture 0.15"),
        ("mixture 0.65", "mixture 0.95"),
        ("mixture 0.45", "chi2 sensor"),
        ("mixture 0.45", "gate"),
        ("median 0.45", "median none"),
    ],
    "26": [
        ("mixture 0.45", "chi2 sensor"),
        ("mixture 0.45", "chi2 central"),
        ("mixture 0.65", "chi2 sensor"),
        ("repaired 0.5", "repaired"),
    ],
    "26c": [("mixture 0.65", "kalman")],
    "none": [("mixture 0.45", "kalman")],
}


def errors(setting: Setting) -> Squares:
    """Squared errors at the scored samples of all runs."""
    work = partial(_run, setting, methods.table(setting), tuple(setting.attacks))
    return _scored(setting, setting.each(work, range(setting.scale["plants"])))


def _run(
    setting: Setting, designs: dict[str, methods.Design], attacks: tuple[str, ...], number: int
) -> Squares:
    chosen = {key: setting.attacks[key] for key in attacks}
    return confront(setting.draw(number), designs, chosen, setting.steps, setting.seed, number)


def _scored(setting: Setting, parts: list[Squares]) -> Squares:
    return {key: square[:, setting.start :] for key, square in stacked(parts).items()}


def table(squares: Squares) -> dict[str, Value]:
    """Mean squared errors that have a mean worth stating; (22d) as printed is in `literal`."""
    found = {
        f"{attack}.{name}": mean(square)
        for (attack, name), square in squares.items()
        if name != "literal" and (attack != "26f" or name in STEADY)
    }
    return prefixed("mse", found)


def starts(setting: Setting) -> dict[str, Value]:
    """Mean squared errors under (25) by where mu_1 starts and by threshold."""
    work = partial(_run, setting, methods.starts(setting), ("25",))
    squares = _scored(setting, setting.each(work, range(setting.scale["starts"])))
    return prefixed("starts", {name: mean(square) for (_, name), square in squares.items()})


def claims(squares: Squares) -> dict[str, Value]:
    """Ratios of mean squared errors: what the paper says, what it does not, and distances from the oracle."""
    found = {
        f"{attack}.{one} over {other}": ratio(squares[attack, one], squares[attack, other])
        for attack, pairs in CLAIMS.items()
        for one, other in pairs
    }
    for attack, name in squares:
        if name in methods.INNOVATION:
            found[f"{attack}.{name} over oracle"] = ratio(squares[attack, name], squares[attack, "oracle"])
    return prefixed("claim", found)


def literal(squares: Squares) -> dict[str, Value]:
    """(22d) as printed, told in a way that a few runs cannot decide."""
    found: dict[str, Value] = {}
    for attack in ("25", "26", "26c", "none"):
        per_run = squares[attack, "literal"].mean(axis=1)
        worse = per_run > squares[attack, "mixture none"].mean(axis=1)
        found[f"{attack}.median"] = _median(np.log10(per_run))
        found[f"{attack}.lost"] = mean((per_run > LOST)[:, np.newaxis])
        found[f"{attack}.worse"] = mean(worse[:, np.newaxis])
    return prefixed("literal", found)


def _median(values: Float) -> Value:
    """Median; its standard error comes from the order statistics half a standard error of the rank away."""
    reach = 0.5 / np.sqrt(len(values))
    low, high = np.quantile(values, [0.5 - reach, 0.5 + reach])
    return Value(float(np.median(values)), float(high - low) / 2)


@dataclass(frozen=True)
class Path:
    """One run under one attack from the first attacked sample on.

    Attributes:
        x: the state, (T,). estimates: by estimator, (T,) each. attacked: how many sensors lie, (T,).
    """

    x: Float
    estimates: dict[str, Float]
    attacked: Float


@dataclass(frozen=True)
class Curves:
    """What the figures show.

    Attributes:
        start: index of the first sample shown.
        paths: by attack. squares: mean squared error over k, by attack and estimator, (T,) each.
    """

    start: int
    paths: dict[str, Path]
    squares: dict[tuple[str, str], Float]


def curves(setting: Setting, squares: Squares) -> Curves:
    """Everything the figures need; the trajectories are those of the first run."""
    means = {key: square.mean(axis=0) for key, square in squares.items()}
    return Curves(setting.start, {attack: _path(setting, attack) for attack in ("25", "26")}, means)


def _path(setting: Setting, attack: str) -> Path:
    plant, shown = setting.draw(0), slice(setting.start, None)
    trajectory = simulate(plant, setting.steps, setting.attacks[attack], seed=setting.seed)
    estimates = {
        name: trajectory.confront(design(plant))[0].x[0, shown, 0]
        for name, design in methods.table(setting).items()
    }
    return Path(trajectory.x[0, shown, 0], estimates, trajectory.attacked[0, shown].sum(axis=-1))
