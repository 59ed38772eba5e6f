"""The largest share that a few sensors can have in what all sensors say of a direction.

    kappa = max over u != 0 of  sum of ||H_i u|| over attacked i  /  sum of ||H_i u|| over all i

An estimator that minimises such a sum of norms stays with the honest sensors if and only if kappa < 1/2, that
is, if rho = kappa / (1 - kappa) < 1. ||H_i u|| is a sum over the blocks of sensor i: one block in a group
norm, one per element in a 1-norm. Sets of sensors are never enumerated: for a direction the worst p are the p
loudest.

Three bounds, in coordinates with sum H_b' H_b = I:
    * From below, an ascent: u <- (sum of H_b' H_b / ||H_b u||)^-1 times the gradient of what is attacked.
    * From above at any size: H_i = sum over j of Z_ij H_j with Z_ij = w_j H_i M^-1 H_j', M = sum w_j H_j'
      H_j, so that kappa <= max over j of the p largest ||Z_ij||. The weights w, one set per i, even these
      norms out.
    * Exactly, up to six dimensions: branch and bound over simplicial cones. What is attacked is convex and
      the total is at least its tangent at the centre; a convex over a linear function is largest at a vertex.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate.resilience.eigenspaces import Array, Indices

#: Norm below which a block counts as zero where all blocks together have norm sqrt(d).
SILENT = 1e-12
#: Dimensions up to which the branch and bound is worth starting.
SMALL = 6
#: Rounds of reweighting of the bound from above.
ROUNDS = 15
#: Cones that are split at once; the rest keep their bounds.
WIDTH = 60_000
#: Cones after which the branch and bound stops.
CONES = 2_000_000


@final
@dataclass(frozen=True, eq=False)
class Norms:
    """The norms ||H_i u|| of all sensors in whitened coordinates.

    Attributes:
        H: (B, r, d), blocks with sum H_b' H_b = I.
        owner: (B,), the sensor of every block.
        sensors: N.
        back: (d, d), u = back @ z for a direction z in these coordinates.
    """

    H: Array
    owner: Indices
    sensors: int
    back: Array

    @classmethod
    def of(cls, blocks: Sequence[Array], owner: Sequence[int], sensors: int) -> Norms:
        """Whiten blocks of shape (r_b, d) that together see every direction."""
        depth = max(len(block) for block in blocks)
        H = np.stack([np.vstack([b, np.zeros((depth - len(b), b.shape[1]))]) for b in blocks])
        if depth > H.shape[2]:
            H = np.asarray(np.linalg.qr(H, mode="r"))
        _, shares, Wh = np.linalg.svd(H.reshape(-1, H.shape[2]), full_matrices=False)
        back = Wh.T / shares
        H = H @ back
        heard = np.linalg.norm(H, axis=(1, 2)) > SILENT  # a block that is zero says nothing
        return cls(H[heard], np.array(owner, dtype=np.intp)[heard], sensors, back)

    @property
    def dimension(self) -> int:
        """How many directions, d."""
        return int(self.H.shape[2])

    def per_sensor(self, U: Array) -> Array:
        """||H_i u||, (K, N), for directions U (K, d)."""
        return self.summed(self.per_block(U))

    def per_block(self, U: Array) -> Array:
        """The norm of every block, (K, B)."""
        flat = self.H.reshape(-1, self.dimension)
        lengths: Array = np.linalg.norm((U @ flat.T).reshape(len(U), *self.H.shape[:2]), axis=2)
        return lengths

    def summed(self, lengths: Array) -> Array:
        """Norms of blocks (K, B) as those of their sensors, (K, N)."""
        if len(self.owner) == self.sensors and np.array_equal(self.owner, np.arange(self.sensors)):
            return lengths
        summed: Array = lengths @ (self.owner[:, None] == np.arange(self.sensors)).astype(np.float64)
        return summed


@final
@dataclass(frozen=True, eq=False)
class Attacked:
    """Who may be attacked: a fixed set, or any `count` of `allowed`.

    Attributes:
        allowed: (N,) booleans.
        count: how many of them.
    """

    allowed: NDArray[np.bool_]
    count: int

    @classmethod
    def exactly(cls, chosen: Sequence[int], sensors: int) -> Attacked:
        """All of these sensors and no other."""
        allowed = np.zeros(sensors, dtype=bool)
        allowed[list(chosen)] = True
        return cls(allowed, int(allowed.sum()))

    def loudest(self, norms: Array) -> Indices:
        """The worst set for every row of (K, N), (K, count)."""
        order = np.argsort(-np.where(self.allowed, norms, -1.0), axis=1, kind="stable")
        return order[:, : self.count]

    def sum(self, norms: Array) -> Array:
        """What the worst set says, (K,)."""
        if self.count == 0:
            return np.zeros(len(norms))
        kept = norms[:, self.allowed]
        if self.count >= kept.shape[1]:
            return np.asarray(kept.sum(axis=1))
        return np.asarray(
            np.partition(kept, kept.shape[1] - self.count, axis=1)[:, -self.count :].sum(axis=1)
        )


@final
@dataclass(frozen=True, eq=False)
class Share:
    """Bounds of kappa, and the direction that attains the lower one.

    Attributes:
        lower, upper: bounds in [0, 1].
        direction: u, (d,), in the coordinates of the blocks.
        sensors: the attacked ones.
        factor: the bound from above that needs no search.
    """

    lower: float
    upper: float
    direction: Array
    sensors: Indices
    factor: float = 1.0


def largest_share(
    norms: Norms, attacked: Attacked, *, gap: float = 1e-3, time_limit: float = 60.0, decide: bool = False
) -> Share:
    """Bounds of kappa.

    Args:
        norms: of the sensors.
        attacked: who may be attacked.
        gap: largest relative error of rho at which the branch and bound stops.
        time_limit: seconds after which the bounds are returned as they are.
        decide: stop as soon as it is known whether kappa < 1/2.
    """
    deadline = time.monotonic() + time_limit
    best = _Highest(norms, attacked)
    best.offer(_starts(norms))
    upper = min(1.0, bound_from_above(norms, attacked, rounds=2 if decide else ROUNDS))
    if decide and upper >= 0.5:
        upper = min(1.0, bound_from_above(norms, attacked))
    if not (decide and upper < 0.5):
        _ascend(norms, attacked, best, _starts(norms), 60)
    factor = upper
    settled = decide and (upper < 0.5 or best.share >= 0.5)
    if norms.dimension == 1:
        upper = best.share
    elif norms.dimension <= SMALL and not settled:
        upper = min(upper, _branch_and_bound(norms, attacked, best, gap, deadline, decide))
    if not settled:
        _ascend(norms, attacked, best, best.z[None], 1000)
    upper = max(upper, best.share)
    u = norms.back @ best.z
    return Share(best.share, upper, u / np.linalg.norm(u), best.sensors, factor)


class _Highest:
    """The direction with the largest share so far."""

    def __init__(self, norms: Norms, attacked: Attacked) -> None:
        self.norms, self.attacked = norms, attacked
        self.share = -1.0
        self.z = np.zeros(norms.dimension)

    def offer(self, Z: Array) -> Array:
        """Take the best of the directions (K, d); returns the shares of all."""
        return self.take(Z, self.norms.per_sensor(Z))

    def take(self, Z: Array, heard: Array) -> Array:
        """The same where ||H_i u||, (K, N), is known."""
        shares: Array = self.attacked.sum(heard) / heard.sum(axis=1)
        k = int(np.argmax(shares))
        if shares[k] > self.share:
            self.share, self.z = float(shares[k]), Z[k]
        return shares

    @property
    def sensors(self) -> Indices:
        """The attacked sensors of that direction, sorted."""
        return np.sort(self.attacked.loudest(self.norms.per_sensor(self.z[None]))[0])


def _starts(norms: Norms) -> Array:
    """Random directions and the loudest of every block."""
    random = np.random.default_rng(0).standard_normal((60, norms.dimension))
    return np.vstack([random, np.linalg.svd(norms.H)[2][:, 0]])


def _ascend(norms: Norms, attacked: Attacked, best: _Highest, Z: Array, rounds: int) -> None:
    """Ascend from all directions Z (K, d) at once; the share never falls."""
    d = norms.dimension
    Q = np.einsum("bkl,bkm->blm", norms.H, norms.H).reshape(-1, d * d)
    before = np.full(len(Z), -1.0)
    for _ in range(rounds):
        lengths = norms.per_block(Z)
        heard = norms.summed(lengths)
        shares = best.take(Z, heard)
        rising = (shares > before + 1e-12) & (shares > 0)
        if not rising.any():
            return
        Z, before, lengths = Z[rising], shares[rising], np.maximum(lengths[rising], 1e-13)
        chosen = np.zeros((len(Z), norms.sensors))
        np.put_along_axis(chosen, attacked.loudest(heard[rising]), 1.0, axis=1)
        said = ((chosen[:, norms.owner] / lengths) @ Q).reshape(-1, d, d)
        metric = ((1 / lengths) @ Q).reshape(-1, d, d)
        Z = np.linalg.solve(metric, said @ Z[:, :, None])[:, :, 0]
        Z /= np.linalg.norm(Z, axis=1)[:, None]


def bound_from_above(norms: Norms, attacked: Attacked, rounds: int = ROUNDS) -> float:
    """Bound kappa by what p sensors have of ||Z_bj|| in the worst column j, and by their largest entries."""
    H = norms.H
    B = len(H)
    Q = np.einsum("bkl,bkm->blm", H, H).reshape(B, -1)
    Z = np.vstack(
        [
            _factor(H, Q, rows, rounds)
            for rows in np.array_split(np.arange(B), max(1, B * B * H[0].size // 10**6))
        ]
    )
    member = (norms.owner[:, None] == np.arange(norms.sensors)).astype(np.float64)
    by_column = attacked.sum((member.T @ Z).T).max()
    by_sensor = attacked.sum((member.T @ Z.max(axis=1))[None])[0]
    return float(min(by_column, by_sensor))


def _factor(H: Array, Q: Array, rows: Indices, rounds: int) -> Array:
    """||Z_bj|| for some blocks b and all j, (len(rows), B); every b has weights of its own."""
    d = H.shape[2]
    w = np.tile(
        1 / np.sqrt(np.maximum(np.trace(Q.reshape(-1, d, d), axis1=1, axis2=2), 1e-300)), (len(rows), 1)
    )
    best = np.full((len(rows), len(H)), np.inf)
    eagerness = 0.7
    for _ in range(rounds):
        M = (w @ Q).reshape(-1, d, d)
        left = np.swapaxes(np.linalg.solve(M, np.swapaxes(H[rows], 1, 2)), 1, 2)
        Z = np.einsum("bkl,jml->bjkm", left, H, optimize=True)
        sizes = w * _spectral_norms(Z)
        better = sizes.max(axis=1) < best.max(axis=1)
        best[better] = sizes[better]
        spread = np.log(np.maximum(sizes, 1e-12)) - np.log(
            np.maximum(sizes.max(axis=1, keepdims=True), 1e-12)
        )
        w = w * np.clip(np.exp(-eagerness * spread), 1, 5)
        w /= w.sum(axis=1, keepdims=True)
        eagerness = max(0.15, 0.96 * eagerness)
    return best


def _spectral_norms(Z: Array) -> Array:
    """Largest singular values of a stack of small matrices; the Frobenius norm where they have one row."""
    if min(Z.shape[2:]) == 1:
        return np.asarray(np.sqrt(np.einsum("bjkm,bjkm->bj", Z, Z)))
    return np.asarray(np.sqrt(np.linalg.eigvalsh(Z @ np.swapaxes(Z, 2, 3))[..., -1].clip(0)))


def _branch_and_bound(
    norms: Norms, attacked: Attacked, best: _Highest, gap: float, deadline: float, decide: bool
) -> float:
    """Upper bound of kappa over all directions; `best` rises on the way."""
    d = norms.dimension
    signs = itertools.product([1.0, -1.0], repeat=d - 1)
    cones = np.stack([np.diag(np.r_[1.0, s]) for s in signs])  # (K, d, d): one vertex per row
    tops = _tops(norms, attacked, cones.reshape(-1, d)).reshape(len(cones), d)
    bounds = _cone_bounds(norms, cones, tops, best)
    seen, discarded = len(cones), 0.0
    while len(cones):
        allowed = best.share + gap * best.share * (1 - best.share)
        closed = bounds <= allowed
        discarded = max(discarded, float(bounds[closed].max(initial=0.0)))
        cones, tops, bounds = cones[~closed], tops[~closed], bounds[~closed]
        upper = max(best.share, discarded, float(bounds.max(initial=0.0)))
        if not len(cones) or (decide and (upper < 0.5 or best.share >= 0.5)):
            return upper
        if seen > CONES or time.monotonic() > deadline:
            return upper
        worst = np.argsort(-bounds, kind="stable")
        split, rest = worst[:WIDTH], worst[WIDTH:]
        halves, half_tops = _split(norms, attacked, cones[split], tops[split], best)
        half_bounds = np.minimum(_cone_bounds(norms, halves, half_tops, best), np.tile(bounds[split], 2))
        cones = np.concatenate([halves, cones[rest]])
        tops = np.concatenate([half_tops, tops[rest]])
        bounds = np.concatenate([half_bounds, bounds[rest]])
        seen += len(halves)
    return max(best.share, discarded)


def _tops(norms: Norms, attacked: Attacked, U: Array) -> Array:
    return attacked.sum(norms.per_sensor(U))


def _cone_bounds(norms: Norms, cones: Array, tops: Array, best: _Highest) -> Array:
    """Largest share that a cone can hold: attacked at a vertex over the total's tangent there."""
    flat, d = norms.H.reshape(-1, norms.dimension), norms.dimension
    centres = cones.mean(axis=1)
    best.offer(centres)
    said = (centres @ flat.T).reshape(len(cones), *norms.H.shape[:2])
    lengths = np.maximum(np.linalg.norm(said, axis=2), 1e-300)
    slope = (said / lengths[:, :, None]).reshape(len(cones), -1) @ flat
    total = np.einsum("cvd,cd->cv", cones, slope.reshape(-1, d))
    bounds: Array = np.where(total > 1e-12, tops / np.maximum(total, 1e-12), 1.0).max(axis=1)
    return np.minimum(bounds, 1.0)


def _split(
    norms: Norms, attacked: Attacked, cones: Array, tops: Array, best: _Highest
) -> tuple[Array, Array]:
    """Halve every cone at the middle of its longest edge."""
    d, k = norms.dimension, np.arange(len(cones))
    edges = np.linalg.norm(cones[:, :, None] - cones[:, None], axis=3).reshape(len(cones), -1)
    longest = edges.argmax(axis=1)
    i, j = longest // d, longest % d
    middle = cones[k, i] + cones[k, j]
    middle /= np.linalg.norm(middle, axis=1)[:, None]
    best.offer(middle)
    top = _tops(norms, attacked, middle)
    left, right, left_tops, right_tops = cones.copy(), cones.copy(), tops.copy(), tops.copy()
    left[k, i], right[k, j] = middle, middle
    left_tops[k, i], right_tops[k, j] = top, top
    return np.concatenate([left, right]), np.concatenate([left_tops, right_tops])
