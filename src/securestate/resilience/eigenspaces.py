"""The relevant modes of a plant as whole eigenspaces, and what every sensor sees of them.

A vector v with A v = lambda v is a motion of the plant that looks like itself at every sample. Whoever wants
to tell x from x + v has to see v, so everything about resilience is a question about eigenspaces ker(A -
lambda I) and the rows X_i = C_i V of the sensors in a basis V.

Computed eigenvalues are exact for a matrix within eps ||A||. Three consequences:
    * A Jordan block of size k scatters its eigenvalue over eps^(1/k), and an eigenvector of each scattered
      value would be taken for a mode of its own. The mean of the cluster is accurate to eps, and replaces it
      where A - mean I is singular.
    * Eigenvalues closer than `tol` share one eigenspace; a larger space can only lower counts, which is safe.
    * "Sensor i sees v" means ||C_i v|| > blind ||C_i|| ||v||, `blind` never below the accuracy of V, that is,
      what a true eigenvector may have outside of V.
Whether an eigenvalue reaches the cut is judged by the largest it may be in truth.
All norms are taken in units of the states in which A and C are balanced.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from securestate.resilience._units import ROUNDING, balanced_units

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
#: Real for a real eigenvalue, complex for one of a pair.
Field = NDArray[Any]

#: Relative singular value of A - lambda I, and share of a direction that a sensor sees, that count as zero.
TOLERANCE = 1e-8
#: Reaches within which neighbouring eigenvalues may be one scattered eigenvalue, in units of ||A||.
RADII = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
#: Largest share of its size that an eigenvector may have outside of the space that stands for it as well.
ALIKE = 1e-4
#: No sensor is taken for blind that sees more than this share.
DIM = 0.1
#: Largest distance of a scattered eigenvector, of length 1, from the eigenspace that it stands for.
SPAN = 0.05


@final
@dataclass(frozen=True, eq=False)
class Eigenspace:
    """ker(A - lambda I) for one eigenvalue, to the tolerance asked for.

    Attributes:
        value: the eigenvalue; one with a positive imaginary part stands for itself and its conjugate.
        V: (n, g), a basis; its columns are orthonormal in the balanced states z = x / `scale`.
        scale: (n,), the balanced units of the states.
        blind: share of ||C_i|| ||v|| below which a sensor does not see v.
    """

    value: complex
    V: Field
    scale: Array
    blind: float

    @property
    def multiplicity(self) -> int:
        """Geometric multiplicity g."""
        return int(self.V.shape[1])

    def within(self, basis: Field) -> Eigenspace:
        """The part of it that the columns of `basis`, (g, h), orthonormal, span."""
        return Eigenspace(self.value, self.V @ basis, self.scale, self.blind)


@final
@dataclass(frozen=True, eq=False)
class Sight:
    """What sensors see of an eigenspace: sensor i sees V u if and only if a row of it is not orthogonal to u.

    Attributes:
        rows: (R, g), orthonormal rows per sensor; a sensor that sees nothing has none.
        owner: (R,), the sensor of every row.
        sensors: N, how many sensors there are.
        blind: |row u| <= blind ||u|| counts as zero.
    """

    rows: Field
    owner: Indices
    sensors: int
    blind: float

    @property
    def dimension(self) -> int:
        """How many directions, g."""
        return int(self.rows.shape[1])

    def support(self, u: Field) -> Indices:
        """The sensors that see V u."""
        return np.unique(self.owner[np.abs(self.rows @ u) > self.blind * np.linalg.norm(u)])

    def only(self, kept: NDArray[np.bool_]) -> Sight:
        """The rows of some sensors, `kept` (N,); the others count as absent."""
        mine = kept[self.owner]
        return Sight(self.rows[mine], self.owner[mine], self.sensors, self.blind)


def eigenspaces(A: Array, C: Array, cut: float, tol: float = TOLERANCE) -> tuple[Eigenspace, ...]:
    """Find the eigenspaces of all eigenvalues with |lambda| >= cut, largest first.

    Args:
        A: (n, n).
        C: (m, n), each row in units of its own noise; it only balances the units of the states.
        cut: 0 for all eigenvalues.
        tol: eigenvalues this close, in units of max(1, ||A||), count as equal.
    Returns:
        Nothing if ||A||^2 overflows.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        scale = balanced_units(A, C)
        A = A / scale[:, None] * scale
        size = max(1.0, float(np.sqrt((A * A).sum())))
    if not np.isfinite(size):  # beyond what numbers can tell
        return ()
    size = max(1.0, float(np.linalg.norm(A, 2)))
    decomposed: tuple[Field, ...] = scipy.linalg.eig(A, left=True)
    values, left, vectors = decomposed
    doubt = _doubt(left, vectors, size)
    if np.max(np.abs(values) + doubt) < cut:
        return ()
    skewness = float(np.linalg.cond(vectors))
    settled = list(_settle(A, values, vectors, doubt, skewness, tol * size, size))
    found: list[_Found] = []
    for value, reach, moved in sorted(settled, key=lambda one: (-abs(one[0]), -one[0].real)):
        if value.imag >= 0 and reach >= cut and not _listed(A, value, found, tol * size):
            space = _kernel(A, value, values, vectors, skewness, tol * size, size)
            space.moved = moved
            found.append(space)
    return tuple(
        Eigenspace(one.value, scale[:, None] * one.V, scale, min(DIM, max(tol, one.error(size))))
        for one in found
    )


