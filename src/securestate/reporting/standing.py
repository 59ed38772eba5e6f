"""Who stands where in a comparison: who ran everywhere, who leads, where nobody gets near the oracle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from securestate._words import count, enumerate_names
from securestate.reporting.page import compact

if TYPE_CHECKING:
    import pandas as pd

    from securestate.simulation import Comparison

NEAR = 1.5
"""An estimator with at most so many times the oracle's squared error is near it."""

FAR = 3.0
"""Where every estimator has more than that, nothing works."""


@dataclass(frozen=True, eq=False)
class Standing:
    """A comparison as a reader asks about it.

    Attributes:
        oracle: the yardstick.
        ratio: of the others to the oracle, scenario by estimator; NaN where one of the two could not run.
        measured: scenarios in which the oracle runs.
        ranked: estimators that run in all of these, best first.
        partial: the others.
        mean: geometric mean of the ratio over the scenarios where an estimator runs.
        tied: ranked estimators that the runs do not tell from the best: their 95 % intervals overlap.
    """

    oracle: str
    ratio: pd.DataFrame
    measured: tuple[str, ...]
    ranked: tuple[str, ...]
    partial: tuple[str, ...]
    mean: Mapping[str, float]
    tied: tuple[str, ...]

    @classmethod
    def of(cls, comparison: Comparison) -> Standing:
        """Sort the estimators of a comparison; its first one is the oracle."""
        oracle, *others = comparison.table["estimator"].to_numpy().tolist()
        ratio, order = frame_of(comparison, "ratio"), comparison.ranking
        measured = tuple(ratio.index[ratio[oracle].notna()])
        names = [name for name in order.index if name in others]
        ranked = tuple(n for n in names if measured and order["scenarios"][n] == len(measured))
        partial = tuple(n for n in names if n not in ranked)
        mean = {str(name): float(value) for name, value in order["ratio"].items()}
        return cls(oracle, ratio[others], measured, ranked, partial, mean, _tied(comparison, ranked, mean))

    @property
    def best(self) -> tuple[str, ...]:
        """The first of those that are ranked, with those whose mean looks the same in print."""
        return tuple(n for n in self.ranked if compact(self.mean[n]) == compact(self.mean[self.ranked[0]]))

    def where_it_runs(self, name: str) -> tuple[int, float, float]:
        """In how many measured scenarios an estimator runs, its geometric mean there, and the best's."""
        there = self.ratio.loc[list(self.measured)].dropna(subset=[name])
        with np.errstate(all="ignore"):
            own, best = (float(np.exp(np.log(there[n]).mean())) for n in (name, self.ranked[0]))
        return len(there), own, best

    def beyond(self, limit: float) -> tuple[str, ...]:
        """Scenarios in which no estimator comes within `limit` times the oracle's squared error."""
        return tuple(name for name in self.measured if not (self.ratio.loc[name] <= limit).any())

    @property
    def headline(self) -> str:
        """What came out, in at most two sentences."""
        if not len(self.ratio.columns):
            return "Only the oracle was run: there is nothing to compare."
        if not self.measured:
            return "The oracle runs in no scenario: there is nothing to measure the others by."
        return f"{_closest(self)} {_nobody(self)}".strip()


def frame_of(comparison: Comparison, figure: str) -> pd.DataFrame:
    """One figure, scenario by estimator."""
    import pandas as pd

    values = comparison.table[figure]
    return pd.DataFrame(
        values.to_numpy(), index=list(values["scenario"].values), columns=list(values["estimator"].values)
    )


def _tied(comparison: Comparison, ranked: tuple[str, ...], mean: Mapping[str, float]) -> tuple[str, ...]:
    """Scenarios may share their noise, so the half widths are averaged as if all moved together."""
    with np.errstate(all="ignore"):
        width = np.log(frame_of(comparison, "ratio_high") / frame_of(comparison, "ratio"))
        factor = {name: float(np.exp(width[name].mean())) for name in ranked}
    return tuple(n for n in ranked[1:] if mean[n] / factor[n] <= mean[ranked[0]] * factor[ranked[0]])


def _closest(s: Standing) -> str:
    scenarios = count(len(s.measured), "scenario")
    if not s.ranked:
        most = s.ratio.notna().sum().max()
        return (
            f"No estimator runs in all of {scenarios}; at best one runs in {most}."
            if most
            else (f"No estimator can run in any of {scenarios}.")
        )
    if not np.isfinite(s.mean[s.ranked[0]]):
        return f"Every estimator that runs in all of {scenarios} diverges in at least one."
    over = "" if len(s.measured) == 1 else f" in the geometric mean over {scenarios}"
    times = f"{compact(s.mean[s.ranked[0]])} times"
    if len(s.ranked) == 1:
        only = f", the only estimator that runs in all {scenarios}," if s.partial else ""
        return f"{s.ranked[0]}{only} has {times} the oracle’s squared error{over if not only else ''}."
    come = "comes" if len(s.best) == 1 else "come"
    closest = f"{enumerate_names(s.best)} {come} closest to the oracle: {times} its squared error"
    if s.partial:
        return f"Of those that run in all {scenarios}, {closest} in the geometric mean."
    return f"{closest}{over}."


def _nobody(s: Standing) -> str:
    """In how many scenarios nobody is near, and in how many everybody is far."""
    off, far, several = s.beyond(NEAR), s.beyond(FAR), len(s.measured) > 1
    if not off:
        return f"In every scenario some estimator comes within {NEAR:g} times." if several else ""
    if not several:
        return f"No estimator comes within {FAR if far else NEAR:g} times."
    if not far:
        return (
            f"In {len(off)} no estimator comes within {NEAR:g} times, but in all some comes within {FAR:g}."
        )
    if len(far) == len(off):
        return f"In {len(far)} no estimator comes within {FAR:g} times."
    return (
        f"In {len(off)} no estimator comes within {NEAR:g} times, in {len(far)} of these none within {FAR:g}."
    )
