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
from typing import Any, Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from securestate import _kernels
from securestate._checks import whole_number, yes_or_no
from securestate._local_filters import local_filters
from securestate._steady_state import SteadyState
from securestate.errors import InputError, ShapeError
from securestate.estimators import _joint_design as design
from securestate.estimators._detectors import Arguments, arguments, checked_rate, quantiles
from securestate.estimators._joint_design import Local, Pairing
from securestate.estimators._protected import warn_of_small
from securestate.estimators.adaptive_joint import checked_gate, checked_window
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
            by sensor name, one per sensor that may lie (r,), or (T, r) if it varies. "adaptive" takes it from
            the innovations of every local, by `window` and `gate` as `AdaptiveJointFilter` does.
        form: "exact" or "printed"; see the module.
        pairing: which protected sensors each sensor that may lie is stacked with, by name; default all.
            Sensors that are not in it are not used, only judged.
        protected: "marked", those that the plant marks; or "auto" (Remark 2), those that `detector` trusts at
            this sample, and the marked ones. Every sensor that is not marked then has a local, stacked with
            all trusted others; a trusted sensor has eta = 0. If nobody is trusted nothing is used.
        detector: for protected="auto": "gate", as `InnovationGate`, or "chi-square", as `ChiSquareFilter`.
        fusion: "optimal" (12), "average", or "covariance-intersection" (for comparison).
        square_root: keep the moments of all locals as factors U D U' of one array. Slower (the cube of
            r (n + 3) per sample), for plants whose variances span many decades. Form "exact" only.
        window, gate: for eta="adaptive"; samples averaged, 1 to 10000, and the squared surprise that counts
            at once.
        false_alarm_rate: probability per sample that an honest sensor is suspected, in (0, 1); for
            protected="auto" that of the detector.

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
        With protected="auto" they are the detector's, and say who counts as protected at every sample.
        `Run.P` is the covariance P_0 under the assumed eta; `Run.innovation` that of A xhat_0 + B u.
        `Run.diagnostics`: "channels" in use; "trace", tr P_0; "protected_trace", the same of the filter
        beside; "protected_gap", the largest |xhat_0 - xhat_protected| in deviations of the filter beside;
        "protected", how many sensors counted as protected.
        Cost: gains that have settled are reused, and a step is O(r n (n + m)). While a channel is missing, or
        eta or the plant varies, the recursion runs: O(r^2 n^3 + (r n)^3) for r sensors that may lie. A filter
        holds r^2 (n + 2)^2 / 2 numbers.
        With eta="adaptive" or protected="auto" the recursion always runs, and P is exact only for gains that
        do not depend on the data, which these do (docs/joint-fusion.md has measurements). An adaptive eta
        ends at 1e12 times the variance expected; a reading further off than its root counts as that far off.
        With an eta that is given no reading is left out: one that is off by 1e20 moves the estimate by as
        much as its gain says.
        BROKEN_DOWN: a moment is no covariance any more (form "printed" under dropouts or a changing eta); the
        estimate is that of the filter beside. NO_MEASUREMENT: no channel in use arrived, or nobody is
        trusted.

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
        eta: float | Mapping[str, float] | ArrayLike | Literal["adaptive"] = 1.0,
        form: Literal["exact", "printed"] = "exact",
        pairing: Pairing | None = None,
        protected: Literal["marked", "auto"] = "marked",
        detector: Literal["gate", "chi-square"] = "gate",
        fusion: Literal["optimal", "average", "covariance-intersection"] = "optimal",
        square_root: bool = False,
        window: int = 20,
        gate: float = 9.0,
        false_alarm_rate: float = 0.01,
    ) -> None:
        self._steady, self._why = steady_or_reason(plant)
        rate = checked_rate(false_alarm_rate)
        samples, at_once = checked_window(window), checked_gate(gate)
        adapts = isinstance(eta, str)
        _check_settings(eta, form, protected, detector, fusion, pairing)
        self._arithmetic, self._fusion = _arithmetic(form, square_root), fusion
        auto = protected == "auto"
        self.locals = design.everybody(plant) if auto else design.local_estimators(plant, pairing)
        self._eta = design.injection_variances(plant, self.locals, 0.0 if adapts else eta)
        self._varies = plant.time_varying or len(self._eta) > 1
        design.check_conditions(plant, self.locals)
        weak = np.array([channel for local in self.locals for channel in local.weak_channels])
        warn_of_small(plant, "eta", weak, self._eta.max(axis=0), 'give a larger one, or eta="adaptive"')
        kernel, self.beside, self.no_steady_state = self._kernel(
            plant,
            ((samples, at_once) if adapts else None),
            (_detector(plant, self._steady, detector, rate) if auto else None),
            rate,
        )
        settings = {
            "eta": eta if adapts else _plain(eta),
            "form": form,
            "pairing": None if pairing is None else {name: list(others) for name, others in pairing.items()},
            "protected": protected,
            "detector": detector,
            "fusion": fusion,
            "square_root": self._arithmetic == "square-root",
            "window": samples,
            "gate": at_once,
            "false_alarm_rate": rate,
        }
        super().__init__(plant, kernel, settings)

    def _settings_from(self, first: int) -> Mapping[str, Any]:
        if len(self._eta) == 1:
            return self.settings
        return {**self.settings, "eta": np.asarray(self.settings["eta"])[first:]}

    def _kernel(
        self,
        plant: Plant,
        adaptive: tuple[int, float] | None,
        detector: Arguments | None,
        rate: float,
    ) -> tuple[_kernels.Kernel, ProtectedKalman | None, str]:
        """The kernel, the filter beside it, and why there is no steady state."""
        beside = ProtectedKalman(plant, false_alarm_rate=rate) if plant.protected.any() else None
        alone, why = (protected_alone(plant)[2], beside.no_steady_state) if beside else (None, "")
        start = (beside.steady if beside else None) or self._steady
        if start is not None and not self._varies:
            worst = self._eta if adaptive is None else design.large_injections(plant, self.locals)
            design.check_stability(plant, self.locals, worst, self._arithmetic, start.P_prior)
        kernel, settles = _kernels.joint_fusion(
            plant,
            [local.stack for local in self.locals],
            eta=self._eta,
            adaptive=adaptive,
            detector=detector,
            form=self._arithmetic,
            fusion=self._fusion,
            protected=alone,
            quantiles=quantiles(plant.m, rate),
            prior=None if start is None or self._varies else np.ascontiguousarray(start.P_prior),
        )
        return kernel, beside, _reason(self._eta, self._why or why, settles=settles)

    def moments(self, steps: int, prior: Belief, *, missing: ArrayLike | None = None) -> JointMoments:
        """The gains and moments that decide a run, without data.

        Not for eta="adaptive" or protected="auto", whose gains depend on the data.

        Args:
            steps: samples, at least 1.
            prior: belief about x[0] with a covariance P.
            missing: True where a channel does not arrive, (m,) or (steps, m); default none.
        Raises:
            InputError, ShapeError: naming the argument, expected and received.
        """
        whole_number("steps", steps, 1, InputError)
        if self.settings["eta"] == "adaptive" or self.settings["protected"] == "auto":
            raise InputError("moments", "an eta and a protected set that are given", repr(self))
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
            form=self._arithmetic,
            fusion=self._fusion,
        )
        return JointMoments(**arrays)


