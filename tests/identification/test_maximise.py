"""The gradient, the steps of EM and of L-BFGS, and what may not change."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate.identification.expectation import Moments, _add_smoothed, expect, expect_with_gaps
from securestate.identification.forms import Independent, Record, Stack, radius, spread
from securestate.identification.maximise import LEAST_PROCESS, Freedom, _m_step, _Task, balanced, maximise
from tests.identification.identification_cases import random_model, record, with_gaps
from tests.reference.identification import conditioned, joint

Array = NDArray[np.float64]
FLOOR = 1e-6


def from_a_known_start(base: Independent, segments: Record) -> Callable[[Independent], Moments]:
    """The exact E-step whose start does not depend on the model, so that Fisher's identity is exact."""
    start = spread(base.A, base.Q)

    def evaluate(model: Independent) -> Moments:
        sums = Moments.none(model)
        for y, u in segments:
            _add_smoothed(model, start, y, u, sums)
        return sums

    return evaluate


def central_differences(task: Callable[[Array], tuple[float, Array]], x: Array, step: float) -> Array:
    return np.array([(task(x + step * e)[0] - task(x - step * e)[0]) / (2 * step) for e in np.eye(len(x))])


def everything(model: Independent) -> Freedom:
    return Freedom.all(model, feedthrough=True)


def some_entries(model: Independent) -> Freedom:
    """A random half of all entries, the noises of states in two blocks."""
    rng = np.random.default_rng(3)
    tables = [rng.random(X.shape) < 0.5 for X in (model.A, model.B, model.C, model.D)]
    blocks = (np.array([0, 2]), np.array([1]))
    return Freedom(*tables, blocks, np.array([True, False, True]))


def blocked(model: Independent) -> Independent:
    """The same, noises of state 1 independent of the others."""
    Q = model.Q.copy()
    Q[1, [0, 2]] = Q[[0, 2], 1] = 0.0
    return replace(model, Q=Q)


@pytest.mark.parametrize("freedom", [everything, some_entries])
@pytest.mark.parametrize("share", [0.0, 0.3])
def test_the_gradient_equals_central_differences(
    freedom: Callable[[Independent], Freedom], share: float
) -> None:
    model = blocked(random_model(1, n=3, m=3, q=2, radius=0.8))
    segments = [(with_gaps(y, share, 1), u) for y, u in (record(model, 15, 2), record(model, 10, 3))]
    task = _Task(model, freedom(model), np.full(3, 0.1), from_a_known_start(model, segments), samples=25)
    x = task.pack() + 0.05 * np.random.default_rng(4).normal(size=len(task.pack()))
    value, slope = task(x)
    assert np.isfinite(value)
    np.testing.assert_allclose(slope, central_differences(task, x, 1e-5), rtol=1e-6, atol=1e-7)


def test_without_gaps_the_gradient_misses_no_more_than_what_the_ends_of_segments_have() -> None:
    """The stationary filter leaves out how start and ends depend on the parameters: a share of 1 / N."""
    model = random_model(1, n=2, m=3, q=1, radius=0.8)
    errors = []
    for N in (200, 2000):
        segments = [record(model, N, 5)]
        stack = Stack(segments)
        task = _Task(model, everything(model), np.full(3, FLOOR), lambda one, s=stack: expect(one, s), N)
        x = task.pack() + 0.1 * np.random.default_rng(6).normal(size=len(task.pack()))
        _, slope = task(x)
        errors.append(
            float(np.linalg.norm(slope - central_differences(task, x, 1e-5)) / np.linalg.norm(slope))
        )
    assert errors[0] < 0.03
    assert errors[1] < 0.2 * errors[0]


