"""Modes of a plant that its sensors cannot see, or that its noise does not reach.

The test of Popov, Belevitch and Hautus: a mode (lambda, v) with A v = lambda v is hidden from C if C v = 0,
that is, if [A - lambda I; C] loses rank. Here the eigenspaces of A come first (`eigenspaces`, in units in
which A and C are even), and what is hidden is the part of them that no row sees: rank is lost where a
singular value is below 1e-8.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from securestate import _checks as check
from securestate.errors import DesignError, InputError
from securestate.plant import Plant
from securestate.resilience._units import balanced_units, or_one
from securestate.resilience.eigenspaces import eigenspaces, kernel_of, sight

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

CUT = 1 - 1e-9  # a mode of at least this size does not fade
RANK = 1e-8  # singular value, relative to the largest, that counts as zero
SHARE = 0.5  # a state is named if its part in a direction is at least this much of the largest
SLIGHT = 0.02  # the same where several directions have to be told apart ...
MANY = 6  # ... and how many are named then


@dataclass(frozen=True, eq=False)
class Mode:
    """One mode of the dynamics.

    Attributes:
        eigenvalue: complex; one with a positive imaginary part stands for itself and its conjugate.
        states: names of the states with the largest share in the direction, largest first.
        direction: unit vector (n,), complex, its largest entry real and positive.
    """

    eigenvalue: complex
    states: tuple[str, ...]
    direction: Complex

    def __str__(self) -> str:
        value = self.eigenvalue
        shown = f"{value.real:.6g}" + (f" ± {value.imag:.6g}i" if value.imag else "")
        return f"mode {shown} ({', '.join(self.states)})"


def modes(plant: Plant, cut: float = CUT) -> tuple[Mode, ...]:
    """Find all modes with |eigenvalue| >= cut, largest first; equal eigenvalues give a basis of directions.

    Raises:
        DesignError: the plant varies in time.
        InputError: cut is not a number >= 0.

    Examples:
        >>> from securestate.plant import Sensor
        >>> plant = Plant([[1, 0], [1, 0.5]], [[1, 0], [0, 1]], [Sensor("level", C=[0, 1], R=1)])
        >>> print(*modes(plant, cut=0), sep="; ")
        mode 1 (x2, x1); mode 0.5 (x2)
    """
    _require_constant(plant)
    return _hidden(plant.A, np.zeros((0, plant.n)), cut, plant.state_names)


def undetectable_modes(plant: Plant, cut: float = CUT) -> tuple[Mode, ...]:
    """Find the modes with |eigenvalue| >= cut that no sensor sees; none means that the plant is detectable.

    Raises:
        DesignError: the plant varies in time.
        InputError: cut is not a number >= 0.

    Examples:
        >>> from securestate.plant import Sensor
        >>> plant = Plant([[1, 1], [0, 1]], [[1, 0], [0, 1]], [Sensor("speed", C=[0, 1], R=1)])
        >>> print(undetectable_modes(plant)[0])
        mode 1 (x1)
    """
    _require_constant(plant)
    return _hidden(plant.A, plant.C, cut, plant.state_names)


def unobserved_modes(plant: Plant, sensor: int, cut: float = CUT) -> tuple[Mode, ...]:
    """Find the modes with |eigenvalue| >= cut that one sensor, counted from 0, does not see on its own.

    Raises:
        DesignError: the plant varies in time.
        InputError: there is no such sensor, or cut is not a number >= 0.
    """
    _require_constant(plant)
    return _hidden(plant.A, plant.C[plant.channels_of(sensor)], cut, plant.state_names)


def detectability_margin(plant: Plant, sensors: Iterable[int] | None = None, cut: float = CUT) -> float:
    """How far the plant is from hiding a mode with |eigenvalue| >= cut: 0 if it hides one.

        min over lambda of the smallest singular value of  [(A - lambda I) / max(1, ||A||); C_j / (sigma_j
        size)],

    in units of the states in which A and C are even, sigma_j the noise of channel j, size the largest row.
    Unlike a count it falls when two modes come so close that sensors cannot tell them apart.

    Args:
        plant: time-invariant.
        sensors: only these, counted from 0; default all.
        cut: 0 for observability.

    Returns:
        A number in [0, 1]; 1 if there is no such mode.

    Raises:
        DesignError: the plant varies in time.
        InputError: there is no such sensor.
    """
    _require_constant(plant)
    chosen = range(plant.n_sensors) if sensors is None else list(sensors)
    rows = np.concatenate([np.arange(plant.m)[plant.channels_of(i)] for i in chosen] or [np.arange(0)])
    X = plant.C / np.sqrt(np.diag(plant.R))[:, None]
    units = balanced_units(plant.A, X)
    A, X = plant.A / units[:, None] * units, X * units
    size = max(1.0, float(np.linalg.norm(A, 2)))
    seen = X[rows] / np.linalg.norm(X, axis=1).max()
    values = [space.value for space in eigenspaces(plant.A, X, cut)]
    tested = [np.vstack([(A - value * np.eye(plant.n)) / size, seen]) for value in values]
    return min((float(np.linalg.svd(stacked, compute_uv=False)[-1]) for stacked in tested), default=1.0)


def unreachable_noise_modes(plant: Plant, cut: float = CUT) -> tuple[Mode, ...]:
    """Find the modes with |eigenvalue| >= cut that the process noise Q does not excite.

    At |eigenvalue| = 1 such a mode means that a stabilising steady-state filter does not exist: its gain
    there goes to zero. A direction belongs to A transposed: the combination of states that gets no noise.

    Raises:
        DesignError: the plant varies in time.
        InputError: cut is not a number >= 0.
    """
    _require_constant(plant)
    return _hidden(plant.A.T, _range(plant.Q).T, cut, plant.state_names)


def _require_constant(plant: Plant) -> None:
    if plant.time_varying:
        which = "A" if plant.A.ndim == 3 else "C"
        raise DesignError(
            f"plant: {which} varies in time ({plant.horizon} samples), so it has no fixed modes",
            "give a plant with constant A and C, for example its value at one sample",
        )


def _hidden(A: Array, C: Array, cut: float, names: tuple[str, ...]) -> tuple[Mode, ...]:
    """Return the modes of A with |eigenvalue| >= cut whose direction C maps to zero, largest first."""
    least = check.real_array("cut", cut, InputError)
    if least.ndim or least < 0:
        raise InputError("cut", "a number >= 0", check.describe(cut))
    found = []
    for space in eigenspaces(A, C, float(least)):
        seen = sight(space, C, np.arange(len(C)), len(C))
        hidden = space.V @ kernel_of(seen.rows, RANK)
        found += [mode_along(space.value, v, names) for v in readable(hidden.T.astype(np.complex128))]
    return tuple(sorted(found, key=lambda mode: (-abs(mode.eigenvalue), -mode.eigenvalue.real)))


def mode_along(
    value: complex, direction: Complex, names: tuple[str, ...], *, among_others: bool = False
) -> Mode:
    """Return the mode with this eigenvalue and direction, of any length, and the states it moves most.

    Args:
        among_others: the eigenvalue has other directions too, so that small parts tell them apart.
    """
    unit = _normal(direction)
    named = _largest(unit, names, SLIGHT)[:MANY] if among_others else _largest(unit, names, SHARE)
    return Mode(value, named, unit)


def readable(directions: Complex) -> list[Complex]:
    """Return a basis of the same space in which every direction has a state that the others lack."""
    basis = directions.copy()
    for k in range(len(basis)):
        rest = np.abs(basis[k:])
        row, pivot = np.unravel_index(int(np.argmax(rest)), rest.shape)
        basis[[k, k + int(row)]] = basis[[k + int(row), k]]
        basis[k] /= basis[k, pivot]
        others = np.arange(len(basis)) != k
        basis[others] -= np.outer(basis[others, pivot], basis[k])
    return [_normal(direction) for direction in basis]


def _normal(direction: Complex) -> Complex:
    """Return the direction with length 1, its largest entry real and positive, read-only."""
    largest = direction[int(np.argmax(np.abs(direction)))]
    unit: Complex = direction / (largest / abs(largest)) / np.linalg.norm(direction)
    unit.setflags(write=False)
    return unit


def _largest(direction: Complex, names: tuple[str, ...], least: float) -> tuple[str, ...]:
    share = np.abs(direction)
    order = np.argsort(-share, kind="stable")
    return tuple(names[i] for i in order if share[i] >= least * share.max())


def _range(Q: Array) -> Array:
    """Return columns that span the range of Q, judged on its correlations and therefore free of units."""
    spread = np.sqrt(or_one(np.diag(Q)))
    sizes, vectors = np.linalg.eigh(Q / spread[:, None] / spread)
    kept = sizes > 1e-12 * max(1.0, sizes[-1])
    columns: Array = spread[:, None] * vectors[:, kept]
    return columns
