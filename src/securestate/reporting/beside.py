"""Two estimators of the same record side by side: how sure each is, and how far apart they are."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from securestate.errors import InputError
from securestate.reporting.page import compact, table

if TYPE_CHECKING:
    from securestate.estimators.run import Run

HEAD = ("State", "Deviation here", "Deviation beside", "Difference (RMS)", "Largest difference", "At sample")


@dataclass(frozen=True)
class StateBeside:
    """One state. Deviations are medians over the run; differences are in deviations of the one beside."""

    name: str
    deviation: float
    deviation_beside: float
    rms: float
    largest: float
    sample: int


@dataclass(frozen=True)
class Beside:
    """A run and another one of the same record."""

    estimator: str
    beside: str
    states: tuple[StateBeside, ...]

    @property
    def sentence(self) -> str:
        """How the two compare, in one sentence.

        Examples:
            >>> one = StateBeside("level", 0.2, 0.3, 0.5, 2.0, 7)
            >>> print(Beside("JointFusion", "ProtectedKalman", (one,)).sentence)
            Beside it ProtectedKalman: JointFusion's total variance is 0.44 of its; they differ by 0.50 \
of its deviations (RMS), at most 2.00 (level, sample 7).
        """
        here = sum(state.deviation**2 for state in self.states)
        there = sum(state.deviation_beside**2 for state in self.states)
        rms = float(np.sqrt(np.mean([state.rms**2 for state in self.states])))
        worst = max(self.states, key=lambda state: state.largest)
        return (
            f"Beside it {self.beside}: {self.estimator}'s total variance is {here / there:.2f} of its; they "
            f"differ by {rms:.2f} of its deviations (RMS), at most {worst.largest:.2f} ({worst.name}, "
            f"sample {worst.sample})."
        )


def compare_runs(run: Run, other: Run) -> Beside:
    """Compare a run with another of the same record.

    Raises:
        InputError: the other run has another length or another plant.
    """
    if other.x.shape != run.x.shape or other.plant is not run.plant:
        raise InputError("beside", f"a run of the same plant and {len(run.x)} samples", repr(other))
    gap = np.abs(run.x - other.x) / np.where(other.x_std > 0, other.x_std, np.nan)
    gap = np.where(np.isfinite(gap), gap, 0.0)
    at = np.argmax(gap, axis=0)
    return Beside(
        run.estimator,
        other.estimator,
        tuple(
            StateBeside(
                name,
                float(np.median(run.x_std[:, i])),
                float(np.median(other.x_std[:, i])),
                float(np.sqrt(np.mean(gap[:, i] ** 2))),
                float(gap[at[i], i]),
                int(at[i]),
            )
            for i, name in enumerate(run.plant.state_names)
        ),
    )


def section(both: Beside | None) -> str:
    """The comparison as HTML; empty without one."""
    if both is None:
        return ""
    rows = [
        "<tr>"
        + "".join(f'<td data-label="{head}">{cell}</td>' for head, cell in zip(HEAD, cells, strict=True))
        + "</tr>"
        for cells in (
            (
                escape(state.name),
                compact(state.deviation),
                compact(state.deviation_beside),
                compact(state.rms),
                compact(state.largest),
                f'<button class="go" data-sample="{state.sample}">{state.sample}</button>',
            )
            for state in both.states
        )
    ]
    legend = (
        f'<p class="legend"><span><span class="key accent"></span>{escape(both.estimator)}</span>'
        f'<span><span class="key beside"></span>{escape(both.beside)}</span></p>'
    )
    hint = '<p class="hint">Differences are in standard deviations of the estimate beside.</p>'
    return f"{legend}<p>{escape(both.sentence)}</p>{table(HEAD, rows)}{hint}"
