"""Maximum likelihood for a plant that is known in part: entries that are known stay, the others are
fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from securestate._threads import one_blas_thread
from securestate.errors import DesignError, InputError, MeasurementError, PlantError
from securestate.identification.assemble import with_matrices
from securestate.identification.expectation import expect, expect_with_gaps
from securestate.identification.forms import EDGE, Independent, Segment, radius, spread
from securestate.identification.history import History
from securestate.identification.judge import fitting
from securestate.identification.maximise import Freedom, maximise
from securestate.identification.prepare import split
from securestate.plant import Plant

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Share of the history, its end, that decides whether the fit helps, if there is no other record.
KEPT_BACK = 0.25

#: Least variance of a sensor's noise, as a share of what it is in the plant given.
LEAST_NOISE = 1e-6

MATRICES = ("A", "B", "C", "D", "Q", "R")


@final
@dataclass(frozen=True, eq=False)
class Refined:
    """A refined plant.

    Attributes:
        plant: the refined one, or the one given if that predicts the samples kept back better.
        improved: whether it is the refined one.
        before, after: log-likelihood in nats per sample kept back, of the plant given and of the refined one.
        likelihoods: the same of the samples fitted, over the steps of the fit; they never fall.
    """

    plant: Plant
    improved: bool
    before: float
    after: float
    likelihoods: tuple[float, ...]

    def __str__(self) -> str:
        gain = f"{self.before:.4g} to {self.after:.4g} nats per sample kept back"
        if self.improved:
            return f"Refined: from {gain}."
        return f"Not refined: the fit went from {gain}, so the plant is the one given."


def refine(
    plant: Plant,
    y: object,
    u: object = None,
    *,
    free: Mapping[str, ArrayLike | bool] | Sequence[str] = ("Q", "R"),
    held_out: object = None,
    held_out_u: object = None,
    steps: int = 150,
    progress: Callable[[int, int], None] | None = None,
) -> Refined:
    """Fit what is not known of a plant to a record in which no sensor lied, by maximum likelihood.

    Args:
        plant: does not vary in time; the noises of its channels do not depend on each other.
        y, u: the record, as for `judge`; NaN in y is missing.
        free: names of matrices to be fitted, among A, B, C, D, Q and R; or by name True, or a table of True
            where
            an entry is free, in the matrix's shape, the plant's channels and states in its order. Every other
            entry stays exactly as it is. Q is free in blocks of states: within one all entries, between them
            none; for variances alone give a diagonal table. R is free on its diagonal.
        held_out, held_out_u: another record, which decides whether the fit helps. Default: the last quarter
            of y,
            which is not fitted then.
        steps: of the quasi-Newton method at most, after five of EM.
        progress: called with steps done and steps at most.
    Returns:
        The better plant of the two, by the samples kept back: never a worse one.
    Raises:
        InputError: names `free` if a matrix is unknown or a table does not fit.
        DesignError: the plant has no stationary filter.
        PlantError: the noises of channels depend on each other.
        ShapeError, MeasurementError: the record does not fit the plant, or is too short.
    References:
        shumway1982; the gradient after segal1989.

    Examples:
        >>> from securestate import Plant, Sensor
        >>> rng = np.random.default_rng(1)
        >>> x = np.zeros((2000, 2))
        >>> for k in range(1, 2000):
        ...     x[k] = [[1, 1], [0, 0.9]] @ x[k - 1] + [0, rng.normal(scale=0.3)]
        >>> y = x[:, :1] + rng.normal(size=(2000, 1))
        >>> guess = Plant([[1, 1], [0, 0.9]], [[0, 0], [0, 1]], [Sensor("position", C=[1, 0], R=0.2)])
        >>> found = refine(guess, y, free={"Q": [[False, False], [False, True]], "R": True})
        >>> print(found.improved, found.plant.Q.round(2).tolist(), found.plant.R.round(1))
        True [[0.0, 0.0], [0.0, 0.09]] [[1.]]
    """
    if not isinstance(plant, Plant):
        raise InputError("plant", "a Plant", type(plant).__name__)
    freedom = _freedom(plant, free)
    record = _scaled(plant, fitting(plant, History.of(y, u)))
    if held_out is None:
        record, kept = split(record, KEPT_BACK)
    else:
        kept = _scaled(plant, fitting(plant, History.of(held_out, held_out_u)))
    if not record or not kept:
        raise MeasurementError(
            "y", "enough samples to fit and to judge", f"{sum(len(part) for part, _ in record)}"
        )
    model = Independent(plant.A, plant.B, plant.C, plant.D, plant.Q, np.diag(plant.R))
    size = np.sqrt(np.maximum(np.diag(spread(model.A, model.Q + model.B @ model.B.T)), 1e-300))
    with one_blas_thread():
        try:
            fit = maximise(
                model.turned(np.diag(size)),
                record,
                freedom,
                LEAST_NOISE * model.r,
                steps=steps,
                gaps=_gaps(record),
                progress=progress,
            )
            found = fit.model.turned(np.diag(1 / size))
            before, after = (_likelihood(each, kept) for each in (model, found))
        except np.linalg.LinAlgError as reason:
            raise DesignError(
                f"the plant has no stationary filter ({reason})", "see `securestate plant check`"
            ) from None
    improved = after > before
    exact = _kept_exactly(model, found, freedom)
    return Refined(
        with_matrices(plant, exact) if improved else plant, improved, before, after, fit.likelihoods
    )


def _scaled(plant: Plant, history: History) -> list[Segment]:
    return [(plant.normalise(y), plant.normalise_input(u)) for y, u in history.segments]


def _gaps(record: Sequence[Segment]) -> bool:
    return any(np.isnan(y).any() for y, _ in record)


def _likelihood(model: Independent, record: Sequence[Segment]) -> float:
    heard = (expect_with_gaps if _gaps(record) else expect)(model, record)
    return heard.likelihood / heard.samples


def _kept_exactly(model: Independent, found: Independent, freedom: Freedom) -> Independent:
    """What was fitted where it is free, and every other entry to the bit as it was."""
    Q = model.Q.copy()
    for block in freedom.blocks:
        Q[np.ix_(block, block)] = found.Q[np.ix_(block, block)]
    pairs = {name: (getattr(model, name), getattr(found, name), getattr(freedom, name)) for name in "ABCDr"}
    parts = {name: np.where(free, new, old) for name, (old, new, free) in pairs.items()}
    return Independent(**parts, Q=Q)


def _freedom(plant: Plant, free: Mapping[str, ArrayLike | bool] | Sequence[str]) -> Freedom:
    """Which entries may change."""
    if plant.time_varying:
        raise DesignError("the plant varies in time", "fit one that does not")
    if np.any(np.diag(np.diag(plant.R)) != plant.R):
        raise PlantError(
            "plant", "channels whose noises do not depend on each other", "an R that couples channels"
        )
    asked = dict(free) if isinstance(free, Mapping) else dict.fromkeys(free, True)
    for name in asked:
        if name not in MATRICES:
            raise InputError("free", f"names among {', '.join(MATRICES)}", repr(name))
    tables = {name: _table(name, asked.get(name, False), getattr(plant, name).shape) for name in MATRICES}
    if not any(table.any() for table in tables.values()):
        raise InputError("free", "at least one entry that may change", "none")
    limit = max(EDGE, radius(plant.A) + 1e-6)
    A, B, C, D = (tables[name] for name in "ABCD")
    return Freedom(
        A, B, C, D, _blocks(plant.Q, tables["Q"]), np.diag(tables["R"]).copy(), limit, own_coordinates=True
    )


def _table(name: str, value: ArrayLike | bool, shape: tuple[int, ...]) -> Flags:
    if isinstance(value, bool | np.bool_):
        return np.full(shape, bool(value))
    table = np.asarray(value)
    if table.dtype != np.bool_ or table.shape != shape:
        raise InputError(
            f"free[{name!r}]", f"True, False or such a table of shape {shape}", f"{table.dtype} {table.shape}"
        )
    return table


def _blocks(Q: Array, free: Flags) -> tuple[NDArray[np.int64], ...]:
    """States whose noises are free together; refuses what is not a set of blocks.

    Raises:
        InputError: a table that is not symmetric, or not whole blocks with zeros around them.
    """
    if np.any(free != free.T):
        raise InputError("free['Q']", "a symmetric table", "another one")
    blocks: list[NDArray[np.int64]] = []
    for i in np.flatnonzero(np.diag(free)):
        if any(i in block for block in blocks):
            continue
        block = np.flatnonzero(free[i])
        around = np.setdiff1d(np.arange(len(Q)), block)
        if not free[np.ix_(block, block)].all() or np.any(Q[np.ix_(block, around)]):
            raise InputError(
                "free['Q']",
                "whole blocks of states, with zeros in Q around them",
                f"something else at state {i + 1}",
            )
        blocks.append(block.astype(np.int64))
    if int(free.sum()) != sum(len(block) ** 2 for block in blocks):
        raise InputError("free['Q']", "whole blocks of states", "entries outside of them")
    return tuple(blocks)