@dataclass
class _Found:
    """ker(A - value I) in balanced units.

    Attributes:
        V: orthonormal columns.
        inside, gap: largest singular value of A - value I on V, smallest one outside of it.
        left_out: sine of the largest angle to V of an eigenvector that V stands for as well.
        moved: how far rounding may have moved the eigenvalue.
    """

    value: complex
    V: Field
    inside: float
    gap: float
    left_out: float = 0.0
    moved: float = 0.0

    def error(self, size: float) -> float:
        """How far a true eigenvector may lie outside of V."""
        rounding = 100 * float(np.finfo(np.float64).eps) * size
        return max(10 * self.left_out, (max(10 * self.inside, self.moved) + rounding) / self.gap)


def _doubt(left: Field, vectors: Field, size: float) -> Array:
    """How far rounding may have moved each eigenvalue: eps ||A|| times its condition number, and some."""
    with np.errstate(divide="ignore"):
        moved = 100 * np.finfo(np.float64).eps * size / np.abs(np.einsum("ij,ij->j", left.conj(), vectors))
    doubt: Array = np.minimum(moved, RADII[0] * size)
    return doubt


def sight(space: Eigenspace, C: Array, channel_sensor: NDArray[np.integer], sensors: int) -> Sight:
    """What sensors with the rows C, (m, n), in units of their noise, see of an eigenspace."""
    C, V = C * space.scale, space.V / space.scale[:, None]
    seen = C @ V
    alone = np.bincount(channel_sensor, minlength=sensors)[channel_sensor] == 1
    lengths = np.linalg.norm(seen, axis=1)
    kept = alone & (lengths > space.blind * np.linalg.norm(C, axis=1))
    rows, owner = [seen[kept] / lengths[kept][:, None]], [channel_sensor[kept]]
    for i in np.unique(channel_sensor[~alone]):
        own = channel_sensor == i
        _, shares, Wh = np.linalg.svd(seen[own], full_matrices=False)
        mine = Wh[: len(shares)][shares > space.blind * np.linalg.norm(C[own], 2)]
        rows.append(mine)
        owner.append(np.full(len(mine), i))
    owners = np.concatenate(owner).astype(np.intp)
    order = np.argsort(owners, kind="stable")
    return Sight(np.vstack(rows)[order], owners[order], sensors, space.blind)


def kernel_of(rows: Field, tol: float) -> Field:
    """Orthonormal columns that span the vectors u with |rows u| <= tol ||u||, for rows of length about 1."""
    g = rows.shape[1]
    if not len(rows):
        return np.eye(g, dtype=rows.dtype)
    _, shares, Wh = np.linalg.svd(rows, full_matrices=len(rows) < g)
    basis: Field = Wh[int(np.sum(shares > tol)) :].conj().T
    return basis


