"""What docs/decisions.md says about a penalty per sensor and mode holds on a plant of the bench."""

import numpy as np
import pytest

from benches._modal_cases import liu, modal_ratio, moving, random_plant, worst
from benches._modal_form import Modal, flat_modes
from benches.modal import STEPS, Rivals
from securestate import SparseFusion


def test_every_mode_is_one_coordinate() -> None:
    plant = random_plant(np.random.default_rng(4))
    form = Modal(plant)
    parts = form.parts
    for i in range(plant.m):
        for j, (mu, w) in enumerate(flat_modes(parts)):
            columns = [g for g in form.groups if g.sensor == i]
            at = np.cumsum([0] + [g.size for g in columns])
            own = next(k for k, g in enumerate(columns) if g.mode == j)
            seen = parts.G[i] @ w[:, 0]
            elements = form.axes.S_inverse[i] @ seen
            assert np.allclose(form.axes.S[i] @ elements, seen, atol=1e-8)
            others = np.delete(elements, np.arange(at[own], at[own + 1]))
            assert np.abs(others).max() < 1e-7 * np.abs(elements).max()
            assert mu.imag or abs(elements[at[own]]) == pytest.approx(columns[own].seen)


def test_the_penalties_keep_the_kalman_estimate_as_often_as_asked() -> None:
    plant = random_plant(np.random.default_rng(4))
    rivals = Rivals(plant, 2, 1)
    assert rivals.honest()["modal"][0] > 0.93


def test_counting_is_not_enough_where_a_mode_has_two_directions() -> None:
    plant = liu()
    parts = SparseFusion(plant).decomposition
    assert worst(plant, parts, 1)[0] == pytest.approx(0.609, abs=1e-3)
    assert modal_ratio(plant, parts, 1) == pytest.approx(0.507, abs=1e-3)


def test_the_default_gives_in_before_the_limit_and_the_mode_wise_form_does_not() -> None:
    plant = random_plant(np.random.default_rng(4))
    parts, counts = SparseFusion(plant).decomposition, Modal(plant).counts
    liars = (min(counts) - 1) // 2
    ratio, u, size = worst(plant, parts, liars)
    assert ratio > 1 > modal_ratio(plant, parts, liars)
    who = np.argsort(-size)[:liars]
    lie = moving(plant, parts, who, u, STEPS)
    rivals = Rivals(plant, liars, 1)
    small, large = (rivals.errors(who, scale * lie) for scale in (1e4, 1e6))
    assert large["default"] == pytest.approx(1e4 * small["default"], rel=0.1)  # the square of the lie
    assert large["modal"] < 1.5
    assert large["fewest, modal"] < 1.5
