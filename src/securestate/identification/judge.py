"""Judge a model by a record that it was not fitted to: a grade, and what the others say of every sensor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from securestate._steady_state import steady_state
from securestate._threads import one_blas_thread
from securestate._words import count, enumerate_names
from securestate.errors import DesignError, InputError, ShapeError
from securestate.estimators.kalman import KalmanFilter
from securestate.identification.blame import BLAMED, RESTORED, fewest_without, reason_of, without
from securestate.identification.forms import Innovations, Segment
from securestate.identification.history import History, numbered
from securestate.identification.redundancy import explained, left_out
from securestate.identification.rehearsal import suspected_shares
from securestate.identification.residuals import WARM_UP, Residuals, anywhere, residuals
from securestate.identification.verdict import (
    Criterion,
    Grade,
    Problem,
    criteria,
    overall,
    problems,
    rehearsed,
)
from securestate.identification.vouching import VERIFIABLE
from securestate.plant import Plant

Array = NDArray[np.float64]

#: Samples used where channels are missing and every sensor takes a filter run of its own.
GAP_SAMPLES = 5000


@final
@dataclass(frozen=True)
class SensorEvidence:
    """What a record says of one sensor.

    Attributes:
        name: of the sensor.
        explained: share of its variation that the other sensors (and the inputs) explain, at most 1; of
            several
            channels the least. NaN if it was hardly read.
        explained_least: the same at least, with 95 % confidence.
        verifiable: whether the others explain at least half of it, surely.
        variance: its prediction errors over what the model says, as a variance; the worst channel.
        repeat: their correlation from sample to sample. ljung_box: how likely that much is by chance.
        shift: their mean in standard deviations.
        noise: share of the prediction error's variance that is the sensor's own noise, by the model.
    """

    name: str
    explained: float
    explained_least: float
    verifiable: bool
    variance: float
    repeat: float
    ljung_box: float
    shift: float
    noise: float


@final
@dataclass(frozen=True, eq=False)
class Verdict:
    """Whether a model is good enough to judge sensors by.

    Attributes:
        grade: good, usable or inadequate.
        problems: what is wrong, the gravest first.
        sensors: evidence per sensor, in the plant's order.
        residuals: the numbers behind it. criteria: those that the grade rests on, with their limits.
        reason: what a fit that is much too bad is put down to, one sentence; it is among the problems, too.
        blamed: sensors without which an inadequate model fits; empty if there are none such, or none is
            needed.
    """

    grade: Grade
    problems: tuple[Problem, ...]
    sensors: tuple[SensorEvidence, ...]
    residuals: Residuals
    criteria: tuple[Criterion, ...]
    blamed: tuple[str, ...] = ()
    reason: str = ""

    @property
    def verifiable(self) -> tuple[str, ...]:
        """Names of the sensors that the others can vouch for."""
        return tuple(sensor.name for sensor in self.sensors if sensor.verifiable)

    def __str__(self) -> str:
        return "\n".join(self.sentences())

    def sentences(self) -> Iterator[str]:
        """The verdict as an engineer reads it."""
        found = self.residuals
        samples = count(found.samples, "sample")
        yield {
            Grade.GOOD: f"The model is good: on {samples} its errors are what it says "
            f"({found.size:.2f} times the variance; {100 * found.exceed:.1f} % beyond the limit for 5 %).",
            Grade.USABLE: f"The model is usable, judged by {samples}.",
            Grade.INADEQUATE: f"The model is inadequate, judged by {samples}: do not judge sensors by it.",
        }[self.grade]
        yield from (str(problem) for problem in self.problems)
        if self.grade is Grade.INADEQUATE:
            return  # what it says of the sensors means nothing
        named = self.verifiable
        total = len(self.sensors)
        if total == 1:
            yield f"There is no other sensor that could check {self.sensors[0].name}."
            return
        unknown = [sensor.name for sensor in self.sensors if np.isnan(sensor.explained)]
        if len(unknown) == total:
            yield "Too few readings to say which sensors the others can check."
        elif not named:
            yield "No sensor can be checked: the others explain less than half of each one's variation."
        elif len(named) == total:
            yield "Every sensor can be checked: the others explain at least half of its variation."
        else:
            yield (
                f"{len(named)} of {count(total, 'sensor')} can be checked by the others: "
                f"{enumerate_names(named, 12)}."
            )


def judge(plant: Plant, y: object, u: object = None) -> Verdict:
    """Judge a plant's model by a record, best one that it was not fitted to and in which nobody lied.

    Args:
        plant: does not vary in time.
        y: measurements (N, m) in engineering units, NaN where missing: an array or a table, or a list of
            these,
            one per segment; or a `History` with the plant's channels.
        u: inputs (N, p) in the same way; None for a plant without inputs.
    Returns:
        The verdict. An inadequate one says whether the plant or some sensors are more likely the reason.
    Raises:
        ShapeError, MeasurementError: the record does not fit the plant.
        DesignError: the plant has no steady state.

    Examples:
        >>> import numpy as np
        >>> from securestate import Plant, Sensor
        >>> plant = Plant([[0.9]], [[0.19]], [Sensor(name, C=[1.0], R=0.1) for name in ("a", "b")])
        >>> rng = np.random.default_rng(1)
        >>> x = np.zeros(2000)
        >>> for k in range(1, 2000):
        ...     x[k] = 0.9 * x[k - 1] + rng.normal(scale=0.19**0.5)
        >>> y = x[:, None] + rng.normal(scale=0.1**0.5, size=(2000, 2))
        >>> print(judge(plant, y).grade)
        good
        >>> print(judge(plant, 2 * y).grade)
        inadequate
    """
    if not isinstance(plant, Plant):
        raise InputError("plant", "a Plant", type(plant).__name__)
    if plant.time_varying:
        raise DesignError("the plant varies in time", "judge one that does not")
    return judged(plant, fitting(plant, History.of(y, u)).segments)


def fitting(plant: Plant, history: History) -> History:
    """The history with exactly the plant's channels and inputs, in its order; columns without names as they
    come.

    Raises:
        InputError: a channel or input is not there. ShapeError: columns without names of another number.
    """
    require_step(history, plant.dt)
    channels = _matched("y", "channel", history.channel_names, plant.channel_names)
    inputs = _matched("u", "input", history.input_names, plant.input_names)
    return history.select(channels, inputs)


def require_step(history: History, dt: float) -> None:
    """Refuse a record of another sample time; one made from arrays has none of its own.

    Raises:
        InputError: names y.dt.
    """
    if history.dt is not None and abs(history.dt - dt) > 0.01 * dt:
        raise InputError("y.dt", f"{dt:g} s between samples, as the plant has", f"{history.dt:g} s")


def _matched(argument: str, what: str, given: tuple[str, ...], wanted: tuple[str, ...]) -> tuple[str, ...]:
    if given != numbered(argument, len(given)):
        return wanted
    if len(given) != len(wanted):
        raise ShapeError(argument, f"{count(len(wanted), what)}, as the plant has", str(len(given)))
    return given


def judged(
    plant: Plant, record: Sequence[Segment], parameters: float | None = None, law: Innovations | None = None
) -> Verdict:
    """The verdict on segments in engineering units.

    Args:
        parameters: expected growth of errors because parameters were fitted, see `verdict.TOO_FEW`.
        law: the channels' law for leaving sensors out, if it is better known than by the plant.
    """
    with one_blas_thread():
        found = residuals(plant, record)
        if found.samples:
            looked_at = tuple(criteria(found, plant.channel_names, parameters))
            if overall(problems(looked_at, found.samples)) is not Grade.INADEQUATE:
                shares = suspected_shares(plant, record)
                looked_at += () if shares is None else (rehearsed(shares, plant.sensor_names),)
            wrong = problems(looked_at, found.samples)
        else:
            looked_at = ()
            wrong = [Problem(Grade.INADEQUATE, "There is no sample to judge the model by.")]
        blamed: tuple[str, ...] = ()
        reason = ""
        tried = min(BLAMED, plant.n_sensors - 1)
        if tried and found.size > RESTORED and overall(wrong) is Grade.INADEQUATE:
            blamed = fewest_without(plant, record, tried)
            rival = fewest_without(plant, record, len(blamed), blamed) if blamed else ()
            wrong.append(reason_of(blamed, rival, tried, plant.n_sensors))
            reason = wrong[-1].text
            blamed = () if rival or 2 * len(blamed) >= plant.n_sensors else blamed
        wrong.sort(key=lambda problem: problem.grade is not Grade.INADEQUATE)
        sensors = tuple(_evidence(plant, record, found, None if blamed else law, blamed))
    return Verdict(overall(wrong), tuple(wrong), sensors, found, looked_at, blamed, reason)


def _evidence(
    plant: Plant,
    record: Sequence[Segment],
    found: Residuals,
    law: Innovations | None,
    blamed: Sequence[str],
) -> Iterator[SensorEvidence]:
    """What the others say of every sensor; sensors that are blamed are not heard."""
    silent = [plant.sensor_names.index(name) for name in blamed]
    record = [(without(plant, y, silent), u) for y, u in record]
    gaps = any(np.isnan(y).any() for y, _ in record)
    steady = steady_state(plant)
    form = law or Innovations(
        plant.A, plant.B, plant.C, plant.D, plant.A @ steady.gain, steady.innovation_cov
    )
    scaled = [(plant.normalise(y), plant.normalise_input(u)) for y, u in record]
    own = np.diag(plant.R) / np.diag(steady.innovation_cov)
    for i, name in enumerate(plant.sensor_names):
        rows = np.arange(plant.m)[plant.channels_of(i)]
        if gaps:
            remains, readings = _left_out_with_gaps(plant, rows, record)
        else:
            remains, readings = left_out(form, rows, scaled), [y[:, rows] for y, _ in scaled]
        skips = [min(WARM_UP, len(part) // 4) for part in remains]
        share, least = explained(
            [part[skip:] for part, skip in zip(remains, skips, strict=True)],
            [part[skip:] for part, skip in zip(readings, skips, strict=True)],
        )
        worst = rows[
            int(np.argmax(np.abs(np.log(np.maximum(np.nan_to_num(found.variance[rows], nan=1.0), 1e-300)))))
        ]
        yield SensorEvidence(
            name=name,
            explained=share,
            explained_least=least,
            verifiable=bool(least >= VERIFIABLE),
            variance=float(found.variance[worst]),
            repeat=float(found.repeat[0, worst]),
            ljung_box=float(found.ljung_box[worst]),
            shift=float(found.shift[worst]),
            noise=float(own[worst]),
        )


def _left_out_with_gaps(
    plant: Plant, rows: NDArray[np.int64], record: Sequence[Segment]
) -> tuple[list[Array], list[Array]]:
    """What the others leave of some channels, by the filter for missing channels; the first samples only."""
    estimator = KalmanFilter(plant)
    remains, readings, seen = [], [], 0
    for y, u in record:
        here = max(0, min(len(y), GAP_SAMPLES - seen))
        if not here:
            break
        seen += here
        others = y[:here].copy()
        others[:, rows] = np.nan
        run = estimator.run(others, u[:here] if plant.n_inputs else None, anywhere(plant), covariance=False)
        predicted = run.x @ plant.C[rows].T + plant.normalise_input(u[:here]) @ plant.D[rows].T
        scaled = plant.normalise(y[:here])[:, rows]
        remains.append(scaled - predicted)
        readings.append(scaled)
    return remains, readings
