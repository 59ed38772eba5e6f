"""The setting of Section IV: the plant, the attacked record, the estimators and their errors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from papers._setting import BaseSetting
from securestate import Belief, Estimator, JointFusion, Plant, Run, Sensor, Status, simulate
from securestate.attacks import Pulse, RandomNoise

Float = NDArray[np.float64]
Form = Literal["printed", "exact"]
FOLDER = Path(__file__).parent
FORMS: tuple[Form, ...] = ("printed", "exact")


@dataclass(frozen=True)
class Record:
    """Attacked runs: states, readings and injections, each (runs, T, .); index 0 is k = 1."""

    x: Float
    y: Float
    a: Float


@dataclass(frozen=True)
class Setting(BaseSetting):
    """Plant, configuration and record of one run of the program."""

    folder = FOLDER

    @cached_property
    def unprotected(self) -> Plant:
        """The same plant with nobody marked as protected."""
        sensors = [Sensor(sensor.name, C=sensor.C, R=sensor.R) for sensor in self.plant.sensors]
        return Plant(self.plant.A, self.plant.Q, sensors, dt=self.plant.dt)

    @cached_property
    def prior(self) -> Belief:
        """The belief before the first sample: the paper has x(0) ~ N(0, I) and hears it first at k = 1."""
        A = self.plant.A
        return Belief(np.zeros(self.plant.n), A @ A.T + self.plant.Q)

    @property
    def pairing(self) -> dict[str, list[str]]:
        return self.config["joint"]["pairing"]

    @cached_property
    def record(self) -> Record:
        choice = self.config["simulation"]
        attack = RandomNoise(np.sqrt(choice["white"]), on="weak 1") + Pulse(
            choice["impulse"], on="weak 2", start=choice["impulse_at"] - 1
        )
        drawn = [
            simulate(
                self.plant, choice["steps"], attack, seed=seed, runs=self.scale["runs"], prior=self.prior
            )
            for seed in choice["seeds"]
        ]
        return Record(*(np.concatenate([getattr(part, name) for part in drawn]) for name in ("x", "y", "a")))

    def joint(
        self,
        form: Form,
        eta: float | None = None,
        weak: str | None = None,
        fusion: Literal["optimal", "average", "covariance-intersection"] = "optimal",
    ) -> JointFusion:
        """Return Algorithm 1, or the local estimator of one weak sensor."""
        pairing = self.pairing if weak is None else {weak: self.pairing[weak]}
        factor = self.config["joint"]["eta"] if eta is None else eta
        return JointFusion(self.plant, eta=factor, form=form, pairing=pairing, fusion=fusion)

    def adaptive(self) -> JointFusion:
        """Return Algorithm 1 with a compensation factor that follows the innovations; not in the paper."""
        return JointFusion(self.plant, eta="adaptive", pairing=self.pairing)

    def stack(self, weak: str) -> list[int]:
        """Sensors of one local estimator, the weak one first."""
        return [self.plant.sensor_names.index(name) for name in (weak, *self.pairing[weak])]

    def run(self, estimator: Estimator, sensors: list[int] | None = None) -> Run:
        """Run an estimator on the record, or on some sensors of it.

        Raises:
            ArithmeticError: a step did not go well.
        """
        y = self.record.y if sensors is None else np.ascontiguousarray(self.record.y[..., sensors])
        run = estimator.run(y, prior=self.prior, covariance=False)
        failed = np.count_nonzero((run.status != Status.OK) & (run.status != Status.NO_MEASUREMENT))
        if failed:
            raise ArithmeticError(f"{estimator!r}: {failed} steps did not go well")
        return run

    def square(self, run: Run) -> Float:
        """Squared error of the state at every sample, (runs, T)."""
        return np.sum((run.x - self.record.x) ** 2, axis=-1)
