"""The lie that the honest sensors see least."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from securestate.attacks._arguments import positive
from securestate.attacks._modal import along_mode
from securestate.attacks.base import PlantAttack
from securestate.attacks.knowledge import Float, PlantKnowledge
from securestate.attacks.zero_dynamics import require_fixed
from securestate.resilience.margin import SLOW, margin


@final
@dataclass(frozen=True)
class WorstCase(PlantAttack):
    """a = scale C d[k], d[k] = Re(s lambda^(k - start) v): of all lies along a mode the one that shows least.

    Mode and direction are those of `securestate.resilience.margin` for these sensors. The honest ones
    contradict the lie by eta times its size, eta the margin; if eta is 0, not at all. A mode that fades is
    kept up: with |lambda| < 1 the factor is lambda / |lambda|. The more slowly the mode fades, the less this
    differs from the plant's own motion.

    Args:
        size: of the lie at the start, > 0: the root sum of squares of C d over the channels of all sensors,
            in standard deviations of their noise. Of an oscillating mode, its root mean square over a turn.
        cut: only modes with |lambda| >= cut are considered; all if there is none.
        on: named sensors, the same at all times.
        start, stop: as for `SingleAttack`.

    Raises:
        InputError: an argument is none of these, or `on` is drawn or changes.
        DesignError: when staged: the plant varies in time, or no sensor sees the modes that count.

    Notes:
        The lie is held once it is 1e100 times its first step.

    Examples:
        >>> WorstCase(10.0, on=["a", "b"], start=50)
        WorstCase(on=Fixed(sensors=('a', 'b')), start=50, stop=None, size=10.0, cut=0.999)
    """

    size: float
    cut: float = SLOW

    def __post_init__(self) -> None:
        super().__post_init__()
        require_fixed(self.on)
        self._keep(size=positive("size", self.size), cut=positive("cut", self.cut))

    def inject(self, view: PlantKnowledge) -> Float:
        """See `OpenLoopAttack.inject`."""
        worst = margin(view.plant, require_fixed(self.on).indices(view.plant), self.cut)
        # The real part of a turning direction has half of its square on average.
        turning = np.sqrt(2.0) if worst.mode.eigenvalue.imag else 1.0
        return view.told(along_mode(worst.mode, turning * self.size / worst.seen, view.elapsed))
