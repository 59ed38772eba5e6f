"""How well an estimator did against what really happened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from securestate.estimators import Run, Status
from securestate.simulation.trajectory import Trajectory

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]

#: What is kept of every run, in this order.
PER_RUN = (
    "mse",  # mean over the scored samples of |x̂ − x|²
    "nees",  # mean of (x̂ − x)ᵀ P⁻¹ (x̂ − x) / n
    "nis",  # mean over honest channels of (innovation / its deviation)²
    "honest",  # sensor-samples that arrived untouched
    "false_alarms",  # of these, suspected
    "lies",  # sensor-samples that arrived falsified
    "detections",  # of these, suspected
    "delay",  # samples from the first lie to the first falsified sensor suspected; inf: never, NaN: no lie
    "exact",  # share of samples in which exactly the falsified sensors were suspected
    "injected",  # falsified channel-samples with an estimate of the injection
    "injection_error",  # mean over these of ((â − a) / noise deviation)²
    "not_ok",  # share of samples whose status is not OK
)
#: Counts kept of every sensor, in this order.
PER_SENSOR = ("honest", "false_alarms", "lies", "detections")

#: Probability that the intervals cover.
LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of a group of runs.

    Attributes:
        per_run: (runs, len(PER_RUN)).
        per_sensor: sums over the group, (len(PER_SENSOR), N).
        curve: squared error of every sample and its square, summed over the group, (2, T).
    """

    per_run: Float
    per_sensor: Float
    curve: Float

    def pack(self) -> bytes:
        """All numbers, to the bit."""
        return np.concatenate(
            [part.ravel() for part in (self.per_run, self.per_sensor, self.curve)]
        ).tobytes()

    @staticmethod
    def unpack(packed: bytes, sensors: int, steps: int) -> Scores:
        """The scores that `pack` wrote, of a plant with this many sensors over this many samples."""
        numbers = np.frombuffer(packed, dtype=np.float64)
        rows = numbers.size - len(PER_SENSOR) * sensors - 2 * steps
        return Scores(
            numbers[:rows].reshape(-1, len(PER_RUN)),
            numbers[rows : numbers.size - 2 * steps].reshape(len(PER_SENSOR), sensors),
            numbers[numbers.size - 2 * steps :].reshape(2, steps),
        )

    @staticmethod
    def join(groups: Sequence[Scores]) -> Scores:
        """The scores of all groups, in the order given."""
        return Scores(
            np.concatenate([group.per_run for group in groups]),
            np.sum([group.per_sensor for group in groups], axis=0),
            np.sum([group.curve for group in groups], axis=0),
        )


def score(run: Run, truth: Trajectory, score_from: int = 0) -> Scores:
    """Compare a batch of estimates with the truth, from sample `score_from` on.

    A lie is a reading that an adversary changed. One that was suppressed is neither a lie nor honest, nor is
    one that an adversary had in hand and left as it was: such a sensor does not count at that sample.
    """
    plant, scored = truth.plant, slice(score_from, None)
    with np.errstate(over="ignore", invalid="ignore"):
        error = run.x - truth.x
        square = np.einsum("...n,...n->...", error, error)
        square = np.where(np.isnan(square), np.inf, square)
        curve = np.stack([square.sum(axis=0), (square**2).sum(axis=0)])
    arrived = ~np.isnan(truth.y)
    present = per_sensor(arrived, plant.channel_sensor, plant.n_sensors)[:, scored]
    controlled, suspected = truth.attacked[:, scored] & present, run.suspected[:, scored] & present
    changed = per_sensor(arrived & (truth.a != 0), plant.channel_sensor, plant.n_sensors)[:, scored]
    lies, honest = controlled & changed, present & ~controlled
    counts = (honest, suspected & honest, lies, suspected & lies)
    noise = plant.scale * np.sqrt(np.diag(plant.R))
    injected, injection_error = _injection(run, truth, noise, scored)
    per_run = {
        "mse": square[:, scored].mean(axis=1),
        "nees": _nees(run, error, scored),
        "nis": _nis(run, truth, scored),
        "delay": _delay(lies, suspected & lies),
        "exact": ((suspected == lies) | ~(lies | honest)).all(axis=-1).mean(axis=1),
        "injected": injected,
        "injection_error": injection_error,
        "not_ok": (run.status[:, scored] != Status.OK).mean(axis=1),
    }
    per_run |= {name: count.sum(axis=(1, 2)) for name, count in zip(PER_SENSOR, counts, strict=True)}
    return Scores(
        np.stack([np.asarray(per_run[name], dtype=np.float64) for name in PER_RUN], axis=1),
        np.stack([count.sum(axis=(0, 1)) for count in counts]).astype(np.float64),
        curve,
    )


def per_sensor(channels: Bool, channel_sensor: NDArray[np.int64], sensors: int) -> Bool:
    """Whether any channel of each sensor is set, (..., N) from (..., m)."""
    if len(channel_sensor) == sensors:
        return channels
    starts = np.searchsorted(channel_sensor, np.arange(sensors))
    return np.logical_or.reduceat(channels, starts, axis=-1)


