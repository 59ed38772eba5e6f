"""The cold start: a first estimate without a prior, while sensors lie from the first sample on.

    y = O x0 + G w + v + a,      a is zero for honest groups: sensors, or sensors at instants

of the first tau samples. Stage 1 is a robust regression (`_anneal`), stage 2 tests every group against those
that are believed (`_relabel`), stage 3 is generalised least squares on the honest readings (`_smooth`). A
certificate says whether what is believed was checked (`_certificate`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from securestate._checks import whole_number
from securestate._threads import one_blas_thread
from securestate._value import Value
from securestate.errors import DesignError, InputError, MeasurementError
from securestate.estimators._anneal import Groups
from securestate.estimators._certificate import RIVAL, doubt
from securestate.estimators._identify import Evidence, evidence, identify
from securestate.estimators._relabel import Labels, determines
from securestate.estimators._smooth import guess, injections, positive, smooth, trusts
from securestate.estimators._window import Window, at, known_response, window_model
from securestate.estimators.base import check_inputs, check_measurements
from securestate.estimators.kalman import require_plant
from securestate.plant import Belief, Plant
from securestate.resilience.detectability import mode_along, undetectable_modes

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]

#: Readings in a window, and numbers in its covariances, at most. Its matrices then take about 1 GB.
READINGS, NUMBERS = 4096, 2**24
#: Samples of the shortest window, and rows per state and honest sensor it is made for.
SHORTEST, ROWS_PER_STATE = 4, 1.5
#: Growth of a window that was not certified, and how often in vain: refused for the same reason as before.
GROWTH, VAIN = 1.5, 3
ADVICE = "give a prior, Belief(x, P)"
UNDETERMINED = "the readings that arrived and can be believed do not determine the state"


@final
class ColdStart(Value):
    """What the first samples of a record say about the state, without a prior. Made by `cold_start`.

    Attributes:
        plant: the plant.
        samples: tau, how many samples the window has.
        x: smoothed states of the window, (tau, n). P: their covariances, (tau, n, n).
        belief: about x[tau], the state at the first sample after the window.
        attacked: "fixed" or "changing", what was assumed of the attacked set.
        honest: who is believed, (N,) for a fixed set, (tau, N) for a changing one; False where nothing came.
        trust: (tau, N) in [0, 1], NaN where nothing arrived or nobody else checks what arrived, as with a
            sensor that the plant marks as not verifiable, where it is believed.
        attack: what a distrusted reading is off by, (tau, m), file units; 0 where a reading is believed, NaN
            where none arrived. attack_std: standard deviation of its error, NaN where nothing is estimated.
        certified: whether what is believed was checked. reason: why it is not certified; empty if it is.
        statistic: squared residuals of the believed readings, whitened; chi-square with
            degrees_of_freedom if they are honest.
    """

    plant: Plant
    samples: int
    x: Float
    P: Float
    belief: Belief
    attacked: str
    honest: Bool
    trust: Float
    attack: Float
    attack_std: Float
    certified: bool
    reason: str
    statistic: float
    degrees_of_freedom: int

    @classmethod
    def _made(cls, **parts: object) -> ColdStart:
        self = cls.__new__(cls)
        self._fill(**parts)
        return self

    def __repr__(self) -> str:
        said = "certified" if self.certified else f"not certified: {self.reason}"
        return f"ColdStart({self.samples} samples of {self.plant!r}, {said})"

    @property
    def suspected(self) -> Bool:
        """Whether a sensor is distrusted at a sample of the window at which it sent something, (tau, N)."""
        starts = np.searchsorted(self.plant.channel_sensor, np.arange(self.plant.n_sensors))
        heard: Bool = np.logical_or.reduceat(~np.isnan(self.attack), starts, axis=1)
        return heard & ~self.honest


def cold_start(
    plant: Plant,
    y: ArrayLike,
    u: ArrayLike | None = None,
    *,
    attacked: Literal["any", "fixed", "changing"] = "any",
    window: int | None = None,
) -> ColdStart:
    """Estimate the first states of a record without a prior, while sensors may lie from the first sample on.

    The window begins with max(4, 1.5 n / honest sensors) samples, the honest ones being a bare majority, and
    grows until it is certified, `y` is used up, it holds 4096 readings, or three larger windows in a row are
    refused for the same reason as the one before.

    Args:
        plant: any plant whose state its sensors see. Protected sensors are never accused.
        y: measurements, shape (T, m), file units; NaN marks a missing channel. Samples that are not needed
            do not count.
        u: inputs, shape (T, p), file units; needed if and only if the plant has inputs.
        attacked: "fixed", the same sensors lie throughout the window; "changing", others at every sample;
            "any" tries both, fixed first.
        window: samples to begin with.
    Returns:
        ColdStart; `certified` says whether it can be relied on.
    Raises:
        DesignError: no sensor sees some mode of the plant, or a window would be too large.
        ShapeError, MeasurementError, InputError: naming the argument, expected and received.

    References:
        Ours; group-sparse robust regression, tested in the manner of Barshalom 2001.

    Examples:
        >>> from securestate import Plant, Sensor
        >>> sensors = [Sensor(name, C=[1.0], R=1.0) for name in ("a", "b", "c")]
        >>> first = cold_start(Plant([[1.0]], [[0.01]], sensors), [[7.2, 50.0, 6.9]] * 4)
        >>> print(first.certified, first.honest, first.belief.x.round(1))
        True [ True False  True] [7.]
    """
    require_plant(plant)
    if attacked not in ("any", "fixed", "changing"):
        raise InputError("attacked", '"any", "fixed" or "changing"', repr(attacked))
    y, u = _checked(plant, y, u)
    longest = _longest(plant, len(y))
    tau = _shortest(plant) if window is None else whole_number("window", window, 1, InputError)
    if window is not None and tau > longest:
        raise InputError("window", f"at most {longest} samples here", str(window))
    kinds = [True, False] if attacked == "any" else [attacked == "fixed"]
    with one_blas_thread():
        vain, earlier = 0, ""
        while True:
            tau = min(tau, longest)
            found = _attempt(plant, y[:tau], u[:tau], kinds)
            vain = vain + 1 if found.reason == earlier != UNDETERMINED else 0
            if found.certified or tau == longest or vain == VAIN:
                return found
            tau, earlier = int(np.ceil(GROWTH * tau)), found.reason


def _checked(plant: Plant, y: ArrayLike, u: ArrayLike | None) -> tuple[Float, Float]:
    values = check_measurements(y, plant, ("T",))
    inputs = check_inputs(u, plant, values.shape)
    for name, array, what in (("y", values, "channel"), ("u", inputs, "input")):
        wrong = np.isinf(array) if name == "y" else ~np.isfinite(array)
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            expected = "finite numbers" + (", or NaN where a sample is missing" if name == "y" else "")
            raise MeasurementError(name, expected, f"{array[row, column]} in {what} {column}")
    if plant.horizon is not None and len(values) > plant.horizon:
        raise MeasurementError(
            "y", f"at most {plant.horizon} samples, as the plant describes", str(len(values))
        )
    return values, inputs


def _shortest(plant: Plant) -> int:
    """Samples such that a bare majority of the sensors gives 1.5 n readings."""
    majority = plant.n_sensors - (plant.n_sensors - 1) // 2
    return max(SHORTEST, int(np.ceil(ROWS_PER_STATE * plant.n / majority)))


def _longest(plant: Plant, samples: int) -> int:
    """Samples of the largest window."""
    limit = max(1, min(READINGS // plant.m, NUMBERS // plant.n**2))
    if limit * plant.m < plant.n:
        raise DesignError(
            f"a window of {limit} samples, the largest for {plant.n} states and {plant.m} channels, does not "
            "determine the state",
            ADVICE,
        )
    return min(limit, samples)


def _attempt(plant: Plant, y: Float, u: Float, kinds: list[bool]) -> ColdStart:
    """The window of these samples; of several kinds of attacked sets the first that is certified.

    If none is, the one that believes most readings.
    """
    model = window_model(plant, len(y))
    xi, response = known_response(plant, u)
    if not (model.finite and np.isfinite(xi).all()):
        raise DesignError(f"within {len(y)} samples the state grows beyond all numbers", ADVICE)
    _refuse_blind(model)
    with np.errstate(over="ignore"):
        seen = evidence(model, plant.normalise(y) - response)
    found: list[ColdStart] = []
    for fixed in (True, False):
        groups, keys = seen.groups(fixed)
        labels = identify(seen, groups)
        why = UNDETERMINED if labels is None else doubt(seen, groups, labels, keys, fixed)
        if not fixed and not why and found[0].reason == RIVAL:
            why = RIVAL  # who changes may also stay
        found.append(_cold_start(_Data(model, seen, y, xi, response), labels, fixed, why))
        if found[-1].certified and fixed in kinds:
            return found[-1]
        if kinds == [True]:
            break
    wanted = [one for one in found if (one.attacked == "fixed") in kinds]
    return max(wanted, key=lambda one: one.degrees_of_freedom)


def _refuse_blind(model: Window) -> None:
    """Refuse a plant that no samples would determine.

    Raises:
        DesignError: names the modes.
    """
    plant = model.plant
    scaled = model.O / np.sqrt(np.diag(model.Sigma))[:, np.newaxis]
    if determines(scaled):
        return
    if not plant.time_varying:
        hidden = ", ".join(map(str, undetectable_modes(plant, cut=0.0)))
    elif model.tau == plant.horizon:
        direction = np.linalg.svd(scaled)[2][-1].astype(np.complex128)
        hidden = ", ".join(mode_along(1.0, direction, plant.state_names).states)
    else:
        hidden = ""
    if hidden:
        raise DesignError(f"no sensor sees {hidden}, so no window of samples determines the state", ADVICE)


def _cold_start(window: _Data, labels: Labels | None, fixed: bool, why: str) -> ColdStart:
    """Put the result together, in file units."""
    model, seen = window.model, window.seen
    plant, tau, k = model.plant, model.tau, model.tau - 1
    groups, keys = seen.groups(fixed)
    sure, labels = labels is not None, labels or guess(model, seen, groups)
    x, P = smooth(model, seen, labels.fit)
    honest = np.zeros(plant.n_sensors if fixed else (tau, plant.n_sensors), dtype=np.bool_)
    honest.ravel()[keys] = labels.honest | groups.protected
    trust = np.full((tau, plant.n_sensors), np.nan)
    trust[seen.instant, seen.sensor] = trusts(seen, labels, groups)[groups.of]
    trust[np.broadcast_to(honest & plant.uncheckable, trust.shape)] = np.nan
    attack, attack_std = window.injections(labels, groups)
    A = at(plant.A, k)
    return ColdStart._made(
        plant=plant,
        samples=tau,
        x=window.xi[:-1] + x,
        P=P,
        belief=Belief(window.xi[-1] + A @ x[k], positive(A @ P[k] @ A.T + plant.Q)),
        attacked="fixed" if fixed else "changing",
        honest=honest,
        trust=trust,
        attack=attack,
        attack_std=attack_std,
        certified=not why,
        reason=why,
        statistic=labels.fit.statistic if sure else 0.0,
        degrees_of_freedom=labels.fit.freedom if sure else 0,
    )


@dataclass(frozen=True, eq=False)
class _Data:
    """A window and its readings y (tau, m) in file units; xi and response as `known_response` gives them."""

    model: Window
    seen: Evidence
    y: Float
    xi: Float
    response: Float

    def injections(self, labels: Labels, groups: Groups) -> tuple[Float, Float]:
        """Attack and its deviation, (tau, m), file units."""
        plant, row = self.model.plant, self.seen.row
        attack, std = np.full(self.y.size, np.nan), np.full(self.y.size, np.nan)
        found, deviation = injections(self.seen, labels, groups)
        with np.errstate(over="ignore"):
            honest = plant.denormalise(self.response).ravel()[row]
            scale = plant.scale[row % plant.m]
            far = self.seen.beyond & ~groups.protected[groups.of]
            attack[row] = scale * found + np.where(far, self.y.ravel()[row] - honest, 0.0)
            std[row] = scale * deviation
        return attack.reshape(self.y.shape), std.reshape(self.y.shape)
