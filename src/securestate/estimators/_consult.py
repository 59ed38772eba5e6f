"""What an estimator says at design time about liars that its plant does not let it survive."""

from __future__ import annotations

import warnings

from securestate.errors import DesignError, InsecureWarning
from securestate.plant import Plant
from securestate.resilience.eigenspaces import eigenspaces, sight
from securestate.resilience.fusion_margin import FusionMargin
from securestate.resilience.limit import limit
from securestate.resilience.margin import SLOW, noise_scaled

#: Seconds that the question may take at design time.
PATIENCE = 0.2

_ADVICE = "securestate.analyse(plant) says which sensor would help"


def refuse_without_redundancy(plant: Plant) -> None:
    """Refuse a plant whose lasting modes are each seen by one sensor only, that may lie.

    Raises:
        DesignError: a lie along a mode would not even show.
    """
    X = noise_scaled(plant)
    spaces = eigenspaces(plant.A, X, SLOW)
    seen = [sight(space, X, plant.channel_sensor, plant.n_sensors) for space in spaces]
    if spaces and not plant.protected.any() and all(len(one.rows) <= one.dimension for one in seen):
        raise DesignError(
            "every mode that does not fade is seen by one sensor only: a lie along it would not even show",
            "add sensors (securestate.analyse(plant) says which), or use KalmanFilter and trust them all",
        )


def warn_of_margin(margin: FusionMargin, stacklevel: int = 3) -> None:
    """Warn if one liar is known to move a sparse fusion without bound."""
    if margin.verdict != "insecure":
        return
    warnings.warn(
        f"one lying sensor can move this estimate without bound: {', '.join(margin.sensors)} has the margin "
        f"rho = {margin.lower:.3g}, and only below 1 do the others outweigh it; {_ADVICE}",
        InsecureWarning,
        stacklevel=stacklevel + 1,
    )


def warn_of_limit(plant: Plant, stacklevel: int = 3) -> None:
    """Warn if no estimator at all can follow a mode that lasts while one sensor lies.

    Nothing is said of a plant that varies in time, or where the count takes longer than a moment.
    """
    if plant.time_varying:
        return
    found = limit(plant, SLOW, target=3, time_limit=PATIENCE)
    weak = found.weakest
    if weak is None or weak.upper == 0 or found.max_attacked_upper >= 1:
        return
    seen = "one sensor" if len(weak.sensors) == 1 else f"{len(weak.sensors)} sensors"
    warnings.warn(
        f"{weak.mode} does not fade and is seen by {seen}, {' and '.join(weak.sensors)}: if one lies, no "
        f"estimator can tell; {_ADVICE}",
        InsecureWarning,
        stacklevel=stacklevel + 1,
    )
