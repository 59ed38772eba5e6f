"""When a sensor was suspected: single alarms of one sensor joined to episodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import stats

if TYPE_CHECKING:
    from securestate.estimators.run import Run

WINDOW = 20
"""A sensor lies if half of some WINDOW samples it sent in a row were suspected."""

PAUSE = 2 * WINDOW
"""So many samples in a row without suspicion always end an episode; fewer, if they outweigh a part of it."""

END = WINDOW // 2
"""An episode lasts until the end if fewer samples than that came after it."""

IDLE = 0.25
"""What a sample without suspicion takes from an episode; one with suspicion gives 1."""

Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class Episode:
    """A stretch of the samples of one sensor, from its first suspected sample to its last.

    Attributes:
        start: its first sample.
        stop: its last sample, included.
        suspected: how many of its samples were suspected.
        sent: how many arrived.
        persistent: at least half of some WINDOW samples in a row were suspected.
        until_end: fewer than END samples of this sensor arrived after it.
    """

    start: int
    stop: int
    suspected: int
    sent: int
    persistent: bool
    until_end: bool

    @property
    def share(self) -> float:
        """How many of the samples that arrived were suspected, in [0, 1]."""
        return self.suspected / self.sent

    def by_chance(self, rate: float, samples: int) -> float:
        """How many episodes as dense as this one, of an honest sensor, to expect in so many samples.

        Alarms of honest sensors are taken as independent of each other.

        Examples:
            >>> one = Episode(70, 72, suspected=2, sent=3, persistent=False, until_end=False)
            >>> f"{one.by_chance(1e-3, samples=10_000):.3f}"
            '0.020'
        """
        again = stats.binom.sf(self.suspected - 2, self.sent - 1, rate) if self.sent > 1 else 1.0
        return float(samples * rate * again)


def episodes(suspected: Bool, sent: Bool) -> list[Episode]:
    """Episodes of one sensor, in time; single alarms are episodes of one sample.

    Samples that did not arrive do not count, neither as suspected nor as time that passes. A suspected sample
    gives 1, another one takes IDLE; an episode is a stretch whose sum no shorter or longer one between two
    pauses exceeds (ruzzo1999), so that an alarm shortly before a lie does not date it.

    Args:
        suspected: (T,).
        sent: whether something arrived, (T,).
    Examples:
        >>> suspected = np.zeros(60, bool)
        >>> suspected[[3, 20, 21, 22, 24, 25, 50]] = True
        >>> [(e.start, e.stop, e.suspected, e.sent) for e in episodes(suspected, np.ones(60, bool))]
        [(3, 3, 1, 1), (20, 25, 5, 6), (50, 50, 1, 1)]
    """
    index = np.flatnonzero(sent | suspected)
    flags = suspected[index]
    width = min(WINDOW, flags.size)
    return [
        Episode(
            start=int(index[first]),
            stop=int(index[last]),
            suspected=int(flags[first : last + 1].sum()),
            sent=last + 1 - first,
            persistent=_persistent(flags[first : last + 1], width),
            until_end=flags.size - 1 - last < END,
        )
        for first, last in _stretches(flags)
    ]


def silent(run: Run, i: int) -> Bool:
    """Where a sensor sent nothing, (T,): no channel has an innovation or, in a cold start, an injection.

    A trust of NaN alone does not say so: what arrived may be impossible to check.
    """
    own = run.plant.channels_of(i)
    unheard = np.isnan(run.innovation[:, own]) & np.isnan(run.attack[:, own])
    nothing: Bool = np.isnan(run.trust[:, i]) & unheard.all(axis=1)
    return nothing


def _persistent(flags: Bool, width: int) -> bool:
    """Whether half of some `width` samples in a row were suspected; beyond the ends nobody is."""
    total = np.concatenate([[0], np.cumsum(flags)])
    most = total[-1] if flags.size <= width else np.max(total[width:] - total[:-width])
    return bool(2 * most >= width)


def _stretches(flags: Bool) -> list[tuple[int, int]]:
    """First and last position of every stretch of largest sum."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    begins, ends = edges[::2], edges[1::2]
    found: list[tuple[int, int]] = []
    first = 0
    for k in range(1, begins.size + 1):
        if k == begins.size or begins[k] - ends[k - 1] >= PAUSE:
            found += _largest(begins[first:k].tolist(), ends[first:k].tolist())
            first = k
    return found


def _largest(begins: list[int], ends: list[int]) -> list[tuple[int, int]]:
    """All maximal scoring stretches of runs [begin, end) of alarms (Ruzzo and Tompa 1999)."""
    kept: list[tuple[float, float, int, int, int]] = []  # sum before, sum at the end, ends, see `_below`
    total, past = 0.0, begins[0]
    for begin, end in zip(begins, ends, strict=True):
        before, first = total - IDLE * (begin - past), begin
        total, past = before + (end - begin), end
        below = _below(kept, before)
        while below >= 0 and kept[below][1] < total:
            before, first = kept[below][0], kept[below][2]
            del kept[below:]
            below = _below(kept, before)
        kept.append((before, total, first, end - 1, below))
    return [(first, last) for _, _, first, last, _ in kept]


def _below(kept: list[tuple[float, float, int, int, int]], sum_before: float) -> int:
    """The last stretch that begins at a smaller sum, or -1; each one knows its own."""
    k = len(kept) - 1
    while k >= 0 and kept[k][0] >= sum_before:
        k = kept[k][4]
    return k
