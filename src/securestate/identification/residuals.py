"""How a plant predicts a record it was not fitted to: the numbers a verdict rests on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

from securestate.estimators.kalman import KalmanFilter
from securestate.identification._scan import scan
from securestate.identification.forms import Segment, radius, spread
from securestate.plant import Belief, Plant

Array = NDArray[np.float64]

#: Samples after the start of a segment that are not judged: the state is still unknown.
WARM_UP = 20

#: Lags of the autocorrelation.
LAGS = 10

#: Blocks into which the record is cut, to see whether the fit is as good everywhere; samples in one at least.
BLOCKS, BLOCK = 20, 10


@final
@dataclass(frozen=True, eq=False)
class Residuals:
    """Standardised innovations of a record, and what they say.

    Attributes:
        names: of the channels judged: of channels that repeat each other one.
        segments: innovation / its standard deviation, (N, m) per segment, NaN where nothing was read.
        nis: normalised innovation squared per sample, (T,); channels: how many channels it counts, (T,).
        size: nis per channel: 1 if errors are as large as the model says.
        exceed: share of samples above the 95 % limit of chi-square.
        extreme: the same for the 99.9 % limit.
        variance: mean square of every channel, (m,).
        repeat: autocorrelation at lags 1..10, (10, m).
        ljung_box: p-value per channel: how likely so much autocorrelation is if there is none, (m,).
        shift: mean per channel, (m,). change: the second half's mean less the first half's, (m,).
        worst_block, median_block: largest and median nis per channel over blocks of the record.
        level, level_error: how far the record lies from the operating point, per channel in standard
            deviations of
            its noise-driven variation, and the standard error the plant gives that mean, (m,).
        counted: readings per channel, (m,).
    """

    names: tuple[str, ...]
    segments: tuple[Array, ...]
    nis: Array
    channels: NDArray[np.int64]
    size: float
    exceed: float
    extreme: float
    variance: Array
    repeat: Array
    ljung_box: Array
    shift: Array
    change: Array
    worst_block: float
    median_block: float
    level: Array
    level_error: Array
    counted: NDArray[np.int64]

    @property
    def samples(self) -> int:
        """Samples judged."""
        return len(self.nis)

    @property
    def repeats(self) -> float:
        """Root mean square over channels of the autocorrelation at lag 1, less what chance alone gives."""
        chance = 1 / np.maximum(self.counted, 1)
        return float(np.sqrt(max(0.0, float(np.mean(np.nan_to_num(self.repeat[0]) ** 2 - chance)))))

    @property
    def colour_by_channel(self) -> Array:
        """Root of the sum of squared autocorrelations over all lags, less what chance alone gives, (m,)."""
        return np.asarray(np.sqrt(np.maximum(0.0, self._colours())))

    @property
    def colour(self) -> float:
        """The same over all channels, root mean square."""
        return float(np.sqrt(max(0.0, float(np.mean(self._colours())))))

    def _colours(self) -> Array:
        chance = LAGS / np.maximum(self.counted, 1)
        return np.asarray(np.sum(np.nan_to_num(self.repeat) ** 2, axis=0) - chance)


def residuals(plant: Plant, record: Sequence[Segment]) -> Residuals:
    """Run the Kalman filter over segments in engineering units and look at its innovations.

    Args:
        plant: does not vary in time.
        record: y (N, m), u (N, p) per segment, m and p as the plant has them.
    """
    estimator = KalmanFilter(plant)
    prior = anywhere(plant)
    parts: list[Array] = []
    nis: list[Array] = []
    channels: list[Array] = []
    for y, u in record:
        run = estimator.run(y, u if plant.n_inputs else None, prior, covariance=False)
        skipped = min(WARM_UP, len(y) // 4)
        parts.append((run.innovation / run.innovation_std)[skipped:])
        nis.append(run.diagnostics["nis"][skipped:])
        channels.append(run.diagnostics["channels"][skipped:])
    return _summed(
        plant, record, tuple(parts), np.concatenate(nis), np.concatenate(channels).astype(np.int64)
    )


def anywhere(plant: Plant) -> Belief:
    """What is known of a state before the first sample of a segment: where it is in the long run."""
    X = spread(plant.A, plant.Q + plant.B @ plant.B.T)
    return Belief(np.zeros(plant.n), X + 1e-9 * np.trace(X) / plant.n * np.eye(plant.n))


def _summed(
    plant: Plant, record: Sequence[Segment], parts: tuple[Array, ...], nis: Array, channels: NDArray[np.int64]
) -> Residuals:
    heard = channels > 0
    nis, channels = nis[heard], channels[heard]
    whole = np.vstack(parts)
    counted = np.isfinite(whole).sum(axis=0)
    repeat = _autocorrelation(parts)
    n = np.maximum(counted, LAGS + 2)
    portmanteau = n * (n + 2) * np.nansum(repeat**2 / (n - np.arange(1, LAGS + 1)[:, None]), axis=0)
    half = len(whole) // 2
    blocks = _block_means(nis / np.maximum(channels, 1))
    level, level_error = _level(plant, record)
    return Residuals(
        names=plant.channel_names,
        segments=parts,
        nis=nis,
        channels=channels,
        size=float(nis.sum() / max(channels.sum(), 1)),
        exceed=float(np.mean(nis > special.chdtri(channels, 0.05))) if len(nis) else float("nan"),
        extreme=float(np.mean(nis > special.chdtri(channels, 0.001))) if len(nis) else float("nan"),
        variance=_mean(whole**2),
        repeat=repeat,
        ljung_box=np.asarray(special.chdtrc(LAGS, portmanteau)),
        shift=_mean(whole),
        change=_mean(whole[half:]) - _mean(whole[:half]),
        worst_block=float(blocks.max()),
        median_block=float(np.median(blocks)),
        level=level,
        level_error=level_error,
        counted=counted,
    )


def _mean(x: Array) -> Array:
    """Mean over samples of what was read; NaN if nothing was."""
    there = np.isfinite(x)
    number = there.sum(axis=0)
    total = np.where(there, x, 0.0).sum(axis=0)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def _autocorrelation(parts: Sequence[Array]) -> Array:
    """Per lag and channel; sums over pairs within a segment, over the sum of squares: never above 1."""
    mean = _mean(np.vstack(parts))
    centred = [part - mean for part in parts]
    size = np.maximum(np.nansum(np.vstack(centred) ** 2, axis=0), 1e-300)
    rows = []
    for lag in range(1, LAGS + 1):
        pairs = np.vstack([part[lag:] * part[:-lag] for part in centred])
        rows.append(np.nansum(pairs, axis=0) / size)
    return np.array(rows)


def _block_means(x: Array) -> Array:
    length = max(BLOCK, len(x) // BLOCKS)
    whole = x[: len(x) // length * length]
    return (
        whole.reshape(-1, length).mean(axis=1) if len(whole) else np.array([x.mean() if len(x) else np.nan])
    )


def _level(plant: Plant, record: Sequence[Segment]) -> tuple[Array, Array]:
    """Mean distance from the operating point and its standard error, in standard deviations of the channel.

    What the inputs do is taken off first. A mean over N samples of y = C x + v has the variance

        [N C X C' + 2 sum_k (N - k) C A^k X C'] / N^2 + R / N,   sum_k = A (I - A)^-1 (N I - (I - A)^-1 (I -
        A^N))
    """
    A = plant.A * min(1.0, 0.9999 / max(radius(plant.A), 1e-300))
    X = spread(A, plant.Q)
    R = np.diag(plant.R)
    deviation = np.sqrt(np.einsum("ij,jk,ik->i", plant.C, X, plant.C) + R)
    total, weight, variance = np.zeros(plant.m), np.zeros(plant.m), np.zeros(plant.m)
    for y, u in record:
        driven = plant.normalise_input(u)
        expected = scan(A, driven @ plant.B.T) @ plant.C.T + driven @ plant.D.T
        z = plant.normalise(y) - expected
        number = np.isfinite(z).sum(axis=0)
        total += np.where(np.isfinite(z), z, 0.0).sum(axis=0)
        weight += number
        N = len(y)
        F = linalg.inv(np.eye(plant.n) - A)
        summed = A @ F @ (N * np.eye(plant.n) - F @ (np.eye(plant.n) - np.linalg.matrix_power(A, N)))
        moved = N * X + summed @ X + (summed @ X).T
        mean_of = np.einsum("ij,jk,ik->i", plant.C, moved, plant.C) / N**2 + R / N
        variance += number**2 * np.maximum(mean_of, 0.0)
    known = np.maximum(weight, 1)
    return total / known / deviation, np.sqrt(variance) / known / deviation