def test_packing_and_unpacking_is_the_same_model() -> None:
    model = blocked(random_model(2, n=3))
    task = _Task(model, some_entries(model), np.full(3, FLOOR), lambda one: Moments.none(one), 1)
    again = task.unpack(task.pack())
    for name in "ABCDQr":
        np.testing.assert_allclose(getattr(again, name), getattr(model, name), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("spoil", [np.nan, 1e9, np.inf])
def test_impossible_parameters_cost_more_than_anything(spoil: float) -> None:
    model = random_model(2)
    task = _Task(model, everything(model), np.full(3, FLOOR), lambda one: Moments.none(one), 1)
    x = task.pack()
    x[0] = spoil
    value, slope = task(x)
    assert value == 1e10
    assert not slope.any()


@pytest.mark.parametrize("freedom", [everything, some_entries])
@pytest.mark.parametrize("share", [0.0, 0.4])
def test_an_em_step_never_lowers_the_textbooks_likelihood(
    freedom: Callable[[Independent], Freedom], share: float
) -> None:
    truth = blocked(random_model(4, n=3))
    y, u = record(truth, 40, 7)
    segments = [(with_gaps(y, share, 2), u)]
    model = blocked(random_model(5, n=3))
    evaluate, start = from_a_known_start(model, segments), spread(model.A, model.Q)
    values = []
    for _ in range(8):
        values.append(conditioned(joint(model, u, np.zeros(3), start), segments[0][0])[1])
        model = _m_step(model, evaluate(model), freedom(model), np.full(3, FLOOR))
    assert np.all(np.diff(values) > 0)
    assert values[-1] - values[0] > 1


@pytest.mark.parametrize("gaps", [False, True])
def test_likelihoods_never_fall_and_the_last_is_that_of_the_model(gaps: bool) -> None:
    truth = random_model(6, radius=0.9)
    y, u = record(truth, 150, 8)
    segments = [(with_gaps(y, 0.2 if gaps else 0.0, 3), u)]
    start = replace(random_model(7), D=np.zeros((3, 1)))
    fit = maximise(start, segments, everything(start), np.full(3, FLOOR), em=4, steps=12, gaps=gaps)
    assert len(fit.likelihoods) > 8
    assert np.all(np.diff(fit.likelihoods) >= 0)
    assert fit.likelihoods[-1] > fit.likelihoods[0] + 0.5
    found = expect_with_gaps(fit.model, segments) if gaps else expect(fit.model, Stack(segments))
    assert found.likelihood / 150 == pytest.approx(fit.likelihoods[-1], abs=1e-6)


def test_what_is_not_free_stays() -> None:
    model = blocked(random_model(8, n=3))
    freedom = some_entries(model)
    fit = maximise(model, [record(random_model(9, n=3), 100, 9)], freedom, np.full(3, FLOOR), em=2, steps=5)
    for name in "ABCDr":
        fixed = ~getattr(freedom, name)
        # Rows of C and D are divided by their sensor's noise and multiplied again.
        np.testing.assert_allclose(getattr(fit.model, name)[fixed], getattr(model, name)[fixed], rtol=1e-15)
        assert np.any(getattr(fit.model, name)[~fixed] != getattr(model, name)[~fixed])
    assert not fit.model.Q[1, [0, 2]].any()
    assert np.all(np.linalg.eigvalsh(fit.model.Q) >= 0.99 * LEAST_PROCESS)


def test_noises_never_fall_below_their_floor_and_a_stays_within_its_limit() -> None:
    truth = replace(random_model(10, radius=0.99), r=np.full(3, 1e-4))
    segments = [record(truth, 200, 10)]
    start, floor = random_model(11), np.array([0.3, 1e-6, 0.5])
    freedom = replace(everything(start), limit=0.9)
    fit = maximise(start, segments, freedom, floor, em=5, steps=30)
    assert np.all(fit.model.r >= floor)
    assert radius(fit.model.A) <= 0.9 + 1e-9


def test_balancing_changes_coordinates_only() -> None:
    model = random_model(12)
    found = balanced(model)
    np.testing.assert_allclose(spread(found.A, found.Q), np.eye(2), atol=1e-9)
    segments = [record(model, 100, 12)]
    assert expect(found, Stack(segments)).likelihood == pytest.approx(
        expect(model, Stack(segments)).likelihood, rel=1e-9
    )
