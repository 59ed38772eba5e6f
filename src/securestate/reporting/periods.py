"""When a run's numbers did not mean what they say, in plain words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from securestate.estimators.base import Status
from securestate.reporting.clock import Moment
from securestate.reporting.episodes import END

if TYPE_CHECKING:
    from securestate.estimators.run import Run

_MEANING = {
    Status.NO_MEASUREMENT: (
        "nothing arrived that could be used, so the estimate is a prediction that gets worse with time; "
        "check the connection"
    ),
    Status.AMBIGUOUS: (
        "two ways to say who lies explain the readings about equally well; do not act on a name from this "
        "time before somebody has looked at the sensors"
    ),
    Status.MAJORITY_SUSPECT: (
        "more sensors were suspected than believed, of all or of those that see some part of the state, so "
        "that the believed ones may be the liars; look for a change of the plant that the model does not "
        "know before you blame a sensor"
    ),
    Status.COLD_START: (
        "no prior was given, so these samples were estimated together, each with the help of later ones; "
        "nothing is to be done"
    ),
}


@dataclass(frozen=True)
class Period:
    """All samples with one status other than OK.

    Attributes:
        status: its name.
        samples: how many there are.
        stretches: first and last sample of each stretch, in time; a few samples between do not end one.
        meaning: what it means and what to do, half a sentence.
    """

    status: str
    samples: int
    stretches: tuple[tuple[Moment, Moment], ...]
    meaning: str

    @property
    def longest(self) -> tuple[Moment, Moment]:
        """The stretch that lasts longest."""
        return max(self.stretches, key=lambda ends: ends[1].index - ends[0].index)


def periods(run: Run) -> tuple[Period, ...]:
    """One period for each status other than OK, the most frequent first."""
    codes, counts = np.unique(run.status[run.status != Status.OK], return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return tuple(_period(run, Status(int(codes[k]))) for k in order)


def meaning(status: Status) -> str:
    """What a status means and what to do, half a sentence."""
    said = _MEANING.get(status, status.advice.rstrip("."))
    return said[:1].lower() + said[1:]


def _period(run: Run, status: Status) -> Period:
    at = np.flatnonzero(run.status == status)
    cuts = np.flatnonzero(np.diff(at) > END)
    begins, ends = at[np.concatenate([[0], cuts + 1])], at[np.concatenate([cuts, [at.size - 1]])]
    stretches = tuple(
        (Moment.of(run, b), Moment.of(run, e)) for b, e in zip(begins.tolist(), ends.tolist(), strict=True)
    )
    return Period(status.name, int(at.size), stretches, meaning(status))
