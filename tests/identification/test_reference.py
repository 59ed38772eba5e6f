"""Every step against golden numbers of an independent implementation."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate import identify
from securestate.identification.expectation import expect
from securestate.identification.forms import (
    Independent,
    Innovations,
    Predictor,
    Stack,
    innovations_of,
    log_density,
    stationary,
)
from securestate.identification.independent import independent_of
from securestate.identification.lags import lag_moments, past_length
from securestate.identification.order import score
from securestate.identification.prepare import rounding
from securestate.identification.redundancy import left_out
from securestate.identification.residuals import residuals
from securestate.identification.subspace import Subspace
from tests.identification.identification_cases import golden, model_of, record

Array = NDArray[np.float64]
GOLDEN = golden("reference.json")
RECORD = [(part["y"], part["u"]) for part in GOLDEN["record"]]


def assert_close(got: Any, expected: Any, tolerance: float = 1e-8) -> None:
    """Equal relative to the largest number."""
    np.testing.assert_allclose(got, expected, rtol=0, atol=tolerance * np.max(np.abs(expected)))


def markov(A: Array, C: Array, G: Array) -> Array:
    """C A^i G, i = 0..4."""
    return np.array([C @ np.linalg.matrix_power(A, i) @ G for i in range(5)])


def innovations() -> Innovations:
    return Innovations(**GOLDEN["innovations"])


def test_moments_over_lags_are_the_reference() -> None:
    expected = GOLDEN["moments"]
    M, samples = lag_moments(RECORD, expected["p"])
    assert samples == expected["samples"]
    assert_close(M, expected["average"], 1e-12)


@pytest.mark.parametrize("case", GOLDEN["past"])
def test_the_length_of_the_past_is_the_reference(case: dict[str, Any]) -> None:
    assert past_length(RECORD, case["longest"], case["feedthrough"]) == case["length"]


@pytest.mark.parametrize("case", GOLDEN["subspace"], ids=lambda case: f"past {case['p']}, order {case['n']}")
def test_the_subspace_model_is_the_reference_up_to_coordinates(case: dict[str, Any]) -> None:
    subspace = Subspace(RECORD, case["p"], case["feedthrough"])
    form = subspace.model(case["n"])
    real, imaginary = case["eigenvalues"]
    assert_close(subspace.values[:4], case["singular_values"])
    assert_close(np.sort_complex(np.linalg.eigvals(form.A)), real + 1j * imaginary)
    np.testing.assert_allclose(form.D, case["D"], rtol=0, atol=1e-8)
    assert_close(form.S, case["S"])
    assert_close(markov(form.A, form.C, form.K), case["of_noise"])
    assert_close(markov(form.A, form.C, form.B), case["of_input"])


def test_the_nearest_independent_noises_are_the_reference() -> None:
    found = independent_of(innovations())
    assert_close(found.Q, GOLDEN["independent"]["Q"])
    assert_close(found.r, GOLDEN["independent"]["r"])


def test_the_stationary_filter_is_the_reference() -> None:
    expected = GOLDEN["expectation"]
    steady = stationary(Independent(**expected["model"]))
    assert_close(steady.P, expected["P"], 1e-10)
    assert_close(steady.S, expected["S"], 1e-10)
    assert_close(steady.L, expected["gain"], 1e-10)


def test_the_e_step_is_the_reference() -> None:
    expected = GOLDEN["expectation"]
    found = expect(Independent(**expected["model"]), Stack(RECORD))
    assert (found.transitions, found.samples) == (expected["transitions"], expected["samples"])
    np.testing.assert_allclose(found.likelihood, expected["likelihood"], rtol=1e-10)
    for name in ("zz", "zx", "xx", "gg", "gy", "yy"):
        assert_close(getattr(found, name), expected[name])


@pytest.mark.parametrize("channel", range(3))
def test_what_the_others_leave_of_a_channel_is_the_reference(channel: int) -> None:
    expected = GOLDEN["left_out"]
    remains = left_out(innovations(), np.array([channel]), RECORD[: expected["segment"] + 1])
    assert_close(remains[-1][expected["from"] :, 0], expected["remains"][channel])


def test_the_log_density_is_the_reference() -> None:
    assert_close(log_density(RECORD[0][0][:5], innovations().S), GOLDEN["log_density"], 1e-12)


def test_the_step_of_rounded_readings_is_the_reference() -> None:
    first, second = RECORD[0][0][:, 0], RECORD[0][0][:, 1]
    columns = (np.round(first / 0.25) * 0.25, first, np.round(second, 1))
    np.testing.assert_allclose([rounding(column) for column in columns], GOLDEN["rounding"], rtol=1e-10)


@pytest.mark.parametrize("case", golden("systems.json"), ids=lambda case: f"n = {len(case['A'])}")
def test_a_random_plant_is_learned_as_well_as_the_reference_learned_it(case: dict[str, Any]) -> None:
    """On another sample of 5,000 learned and 5,000 judged, so that the bounds leave room for chance.

    The reference had sizes of .996 to 1.022, likelihoods .0007 to .0091 below the truth's, eigenvalues off by
    up to .018 (.038 on the sample of order 3 here), and losses of up to .09 points.
    """
    truth = truth_of(case)
    y, u = record(truth, 10_000, case["seed"])
    found = identify(y[:5000], u[:5000] if u.size else None, order=truth.n)
    plant, fresh = found.plant, (y[5000:], u[5000:])
    assert 0.97 < residuals(plant, [fresh]).size < 1.03
    learned = [(plant.normalise(fresh[0]), plant.normalise_input(fresh[1]))]
    units = np.sum(np.log(plant.scale))
    lost = score(truth, [fresh]).mean() - (score(model_of(plant), learned).mean() - units)
    assert lost < 0.02
    sizes = [np.sort(np.abs(np.linalg.eigvals(A))) for A in (plant.A, truth.A)]
    assert np.max(np.abs(sizes[0] - sizes[1])) < 0.05
    true, own = (explained(model, part) for model, part in ((truth, [fresh]), (model_of(plant), learned)))
    assert np.max(true - own) < 0.003


def truth_of(case: dict[str, Any]) -> Independent:
    B = case["B"].reshape(len(case["A"]), -1)
    return Independent(case["A"], B, case["C"], np.zeros((len(case["C"]), B.shape[1])), case["Q"], case["r"])


def explained(model: Independent, part: list[tuple[Array, Array]]) -> Array:
    """Share of every channel's variance that is predicted one step ahead."""
    e, _ = Predictor(innovations_of(model))(Stack(part))
    return 1 - e[100:].var(axis=0) / part[0][0][100:].var(axis=0)
