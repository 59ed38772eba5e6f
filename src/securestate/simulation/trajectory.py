"""What a simulation returns: the truth, what sensors measure, what arrives, what an estimator makes of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from securestate.attacks.base import Reaction
from securestate.errors import InputError
from securestate.estimators import Estimator, OracleFilter, Run
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
            return self._close_loop(estimator, covariance=covariance)
        u = self.u if self.plant.n_inputs else None
        if isinstance(estimator, OracleFilter):
            return estimator.run(self.y, u, self.prior, attacked=self.attacked, covariance=covariance), self
        return estimator.run(self.y, u, self.prior, covariance=covariance), self

    @property
    def _start(self) -> Float:
        """x[0|-1], (n,), from which every estimator starts."""
        return np.zeros(self.plant.n) if self.prior is None else self.prior.x

    def _close_loop(self, estimator: Estimator | OracleFilter, *, covariance: bool) -> tuple[Run, Trajectory]:
        """Who reacts in proportion does so in the kernels; to the oracle, which hears none, beforehand."""
        if isinstance(estimator, OracleFilter):
            met = self._met(self._reactions_to(estimator))
            return met.confront(estimator, covariance=covariance)
        gains = [one for reaction in self.reactions if (one := reaction.gain) is not None]
        if len(gains) < len(self.reactions):
            return self._step_by_step(estimator, covariance=covariance)
        live = estimator.start(self.prior, runs=self.runs)
        gain: Float = np.sum(gains, axis=0)
        run, y = live.run_against(self.clean, self.y, gain, self.u, self._start, covariance=covariance)
        return run, self._met(y - self.clean)

    def _reactions_to(self, oracle: OracleFilter) -> Float:
        """All injections when the oracle is the defender, (runs, T, m)."""
        u = self.u if self.plant.n_inputs else None
        run = oracle.run(self.y, u, self.prior, attacked=self.attacked, covariance=False)
        before = np.broadcast_to(self._start, (self.runs, 1, self.plant.n))
        x = np.concatenate([before, self.plant.successor(run.x, self.u)[:, :-1]], axis=1)
        expected, a = self.plant.reading(x, self.u), self.a.copy()
        for k in range(self.steps):
            for reaction in self.reactions:
                a[:, k] += reaction(k, expected[:, k])
        return a

    def _step_by_step(self, estimator: Estimator, *, covariance: bool) -> tuple[Run, Trajectory]:
        """What the defender expects, what adversaries make of it, what the defender makes of that."""
        plant = self.plant
        live, x = (
            estimator.start(self.prior, runs=self.runs),
            np.broadcast_to(self._start, (self.runs, 1, plant.n)),
        )
        a, blocks = self.a.copy(), []
        for k in range(self.steps):
            now = slice(k, k + 1)
            expected = plant.reading(x, self.u[:, now], k)[:, 0]
            for reaction in self.reactions:
                a[:, k] += reaction(k, expected)
            u = self.u[:, now] if plant.n_inputs else None
            blocks.append(live.run(self.clean[:, now] + a[:, now], u, covariance=covariance))
            x = plant.successor(blocks[-1].x, self.u[:, now], k)
        return Run.concat(blocks), self._met(a)

    def _met(self, a: Float) -> Trajectory:
        """This trajectory with all injections known."""
        return replace(self, y=self.clean + a, a=a, reactions=())
