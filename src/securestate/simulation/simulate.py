"""Simulate a plant whose sensors are under attack."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import final

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng
from numpy.typing import ArrayLike, NDArray

from securestate import _kernels
from securestate._checks import whole_number
from securestate._steady_state import steady_state
from securestate.attacks.base import Attack, Injection
from securestate.attacks.knowledge import Scene
from securestate.errors import DesignError, InputError, ShapeError
from securestate.plant import Belief, Plant
from securestate.simulation.stabilise import feedback_for
from securestate.simulation.trajectory import Trajectory

Float = NDArray[np.float64]

#: Branches of a run's random numbers: the plant itself, and the adversaries, one branch each.
NOISE, ADVERSARY = 0, 1


def simulate(
    plant: Plant,
    steps: int,
    attack: Attack | None = None,
    *,
    seed: int | Generator,
    runs: int = 1,
    first_run: int = 0,
    u: ArrayLike | None = None,
    prior: Belief | None = None,
) -> Trajectory:
    """Draw independent runs of a plant and let an adversary falsify what its sensors send.

        x[k+1] = A x[k] + B u[k] + w[k],   w ~ N(0, Q),   y[k] = C x[k] + D u[k] + v[k] + a[k],   v ~ N(0, R)

    Args:
        plant: the plant; A and C may vary in time.
        steps: samples per run.
        attack: the adversary; None: nobody lies.
        seed: a whole number, or a generator from which one is drawn. Run r depends on the seed and on r only:
            not on how many runs there are, nor on the number of threads.
        runs: number of runs.
        first_run: number of the first one.
        u: inputs, (T, p) or (runs, T, p), file units; default: the operating point. A feedback from the true
            state is added where A has eigenvalues outside the unit circle; `Trajectory.u` holds the sum.
        prior: belief from which x[0] is drawn; default: mean zero and the steady state of the Kalman filter.
            A belief without P stands for its mean and the steady-state covariance.
    Returns:
        Trajectory; give its `u` to every estimator.
    Raises:
        InputError, ShapeError: naming the argument, expected and received.
        DesignError: the plant has no steady state and there is no prior with a covariance; the state of an
            unstable plant without inputs would outgrow double precision (see `stabilised`).
    Examples:
        >>> from securestate.attacks import Bias
        >>> from securestate.plant import Sensor
        >>> plant = Plant([[0.9]], [[1.0]], [Sensor(s, C=[1.0], R=1.0) for s in "abc"])
        >>> trajectory = simulate(plant, 100, Bias(5.0, on="b", start=50), runs=20, seed=1)
        >>> trajectory
        Trajectory(20 runs × 100 samples of Plant(n=1, m=3, sensors=3, inputs=0, dt=1 s))
        >>> print(trajectory.a[0, 49:51, 1], trajectory.attacked[0, 50])
        [0. 5.] [False  True False]
    """
    return Simulator(plant, steps, prior).run(attack, seed=seed, runs=runs, first_run=first_run, u=u)


@final
class Simulator:
    """What `simulate` works out before it draws, for several calls with one plant, length and prior."""

    def __init__(self, plant: Plant, steps: int, prior: Belief | None = None) -> None:
        """Arguments and errors as for `simulate`."""
        if not isinstance(plant, Plant):
            raise InputError("plant", "a Plant; Plant.load reads a file", type(plant).__name__)
        whole_number("steps", steps, 1, InputError)
        if plant.horizon is not None and steps > plant.horizon:
            raise InputError("steps", f"at most {plant.horizon}, as many as A and C cover", str(steps))
        if prior is not None and len(prior.x) != plant.n:
            raise InputError("prior", f"a Belief about {plant.n} states, or None", repr(prior))
        self.plant, self.steps, self.prior = plant, steps, prior
        self._mean, self._root_P = _start(plant, prior)
        self._roots = square_root(plant.Q), square_root(plant.R)
        self._feedback = feedback_for(plant, steps)

    def run(
        self,
        attack: Attack | None = None,
        *,
        seed: int | Generator,
        runs: int = 1,
        first_run: int = 0,
        u: ArrayLike | None = None,
    ) -> Trajectory:
        """Arguments, result and errors as for `simulate`."""
        whole_number("runs", runs, 1, InputError)
        whole_number("first_run", first_run, 0, InputError)
        if attack is not None and not isinstance(attack, Attack):
            raise InputError("attack", "an Attack from securestate.attacks, or None", type(attack).__name__)
        plant, streams = self.plant, streams_of(seed, first_run, runs)
        x, y = _draw(plant, self.steps, streams(NOISE, 0))
        x[:, 0] = self._mean + x[:, 0] @ self._root_P
        inputs = np.ascontiguousarray(plant.normalise_input(_inputs(u, plant, runs, self.steps)))
        noise = np.empty_like(y)
        _kernels.simulate(plant, *self._roots, self._feedback, x, inputs, y, noise)
        known = plant.input_offset + plant.input_scale * inputs
        clean = plant.denormalise(y)
        scene = Scene(plant, x, known, plant.scale * noise, clean, lambda number: streams(ADVERSARY, number))
        injection = _nobody(scene) if attack is None else attack.stage(scene)
        return Trajectory(
            plant=plant,
            x=x,
            u=known,
            clean=clean,
            y=clean + injection.a,
            a=injection.a,
            attacked=injection.attacked,
            prior=self.prior,
            reactions=injection.reactions,
        )


def square_root(P: Float) -> Float:
    """The symmetric square root of a covariance."""
    values, vectors = np.linalg.eigh(P)
    root: Float = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return np.ascontiguousarray(root)


def streams_of(seed: int | Generator, first: int, runs: int) -> Callable[[int, int], Sequence[Generator]]:
    """Generators of every run, given the branch and its number; the same ones at every call."""
    entropy = int(seed.integers(2**63)) if isinstance(seed, Generator) else seed
    whole_number("seed", entropy, 0, InputError)

    @cache
    def streams(branch: int, number: int) -> Sequence[Generator]:
        each = range(first, first + runs)
        return [default_rng(SeedSequence(entropy, spawn_key=(run, branch, number))) for run in each]

    return streams


def _draw(plant: Plant, steps: int, rngs: Sequence[Generator]) -> tuple[Float, Float]:
    """Standard normal numbers for x[0], w[0], w[1], ... (runs, T, n) and v (runs, T, m).

    A run draws its numbers sample by sample, so that a longer one begins like a shorter one.
    """
    z = np.empty((len(rngs), steps, plant.n + plant.m))
    for rng, rows in zip(rngs, z, strict=True):
        rng.standard_normal(out=rows)
    return np.ascontiguousarray(z[..., : plant.n]), np.ascontiguousarray(z[..., plant.n :])


def _start(plant: Plant, prior: Belief | None) -> tuple[Float, Float]:
    """Mean and a square root of the covariance of x[0]."""
    mean = np.zeros(plant.n) if prior is None else prior.x
    if prior is not None and prior.P is not None:
        return mean, square_root(prior.P)
    try:
        return mean, square_root(steady_state(plant).P_prior)
    except DesignError as reason:
        raise DesignError(
            f"x[0] has no steady state to be drawn from: {reason.reason}", "give a prior with a covariance P"
        ) from None


def _inputs(u: ArrayLike | None, plant: Plant, runs: int, steps: int) -> Float:
    """Inputs without feedback, (runs, T, p), file units."""
    shape = (runs, steps, plant.n_inputs)
    if u is None:
        return np.broadcast_to(plant.input_offset, shape)
    values = np.asarray(u, dtype=np.float64)
    if values.shape not in (shape, shape[1:]):
        raise ShapeError("u", f"shape {shape[1:]} or {shape}", f"shape {values.shape}")
    if not np.all(np.isfinite(values)):
        raise InputError("u", "finite numbers", "NaN or infinity")
    return np.broadcast_to(values, shape)


def _nobody(scene: Scene) -> Injection:
    runs, steps, _ = scene.y.shape
    return Injection(
        np.zeros_like(scene.y), np.zeros((runs, steps, scene.plant.n_sensors), dtype=np.bool_), ()
    )
