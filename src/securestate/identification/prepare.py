"""What a history is before anything is fitted: segments in normalised units, and what had to be done to it.

Constant channels say nothing and are left out. Channels that repeat each other are one sensor. Rounded
readings have at least the noise of their rounding. Gaps stay gaps, but for the subspace step, which needs
complete stretches, up to `FILLED` missing samples in a row are interpolated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate._words import count, enumerate_names
from securestate.errors import MeasurementError
from securestate.identification.forms import Segment
from securestate.identification.history import History, runs

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Missing samples in a row that are interpolated for the subspace step.
FILLED = 3

#: Samples of a complete stretch at least.
STRETCH = 10

#: Two channels repeat each other if their difference is less than this share of their standard deviation.
REPEATS = 1e-3

#: Or less than this times the rounding of both.
ROUNDED = 1.5

#: A value that stays this many times as long as chance would have it has got stuck; samples at least.
STUCK, STUCK_LEAST = 4.0, 30

#: An input whose part that others do not give is a smaller share of it than this says nothing new.
DEPENDENT = 1e-6

#: Least variance of a sensor's noise, as a share of the channel's variance.
LEAST_NOISE = 1e-6

#: A standard deviation below this share of the channel's size is rounding of the numbers themselves.
CONSTANT = 1e-12


@final
@dataclass(frozen=True, eq=False)
class Group:
    """Channels of the history that are one channel of the model.

    Attributes:
        channels: their numbers in the history; several if they repeat each other.
        signs: +1 or -1 per channel, -1 if it runs against the first.
    """

    channels: tuple[int, ...]
    signs: tuple[float, ...]


@final
@dataclass(frozen=True, eq=False)
class Prepared:
    """A history in normalised units.

    Attributes:
        groups: the channels of the model.
        offset, scale: mean and standard deviation of every channel of the history, (m,).
        steps: rounding of every channel of the history, engineering units; 0 if none was found, (m,).
        inputs: numbers of the inputs used; input_offset, input_scale: their mean and standard deviation.
        floor: least noise variance of the channels of the model.
        segments: y (N, groups), u (N, inputs); NaN where nothing was read.
        remarks: what was done, one sentence each.
    """

    groups: tuple[Group, ...]
    offset: Array
    scale: Array
    steps: Array
    inputs: Indices
    input_offset: Array
    input_scale: Array
    floor: Array
    segments: tuple[Segment, ...]
    remarks: tuple[str, ...]

    def normalise(self, history: History) -> tuple[Segment, ...]:
        """The segments of another history of the same channels, in the same units."""
        return tuple((self._channels(y), self._inputs(u)) for y, u in history.segments)

    def _channels(self, y: Array) -> Array:
        z = (y - self.offset) / self.scale
        return np.column_stack([_mean(z[:, list(g.channels)] * g.signs) for g in self.groups])

    def _inputs(self, u: Array) -> Array:
        return (u[:, self.inputs] - self.input_offset) / self.input_scale


def prepare(history: History) -> Prepared:
    """Look at a history and normalise it.

    Raises:
        MeasurementError: no channel varies.
    """
    y, u = (np.vstack(parts) for parts in zip(*history.segments, strict=True))
    read = np.isfinite(y).any(axis=0)
    offset, scale = np.zeros(y.shape[1]), np.zeros(y.shape[1])
    offset[read], scale[read] = np.nanmean(y[:, read], axis=0), np.nanstd(y[:, read], axis=0)
    varies = scale > CONSTANT * np.maximum(1.0, np.abs(offset))
    if not varies.any():
        raise MeasurementError("y", "channels that vary", "constant channels only")
    moves = np.std(u, axis=0) > CONSTANT * np.maximum(1.0, np.abs(np.mean(u, axis=0)))
    moves &= ~_dependent(u, moves)
    z = (y - offset) / np.where(varies, scale, 1.0)
    steps = np.array([rounding(column) for column in y.T])
    own = np.maximum(LEAST_NOISE, (steps / np.where(varies, scale, 1.0)) ** 2 / 12)
    groups = _groups(z, np.flatnonzero(varies), own)
    _align(y, groups, offset, scale)
    found = Prepared(
        groups=groups,
        offset=offset,
        scale=np.where(varies, scale, 1.0),
        steps=steps,
        inputs=np.flatnonzero(moves),
        input_offset=np.mean(u, axis=0)[moves],
        input_scale=np.std(u, axis=0)[moves],
        floor=np.array([np.mean(own[list(group.channels)]) for group in groups]),
        segments=(),
        remarks=(*_remarks(history, read, varies, moves, groups), *_stuck(history, varies)),
    )
    return Prepared(**{**vars(found), "segments": found.normalise(history)})


def _dependent(u: Array, moves: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Inputs that are a linear function of those before them, (q,)."""
    found = np.zeros(u.shape[1], dtype=np.bool_)
    kept = np.zeros((len(u), 0))
    for j in np.flatnonzero(moves):
        z = (u[:, j] - u[:, j].mean()) / u[:, j].std()
        left = z - kept @ (kept.T @ z)
        size = float(np.linalg.norm(left)) / np.sqrt(len(u))
        found[j] = size < DEPENDENT
        if not found[j]:
            kept = np.column_stack([kept, left / np.linalg.norm(left)])
    return found