def _nees(run: Run, error: Float, scored: slice) -> Float:
    """Mean normalised estimation error squared over n, per run; NaN without P, inf where P is singular."""
    if run.P is None:
        return np.full(error.shape[0], np.nan)
    P, e, std = run.P[:, scored], error[:, scored], run.x_std[:, scored]
    with np.errstate(all="ignore"):
        unit, unitless = e / std, P / (std[..., :, np.newaxis] * std[..., np.newaxis, :])
        try:
            solved = np.linalg.solve(unitless, unit[..., np.newaxis])[..., 0]
        except np.linalg.LinAlgError:
            return np.full(error.shape[0], np.inf)
        nees: Float = np.einsum("...n,...n->...", unit, solved).mean(axis=1) / e.shape[-1]
    return np.where(np.isnan(nees), np.inf, nees)


def _nis(run: Run, truth: Trajectory, scored: slice) -> Float:
    """Mean normalised innovation squared of honest channels that arrived, per run; NaN if there is none."""
    honest = ~truth.attacked[:, scored][..., truth.plant.channel_sensor]
    with np.errstate(all="ignore"):
        ratio = (run.innovation[:, scored] / run.innovation_std[:, scored]) ** 2
        honest &= ~np.isnan(ratio)
        count = honest.sum(axis=(1, 2))
        nis: Float = np.where(honest, ratio, 0.0).sum(axis=(1, 2)) / np.where(count, count, np.nan)
    return nis


def _delay(lies: Bool, found: Bool) -> Float:
    """Samples from the first lie to the first one found, per run."""
    first_lie = np.where(lies.any(axis=(1, 2)), lies.any(axis=2).argmax(axis=1), np.nan)
    first_find = np.where(found.any(axis=(1, 2)), found.any(axis=2).argmax(axis=1), np.inf)
    delay: Float = first_find - first_lie
    return delay


def _injection(run: Run, truth: Trajectory, noise: Float, scored: slice) -> tuple[Float, Float]:
    """How many injections were estimated, and their mean squared error in units of the noise, per run."""
    lies = truth.attacked[:, scored][..., truth.plant.channel_sensor] & (truth.a[:, scored] != 0)
    with np.errstate(all="ignore"):
        miss = (run.attack[:, scored] - truth.a[:, scored]) / noise
        known = lies & ~np.isnan(miss)
        count = known.sum(axis=(1, 2))
        return count, np.where(known, miss**2, 0.0).sum(axis=(1, 2)) / np.where(count, count, np.nan)


def summarise_scores(scores: Scores, oracle: Scores | None) -> Mapping[str, float]:
    """The figures of one cell of a comparison, each a single number.

    Rates are shares of all sensor-samples; `delay` is the median over runs with a lie, inf if most never
    found it. Intervals are 95 %, from the runs as independent samples; that of the ratio to the oracle counts
    that both saw the same data (delta method on its logarithm).
    """
    run = dict(zip(PER_RUN, scores.per_run.T, strict=True))
    runs = len(scores.per_run)
    quantile = _quantile(runs)
    with np.errstate(all="ignore"):
        mse = float(run["mse"].mean())
        half = quantile * float(run["mse"].std(ddof=1)) / np.sqrt(runs) if runs > 1 else np.nan
        figures = {
            "mse": mse,
            "mse_low": max(mse - half, 0.0) if runs > 1 else np.nan,
            "mse_high": mse + half,
            "runs": float(runs),
        }
        figures |= _ratio(run["mse"], oracle, quantile)
        sums = {name: float(run[name].sum()) for name in PER_SENSOR}
        delays = run["delay"][~np.isnan(run["delay"])]
        figures |= {
            "nees": float(run["nees"].mean()),
            "nis": float(run["nis"].mean()),
            "false_alarm_rate": _over(sums["false_alarms"], sums["honest"]),
            "detection_rate": _over(sums["detections"], sums["lies"]),
            "delay": float(np.median(delays)) if delays.size else np.nan,
            "found": float(np.isfinite(delays).mean()) if delays.size else np.nan,
            "exact_sets": float(run["exact"].mean()),
            "injection_rms": _injection_rms(run["injected"], run["injection_error"]),
            "not_ok": float(run["not_ok"].mean()),
        }
    return figures


def error_over_time(scores: Scores) -> tuple[Float, Float]:
    """Mean squared error of every sample, and half the width of its 95 % interval, each (T,)."""
    runs = len(scores.per_run)
    with np.errstate(all="ignore"):
        mean: Float = scores.curve[0] / runs
        variance = np.maximum(scores.curve[1] / runs - mean**2, 0.0) / (runs - 1)
        half: Float = _quantile(runs) * np.sqrt(variance)
    return mean, half


def _quantile(runs: int) -> float:
    """Student's quantile of the intervals; NaN for a single run."""
    return float(special.stdtrit(runs - 1, (1 + LEVEL) / 2)) if runs > 1 else np.nan


def _ratio(mse: Float, oracle: Scores | None, quantile: float) -> dict[str, float]:
    """Mean squared error over the oracle's, with its interval."""
    if oracle is None:
        return dict.fromkeys(("ratio", "ratio_low", "ratio_high"), np.nan)
    other = oracle.per_run[:, PER_RUN.index("mse")]
    ratio = float(mse.mean() / other.mean())
    spread = (mse / mse.mean() - other / other.mean()).std(ddof=1) if len(mse) > 1 else np.nan
    factor = float(np.exp(quantile * spread / np.sqrt(len(mse))))
    return {"ratio": ratio, "ratio_low": ratio / factor, "ratio_high": ratio * factor}


def _over(count: float, total: float) -> float:
    return count / total if total else np.nan


def _injection_rms(injected: Float, squares: Float) -> float:
    total = injected.sum()
    return float(np.sqrt(np.where(injected > 0, injected * squares, 0.0).sum() / total)) if total else np.nan
