"""What a simulation returns: the truth, what sensors measure, what arrives, what an estimator makes of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from securestate.attacks.base import Reaction
from securestate.errors import InputError
from securestate.estimators import Estimator, OracleFilter, Run
from securestate.estimators.oracle import LiveOracle
from securestate.plant import Belief, Plant

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, kw_only=True)
class Trajectory:
    """A batch of independent runs of a plant under attack.

    Attributes:
        plant: the plant.
        x: true states, (runs, T, n), normalised units.
        u: inputs, (runs, T, p), file units.
        clean: what the sensors measure, (runs, T, m), sensor units.
        y: what arrives, clean + a, (runs, T, m); NaN where a reading was suppressed.
        a: injected signal, (runs, T, m), sensor units; NaN where a reading was suppressed.
        attacked: sensors under attack, (runs, T, N).
        prior: belief about x[0] from which x[0] was drawn; None: mean zero and steady state.
        reactions: adversaries that react to the defender. If there are any, y and a lack their part, and only
            `confront` can add it.
    """

    plant: Plant
    x: Float
    u: Float
    clean: Float
    y: Float
    a: Float
    attacked: Bool
    prior: Belief | None = None
    reactions: tuple[Reaction, ...] = ()

    @property
    def runs(self) -> int:
        """Number of runs."""
        return int(self.x.shape[0])

    @property
    def steps(self) -> int:
        """T, samples per run."""
        return int(self.x.shape[1])

    def __repr__(self) -> str:
        kind = ", closed loop" if self.reactions else ""
        return f"Trajectory({self.runs} runs × {self.steps} samples of {self.plant!r}{kind})"

    def confront(
        self, estimator: Estimator | OracleFilter, *, covariance: bool = True
    ) -> tuple[Run, Trajectory]:
        """Let an estimator run on what arrives, adversaries that react to it included.

        Args:
            estimator: for the same plant. An `OracleFilter` is told `attacked`.
            covariance: False leaves `Run.P` None.
        Returns:
            The run, a batch, and the trajectory as it came about: y and a complete, no reactions left.
        Raises:
            InputError: the estimator was designed for another plant.
        """
        if estimator.plant is not self.plant and estimator.plant != self.plant:
            raise InputError("estimator", f"one for {self.plant!r}", f"one for {estimator.plant!r}")
        if self.reactions:
            return self._react(estimator, covariance=covariance)
        u = self.u if self.plant.n_inputs else None
        if isinstance(estimator, OracleFilter):
            return estimator.run(self.y, u, self.prior, attacked=self.attacked, covariance=covariance), self
        return estimator.run(self.y, u, self.prior, covariance=covariance), self

    def _react(self, estimator: Estimator | OracleFilter, *, covariance: bool) -> tuple[Run, Trajectory]:
        """Sample by sample: what the defender expects, what adversaries make of it, what it does."""
        plant, several = self.plant, self.plant.n_inputs > 0
        live = estimator.start(self.prior, runs=self.runs)
        x = np.broadcast_to(0.0 if self.prior is None else self.prior.x, (self.runs, 1, plant.n))
        a, blocks = self.a.copy(), []
        for k in range(self.steps):
            now = slice(k, k + 1)
            expected = plant.reading(x, self.u[:, now], k)[:, 0]
            for reaction in self.reactions:
                a[:, k] += reaction(k, expected)
            y, u = self.clean[:, now] + a[:, now], self.u[:, now] if several else None
            if isinstance(live, LiveOracle):
                run = live.run(y, u, attacked=self.attacked[:, now], covariance=covariance)
            else:
                run = live.run(y, u, covariance=covariance)
            blocks.append(run)
            x = plant.successor(run.x, self.u[:, now], k)
        return Run.concat(blocks), replace(self, y=self.clean + a, a=a, reactions=())
