"""Joint fusion: the attack estimated with the state, per sensor that may lie, then fused.

    augmented system  X_i = [x; theta_i],  X_i(k) = A^a X_i(k-1) + F phi_i(k) + W,  y_i = C^a X_i + v_i  (5)
    local estimate    Xhat_i = A^a Xhat_i + F phihat_i + K_i ytilde_i,   phihat_i += Gamma_i ytilde_i     (6)
    gains             optimal one step ahead if theta_i is white with covariance eta_i I           (36), (37)
    fusion            xhat_0 = sum G_i xhat_i,  [G_1 ... G_r] = (H' Sigma^-1 H)^-1 H' Sigma^-1      (8), (12)

References:
    Chen, Weng, Ho, Yu 2022 (docs/bibliography.md: chen2022).
Deviations from the paper, form="exact":
    * Second moments are exact: Xi^1 = (eta(k) + eta(k-1)) I + V(k-1) + eta(k-1) (g + g') with
      g = Gamma C^a F at k-1. (19) and (25) take E phihat phitilde' for zero, which it is not.
    * The cross moments (45)-(49) get the noise R_ij of the sensors that two locals share.
    * Moments move in the form of Joseph, so that they stay covariances under dropouts and when eta changes.
    * A fused estimate exists for any Sigma, also one without an inverse (two locals that know the same).
form="printed" is (15)-(19), (36), (37), (45)-(50) with the one superscript restored that (19) has lost.
Both: sample 0 is corrected with the prior as it is; the paper moves it by A first. A missing channel is a row
of zeros in C^a.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from securestate import _kernels
from securestate._checks import whole_number, yes_or_no
from securestate.errors import InputError, ShapeError
from securestate.estimators import _joint_design as design
from securestate.estimators._detectors import checked_rate, quantiles
from securestate.estimators._joint_design import Local, Pairing
from securestate.estimators.base import Estimator
from securestate.estimators.kalman import steady_or_reason
from securestate.estimators.protected_kalman import ProtectedKalman, protected_alone
from securestate.plant import Belief, Plant

Float = NDArray[np.float64]

FORMS = ("exact", "printed")
FUSIONS = ("optimal", "average", "covariance-intersection")


@final
@dataclass(frozen=True)
class JointMoments:
    """Gains and second moments per sample; lists have one array per local estimator. Units of C x.

    Attributes:
        K, Gamma: gains of (6), (T, n + p_i, m_i) and (T, p_i, m_i).
        P_X, U, V: E Xtilde Xtilde', E Xtilde phihat' and E phihat phihat' of (11), (T, n + p_i, n + p_i),
            (T, n + p_i, p_i), (T, p_i, p_i).
        Sigma: covariance {P_ij^x} of all local errors of x (13), (T, n r, n r).
        G: weights [G_1 ... G_r] of (8), (T, n, n r).
        P0: covariance of the fused error, (T, n, n).
        broken: where a matrix that should be a covariance is none, (T,).
    """

    K: list[Float]
    Gamma: list[Float]
    P_X: list[Float]
    U: list[Float]
    V: list[Float]
    Sigma: Float
    G: Float
    P0: Float
    broken: NDArray[np.bool_]


@final
class JointFusion(Estimator):
    """Secure fusion of local estimators that know their sensor's injection (Chen, Weng, Ho, Yu).

    Every sensor that is not protected gets a local estimator of the state and of what is injected, from its
    own readings and those of protected sensors; the local estimates are fused. In the paper's example this is
    no better than `ProtectedKalman`, which always runs beside it; `AdaptiveJointFilter` beats both.

    Args:
        plant: at least one sensor protected and one not. A and C may vary in time.
        eta: compensation factor, the variance assumed of an injection, (sensor unit)^2: a number, a mapping
            by sensor name, one per sensor that may lie (r,), or (T, r) if it varies.
        form: "exact" or "printed"; see the module.
        pairing: which protected sensors each sensor that may lie is stacked with, by name; default all.
            Sensors that are not in it are not used.
        fusion: "optimal" (12), "average", or "covariance-intersection" (for comparison).
        square_root: keep the moments of all locals as factors U D U' of one array. Slower (the cube of
            r (n + 3) per sample), for plants whose variances span many decades. Form "exact" only.
        false_alarm_rate: probability per sample that an honest sensor is suspected, in (0, 1).

    Attributes:
        locals: who is stacked with whom, a tuple of `Local`.
        beside: `ProtectedKalman` of this plant; None where it has neither a steady state nor a prior.
        no_steady_state: why `run` and `start` need a prior with P; empty if they do not.

    Raises:
        DesignError: nobody or everybody is protected; a local estimator does not see a mode that does not
            fade or cannot tell it from an injection; its closed loop is unstable.
        InputError, ShapeError: a setting is out of range.

    Warns:
        SecurestateWarning: the protected sensors do not detect a mode; an injection along it is invisible.

    Notes:
        `Run.attack` is thetahat_i of (6), `Run.attack_std` the deviation of its error under the assumed eta.
        `Run.trust` and `Run.suspected` come from the filter beside: they hold whatever is injected elsewhere.
        `Run.P` is the covariance P_0 under the assumed eta; `Run.innovation` that of A xhat_0 + B u.
        `Run.diagnostics`: "channels" in use; "trace", tr P_0; "protected_trace", the same of the filter
        beside; "protected_gap", the largest |xhat_0 - xhat_protected| in deviations of the filter beside.
        Cost: gains that have settled are reused, and a step is O(r n (n + m)). While a channel is missing, or
        eta or the plant varies, the recursion runs: O(r^2 n^3 + (r n)^3) for r sensors that may lie. A filter
        holds r^2 (n + 2)^2 / 2 numbers.
        BROKEN_DOWN: a moment is no covariance any more (form "printed" under dropouts or a changing eta); the
        estimate is that of the filter beside. NO_MEASUREMENT: no channel in use arrived.

    Examples:
        >>> from securestate import JointFusion, Plant, Sensor
        >>> sensors = [Sensor("a", C=[1.0], R=1.0), Sensor("b", C=[1.0], R=1.0, protected=True)]
        >>> run = JointFusion(Plant([[0.9]], [[1.0]], sensors), eta=100.0).run([[50.0, 0.1]])
        >>> print(run.suspected[0], run.attack[0].round(0), abs(run.x[0, 0]) < 1)
        [ True False] [49.  0.] True
    """

    locals: tuple[Local, ...]
    beside: ProtectedKalman | None

    def __init__(
        self,
        plant: Plant,
        *,
        eta: float | Mapping[str, float] | ArrayLike = 1.0,
        form: Literal["exact", "printed"] = "exact",
        pairing: Pairing | None = None,
        fusion: Literal["optimal", "average", "covariance-intersection"] = "optimal",
        square_root: bool = False,
        false_alarm_rate: float = 0.01,
    ) -> None:
        steady, reason = steady_or_reason(plant)
        rate = checked_rate(false_alarm_rate)
        one_of("form", form, FORMS)
        one_of("fusion", fusion, FUSIONS)
        self.locals = design.local_estimators(plant, pairing)
        self._eta = design.injection_variances(plant, self.locals, eta)
        arithmetic = _arithmetic(form, square_root)
        self._choice = {"form": arithmetic, "fusion": fusion}
        design.check_conditions(plant, self.locals)
        alone_steady, alone_reason, alone = protected_alone(plant)
        start = alone_steady or steady
        varies = plant.time_varying or len(self._eta) > 1
        if start is not None and not varies:
            design.check_stability(plant, self.locals, self._eta, arithmetic, start.P_prior)
        kernel, settles = _kernels.joint_fusion(
            plant,
            [local.stack for local in self.locals],
            eta=self._eta,
            form=arithmetic,
            fusion=fusion,
            protected=alone,
            quantiles=quantiles(plant.m, rate),
            prior=None if start is None or varies else np.ascontiguousarray(start.P_prior),
        )
        self.no_steady_state = _reason(self._eta, reason or alone_reason, settles=settles)
        self.beside = ProtectedKalman(plant, false_alarm_rate=rate)
        settings = {
            "eta": _plain(eta),
            "form": form,
            "pairing": None if pairing is None else {name: list(others) for name, others in pairing.items()},
            "fusion": fusion,
            "square_root": arithmetic == "square-root",
            "false_alarm_rate": rate,
        }
        super().__init__(plant, kernel, settings)

    def moments(self, steps: int, prior: Belief, *, missing: ArrayLike | None = None) -> JointMoments:
        """The gains and moments that decide a run, without data.

        Args:
            steps: samples, at least 1.
            prior: belief about x[0] with a covariance P.
            missing: True where a channel does not arrive, (m,) or (steps, m); default none.
        Raises:
            InputError, ShapeError: naming the argument, expected and received.
        """
        whole_number("steps", steps, 1, InputError)
        P = _covariance(prior, self.plant.n)
        horizon = self.plant.horizon or (len(self._eta) if len(self._eta) > 1 else steps)
        if steps > horizon:
            raise ShapeError("steps", f"at most {horizon}, as many as A, C and eta cover", str(steps))
        eta = self._eta[:steps] if len(self._eta) > 1 else np.repeat(self._eta, steps, axis=0)
        arrays = _kernels.joint_moments(
            self.plant,
            [local.stack for local in self.locals],
            eta=np.ascontiguousarray(eta),
            prior=P,
            heard=design.as_mask(self.plant, steps, missing),
            **self._choice,
        )
        return JointMoments(**arrays)


def _arithmetic(form: str, square_root: object) -> str:
    """The recursion that the kernel runs."""
    if not yes_or_no("square_root", square_root, InputError):
        return form
    if form == "exact":
        return "square-root"
    raise InputError("square_root", 'form="exact"', f"form={form!r}")


def _covariance(prior: object, n: int) -> Float:
    if not isinstance(prior, Belief) or prior.P is None or prior.P.shape != (n, n):
        raise InputError("prior", f"a Belief with a covariance P ({n}, {n})", repr(prior))
    return np.ascontiguousarray(prior.P)


def one_of(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Refuse a setting that is none of the choices.

    Raises:
        InputError: it is not.
    """
    if value not in choices:
        raise InputError(name, " or ".join(f'"{choice}"' for choice in choices), repr(value))


def _reason(eta: Float, reason: str, *, settles: bool) -> str:
    """Why there is no steady state; empty if there is one."""
    if settles and not reason:
        return ""
    if len(eta) > 1:
        return "eta varies in time, so there is no steady state; give a prior with a covariance P"
    return reason or "the moments of this plant do not settle; give a prior with a covariance P"


def _plain(eta: object) -> object:
    """Eta as plain values."""
    if isinstance(eta, Mapping):
        return {str(name): float(value) for name, value in eta.items()}
    return np.asarray(eta, dtype=np.float64).tolist()
