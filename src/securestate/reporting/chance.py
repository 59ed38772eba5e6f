"""Whether chance explains an episode: by the stated rate, by the way alarms cluster, by what is injected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from securestate.estimators.base import Status
from securestate.reporting.episodes import WINDOW, Episode

if TYPE_CHECKING:
    from securestate.estimators.run import Run

RARE = 0.01
"""A brief episode is told if honest sensors would give fewer than so many in the whole run."""

CHAINED, ALARMS = 1, 4
"""Before any is seen: of ALARMS alarms of an honest sensor so many are taken to follow another one."""

REMEMBERING = ("SecureFilter",)
"""Estimators that go on suspecting whom they suspected, so that many suspected samples may rest on few."""

LONG = 10 * WINDOW
"""So many samples in a row no honest sensor is suspected by its own past alone."""


@dataclass(frozen=True)
class Chance:
    """What honest sensors do in a run.

    A method with a memory that errs once errs again soon, so that its false alarms are as many as stated but
    not independent. How often one follows another is taken from the brief episodes of the other sensors.

    Attributes:
        rate: false alarms per sample of an honest sensor, or None if it is not stated.
        samples: samples of all sensors together.
        alarms: how many there are in episodes that do not persist, per sensor, (N,).
        episodes: how many such episodes there are, (N,).
    """

    rate: float | None
    samples: int
    alarms: NDArray[np.int_]
    episodes: NDArray[np.int_]

    @classmethod
    def of(
        cls, each: Sequence[tuple[int, Episode]], sensors: int, samples: int, rate: float | None
    ) -> Chance:
        """From all episodes of a run, each with the number of its sensor."""
        brief = [(i, e.suspected) for i, e in each if not e.persistent]
        who = np.array([i for i, _ in brief], dtype=int)
        size = np.array([k for _, k in brief], dtype=int)
        alarms = np.bincount(who, size, sensors).astype(int)
        return cls(rate, samples, alarms, np.bincount(who, minlength=sensors))

    def explains(self, sensor: int, episode: Episode) -> bool:
        """Whether RARE or more episodes like this one are expected of honest sensors.

        Examples:
            >>> alone = Chance(1e-3, 10_000, alarms=np.array([5, 0]), episodes=np.array([1, 0]))
            >>> row = lambda k: Episode(70, 69 + k, suspected=k, sent=k, persistent=False, until_end=False)
            >>> [alone.explains(0, row(k)) for k in (2, 4, 5)]
            [True, True, False]
            >>> usual = Chance(1e-3, 10_000, alarms=np.array([5, 40]), episodes=np.array([1, 10]))
            >>> usual.explains(0, row(5))
            True
        """
        if self.rate is not None and episode.by_chance(self.rate, self.samples) >= RARE:
            return True
        alarms = int(self.alarms.sum() - self.alarms[sensor])
        others = int(self.episodes.sum() - self.episodes[sensor])
        again = (alarms - others + CHAINED) / (alarms + ALARMS)
        return float((others + 1) * again ** (episode.suspected - 1)) >= RARE


def faint(run: Run, sensor: int, episode: Episode) -> bool:
    """Whether a persistent episode may be one error that an estimator remembered.

    It may if it is not LONG, and what the sensor injects never is further from zero, in units of
    `Run.attack_std`, than RARE such records of honest sensors show anywhere: with one trial for every reading
    and for every one of the WINDOW samples before it at which the lie may have begun.
    """
    if run.estimator not in REMEMBERING or not episode.persistent or episode.sent >= LONG:
        return False
    own, rows = run.plant.channels_of(sensor), slice(episode.start, episode.stop + 1)
    injected, error = np.abs(run.attack[rows, own]), run.attack_std[rows, own]
    known = run.suspected[rows, sensor][:, None] & np.isfinite(injected) & (error > 0)
    limit = stats.norm.isf(RARE / (2 * WINDOW * run.innovation.size))
    return bool(known.any()) and bool(np.max(injected[known] / error[known]) < limit)


def carried_over(run: Run, episode: Episode, start: int) -> bool:
    """Whether an episode may be left of a start away from the true state, that an estimator remembered.

    It may if it begins within `start` samples, is not LONG, and no cold start preceded it.
    """
    begun = run.estimator in REMEMBERING and run.status[0] != Status.COLD_START
    return begun and episode.start < start and episode.sent < LONG
