"""Recursions without a Python step per sample equal those with one."""

from dataclasses import replace

import numpy as np
import pytest

from securestate._steady_state import doubling
from securestate.identification._scan import Scan, scan
from securestate.identification.forms import Stack, stationary
from tests.identification.identification_cases import random_model
from tests.reference.identification import plain_scan

LENGTHS = [(1,), (1, 1, 1), (2,), (7, 1, 30), (50, 3, 200, 1), (1000,)]


@pytest.mark.parametrize("lengths", LENGTHS)
def test_a_scan_is_the_plain_loop_of_every_segment(lengths: tuple[int, ...]) -> None:
    rng = np.random.default_rng(sum(lengths))
    F, parts = random_model(1, n=3).A, [rng.normal(size=(N, 3)) for N in lengths]
    np.testing.assert_allclose(
        Scan(lengths)(F, np.vstack(parts)), np.vstack([plain_scan(F, g) for g in parts]), atol=1e-12
    )


@pytest.mark.parametrize("lengths", LENGTHS)
def test_backwards_every_segment_begins_at_its_end(lengths: tuple[int, ...]) -> None:
    rng = np.random.default_rng(sum(lengths))
    J, parts = random_model(2, n=3).A, [rng.normal(size=(N, 3)) for N in lengths]
    expected = []
    for g in parts:
        x = [g[-1]]
        for k in range(len(g) - 2, -1, -1):
            x.insert(0, J @ x[0] + g[k])
        expected += x
    stack = Stack([(g, np.zeros((len(g), 0))) for g in parts])
    np.testing.assert_allclose(stack.backwards(J, np.vstack(parts)), expected, atol=1e-12)


def test_a_scan_of_nothing_is_nothing() -> None:
    assert scan(np.eye(2), np.zeros((0, 2))).shape == (0, 2)


@pytest.mark.parametrize("radius", [0.2, 0.9, 0.9999, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_doubling_solves_the_riccati_equation(seed: int, radius: float) -> None:
    model = random_model(seed, n=4, m=2, radius=radius)
    P = doubling(model.A, model.C, model.Q, np.diag(model.r))
    assert P is not None
    S = model.C @ P @ model.C.T + np.diag(model.r)
    after = P - P @ model.C.T @ np.linalg.solve(S, model.C @ P)
    np.testing.assert_allclose(model.A @ after @ model.A.T + model.Q, P, rtol=1e-10, atol=1e-10)
    L = stationary(model).L
    assert np.max(np.abs(np.linalg.eigvals(model.A - model.A @ L @ model.C))) < 1


def test_a_model_without_a_stationary_filter_is_refused() -> None:
    model = random_model(0)
    A = np.diag([1.2, 0.5])
    C = np.array([[0.0, 1.0]] * 3)
    with pytest.raises(np.linalg.LinAlgError, match="no stationary filter"):
        stationary(replace(model, A=A, C=C))