def _check_settings(
    eta: object, form: str, protected: str, detector: str, fusion: str, pairing: object
) -> None:
    one_of("form", form, FORMS)
    one_of("fusion", fusion, FUSIONS)
    one_of("protected", protected, ("marked", "auto"))
    one_of("detector", detector, ("gate", "chi-square"))
    if isinstance(eta, str) and eta != "adaptive":
        raise InputError("eta", 'a variance, one per sensor that may lie, or "adaptive"', repr(eta))
    if form == "printed" and (isinstance(eta, str) or protected == "auto"):
        raise InputError("form", '"exact" where eta or the protected sensors come from the data', repr(form))
    if protected == "auto" and pairing is not None:
        raise InputError(
            "pairing", 'None for protected="auto", which stacks with whoever is trusted', repr(pairing)
        )
    if protected == "auto" and isinstance(eta, str):
        raise InputError("eta", 'variances for protected="auto"', repr(eta))


def _detector(plant: Plant, steady: SteadyState | None, detector: str, rate: float) -> Arguments:
    if detector == "gate":
        return arguments(plant, steady, "gate", rate)
    return arguments(plant, steady, "drop", rate, local_filters(plant))


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
    if not isinstance(value, str) or value not in choices:
        raise InputError(name, " or ".join(f'"{choice}"' for choice in choices), repr(value))


def _reason(eta: Float, reason: str, *, settles: bool) -> str:
    """Why there is no steady state; empty if there is one."""
    if settles and not reason:
        return ""
    if len(eta) > 1:
        return "eta varies in time, so there is no steady state; give a prior with a covariance P"
    return reason or (
        "its moments do not settle, as when eta is far below the noise of a sensor; give "
        "a larger eta, or a prior with a covariance P"
    )


def _plain(eta: object) -> object:
    """Eta as plain values."""
    if isinstance(eta, Mapping):
        return {str(name): float(value) for name, value in eta.items()}
    return np.asarray(eta, dtype=np.float64).tolist()
