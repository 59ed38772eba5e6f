"""The cells of `benches.secure_filter`: a plant, an attack, how many sensors lie and for how long."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng
from numpy.typing import NDArray

from securestate import (
    Belief,
    ColdStart,
    Estimator,
    KalmanFilter,
    OracleFilter,
    Plant,
    Run,
    Trajectory,
    attacks,
    cold_start,
)
from securestate.attacks import Attack, Drawn, Redrawn, Targets
from securestate.estimators.window_run import start_after, window_run
from securestate.simulation import FAMILIES, Simulator

Float = NDArray[np.float64]
PAPERS = Path(__file__).parents[1] / "papers"

#: Clean samples first; then as many under attack, which are the ones that count.
CLEAN, ATTACKED = 30, 100
#: Variance of every state where the oracle starts cold.
WIDE = 1e4

#: Plants that are drawn afresh for every run, and plants of papers.
FAMILY = {"scalar": "scalar", "partial4": "partial-planar", "full4": "full-planar"}
PAPER = {"liu": "liu2020", "chen": "chen2022"}

_ATTACK: Mapping[str, Callable[..., Attack]] = {
    "25pt": attacks.NoiseLinear,
    "26": partial(attacks.Reflection, "local"),
    "26c": partial(attacks.Reflection, "clean-local"),
    "26f": attacks.DefenderReflection,
    "freeze": attacks.Freeze,
}
#: Attacks that take a number.
_SIZED: Mapping[str, Callable[..., Attack]] = {
    "bias": attacks.Bias,
    "ramp": attacks.Ramp,
    "replay": lambda size, **who: attacks.Delay(int(size), **who),
    "noise": attacks.RandomNoise,
    "drift": attacks.RandomWalk,
    "sine": partial(attacks.Sinusoid, period=12),
    "alt": partial(attacks.Sinusoid, period=2, phase=90),
    "impulse": partial(attacks.Pulse, probability=0.1),
    "coordsd": partial(attacks.FakeState, along="prior"),
    "coordramp": partial(attacks.FakeState, profile="ramp"),
    "sinc": partial(attacks.FakeState, profile="sinusoid", period=25),
}

#: Plant, attack, how many lie, and whether the same ones do ("fixed") or others at every sample ("dynamic").
_CELLS = """
scalar none 6 fixed
scalar 25pt 1-6 dynamic
scalar 26 1-6 dynamic
scalar 26c 1-6 dynamic
scalar 26f 6 dynamic
scalar 26f 6 fixed
scalar bias:1 6 fixed
scalar bias:2 6 fixed
scalar bias:5 6 fixed
scalar bias:5 6 dynamic
scalar ramp:.1 6 fixed
scalar replay:20 6 fixed
scalar noise:10 6 fixed
scalar coordsd:3 6 fixed
scalar coordsd:3 7 fixed
scalar coordsd:5 7 fixed
scalar freeze 6 fixed
scalar sine:3 6 fixed
cold scalar none 6 fixed
cold scalar bias:20 6 fixed
cold scalar bias:5 6 fixed
cold scalar 25pt 6 dynamic
cold scalar coordsd:5 7 fixed
cold scalar noise:10 6 fixed
cold partial4 none 3 fixed
cold partial4 bias:5 3 fixed
cold partial4 bias:20 3 fixed
scalar bias:20 6 fixed
scalar bias:2 6 dynamic
scalar ramp:.02 6 fixed
scalar impulse:10 6 fixed
scalar drift:.3 6 fixed
scalar alt:3 6 fixed
scalar sinc:2 6 fixed
scalar coordsd:20 7 fixed
scalar bias:2 1 fixed
scalar bias:2 3 fixed
scalar bias:5 3 dynamic
scalar 26f 3 dynamic
scalar 26f 3 fixed
scalar 26 3 fixed
scalar replay:5 3 fixed
scalar coordramp:.1 7 fixed
scalar bias:2 7 fixed
liu none 1 fixed
liu bias:5 1 fixed
liu bias:100 1 fixed
liu ramp:.1 1 fixed
liu noise:10 1 dynamic
liu sine:3 1 fixed
liu impulse:10 1 fixed
liu bias:2 1 fixed
chen none 2 fixed
chen bias:1 2 fixed
chen bias:5 2 dynamic
chen ramp:.1 2 fixed
chen ramp:.02 2 fixed
chen noise:10 2 dynamic
chen freeze 2 fixed
chen sine:3 2 fixed
chen drift:.3 2 fixed
partial4 none 3 fixed
partial4 25pt 1-3 dynamic
partial4 26 1-3 dynamic
partial4 26f 3 fixed
partial4 bias:1 3 fixed
partial4 bias:2 3 fixed
partial4 bias:5 3 dynamic
partial4 ramp:.1 3 fixed
partial4 replay:20 3 fixed
partial4 freeze 3 fixed
partial4 sine:3 3 fixed
partial4 drift:.3 3 fixed
partial4 noise:10 3 fixed
partial4 coordsd:3 3 fixed
full4 none 6 fixed
full4 25pt 1-6 dynamic
full4 26f 6 dynamic
full4 26f 6 fixed
full4 bias:1 6 fixed
full4 bias:2 6 fixed
full4 ramp:.1 6 fixed
full4 coordsd:3 7 fixed
full4 freeze 6 fixed
full4 sine:3 6 fixed
full4 sinc:2 6 fixed
"""


@dataclass(frozen=True)
class Cell:
    """One way in which sensors of one kind of plant lie.

    Attributes:
        name: the line that says it all.
        plant: key of `FAMILY` or `PAPER`.
        kind: the attack and, after a colon, its size.
        count: how many lie, uniform between two numbers.
        fixed: whether the same ones lie all the time.
        cold: whether nothing is known at the first attacked sample.
    """

    name: str
    plant: str
    kind: str
    count: tuple[int, int]
    fixed: bool
    cold: bool

    @property
    def attack(self) -> Attack | None:
        """The adversary; None: nobody lies."""
        name, _, size = self.kind.partition(":")
        if name == "none":
            return None
        who: dict[str, Any] = {"on": self.targets, "start": CLEAN}
        return _SIZED[name](float(size), **who) if size else _ATTACK[name](**who)

    @property
    def targets(self) -> Targets:
        """Who lies; protected sensors never do."""
        return Drawn(self.count) if self.fixed else Redrawn(self.count)


def cell(line: str) -> Cell:
    """The cell that a line names."""
    words = line.split()
    plant, kind, count, mode = words[-4:]
    low, _, high = count.partition("-")
    return Cell(line, plant, kind, (int(low), int(high or low)), mode == "fixed", words[0] == "cold")


CELLS = tuple(cell(line) for line in _CELLS.split("\n") if line)


@dataclass(frozen=True)
class Episode:
    """One run of a cell: the truth, what arrives, and from which sample on it counts."""

    trajectory: Trajectory
    scored: int
    cold: bool

    def confront(self, estimator: Estimator | OracleFilter) -> tuple[Run, Trajectory]:
        """Let an estimator run. Cold, it starts from a window of samples, the oracle from a wide belief.

        An estimator without a steady state of its own begins with that of the Kalman filter.
        """
        truth = self.trajectory
        if self.cold and not isinstance(estimator, OracleFilter):
            return self._from_window(estimator), truth
        if getattr(estimator, "no_steady_state", ""):
            truth = replace(truth, prior=_steady(truth.plant))
        return truth.confront(estimator)

    def _from_window(self, estimator: Estimator) -> Run:
        """What `estimator.run(y, prior="window")` returns; all estimators share the window's work."""
        y = self.trajectory.y
        if type(estimator).run is not Estimator.run:
            return estimator.run(y, prior="window")
        first = self._window
        blocks = [window_run(estimator, first, covariance=True)]
        if first.samples < y.shape[1]:
            blocks.append(start_after(estimator, first).run(y[0, first.samples :]))
        return batch_of_one(Run.concat(blocks))

    @cached_property
    def _window(self) -> ColdStart:
        return cold_start(self.trajectory.plant, self.trajectory.y[0])


