"""Sparse fusion: the Kalman filter as a sum of local estimates, fused so that a few liars cannot move it.

    local filters     ζ_i(k+1) = T ζ_i(k) + b y_i(k+1)                                 (12)
    decomposition     x_kf = Σ F_i ζ_i  is the Kalman estimate                         (11), Theorem 1
    local errors      ε_i = G_i x − ζ_i,  Cov(ε) = W                                    (19), (29)
    secure fusion     min ½ φᵀ W⁻¹ φ + γ ‖ϑ‖   subject to   ζ = G x − φ − ϑ             (31)

With x and φ eliminated, (31) is  min ½ fᵀ N f − ν₀ᵀ f + γ ‖f‖  with  ν₀ = −N ζ  and  x_s = F (ζ + f), where
N = W⁻¹ − W⁻¹ G (Gᵀ W⁻¹ G)⁻¹ Gᵀ W⁻¹ and f is the estimate of ϑ. If f = 0 is optimal, x_s = x_kf.

References:
    Liu, Mo, Garone 2020 (docs/bibliography.md: liu2020).
Deviations from the paper, form="robust":
    * (T, b) is the orthonormal Takenaka-Malmquist pair, not the Jordan form: W ≥ R ⊗ I for any n.
    * Only modes of A with |μ| ≥ 0.999 get a flat prior (a column of G). The others keep their stationary
      prior, so A may be singular and may share eigenvalues with A − K C A (no Assumption 1 or 2).
    * One penalty per sensor, γ_i ‖f_i‖ in the metric N_ii, not one per element: independent of the basis.
    * γ_i is chosen from the probability that the answer is the Kalman estimate. Theorem 3 asks for dual
      norms of ν₀ up to γ; Cov ν₀ = N, so that of sensor i is χ² with as many degrees as N_ii has rank.
    * Refit: sensors with ‖f_i‖ > 3 lose their penalty, largest first, and the rest is solved again. This
      removes the shrinkage of the LASSO; at most ⌊(N − 1) / 2⌋ sensors, as many as can be outvoted.
    * Attack estimate: −(bᵀ N_ii b)⁻¹ bᵀ N_ii (f_i(k) − T f_i(k−1)), least squares in the metric N_ii.
    * A reading further than 10¹² standard deviations from its prediction is held at that distance.
form="paper" is (31) as printed. Complex eigenvalues appear as real 2 × 2 blocks, an exact change of basis.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, final

import numpy as np
from numpy.typing import NDArray

from securestate import _kernels
from securestate._checks import real_array, yes_or_no
from securestate._steady_state import SteadyState, steady_state
from securestate.errors import DesignError, InputError
from securestate.estimators import _decomposition as atoms
from securestate.estimators._consult import PATIENCE, refuse_without_redundancy, warn_of_margin
from securestate.estimators._pairs import Pair, jordan, takenaka_malmquist
from securestate.estimators._sparse_design import coordinates, gamma_from_probability, kernel_design
from securestate.estimators._sparse_margin import penalties
from securestate.estimators.base import Estimator
from securestate.plant import Plant
from securestate.resilience.fusion_margin import FusionMargin, Penalties, fusion_margin

Float = NDArray[np.float64]

#: Modes at least this slow get a flat prior in the robust form; later values are for plants that need more.
CUTS = (0.999, 0.99, 0.95, 0.8, 0.5, 0.0)
#: Largest variance of a local error, in units of its measurement noise, for which a cut is accepted at once.
SPREAD_LIMIT = 1e10
#: The same variance above which W has lost its smallest eigenvalues to rounding.
SPREAD_REFUSED = 1e12
#: Largest relative residual of F_i T = M F_i, F_i b = K_i and Σ F_i G_i = V_u.
RESIDUAL_LIMIT = 1e-9
#: Largest condition number of W that the paper form accepts.
CONDITION_LIMIT = 1e12
#: Largest n · m: the solver's matrix has (n · m)² numbers.
SIZE_LIMIT = 6000
#: Share of missing samples above which a steady-state filter is the wrong tool.
MISSING_LIMIT = 0.1


@dataclass(frozen=True)
class Decomposition:
    """The constant matrices of the method, in the paper's letters.

    Attributes:
        steady: K, P and M = A − K C A of the Kalman filter, (5)-(6).
        pair: T and b of the local filters (12).
        split: which modes get a flat prior; V_u are their directions.
        G: (m, n, n_u), ζ_i estimates G_i x_u, (18) and (20).
        F: (m, n, n), x̂ = Σ F_i ζ_i, (13).
        W: (m n, m n), covariance (29) of the local errors.
        N: (m n, m n), information left after x has been eliminated.
        weights: W and N in factored form.
    """

    steady: SteadyState
    pair: Pair
    split: atoms.Split
    G: Float
    F: Float
    W: Float
    N: Float
    weights: atoms.Weights

    @property
    def residual(self) -> float:
        """Largest relative violation of F_i T = M F_i, F_i b = K_i (13) and Σ F_i G_i = V_u (21)."""
        M, K, T, b, F = self.steady.M, self.steady.gain, self.pair.T, self.pair.b, self.F
        V_u = self.split.V[:, : self.split.flat]
        moved = np.abs(F @ T - M @ F).max() / (np.abs(F).max() * max(1.0, float(np.linalg.norm(M, 2))))
        driven = np.abs((F @ b).T - K).max() / np.abs(K).max()
        identity = np.abs(np.einsum("iab,ibc->ac", F, self.G) - V_u).max(initial=0.0)
        return float(max(moved, driven, identity))


@final
class SparseFusion(Estimator):
    """Secure state estimation by sparse fusion of local Kalman estimates (Liu, Mo, Garone).

    Equals the Kalman filter with probability `kalman_probability` per sample when nobody lies, and stays near
    it while a minority of sensors lies, within the limits of the installation. For time-invariant plants.

    Args:
        plant: the plant; (A, C) detectable, process noise in every mode on the unit circle.
        form: "robust" (ours, for any plant) or "paper" (as printed, small well-conditioned plants).
        kalman_probability: probability per sample of returning exactly the Kalman estimate when nobody lies.
            Default 0.95. Robust form only.
        gamma: the penalty itself instead; a number, or one per sensor (robust form). The paper form needs it.
        refit: remove the shrinkage from suspected sensors; default True for "robust", False for "paper".

    Raises:
        DesignError: the plant has no steady-state filter, is too large, or breaks an assumption of the paper.
        InputError: a setting is out of range.

    Notes:
        A missing channel is filled with its prediction and its sensor is left out for that sample, its trust
        is NaN. Above about 10 % missing samples use a time-varying filter (`run` warns).
        `Run.trust` is 1 / (1 + (‖f_i‖ / 3)²), with ‖f_i‖ the accusation in standard deviations; a sensor is
        suspected when it falls below one half. `Run.P` is the covariance without the sensors in use by f.
        NOT_CONVERGED: the relative duality gap stayed above 1e-9. ILL_CONDITIONED: the sensors that are not
        accused do not determine the state.

    Examples:
        >>> from securestate import Plant, Sensor, SparseFusion
        >>> sensors = [Sensor(name, C=[[1.0]], R=1.0) for name in ("a", "b", "c")]
        >>> estimator = SparseFusion(Plant([[0.9]], [[1.0]], sensors))
        >>> run = estimator.run([[0.1, -0.2, 50.0], [0.3, 0.1, 50.0]])
        >>> print(run.suspected[-1], abs(run.x[-1, 0]) < 1)
        [False False  True] True
    """

    #: Share of missing samples above which `run` warns.
    missing_limit = MISSING_LIMIT
    takes_covariance = False
    decomposition: Decomposition
    _penalties: Penalties

    def __init__(
        self,
        plant: Plant,
        *,
        form: Literal["robust", "paper"] = "robust",
        kalman_probability: float | None = None,
        gamma: float | NDArray[np.float64] | None = None,
        refit: bool | None = None,
    ) -> None:
        _check_settings(plant, form, kalman_probability, gamma)
        if refit is not None:
            refit = yes_or_no("refit", refit, InputError)
        refit = form == "robust" if refit is None else refit
        self.decomposition = _robust(plant) if form == "robust" else _paper(plant)
        refuse_without_redundancy(plant)
        axes = coordinates(plant, self.decomposition, form)
        if form == "robust":
            if gamma is None:
                kalman_probability = 0.95 if kalman_probability is None else kalman_probability
                gammas = gamma_from_probability(axes, kalman_probability)
            else:
                checked = np.diff(axes.sensors) > 0
                gammas = np.broadcast_to(np.asarray(gamma, dtype=np.float64), (plant.n_sensors,))[checked]
        else:
            gammas = np.asarray(gamma) * np.sqrt(np.diff(axes.groups))
        settings = {
            "form": form,
            "kalman_probability": kalman_probability,
            "gamma": np.unique(gammas).tolist() if gamma is None else np.asarray(gamma).tolist(),
            "refit": refit,
        }
        self._penalties = penalties(self.decomposition, axes, gammas)
        kernel = _kernels.sparse_fusion(kernel_design(plant, self.decomposition, axes, gammas, refit=refit))
        super().__init__(plant, kernel, settings)
        warn_of_margin(self.margin(1, time_limit=PATIENCE, decide=True))

    @staticmethod
    def require(plant: Plant) -> None:
        """Refuse a plant that varies in time or is too large for this method.

        Raises:
            DesignError: with what to use instead.
        """
        if plant.time_varying:
            raise DesignError(
                "sparse fusion needs a time-invariant plant", "use KalmanFilter for A or C that change"
            )
        if plant.n * plant.m > SIZE_LIMIT:
            raise DesignError(
                f"sparse fusion of n = {plant.n} states and m = {plant.m} channels needs a matrix of "
                f"{plant.n * plant.m} x {plant.n * plant.m}; the limit is {SIZE_LIMIT}",
                "use a smaller model, or the Kalman filter with a detector",
            )

    def margin(
        self, attacked: int | Iterable[str], *, time_limit: float = 60.0, decide: bool = False
    ) -> FusionMargin:
        """Tell whether the error stays bounded whatever some sensors inject (Theorem 4).

        Args:
            attacked: how many sensors lie, any that are not protected, or the names of those that do.
            time_limit: seconds after which the bounds of rho are returned as they are.
            decide: stop as soon as it is known whether rho < 1.

        Raises:
            InputError: attacked is neither a whole number >= 0 nor names of sensors.

        Examples:
            >>> from securestate import Plant, Sensor, SparseFusion
            >>> sensors = [Sensor(name, C=[[1.0]], R=1.0) for name in ("a", "b", "c")]
            >>> plant = Plant([[1.0]], [[1.0]], sensors)
            >>> print(SparseFusion(plant).margin(1))
            secure against 1 (rho 0.5)
        """
        return fusion_margin(self.plant, self._penalties, attacked, time_limit=time_limit, decide=decide)


def _check_settings(
    plant: Plant, form: str, probability: float | None, gamma: float | NDArray[np.float64] | None
) -> None:
    if not isinstance(plant, Plant):
        raise InputError("plant", "a Plant; Plant.load reads a file", type(plant).__name__)
    SparseFusion.require(plant)
    if form not in ("robust", "paper"):
        raise InputError("form", '"robust" or "paper"', repr(form))
    if probability is not None and gamma is not None:
        raise InputError("gamma", "either gamma or kalman_probability", "both")
    if probability is not None:
        real_array("kalman_probability", probability, InputError)
    if gamma is not None:
        real_array("gamma", gamma, InputError)
    if probability is not None and not (np.ndim(probability) == 0 and 0 < probability < 1):
        raise InputError("kalman_probability", "a number in (0, 1)", repr(probability))
    if form == "paper" and gamma is None:
        raise InputError("gamma", 'a number > 0, because form="paper" has no probability knob', "None")
    if gamma is not None:
        values = np.asarray(gamma, dtype=np.float64)
        if not np.all(np.isfinite(values)) or np.any(values <= 0):
            raise InputError("gamma", "finite numbers > 0", repr(gamma))
        if values.ndim and (form == "paper" or values.shape != (plant.n_sensors,)):
            raise InputError(
                "gamma", f"a number, or shape ({plant.n_sensors},) in robust form", f"{values.shape}"
            )


def _robust(plant: Plant) -> Decomposition:
    """Orthonormal pair, flat prior for the slow modes only.

    Where the slow modes cannot be separated from the others (a Jordan block that rounding scatters around the
    cut) or the others have a huge stationary variance, more modes get a flat prior.
    """
    steady = steady_state(plant)
    pair = takenaka_malmquist(steady.M)
    candidates = []
    for cut in CUTS:
        split = atoms.split_modes(plant.A, steady.M, cut)
        try:
            result = _decompose(plant, steady, pair, split, gramian=None)
        except (np.linalg.LinAlgError, ValueError, DesignError):
            continue
        if result.weights.spread <= SPREAD_LIMIT and result.residual <= RESIDUAL_LIMIT:
            return result
        candidates.append(result)
    sound = [result for result in candidates if result.residual <= RESIDUAL_LIMIT]
    best = min(sound, key=lambda result: result.weights.spread, default=None)
    if best is None or best.weights.spread > SPREAD_REFUSED:
        raise DesignError(
            "the plant is too ill-conditioned to be decomposed: rounding breaks Σ F_i G_i = I or W ≥ R",
            "rescale the states, or remove states that hardly influence any sensor",
        )
    return best


def _paper(plant: Plant) -> Decomposition:
    """Jordan pair, flat prior for every mode; refuses what breaks the paper's assumptions."""
    steady = steady_state(plant)
    poles, mu = np.linalg.eigvals(steady.M), np.linalg.eigvals(plant.A)
    distance = np.abs(poles[:, np.newaxis] - mu)
    if distance.min() <= 1e-9 * max(1.0, np.abs(mu).max()):
        shared = mu[np.unravel_index(distance.argmin(), distance.shape)[1]]
        raise DesignError(
            f"A and A − K C A share the eigenvalue {shared:.6g} (Assumption 2 of the paper)",
            'use form="robust", which needs no such assumption',
        )
    pair = jordan(steady.M)
    gramian = atoms.stein(pair.T, np.outer(pair.b, pair.b), pair.T.T)
    try:
        result = _decompose(plant, steady, pair, atoms.no_split(plant.A), gramian=gramian)
        condition = float(np.linalg.cond(result.W))
    except np.linalg.LinAlgError:
        condition = np.inf
    if not condition <= CONDITION_LIMIT:
        spoiled = f"has the condition number {condition:.1e}, above {CONDITION_LIMIT:.0e}"
        raise DesignError(
            f"in the Jordan basis W {'is singular in double precision' if np.isinf(condition) else spoiled}",
            'use form="robust", whose W is never worse than the plant itself',
        )
    return result


def _decompose(
    plant: Plant, steady: SteadyState, pair: Pair, split: atoms.Split, gramian: Float | None
) -> Decomposition:
    E = atoms.observation_maps(split, pair.T, pair.b)
    cov = atoms.local_error_covariance(split, E, plant.Q, pair.T, pair.b)
    weights = atoms.weights(plant.C, plant.R, E, cov, gramian)
    return Decomposition(
        steady=steady,
        pair=pair,
        split=split,
        G=np.einsum("ij,jkl->ikl", plant.C, E),
        F=atoms.fusion_maps(steady.M, steady.gain, pair.T, pair.b, gramian),
        W=atoms.dense_covariance(plant.C, plant.R, cov, gramian),
        N=weights.dense(),
        weights=weights,
    )