def _groups(z: Array, kept: Indices, own: Array) -> tuple[Group, ...]:
    """Channels that repeat each other, together; each group in the order of the history.

    Args:
        own: variances of the rounding of every channel, by which copies may differ.
    """
    groups: list[Group] = []
    alike = _alike(z)
    for i in kept:
        for g, group in enumerate(groups):
            first = group.channels[0]
            apart = max(REPEATS, ROUNDED * float(np.sqrt(own[first] + own[i])))
            sign = _repeats(z[:, first], z[:, i], apart) if alike[first, i] else 0.0
            if sign:
                groups[g] = Group((*group.channels, int(i)), (*group.signs, sign))
                break
        else:
            groups.append(Group((int(i),), (1.0,)))
    return tuple(groups)


def _align(y: Array, groups: Sequence[Group], offset: Array, scale: Array) -> None:
    """Give copies the operating point with which they equal the first channel of their group, in place.

    Their own mean and deviation differ a little if they miss other samples; the rest would look like a lie.
    """
    for group in groups:
        first = group.channels[0]
        for i, sign in zip(group.channels[1:], group.signs[1:], strict=True):
            both = np.isfinite(y[:, first]) & np.isfinite(y[:, i])
            z = sign * (y[both, first] - offset[first]) / scale[first]
            slope = float(np.dot(z - z.mean(), y[both, i]) / np.sum((z - z.mean()) ** 2))
            offset[i], scale[i] = float(np.mean(y[both, i]) - slope * z.mean()), abs(slope)


def _alike(z: Array) -> NDArray[np.bool_]:
    """Pairs of channels that may repeat each other, by their correlation; one pass for all, (m, m)."""
    there = np.isfinite(z).astype(np.float64)
    known = np.where(there > 0, z, 0.0)
    products, squares = known.T @ known, (known**2).T @ there
    return np.asarray(np.abs(products) > 0.99 * np.sqrt(squares * squares.T))


def _repeats(first: Array, second: Array, apart: float) -> float:
    """+1 or -1 if the second channel repeats the first, or repeats it mirrored; 0 otherwise."""
    both = np.isfinite(first) & np.isfinite(second)
    if np.count_nonzero(both) < STRETCH:
        return 0.0
    a, b = ((x[both] - x[both].mean()) / max(float(x[both].std()), 1e-300) for x in (first, second))
    sign = 1.0 if np.dot(a, b) >= 0 else -1.0
    return sign if np.std(a - sign * b) < apart else 0.0


def rounding(x: Array) -> float:
    """The step that readings are rounded to, 0 if none is found.

    Differences of values that occur are multiples of the smallest one, and values occur more than twice.
    """
    values = np.unique(x[np.isfinite(x)])
    readings = np.count_nonzero(np.isfinite(x))
    if len(values) < 2 or len(values) >= readings / 2:
        return 0.0
    apart = np.diff(values)
    apart = apart[apart > CONSTANT * max(1.0, float(np.max(np.abs(values))))]
    if not len(apart):
        return 0.0
    multiples = apart / apart.min()
    whole = np.abs(multiples - np.round(multiples)) < 0.02
    return float(apart.min()) if np.mean(whole) > 0.98 else 0.0