def batch_of_one(run: Run) -> Run:
    """The same run as a batch."""
    arrays: dict[str, Any] = {
        key: value[np.newaxis] for key, value in vars(run).items() if isinstance(value, np.ndarray)
    }
    diagnostics = {key: value[np.newaxis] for key, value in run.diagnostics.items()}
    return replace(run, **arrays, diagnostics=diagnostics)


def episode(cell: Cell, seed: int) -> Episode:
    """The run with this seed; it depends on the cell and the seed only.

    The truth starts in its steady state. An unstable plant is held by a known input, a feedback from the true
    state: the errors of estimators that are told the input do not depend on it.
    """
    of_plant, of_run = SeedSequence([seed, crc32(cell.name.encode())]).spawn(2)
    plant = drawn(cell.plant, default_rng(of_plant))
    trajectory = Simulator(plant, CLEAN + ATTACKED).run(cell.attack, seed=default_rng(of_run))
    if not cell.cold:
        return Episode(trajectory, CLEAN, cold=False)
    late: dict[str, Any] = {
        name: np.ascontiguousarray(getattr(trajectory, name)[:, CLEAN:])
        for name in ("x", "u", "clean", "y", "a", "attacked")
    }
    wide = Belief(np.zeros(plant.n), WIDE * np.eye(plant.n))
    return Episode(replace(trajectory, **late, prior=wide), 0, cold=True)


def drawn(name: str, rng: Generator) -> Plant:
    """A plant of this kind."""
    return FAMILIES[FAMILY[name]](rng) if name in FAMILY else of_paper(name)


@cache
def of_paper(name: str) -> Plant:
    """The plant of a paper, always the same object."""
    return Plant.load(PAPERS / PAPER[name] / "plant.toml")


def _steady(plant: Plant) -> Belief:
    steady = KalmanFilter(plant).steady
    assert steady is not None
    return Belief(np.zeros(plant.n), steady.P_prior)
