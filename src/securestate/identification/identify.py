"""From a history without lies to a plant, with evidence.

1. `prepare`: normalise, leave out what never changes, merge what repeats itself, find the rounding.
2. `lags`: how long a past predicts. `subspace`: models of all orders. `order`: how many states.
3. `maximise`: maximum likelihood with independent sensor noises, on all of the history.
4. `judge`: a verdict by samples not used for fitting; `assemble`: the plant, its noise as large as it turned
out.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal, final

import numpy as np
from numpy.typing import NDArray

from securestate import _checks as check
from securestate._threads import one_blas_thread
from securestate._words import count, enumerate_names
from securestate.errors import InputError, MeasurementError, SecurestateWarning
from securestate.identification.assemble import assemble, grouped, marked, scaled_noise
from securestate.identification.forms import EDGE, Independent, Segment
from securestate.identification.history import History, numbered
from securestate.identification.identified import Identified
from securestate.identification.judge import Verdict, judged, require_step
from securestate.identification.lags import past_length
from securestate.identification.maximise import Fit, Freedom, maximise
from securestate.identification.order import COSTLY, TRIAL, OrderSearch, score, search
from securestate.identification.prepare import FILLED, Prepared, complete, prepare, split
from securestate.identification.subspace import Subspace
from securestate.identification.verdict import Grade
from securestate.identification.vouching import gained_at_once, lost_without_inputs
from securestate.plant import Plant

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Progress = Callable[[str, int, int], None]

#: Share of the history, its end, that judges orders, and the model if there is no other record to do so.
KEPT_BACK = 0.25

#: EM and L-BFGS steps of the fit, of its continuation on all of the history, and of the ones with gaps.
FINAL, AGAIN, WITH_GAPS = (5, 150), (2, 60), (8, 20)

#: Samples that a history needs at least, in all and per channel and input.
LEAST, LEAST_EACH = 50, 3

#: Orders of innovations forms at most.
LARGEST = 20

#: The past is tried so many times as long as the regression on it alone would have it; regressors at most.
LONGER, MOST_REGRESSORS = (1, 2, 3), 800


def identify(
    y: object,
    u: object = None,
    order: int | Literal["auto"] = "auto",
    *,
    held_out: object = None,
    held_out_u: object = None,
    feedthrough: bool = False,
    largest_eigenvalue: float = EDGE,
    sensors: Mapping[str, Sequence[str]] | None = None,
    dt: float | None = None,
    channel_names: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
    input_names: Sequence[str] | None = None,
    name: str = "",
    progress: Progress | None = None,
) -> Identified:
    """Learn a plant from a record in which no sensor lied.

        y = offset + scale (C x + D u~ + v),   x+ = A x + B u~ + w,   w ~ N(0, Q),  v ~ N(0, R)

    u~ are normalised inputs, R does not couple sensors: otherwise the lie of one leaked into the others.

    Args:
        y: measurements (N, m) in engineering units, NaN where missing: an array or a table with column names;
            a
            list of these, one per segment; or a `History`.
        u: inputs of the same samples, (N, q), in the same way. Inputs that a controller computes from y
            repeat
            what the sensors said: leave them out if in doubt.
        order: number of states, or "auto": chosen by samples kept back, see `order`.
        held_out, held_out_u: another record of the same channels for the verdict.
        feedthrough: let an input act within its sample (D). Only if no controller computes u from y of the
            same
            sample: else a sensor vouches for itself by way of the controller, and a warning says for which.
        largest_eigenvalue: A's eigenvalues are kept below this size, in (0, 1).
        sensors: channels by sensor, for sensors that own several; the others own one each.
        dt: seconds between samples, default 1. channel_names, units, input_names, name: as in `History.of`
            and `Plant`.
        progress: called with a stage, steps done and steps at most.
    Returns:
        The plant with its verdict. Look at the verdict.
    Raises:
        InputError, ShapeError, MeasurementError: the record cannot be used; says why.
        SecurestateWarning (a warning): channels left out or merged, inputs that make sensors vouch for
        themselves.
    Notes:
        Takes seconds for 20 channels and 1,500 samples. The same data give the same plant on the same
        machine, whatever the number of threads.
    References:
        chiuso2007 and jansson2003 for the subspace, shumway1982 for maximum likelihood.

    Examples:
        >>> import numpy as np
        >>> rng = np.random.default_rng(1)
        >>> x = np.zeros(1000)
        >>> for k in range(1, 1000):
        ...     x[k] = 0.9 * x[k - 1] + rng.normal()
        >>> y = 20 + x[:, None] + rng.normal(size=(1000, 3))
        >>> found = identify(y, dt=60.0, channel_names=["left", "middle", "right"], units=["cm"] * 3)
        >>> print(found.plant, found.verdict.grade)
        Plant(n=1, m=3, sensors=3, inputs=0, dt=60 s) good
    """
    history = History.of(y, u, dt=dt, channel_names=channel_names, units=units, input_names=input_names)
    other = None if held_out is None else _other(history, held_out, held_out_u)
    wanted = None if order == "auto" else check.whole_number("order", order, 1, InputError)
    if not 0 < check.positive_number("largest_eigenvalue", largest_eigenvalue, InputError) < 1:
        raise InputError("largest_eigenvalue", "a number in (0, 1)", str(largest_eigenvalue))
    if check.yes_or_no("feedthrough", feedthrough, InputError) and not history.input_names:
        raise InputError("feedthrough", "inputs, or False", "True without inputs")
    if held_out is None and held_out_u is not None:
        raise InputError("held_out_u", "None without held_out", "inputs")
    with one_blas_thread():
        task = _Task(history, other, feedthrough, largest_eigenvalue, progress or (lambda *_: None))
        try:
            return task.run(wanted, sensors, name)
        except np.linalg.LinAlgError as reason:
            raise MeasurementError(
                "y", "readings with noise, from which a model can be computed", f"others ({reason})"
            ) from None


def _other(history: History, y: object, u: object) -> History:
    """The held-out record with the history's channels and inputs."""
    given = History.of(y, u)
    if history.dt is not None:
        require_step(given, history.dt)
    channels, inputs = history.channel_names, history.input_names
    if given.channel_names == numbered("y", len(channels)):
        given = replace(given, channel_names=channels)
    if given.input_names == numbered("u", len(inputs)):
        given = replace(given, input_names=inputs)
    return given.select(channels, inputs)


