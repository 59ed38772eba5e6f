"""Who is honest in a window: the readings as evidence, groups, a robust start, a decoy peeled off."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from securestate.estimators._anneal import Groups, anneal
from securestate.estimators._relabel import Labels, Rows, determines, relabel
from securestate.estimators._window import Window
from securestate.plant import Plant

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

#: Mean squared residual, in deviations, up to which a group starts as honest: 4 sigma.
START = 16.0
#: Rows to start with, relative to n.
SPARE = 1.1
#: Consistent minorities that are peeled off at most.
PEELS = 3
#: Readings further from zero than so many deviations leave no digit to check them by.
BEYOND = 1e15
#: Deviations of what the sensors show, the width of a prior that says next to nothing.
VAGUE = 1e9


@dataclass(frozen=True, eq=False)
class Evidence:
    """The readings of a window that arrived, in units of their own deviation.

    Attributes:
        row: (rows,), where they lie among all tau m. deviation: (rows,), in normalised units.
        sensor, instant: (rows,), who sent them, and when.
        f: (rows,), their deviation in the unit of the channel, its root mean square over the window.
        beyond: (rows,), True where a reading is too far off to be computed with.
    """

    plant: Plant
    rows: Rows
    row: Index
    deviation: Float
    sensor: Index
    instant: Index
    f: Float
    beyond: Bool

    def groups(self, fixed: bool) -> tuple[Groups, Index]:
        """Sensors if the attacked set is fixed, else sensors at instants; and what number each group has.

        The number is that of the sensor, or instant times N plus the sensor.
        """
        N = self.plant.n_sensors
        keys, of = np.unique(self.sensor if fixed else self.instant * N + self.sensor, return_inverse=True)
        count = np.bincount(of, minlength=len(keys))
        return Groups(of, count, self.plant.protected[keys % N]), keys

    def computable(self, groups: Groups) -> Bool:
        """Groups without a reading beyond all sizes, (G,)."""
        able: Bool = np.bincount(groups.of, self.beyond[: len(groups.of)], minlength=len(groups.count)) == 0
        return able

    def with_prior(self) -> Evidence:
        """The same beside a prior of the state that says next to nothing."""
        n = self.plant.n
        return replace(
            self,
            rows=self.rows.with_prior(self.rows.O, VAGUE),
            f=np.append(self.f, np.full(n, self.f.min() if len(self.f) else 1.0)),
            beyond=np.append(self.beyond, np.zeros(n, dtype=np.bool_)),
        )


def evidence(window: Window, y: Float) -> Evidence:
    """Take the readings y (tau, m), normalised and without the known response, that are not NaN."""
    plant, m = window.plant, window.plant.m
    sd = np.sqrt(np.diag(window.Sigma))
    unit = np.sqrt((sd.reshape(-1, m) ** 2).mean(axis=0))
    row = np.flatnonzero(~np.isnan(y))
    own = sd[row]
    with np.errstate(over="ignore"):
        scaled = y.ravel()[row] / own
    beyond = ~(np.abs(scaled) <= BEYOND)
    Sigma = window.Sigma[np.ix_(row, row)] / own[:, np.newaxis] / own
    rows = Rows(window.O[row] / own[:, np.newaxis], Sigma, np.where(beyond, 0.0, scaled))
    sensor = plant.channel_sensor[row % m]
    return Evidence(plant, rows, row, own, sensor, row // m, own / unit[row % m], beyond)


def identify(seen: Evidence, groups: Groups) -> Labels | None:
    """Label every group; None if those that can be believed do not determine the state.

    If half or fewer remain honest, these may be liars in concert: they are peeled off, the rest is solved
    alone, and the larger set wins.
    """
    allowed = seen.computable(groups)
    best, use = _solve(seen, groups, allowed, allowed), allowed
    for _ in range(PEELS):
        if best is None or 2 * best.honest.sum() > len(best.honest):
            break
        use = use & (~best.honest | groups.protected)
        other = _solve(seen, groups, allowed, use) if use.any() else None
        if other is None or other.honest.sum() <= best.honest.sum():
            break
        best = other
    return best


def _solve(seen: Evidence, groups: Groups, allowed: Bool, use: Bool) -> Labels | None:
    """Stages 1 and 2, started from the groups in use."""
    if not use.any():
        return None
    s2 = residuals(seen, groups, use)
    return relabel(seen.rows, groups, _start(seen.rows, groups, s2, allowed), allowed)


def residuals(seen: Evidence, groups: Groups, use: Bool) -> Float:
    """Stage 1."""
    rows, f = seen.rows, seen.f
    return anneal(rows.O * f[:, np.newaxis], rows.y * f, f, groups, use)


def _start(rows: Rows, groups: Groups, s2: Float, allowed: Bool) -> Bool:
    """The groups near the robust fit, and the next best ones until the state is determined."""
    order = np.argsort(np.where(groups.protected, -1.0, np.where(allowed, s2, np.inf)))
    order = order[: int((allowed | groups.protected).sum())]
    honest = ((s2 < START) | groups.protected) & allowed

    def enough(count: int) -> bool:
        chosen = honest.copy()
        chosen[order[:count]] = allowed[order[:count]]
        h = chosen[groups.of]
        return bool(h.sum() >= SPARE * rows.O.shape[1]) and determines(rows.O[h])

    low, high = 0, len(order)
    while low < high:  # the least count that is enough; more of them are never worse
        middle = (low + high) // 2 if low else 0
        low, high = (low, middle) if enough(middle) else (middle + 1, high)
    honest[order[:low]] = allowed[order[:low]]
    return honest
