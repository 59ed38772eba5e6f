"""What a run says of its sensors: who lies, from when to when, how much, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from securestate.errors import InputError
from securestate.estimators.base import Status
from securestate.reporting.chance import Chance, carried_over, faint
from securestate.reporting.clock import Moment
from securestate.reporting.courses import Course, courses
from securestate.reporting.episodes import Episode, episodes, silent
from securestate.reporting.periods import Period, periods

if TYPE_CHECKING:
    from securestate.estimators.run import Run

Bool = NDArray[np.bool_]

BY_PROTECTED = (
    *("AdaptiveJointFilter", "AdaptiveKalman", "AugmentedKalman"),
    *("JointFusion", "ProtectedKalman", "SecureFilter"),
)
"""Estimators in which protected sensors judge the others, so that a majority of these may lie."""

START = 10
"""Samples in which a filter that starts at a wrong state may suspect anybody."""

FEWEST = 3
"""Fewer isolated alarms of one sensor are never too many."""

MANY = 3
"""Fewer sensors that are suspected at once for a short time are no jump of the plant."""


@dataclass(frozen=True)
class Finding:
    """One episode in which one sensor was suspected.

    Attributes:
        sensor: its name.
        since: the first suspected sample.
        until: the last one.
        ongoing: it lasts until the last samples of this sensor.
        persistent: the sensor lies: at least half of some 20 samples in a row that it sent were suspected.
            Otherwise it is a brief episode, of more alarms than chance explains.
        together: most of the time at least half of all sensors were suspected at once, so that none of them
            can be blamed.
        faint: what it injects stands out of its error no more than honest sensors do now and then, so that it
            cannot be blamed although it was suspected for long (`chance.faint`).
        suspected: how many samples were suspected.
        sent: how many arrived from `since` to `until`.
        expected: how many of these would be suspected by chance; None if the method states no rate.
        trust: its mean over these samples; NaN if there is none.
        courses: what the sensor adds to each of its channels.
    """

    sensor: str
    since: Moment
    until: Moment
    ongoing: bool
    persistent: bool
    together: bool
    faint: bool
    suspected: int
    sent: int
    expected: float | None
    trust: float
    courses: tuple[Course, ...]

    @property
    def lies(self) -> bool:
        """Whether this sensor can be blamed."""
        return self.persistent and not self.together and not self.faint

    @property
    def verdict(self) -> str:
        """One word: "lies", until the end, or "lied"; "contradicts" or "faint" without blame; "brief"."""
        if not self.persistent:
            return "brief"
        if self.faint and not self.together:
            return "faint"
        return "contradicts" if self.together else "lies" if self.ongoing else "lied"

    @property
    def certainty(self) -> float:
        """Mean distrust while it was judged, or the share of suspected samples, in [0, 1]."""
        return self.suspected / self.sent if np.isnan(self.trust) else 1.0 - self.trust

    @property
    def clear(self) -> bool:
        """Whether some injection stands out of its own scatter."""
        return any(c.known and c.clear for c in self.courses)

    @property
    def size(self) -> float:
        """The largest injection in standard deviations of the noise of its channel; 0 if unknown."""
        return max((c.in_noise for c in self.courses), default=0.0)


@dataclass(frozen=True)
class Crowd:
    """A stretch in which at least half of the sensors were suspected at once."""

    since: Moment
    until: Moment
    sensors: tuple[str, ...]
    persistent: bool


@dataclass(frozen=True)
class Alarms:
    """Alarms that are no finding.

    Attributes:
        count: how many, outside of findings.
        rate: false alarms per sample of an honest sensor, as the method states; None if it does not.
        expected: how many this leads to expect.
        frequent: sensors with many more of them than that, and how many.
        settled: the first sample after the start.
        at_start: sensors suspected before it more than once in a row, and how often; not counted above.
    """

    count: int
    rate: float | None
    expected: float | None
    frequent: tuple[tuple[str, int], ...]
    settled: int
    at_start: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class Findings:
    """What a run says: `found`, what matters most first; `crowds` and `periods` in time."""

    found: tuple[Finding, ...]
    crowds: tuple[Crowd, ...]
    alarms: Alarms
    periods: tuple[Period, ...]

    def of(self, sensor: str) -> tuple[Finding, ...]:
        """The findings about one sensor, what matters most first."""
        return tuple(f for f in self.found if f.sensor == sensor)


def find(run: Run) -> Findings:
    """Say who lies, since when, how much, and how sure that is.

    Alarms of a sensor with at most a few samples between them are one episode (`episodes`). An episode is a
    finding if it is persistent, or if chance does not explain it (`Chance`): neither the stated rate of false
    alarms (`settings["false_alarm_rate"]`), if there is one, nor the way in which brief alarms of other
    sensors cluster. Findings that are certain and large come first, those that are brief, blame nobody, or do
    not stand out of their scatter, last.

    Args:
        run: one run, x of shape (T, n).
    Raises:
        InputError: names `run` if it is a batch of runs or holds no sample.
    """
    require_one_run(run)
    plant, names, rate, settled = run.plant, run.plant.sensor_names, stated_rate(run), _settled(run)
    sent = np.column_stack([~silent(run, i) | run.suspected[:, i] for i in range(plant.n_sensors)])
    quiet = sent & (~plant.protected | run.suspected.any(axis=0))
    suspects = np.flatnonzero(run.suspected.any(axis=0)).tolist()
    each = [(i, episode) for i in suspects for episode in episodes(run.suspected[:, i], sent[:, i])]
    together, chance = _together(run, sent, each), Chance.of(each, len(names), int(quiet.sum()), rate)
    found, alone, early = [], np.zeros(len(names), dtype=int), np.zeros(len(names), dtype=int)
    for k, (i, episode) in enumerate(each):
        ends = episode.stop < settled < len(run.x) or (
            k not in together and carried_over(run, episode, START)
        )
        if episode.suspected > 1 and ends and not episode.until_end:
            early[i] += episode.suspected
        elif episode.persistent or not (k in together or chance.explains(i, episode)):
            found.append(_finding(run, i, episode, sent[:, i], rate, together=k in together))
        elif k not in together:
            alone[i] += episode.suspected
            continue
        quiet[episode.start : episode.stop + 1, i] = False
    return Findings(
        found=tuple(sorted(found, key=_rank)),
        crowds=_crowds(run, [each[k] for k in sorted(together) if each[k][1].stop >= settled]),
        alarms=Alarms(
            count=int(alone.sum()),
            rate=rate,
            expected=None if rate is None else float(rate * quiet.sum()),
            frequent=() if rate is None else _frequent(names, alone, rate * quiet.sum(axis=0)),
            settled=settled,
            at_start=_counted(names, early),
        ),
        periods=periods(run),
    )


def require_one_run(run: Run) -> None:
    """Raise InputError unless `run` is one run of at least one sample."""
    if run.x.ndim != 2 or run.x.shape[0] == 0:
        raise InputError("run", "one run, x of shape (T, n) with T >= 1", f"x of shape {run.x.shape}")


def stated_rate(run: Run) -> float | None:
    """How often an honest sample raises an alarm by the settings of the method; None if they do not say."""
    rate = run.settings.get("false_alarm_rate")
    if not isinstance(rate, float) or run.settings.get("scope") == "central":  # that one is of all at once
        return None
    return rate


def _together(run: Run, sent: Bool, each: Sequence[tuple[int, Episode]]) -> set[int]:
    """Which episodes fall into times at which too many sensors are suspected to blame them.

    Persistent episodes first; sensors that are to blame do not count when brief ones are judged. Where
    protected sensors judge, too many are suspected only while a filter that started at a wrong state settles.
    """
    judged = run.estimator in BY_PROTECTED and run.plant.protected.any()
    found: set[int] = set()
    suspected, heard = run.suspected.copy(), sent.copy()
    for persistent, least in ((True, 1), (False, MANY)):
        many = suspected.sum(axis=1)
        crowded = (2 * many >= heard.sum(axis=1)) & (many >= least) & (sent.sum(axis=1) > 1)
        for k, (i, episode) in enumerate(each):
            rows = slice(episode.start, episode.stop + 1)
            if episode.persistent is not persistent:
                continue
            if judged and (episode.start >= START or episode.until_end):
                continue
            if 2 * np.sum(crowded[rows] & run.suspected[rows, i]) > episode.suspected:
                found.add(k)
            elif persistent:
                suspected[rows, i] = heard[rows, i] = False
    return found


def _settled(run: Run) -> int:
    """The first sample after the start: after START samples, and after a cold start."""
    other = np.flatnonzero(run.status != Status.COLD_START)
    return max(START, int(other[0]) if other.size else len(run.status))


def _finding(
    run: Run, i: int, episode: Episode, sent: Bool, rate: float | None, *, together: bool
) -> Finding:
    trust = run.trust[episode.start : episode.stop + 1, i]
    known = trust[np.isfinite(trust) & sent[episode.start : episode.stop + 1]]
    return Finding(
        sensor=run.plant.sensor_names[i],
        since=Moment.of(run, episode.start),
        until=Moment.of(run, episode.stop),
        ongoing=episode.until_end,
        persistent=episode.persistent,
        together=together,
        faint=faint(run, i, episode),
        suspected=episode.suspected,
        sent=episode.sent,
        expected=None if rate is None else rate * episode.sent,
        trust=float(known.mean()) if known.size else float("nan"),
        courses=courses(run, i, episode),
    )


def _rank(f: Finding) -> tuple[bool, bool, bool, float, float, int]:
    return (
        f.together,
        not f.persistent or f.faint,
        not f.clear,
        -round(f.certainty, 1),
        -f.size,
        f.since.index,
    )


def _crowds(run: Run, crowd: Sequence[tuple[int, Episode]]) -> tuple[Crowd, ...]:
    """Episodes that overlap in time, joined."""
    joined: list[list[tuple[int, Episode]]] = []
    stop = -1
    for i, episode in sorted(crowd, key=lambda each: each[1].start):
        if not joined or episode.start > stop + 1:
            joined.append([])
        joined[-1].append((i, episode))
        stop = max(stop, episode.stop)
    return tuple(
        Crowd(
            Moment.of(run, min(e.start for _, e in group)),
            Moment.of(run, max(e.stop for _, e in group)),
            tuple(run.plant.sensor_names[i] for i in sorted({i for i, _ in group})),
            any(e.persistent for _, e in group),
        )
        for group in joined
    )


def _frequent(
    names: Sequence[str], alone: NDArray[np.int_], expected: NDArray[np.float64]
) -> tuple[tuple[str, int], ...]:
    """Sensors with so many alarms outside of findings that one run in a thousand would show it by chance."""
    unlikely = stats.poisson.sf(alone - 1, np.maximum(expected, 1e-12)) < 1e-3 / len(names)
    return _counted(names, np.where(unlikely & (alone >= FEWEST), alone, 0))


def _counted(names: Sequence[str], counts: NDArray[np.int_]) -> tuple[tuple[str, int], ...]:
    """The names with a count, and what it is."""
    return tuple((name, count) for name, count in zip(names, counts.tolist(), strict=True) if count)