@final
class _Task:
    """One identification: the data, and what is done with them."""

    def __init__(
        self, history: History, other: History | None, feedthrough: bool, edge: float, progress: Progress
    ) -> None:
        self.history, self.other, self.feedthrough, self.edge = history, other, feedthrough, edge
        self.tell = progress
        self.prepared = prepare(history)
        self.stretches = complete(self.prepared.segments)
        _refuse_short(history, self.prepared, self.stretches)
        fitted, kept = split(self.prepared.segments, KEPT_BACK)
        self.fitted, self.kept = complete(fitted), complete(kept)
        self.gaps = any(np.isnan(y).any() for y, _ in self.prepared.segments)

    def run(self, order: int | None, sensors: Mapping[str, Sequence[str]] | None, name: str) -> Identified:
        """Do everything."""
        channels = grouped(self.history, self.prepared, sensors)
        remarks = list(self.prepared.remarks)
        for remark in remarks:
            warnings.warn(remark, SecurestateWarning, stacklevel=4)
        if self.history.held:
            remarks.append(f"{count(self.history.held, 'missing input')} held at the last known value.")
        self.tell("looking at the past", 0, 1)
        pasts, largest = self._pasts(order)
        found, trial, subspace = search(
            [Subspace(self.fitted, past, self.feedthrough, self.edge) for past in pasts],
            self.fitted,
            self.kept,
            self.prepared.floor,
            order,
            largest,
            lambda stage: self.tell(stage, 0, 1),
        )
        checked, steps = self._checked(trial)
        fit = self._final(checked, steps)
        plant = assemble(fit.model, self.history, self.prepared, channels, name)
        remarks += self._leaks(subspace, found, plant)
        self.tell("judging", 0, 1)
        verdict = self._judge(fit.model if self.other else checked, found, subspace, plant, channels, name)
        verdict, alone = self._without_inputs(verdict, plant)
        remarks += alone
        factor = self._noise_factor(verdict)
        if factor > 1:
            remarks.append(
                f"The noises of the plant were raised by {100 * (factor - 1):.2g} %, as variances, so that "
                "errors on new data are as large as it says."
            )
        sure = {sensor.name: sensor.verifiable for sensor in verdict.sensors}
        best = max(found.innovations, key=lambda n: found.innovations[n])
        return Identified(
            plant=marked(scaled_noise(plant, factor), sure),
            verdict=verdict,
            search=found,
            innovations=Subspace(self.stretches, found.past, self.feedthrough, self.edge).model(best),
            channels=tuple(self.history.channel_names[group.channels[0]] for group in self.prepared.groups),
            likelihoods=fit.likelihoods,
            noise_factor=factor,
            remarks=tuple(remarks),
            samples=self.history.samples,
            missing=self.history.missing,
        )

    def _pasts(self, order: int | None) -> tuple[list[int], int]:
        """Lengths of the past that are tried, and the largest order of innovations forms.

        The regression on the past has its own best length; low orders often gain from a longer one.
        """
        m, width = len(self.prepared.groups), len(self.prepared.groups) + len(self.prepared.inputs)
        lengths = np.array([len(y) for y, _ in self.fitted])
        total, longest = int(lengths.sum()), self._longest(width)
        largest = max(2, min(LARGEST, total // 20)) if order is None else order
        best = max(2, past_length(self.fitted, longest, self.feedthrough))
        most = max(2, min(total // (3 * width), MOST_REGRESSORS // width))
        while most > 2 and np.maximum(lengths - most, 0).sum() < 0.8 * total:
            most -= 1
        least = int(np.ceil(1.5 * largest / m))
        if order is not None and order > most * m // 2:
            raise InputError(
                "order", f"at most {max(1, most * m // 2)} for a history of this length", str(order)
            )
        return sorted({min(max(factor * best, least), most) for factor in LONGER}), largest

    def _checked(self, trial: Independent) -> tuple[Independent, int]:
        """The trial fit climbed further, if that predicts the samples kept back better; and in how many
        steps.
        """
        freedom = self._freedom(trial)
        em, steps = FINAL
        further = maximise(
            trial,
            self.fitted,
            freedom,
            self.prepared.floor,
            em=em,
            steps=steps,
            progress=self._bar("fitting"),
        )
        better = score(further.model, self.kept).mean() > score(trial, self.kept).mean()
        model, steps = (further.model, steps) if better else (trial, TRIAL[1])
        if self.gaps:
            model = self._with_gaps(
                model, split(self.prepared.segments, KEPT_BACK)[0], "fitting with gaps"
            ).model
        return model, steps

    def _final(self, start: Independent, steps: int) -> Fit:
        """Maximum likelihood on all of the history."""
        freedom = self._freedom(start)
        fit = maximise(
            start,
            self.stretches,
            freedom,
            self.prepared.floor,
            em=AGAIN[0],
            steps=min(steps, AGAIN[1]),
            progress=self._bar("fitting all"),
        )
        return (
            fit
            if not self.gaps
            else self._with_gaps(fit.model, self.prepared.segments, "fitting all with gaps")
        )

    def _with_gaps(self, model: Independent, record: Sequence[Segment], stage: str) -> Fit:
        """A few more steps with the exact filter for missing channels."""
        em, steps = WITH_GAPS
        floor, freedom = self.prepared.floor, self._freedom(model)
        return maximise(
            model, record, freedom, floor, em=em, steps=steps, gaps=True, progress=self._bar(stage)
        )

    def _bar(self, stage: str) -> Callable[[int, int], None]:
        return lambda done, total: self.tell(stage, done, total)

    def _freedom(self, model: Independent) -> Freedom:
        return replace(Freedom.all(model, self.feedthrough), limit=self.edge)

    def _judge(
        self,
        model: Independent,
        found: OrderSearch,
        subspace: Subspace,
        plant: Plant,
        channels: Mapping[str, list[int]],
        name: str,
    ) -> Verdict:
        """The verdict on this model by the held-out record, or by the samples kept back."""
        # Of channels that repeat each other one is judged: what tells them apart says nothing of the model.
        first = {group.channels[0] for group in self.prepared.groups}
        alone = {sensor: [i for i in rows if i in first] for sensor, rows in channels.items()}
        alone = {sensor: rows for sensor, rows in alone.items() if rows}
        judged_plant = assemble(model, self.history, self.prepared, alone, name)
        kept = replace(self.history, segments=tuple(split(self.history.segments, KEPT_BACK)[1]))
        names = judged_plant.channel_names
        record = (self.other or kept).select(names, plant.input_names).segments
        law = None
        order = [self.history.channel_names.index(channel) for channel in names]
        if found.cost > COSTLY * len(order):
            best = subspace.model(max(found.innovations, key=lambda n: found.innovations[n]))
            place = [self._group_of(channel) for channel in order]
            law = replace(
                best, C=best.C[place], D=best.D[place], K=best.K[:, place], S=best.S[np.ix_(place, place)]
            )
        return judged(judged_plant, record, self._parameters(model), law)

    def _group_of(self, channel: int) -> int:
        return next(g for g, group in enumerate(self.prepared.groups) if channel in group.channels)

    def _parameters(self, model: Independent) -> float:
        """By how much errors grow on new data because so many parameters were fitted: 2 k / readings.

        Fitted errors are too small by k / readings, new ones too large by as much.
        """
        readings = sum(int(np.isfinite(y).sum()) for y, _ in self.prepared.segments)
        return 2 * model.parameters(self.feedthrough) / readings

    def _noise_factor(self, verdict: Verdict) -> float:
        """Errors on new data over what the model says, if surely larger; less where the plant saw more
        data.
        """
        found = verdict.residuals
        readings = max(int(found.channels.sum()), 1)
        excess = found.size - 1
        if verdict.grade is Grade.INADEQUATE or excess < 2 * np.sqrt(2 / readings):
            return 1.0
        return float(1 + excess * (1.0 if self.other else 1 - KEPT_BACK))

    def _without_inputs(self, verdict: Verdict, plant: Plant) -> tuple[Verdict, list[str]]:
        """Count a sensor as verifiable only if the others vouch for it without the inputs; warns of the rest.

        With feedthrough the user has said that no controller is at work.
        """
        rows = {name: own for name, own in self._rows(plant).items() if name in verdict.verifiable}
        if not plant.n_inputs or self.feedthrough or not rows:
            return verdict, []
        longest = self._longest(len(self.prepared.groups))
        lost = lost_without_inputs(self.fitted, self.kept, rows, longest, self.edge)
        if not lost:
            return verdict, []
        sensors = tuple(
            replace(sensor, verifiable=sensor.verifiable and sensor.name not in lost)
            for sensor in verdict.sensors
        )
        text = (
            f"Without the inputs the other sensors do not vouch for {enumerate_names(lost)}: not counted as "
            "verifiable, because a controller may have computed the inputs from these readings"
        )
        warnings.warn(text, SecurestateWarning, stacklevel=5)
        return replace(verdict, sensors=sensors), [text + "."]

    def _leaks(self, subspace: Subspace, found: OrderSearch, plant: Plant) -> list[str]:
        """Warn of sensors that only the inputs of the same sample vouch for."""
        if not self.feedthrough:
            return []
        n = max(found.innovations, key=lambda n: found.innovations[n])
        named = gained_at_once(subspace, n, self.fitted, self.kept, self._rows(plant))
        if not named:
            return []
        text = (
            f"Only inputs of the same sample vouch for {enumerate_names(named)}. If a controller computes "
            "these inputs from y, they repeat what the sensors say, and a liar vouches for itself: set "
            "feedthrough=False"
        )
        warnings.warn(text, SecurestateWarning, stacklevel=5)
        return [text + "."]

    def _rows(self, plant: Plant) -> dict[str, Indices]:
        """Channels of the model by sensor."""
        place = self.history.channel_names.index
        return {
            sensor.name: np.unique([self._group_of(place(channel)) for channel in sensor.channels])
            for sensor in plant.sensors
        }

    def _longest(self, width: int) -> int:
        """The longest past that the regressions try, for so many columns."""
        lengths = np.array([len(y) for y, _ in self.fitted])
        total = int(lengths.sum())
        longest = int(np.clip(total // (4 * width), 1, max(4, min(30, 600 // width))))
        while longest > 1 and np.maximum(lengths - longest, 0).sum() < 0.8 * total:
            longest -= 1
        return longest


def _refuse_short(history: History, prepared: Prepared, stretches: Sequence[Segment]) -> None:
    """Refuse what is too short to learn anything from."""
    width = len(prepared.groups) + len(prepared.inputs)
    needed = max(LEAST, LEAST_EACH * width)
    if history.samples < needed:
        raise MeasurementError(
            "y", f"at least {needed} samples for {width} channels and inputs", str(history.samples)
        )
    whole = sum(len(y) for y, _ in stretches)
    if whole < needed:
        y = np.vstack([y for y, _ in history.segments])
        worst = int(np.argmax(np.isnan(y).mean(axis=0)))
        raise MeasurementError(
            "y",
            f"at least {needed} samples in stretches without a gap of more than {FILLED} samples",
            f"{whole}; {history.channel_names[worst]} misses most, {np.isnan(y[:, worst]).mean():.0%}",
        )