def _settle(
    A: Array, values: Field, vectors: Field, doubt: Array, skewness: float, tol: float, size: float
) -> Iterator[tuple[complex, float, float]]:
    """Replace clusters of eigenvalues that are one scattered eigenvalue by their mean.

    Yields:
        Each eigenvalue, the largest size that it may have in truth, and how far rounding may have moved it; a
        mean hardly moves.
    """
    largest = np.abs(values) + doubt
    waiting = [(np.arange(len(values)), 0)]
    while waiting:
        members, level = waiting.pop()
        if len(members) == 1 or level == len(RADII):
            yield from (
                (_upper(complex(values[i]), size), float(largest[i]), float(doubt[i])) for i in members
            )
            continue
        for group in _linked(values, members, RADII[level] * size):
            mean = _upper(complex(values[group].mean()), size, tol)
            apart = np.abs(values[group] - mean)
            same = len(group) == 1 or bool(apart.max() <= ROUNDING * size)
            if not same and np.all(apart <= doubt[group]):
                limit = min(tol, 1e-3 * float(apart.max()) + ROUNDING * size)
                least = float(np.abs(values - mean).min()) / skewness  # of the singular values of A - mean I
                same = least <= limit and _is_one(A, mean, vectors[:, group], limit, tol)
            if same:
                yield mean, float(largest[group].max()), float(doubt[group].max()) if len(group) == 1 else 0.0
            else:
                waiting.append((group, level + 1))


def _linked(values: Field, members: Indices, reach: float) -> Iterator[Indices]:
    """Groups of members that are linked by steps up to `reach`."""
    near = np.abs(values[members][:, None] - values[members]) <= reach
    left = np.ones(len(members), dtype=bool)
    while left.any():
        group = np.zeros(len(members), dtype=bool)
        edge = np.arange(len(members)) == int(np.argmax(left))
        while edge.any():
            group |= edge
            edge = near[edge].any(axis=0) & ~group
        left &= ~group
        yield members[group]


def _is_one(A: Array, value: complex, vectors: Field, limit: float, tol: float) -> bool:
    """Whether the mean of a cluster is an eigenvalue itself, and the members' eigenvectors belong to it.

    The members of a Jordan block have nearly the same eigenvector; eigenvalues that only lie symmetrically
    around a third have their own.
    """
    _, sizes, Vh = np.linalg.svd(_shifted(A, value))
    if sizes[-1] > limit:
        return False
    V = Vh[sizes <= tol].conj().T
    return bool(np.all(np.linalg.norm(vectors - V @ (V.conj().T @ vectors), axis=0) <= SPAN))


def _listed(A: Array, value: complex, found: list[_Found], tol: float) -> bool:
    """Whether the eigenspace of a nearly equal eigenvalue, found before, contains this one's."""
    for one in found:
        if abs(value - one.value) <= 2 * tol:
            mine = _null_space(A, value, tol).V
            left_out = float(np.linalg.norm(mine - one.V @ (one.V.conj().T @ mine), 2))
            if left_out < ALIKE or abs(value - one.value) <= 0.01 * tol:
                one.left_out = max(one.left_out, left_out)
                return True
    return False


def _kernel(
    A: Array, value: complex, values: Field, vectors: Field, skewness: float, tol: float, size: float
) -> _Found:
    """ker(A - value I), orthonormal.

    The second smallest singular value of A - lambda I is at least the distance of lambda to the next
    eigenvalue over the condition number of the eigenvectors. Where that settles that there is one direction,
    no singular value decomposition is needed.
    """
    apart = np.abs(values - value)
    own = int(np.argmin(apart))
    gap = float(np.min(np.delete(apart, own), initial=np.inf)) / skewness
    if apart[own] <= ROUNDING * size and gap > 10 * tol:
        v = vectors[:, [own]] if value.imag else vectors[:, [own]].real
        v = v / np.linalg.norm(v)
        return _Found(value, v, float(np.linalg.norm(_shifted(A, value) @ v)), gap)
    return _null_space(A, value, tol)


def _null_space(A: Array, value: complex, tol: float) -> _Found:
    _, sizes, Vh = np.linalg.svd(_shifted(A, value))
    g = max(1, int(np.sum(sizes <= tol)))
    gap = float(sizes[-g - 1]) if g < len(A) else np.inf
    return _Found(value, Vh[len(A) - g :].conj().T, float(sizes[-g]), gap)


def _shifted(A: Array, value: complex) -> Field:
    return A - (value if value.imag else value.real) * np.eye(len(A))


def _upper(value: complex, size: float, tol: float = 0.0) -> complex:
    """The value as a plain complex number, real if its imaginary part is mere rounding."""
    return complex(value.real, value.imag if abs(value.imag) > max(tol, ROUNDING * size) else 0.0)