def _mean(columns: Array) -> Array:
    """Mean over the columns that hold a reading; NaN where none does."""
    present = np.isfinite(columns)
    number = present.sum(axis=1)
    total = np.where(present, columns, 0.0).sum(axis=1)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def _remarks(
    history: History,
    read: NDArray[np.bool_],
    varies: NDArray[np.bool_],
    moves: NDArray[np.bool_],
    groups: Sequence[Group],
) -> list[str]:
    names, said = history.channel_names, []
    silent = [name for name, heard in zip(names, read, strict=True) if not heard]
    if silent:
        verb = "holds no reading and is" if len(silent) == 1 else "hold no reading and are"
        said.append(f"{enumerate_names(silent)} {verb} left out.")
    still = [name for name, heard, alive in zip(names, read, varies, strict=True) if heard and not alive]
    if still:
        said.append(
            f"{enumerate_names(still)} never changes in the history and is left out."
            if len(still) == 1
            else f"{enumerate_names(still)} never change in the history and are left out."
        )
    held = [name for name, alive in zip(history.input_names, moves, strict=True) if not alive]
    if held:
        what = (
            "without any change, or a function of others," if len(held) > 1 else "without a change of its own"
        )
        said.append(f"{count(len(held), 'input')} {what} left out: {enumerate_names(held)}.")
    for group in groups:
        if len(group.channels) > 1:
            repeated = enumerate_names([names[i] for i in group.channels])
            said.append(
                f"{repeated} repeat each other and count as one sensor: none of them vouches for another."
            )
    return said


def complete(segments: Sequence[Segment], least: int = STRETCH) -> list[Segment]:
    """Stretches without a gap, after gaps of up to `FILLED` samples are interpolated."""
    stretches: list[Segment] = []
    for y, u in segments:
        filled = np.column_stack([_interpolated(column) for column in y.T])
        whole = np.asarray(np.isfinite(filled).all(axis=1))
        for start, stop in runs(whole):
            if stop - start >= least:
                stretches.append((filled[start:stop], u[start:stop]))
    return stretches


def _interpolated(x: Array) -> Array:
    """The channel with short gaps filled by straight lines."""
    missing = np.isnan(x)
    if not missing.any() or missing.all():
        return x
    line = np.interp(np.arange(len(x)), np.flatnonzero(~missing), x[~missing])
    filled = x.copy()
    for start, stop in runs(missing):
        if stop - start <= FILLED and start > 0 and stop < len(x):
            filled[start:stop] = line[start:stop]
    return filled


def split(segments: Sequence[Segment], share: float) -> tuple[list[Segment], list[Segment]]:
    """Cut a record in time: the last `share` of its samples, and what comes before."""
    total = sum(len(y) for y, _ in segments)
    cut = total - int(share * total)
    before: list[Segment] = []
    after: list[Segment] = []
    seen = 0
    for y, u in segments:
        here = int(np.clip(cut - seen, 0, len(y)))
        seen += len(y)
        if here >= STRETCH:
            before.append((y[:here], u[:here]))
        if len(y) - here >= STRETCH:
            after.append((y[here:], u[here:]))
    return before, after


def _stuck(history: History, varies: NDArray[np.bool_]) -> list[str]:
    """Channels that keep a value for much longer than they usually do."""
    said = []
    for i in np.flatnonzero(varies):
        longest, changes, steps = 0, 0, 0
        for y, _ in history.segments:
            x = y[np.isfinite(y[:, i]), i]
            same = np.diff(x) == 0
            longest = max([longest, *(stop - start for start, stop in runs(same))])
            changes, steps = changes + int(np.sum(~same)), steps + len(same)
        # Were changes independent, the longest run among `steps` would be about log(steps) / -log(1 - share).
        share = min(max(changes / max(steps, 1), 1e-9), 1 - 1e-9)
        usual = np.log(max(steps, 2)) / -np.log1p(-share)
        if longest > max(STUCK_LEAST, STUCK * usual):
            said.append(
                f"{history.channel_names[i]} keeps one value for {longest + 1:,} samples: was it stuck?"
            )
    return said
