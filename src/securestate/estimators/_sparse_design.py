"""From the decomposition to what the kernel of sparse fusion needs: coordinates, penalties, projection.

The kernel solves  min ½ gᵀ H g − ν₀ᵀ g + Σ γ_j ‖g_j‖₂  in coordinates f_i = S_i g_i per sensor, chosen so
that the penalty is a plain 2-norm and every diagonal block of H is diagonal: one block update is then a
scalar equation.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from securestate.estimators._pairs import Pair
from securestate.plant import Plant

if TYPE_CHECKING:
    from securestate.estimators.sparse_fusion import Decomposition

Float = NDArray[np.float64]

#: ‖f_i‖ above which a sensor is suspected, in standard deviations of its own information.
SUSPICION = 3.0
#: Eigenvalues of N_ii below this share of its bound R_ii⁻¹ count as zero: nobody else sees that direction.
RANK_TOLERANCE = 1e-10


@dataclass(frozen=True)
class Coordinates:
    """f_i = S_i g_i per sensor: the penalty becomes a plain 2-norm and the blocks of H diagonal.

    Attributes:
        S: per sensor, (n c_i, d_i): U Λ^{-1/2} of N_ii (robust), a rotation of each complex pair (paper).
        S_inverse: per sensor, (d_i, n c_i).
        groups: first element of every penalty group, and d.
        sensors: first element of every sensor, and d.
        locals_: first entry of every sensor in ζ, and m n.
        H: Sᵀ N S, (d, d).
    """

    S: list[Float]
    S_inverse: list[Float]
    groups: NDArray[np.int64]
    sensors: NDArray[np.int64]
    locals_: NDArray[np.int64]
    H: Float


def coordinates(plant: Plant, parts: Decomposition, form: str) -> Coordinates:
    channels = [plant.channels_of(i) for i in range(plant.n_sensors)]
    locals_ = np.array([c.start * plant.n for c in channels] + [plant.m * plant.n])
    blocks = [slice(a, b) for a, b in pairwise(locals_)]
    if form == "robust":
        bounds = [np.linalg.norm(parts.weights.precision[c, c], 2) for c in channels]
        pairs = [_whiten(parts.N[s, s], float(top)) for s, top in zip(blocks, bounds, strict=True)]
        sensors = np.cumsum([0] + [S.shape[1] for S, _ in pairs])
        groups = np.unique(sensors)  # a sensor that nobody can check has no elements and no group
    else:
        pairs = [_rotate(parts.N[s, s], parts.pair, plant.n) for s in blocks]
        sensors = locals_
        sizes = [len(group) for group in parts.pair.groups] * plant.m
        groups = np.cumsum([0, *sizes])
    H = np.empty((sensors[-1], sensors[-1]))
    for (S_i, _), a, rows in zip(pairs, range(len(pairs)), blocks, strict=True):
        left = S_i.T @ parts.N[rows]
        for (S_j, _), c, columns in zip(pairs, range(len(pairs)), blocks, strict=True):
            H[sensors[a] : sensors[a + 1], sensors[c] : sensors[c + 1]] = left[:, columns] @ S_j
    return Coordinates([S for S, _ in pairs], [I for _, I in pairs], groups, sensors, locals_, (H + H.T) / 2)


def _whiten(N_ii: Float, bound: float) -> tuple[Float, Float]:
    """U Λ^{-1/2} and Λ^{1/2} Uᵀ over the directions that other sensors can check; N_ii ≤ bound."""
    values, U = np.linalg.eigh(N_ii)
    keep = values > RANK_TOLERANCE * bound
    root = np.sqrt(values[keep])
    return U[:, keep] / root, (U[:, keep] * root).T


def _rotate(N_ii: Float, pair: Pair, n: int) -> tuple[Float, Float]:
    """A rotation inside every complex pair that makes its 2 × 2 block of N diagonal and keeps the norm."""
    S = np.zeros_like(N_ii)
    for start in range(0, len(N_ii), n):
        for group in pair.groups:
            at = np.ix_(start + group, start + group)
            S[at] = np.linalg.eigh(N_ii[at])[1] if len(group) > 1 else 1.0
    return S, S.T


def gamma_from_probability(coordinates: Coordinates, probability: float) -> Float:
    """γ_j with P(‖ν₀_j‖ ≤ γ_j for all j) ≥ probability when nobody lies: each gets the N-th root of it."""
    degrees = np.diff(coordinates.groups)
    share = probability ** (1 / max(1, len(degrees)))
    chi2_quantile = 2 * gammaincinv(degrees / 2, share)
    return np.asarray(np.sqrt(chi2_quantile))


def kernel_design(
    plant: Plant, parts: Decomposition, coordinates: Coordinates, gammas: Float, *, refit: bool
) -> dict[str, object]:
    """Everything the kernel needs, by the name of its field."""
    n, m, k = plant.n, plant.m, parts.split.flat
    T, b, steady, split = parts.pair.T, parts.pair.b, parts.steady, parts.split
    V_s, B_modes = split.V[:, k:], split.V_inv @ plant.B
    # (19): the known input moves ζ_i by (G_i − b C_i) B u, here for the flat modes only
    into = parts.G - b[:, np.newaxis] * (plant.C @ split.V[:, :k])[:, np.newaxis, :]
    F = parts.F.transpose(1, 0, 2).reshape(n, m * n)
    now, before = _attack_maps(plant, parts, coordinates)
    joseph = np.eye(n) - steady.gain @ plant.C
    arrays = {
        "a": plant.A,
        "b": plant.B,
        "c": plant.C,
        "d": plant.D,
        "t_transposed": T.T,
        "drive": b,
        "input_map": into.reshape(m * n, k) @ B_modes[:k],
        "start_map": into.reshape(m * n, k),
        "modes": split.V_inv,
        "a_s": split.A_s,
        "b_s": B_modes[k:],
        "c_s": plant.C @ V_s,
        "v_s": V_s,
        "fusion": F,
        "fusion_g": _apply_right(F, coordinates),
        "hessian": coordinates.H,
        "gamma": gammas,
        "attack_now": now,
        "attack_before": before,
        "p": steady.P_posterior,
        "q": plant.Q,
        "krk": steady.gain @ plant.R @ steady.gain.T,
        "ikc": joseph,
        "innovation_std": np.sqrt(np.diag(steady.innovation_cov)),
        "basis_inverse": np.concatenate([I.ravel() for I in coordinates.S_inverse]),
        "offset": plant.offset,
        "scale": plant.scale,
        "input_offset": plant.input_offset,
        "input_scale": plant.input_scale,
        **_projection(plant, parts, coordinates),
    }
    return {name: np.ascontiguousarray(value, dtype=np.float64) for name, value in arrays.items()} | {
        "n": n,
        "m": m,
        "N": plant.n_sensors,
        "p_inputs": plant.n_inputs,
        "groups": coordinates.groups.tolist(),
        "sensors": coordinates.sensors.tolist(),
        "locals": coordinates.locals_.tolist(),
        "channel_sensor": plant.channel_sensor.tolist(),
        "uncheckable": np.flatnonzero(plant.uncheckable).tolist(),
        "suspicion": SUSPICION,
        "refit": (plant.n_sensors - 1) // 2 if refit else 0,
    }


def _apply_right(F: Float, coordinates: Coordinates) -> Float:
    """F S."""
    starts = coordinates.locals_
    return np.hstack([F[:, a:b] @ S for a, b, S in zip(starts[:-1], starts[1:], coordinates.S, strict=True)])


def _projection(plant: Plant, parts: Decomposition, coordinates: Coordinates) -> dict[str, Float]:
    """−Sᵀ N dense, or its factors where they are cheaper to apply (many more channels than states)."""
    n, m = plant.n, plant.m
    weights = parts.weights
    r = weights.Z.shape[1]
    diagonal = np.array_equal(plant.R, np.diag(np.diag(plant.R)))
    plain = np.array_equal(weights.gram_root, np.eye(n))
    structured_cost = (r * n) ** 2 + 2 * r * m * n + m * n * n
    if diagonal and plain and structured_cost < 0.7 * (m * n) ** 2:
        return {
            "precision": 1 / np.diag(plant.R),
            "mix": weights.Z,
            "core": weights.K,
            "basis_transposed": np.concatenate([S.T.ravel() for S in coordinates.S]),
        }
    return {"projection": -_apply_right(parts.N, coordinates).T}


def _attack_maps(plant: Plant, parts: Decomposition, coordinates: Coordinates) -> tuple[Float, Float]:
    """Rows that turn g(k) and g(k−1) of a sensor into the attack on each of its channels.

    ϑ_i(k) − T ϑ_i(k−1) = −b a_i(k), solved for a_i by least squares in the metric N_ii.
    """
    n, T, b = plant.n, parts.pair.T, parts.pair.b
    d = int(coordinates.sensors[-1])
    now, before = np.zeros((plant.m, d)), np.zeros((plant.m, d))
    for i in range(plant.n_sensors):
        rows = plant.channels_of(i)
        count = rows.stop - rows.start
        local = slice(rows.start * n, rows.stop * n)
        into = np.kron(np.eye(count), b[:, np.newaxis])
        metric = parts.N[local, local]
        weight = np.linalg.lstsq(into.T @ metric @ into, into.T @ metric, rcond=None)[0]
        columns = slice(coordinates.sensors[i], coordinates.sensors[i + 1])
        now[rows, columns] = -weight @ coordinates.S[i]
        before[rows, columns] = weight @ np.kron(np.eye(count), T) @ coordinates.S[i]
    return now, before
