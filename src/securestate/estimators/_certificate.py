"""The certificate of a cold start: was what is believed checked, or could it be otherwise?

Spec: enough readings to spare, a majority, no contradiction. That alone certified wrong states: a sensor that
nobody else checks may say anything, and where few sensors see a mode, liars in concert may be the majority of
those. So a certificate also needs that every believed sensor can be checked by the others, and that no other
majority is found that would tell another story.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import special

from securestate.estimators._anneal import Groups
from securestate.estimators._identify import START, Evidence, residuals
from securestate.estimators._relabel import ALPHA, Labels, determines, relabel, unchecked
from securestate.plant import Plant

Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

RIVAL = "another majority of the sensors agrees on another state"
#: Accused ones whose innocence is tried one by one: so many, and more while the window has few rows.
RIVALS, RIVALS_TIMES_ROWS = 3, 1000
#: Rounding of a residual, in deviations, up to which its size means something.
ROUNDING = 0.1
#: Residual degrees of freedom that a certificate needs: so many, and this share of n.
FREEDOM, FREEDOM_SHARE = 4, 0.1


def doubt(seen: Evidence, groups: Groups, labels: Labels, keys: Index, fixed: bool) -> str:
    """Why the labels are not certified; empty if they are."""
    fit, plant = labels.fit, seen.plant
    absurd = np.unique(seen.sensor[seen.beyond & plant.protected[seen.sensor]])
    if len(absurd):
        return f"readings of {_named(plant, absurd)}, which cannot lie, are too large to be computed with"
    needed = max(FREEDOM, int(np.ceil(FREEDOM_SHARE * plant.n)))
    if fit.freedom < needed:
        return f"only {fit.freedom} readings are left to check the state by; {needed} are needed"
    if not _majority(labels.honest, keys, plant, fixed) and not _anchored(seen):
        return "no majority of the sensors agrees on a state"
    if fit.rounding > ROUNDING:
        return "the readings are so large that rounding hides their noise"
    if fit.statistic > special.chdtri(fit.freedom, ALPHA):
        return (
            f"those that are believed contradict each other: {fit.statistic:.4g} for "
            f"{fit.freedom} degrees of freedom"
        )
    alone = unchecked(fit, seen.sensor, plant.n_sensors) & ~plant.protected
    if alone.any():
        return f"no other sensor checks {_named(plant, np.flatnonzero(alone))}, whatever it says"
    if _rival(seen, groups, labels, keys, fixed):
        return RIVAL
    return ""


def _majority(honest: Bool, keys: Index, plant: Plant, fixed: bool) -> bool:
    """Whether more than half of those heard are honest; for a changing set, at every instant."""
    if fixed:
        return bool(2 * honest.sum() > len(honest))
    instants, when = np.unique(keys // plant.n_sensors, return_inverse=True)
    believed = np.bincount(when, honest, minlength=len(instants))
    return bool((2 * believed > np.bincount(when, minlength=len(instants))).all())


def _anchored(seen: Evidence) -> bool:
    """Whether the protected sensors alone determine the state, so that they judge all others."""
    safe = seen.plant.protected[seen.sensor] & ~seen.beyond
    return bool(safe.any()) and determines(seen.rows.O[safe])


def _named(plant: Plant, sensors: Index) -> str:
    names = [plant.sensor_names[i] for i in sensors]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _rival(seen: Evidence, groups: Groups, labels: Labels, keys: Index, fixed: bool) -> bool:
    """Whether another majority, with some of the accused in it, agrees on another state.

    The accused are heard alone, then believed together, then the least suspicious ones one by one. A wide
    prior stands in for what such a majority does not see.
    """
    allowed = seen.computable(groups)
    accused = np.append(~labels.honest & allowed, False)
    if not accused.any():
        return False
    tried = min(max(RIVALS, RIVALS_TIMES_ROWS // len(seen.row)), int(accused.sum()))
    order = np.argsort(np.where(accused[:-1], labels.excess, np.inf))[:tried]
    anchors = [np.zeros_like(accused), accused, *(np.arange(len(accused)) == g for g in order)]
    wide, allowed = seen.with_prior(), np.append(allowed, True)
    n = seen.plant.n

    def enough(honest: Bool, anchor: Bool) -> bool:
        alone = not fixed and anchor.sum() == 1  # a tie at one instant must be as good, not just a majority
        fewer = alone and honest[:-1].sum() < labels.honest.sum()
        return not fewer and _majority(honest[:-1], keys, seen.plant, fixed)

    for anchor in anchors:
        safe = np.append(groups.protected, True) | anchor
        believed = Groups(np.append(groups.of, np.full(n, len(keys))), np.append(groups.count, n), safe)
        use = allowed if anchor.any() else accused | safe
        near = ((residuals(wide, believed, use) < START) | safe) & allowed
        other = relabel(wide.rows, believed, near, allowed) if enough(near, anchor) else None
        if other is None or not enough(other.honest, anchor):
            continue
        consistent = other.fit.statistic <= special.chdtri(max(1, other.fit.freedom), ALPHA)
        moved = labels.fit.X @ (other.fit.x0 - labels.fit.x0)  # in deviations of x0
        if consistent and moved @ moved > special.chdtri(n, ALPHA):
            return True
    return False
