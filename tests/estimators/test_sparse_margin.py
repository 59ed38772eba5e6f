"""Margins of sparse fusion: the golden ratios, and lies that do in simulation what the margin says."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from securestate import (
    DesignError,
    InnovationMixture,
    InputError,
    InsecureWarning,
    KalmanFilter,
    MixtureFusion,
    Plant,
    Sensor,
    SparseFusion,
)
from securestate.resilience import FusionMargin
from tests.estimators.sparse_cases import liu

Array = NDArray[np.float64]
GOLDEN = json.loads((Path(__file__).parent.parent / "cases" / "resilience" / "golden.json").read_text())[
    "liu"
]
NAMES = liu().sensor_names


def paper(gamma: float = 0.75) -> SparseFusion:
    with pytest.warns(InsecureWarning, match=r"s2 has the margin rho = 1\.69"):
        return SparseFusion(liu(), form="paper", gamma=gamma)


def error(estimator: SparseFusion, margin: FusionMargin, size: float, steps: int = 80) -> float:
    """Largest error of a state at the last sample; the true state is zero, the noise always the same."""
    assert margin.lie is not None
    plant = estimator.plant
    noise = np.random.default_rng(0).standard_normal((steps, plant.m)) @ np.linalg.cholesky(plant.R).T
    y = noise + margin.lie.readings(steps, size)
    u = np.zeros((steps, plant.n_inputs)) if plant.n_inputs else None
    return float(np.abs(estimator.run(y, u).x[-1]).max())


def test_ratios_of_theorem_4_are_those_of_the_paper_form() -> None:
    ratios = [paper().margin([name]) for name in NAMES]
    np.testing.assert_allclose([r.lower for r in ratios], [0.431, 1.687, 1.146, 0.758, 0.438], atol=5e-4)
    np.testing.assert_allclose([r.upper for r in ratios], [r.lower for r in ratios], rtol=2e-3)
    pair = paper().margin(2)
    assert pair.lower == pytest.approx(6.265, abs=5e-4)
    assert paper().margin(1).sensors == ("s2",)


def test_ratios_of_the_robust_form_are_golden() -> None:
    estimator = SparseFusion(liu())
    ratios = [estimator.margin([name]) for name in NAMES]
    np.testing.assert_allclose([r.lower for r in ratios], GOLDEN["rho_Nii_p1"], rtol=1e-5)
    np.testing.assert_allclose([r.upper for r in ratios], GOLDEN["rho_Nii_p1"], rtol=1.1e-3)
    for pair, ratio in GOLDEN["rho_Nii_p2"].items():
        chosen = [NAMES[int(i) - 1] for i in pair.strip("[]").split(",")]
        np.testing.assert_allclose(estimator.margin(chosen).lower, ratio, rtol=1e-4)
    worst = estimator.margin(2)
    assert worst.lower == pytest.approx(GOLDEN["rho_Nii_p2_max"], rel=1e-5)
    assert set(worst.sensors) == {"s2", "s3"}


@pytest.mark.parametrize("name", ["s2", "s3"])
def test_the_worst_lie_breaks_the_paper_form_and_not_the_default(name: str) -> None:
    breaking = paper().margin([name])
    assert breaking.verdict == "insecure"
    grown = [error(paper(), breaking, size) for size in (1e2, 1e4, 1e6)]
    assert grown[1] > 50 * grown[0]
    assert grown[2] > 50 * grown[1]
    default = SparseFusion(liu())
    for margin in (breaking, default.margin([name])):
        assert max(error(default, margin, size) for size in (1e2, 1e4, 1e6)) < 5


@pytest.mark.parametrize("refit", [True, False])
@pytest.mark.parametrize("seed", range(10))
def test_a_lie_moves_the_estimate_without_bound_if_and_only_if_the_margin_says_so(
    seed: int, refit: bool
) -> None:
    plant = lasting_plant(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InsecureWarning)
        estimator = SparseFusion(plant, refit=refit)
    decided = 0
    for attacked in (1, 2, 3):
        margin = estimator.margin(attacked)
        if margin.verdict == "undecided" or 0.9 < margin.lower < 1.1:
            continue
        decided += 1
        small, large = error(estimator, margin, 1e4), error(estimator, margin, 1e6)
        if margin.verdict == "secure":
            assert large < 2 * small + 10, (attacked, margin)
        else:
            assert large > 30 * small, (attacked, margin)
    assert decided


def lasting_plant(seed: int) -> Plant:
    """Distinct modes that do not fade, 2 or 3 of them, and one that does; 6 to 8 sensors."""
    rng = np.random.default_rng(seed)
    values = np.array([*[1.0, -1.0, 1.02][: 2 + seed % 2], 0.7])
    n, sensors = len(values), 6 + seed % 3
    T = np.linalg.qr(rng.standard_normal((n, n)))[0]
    C = rng.standard_normal((sensors, n)) * 10.0 ** rng.uniform(-0.3, 0.3, (sensors, 1))
    gauges = [Sensor(f"s{i}", C=row, R=1.0) for i, row in enumerate(C)]
    return Plant(T @ np.diag(values) @ T.T, 0.1 * np.eye(n), gauges)


def test_what_is_secure_is_proved_twice() -> None:
    proved = 0
    for seed in range(10):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InsecureWarning)
            margin = SparseFusion(lasting_plant(seed)).margin(1)
        assert (
            margin.lower <= margin.upper <= margin.factor + 1e-12
        )  # the search is never above the factorisation
        proved += margin.factor < 1
    assert proved >= 5
    np.testing.assert_allclose(
        [SparseFusion(liu()).margin([name]).factor for name in NAMES],
        GOLDEN["rho_Nii_p1_factor_bound"],
        rtol=0.05,
    )


def test_protected_sensors_are_never_among_the_attacked() -> None:
    plant = liu().with_protected([1, 2])
    estimator = SparseFusion(plant)
    assert not set(estimator.margin(2).sensors) & {"s2", "s3"}
    assert estimator.margin(2).lower < SparseFusion(liu()).margin(2).lower
    assert estimator.margin(9).attacked == 3


def test_a_plant_without_lasting_modes_is_bounded_whoever_lies() -> None:
    sensors = [Sensor(name, C=[1.0], R=1.0) for name in "abc"]
    margin = SparseFusion(Plant([[0.9]], [[1.0]], sensors)).margin(3)
    assert (margin.verdict, margin.upper, margin.lie) == ("secure", 0.0, None)


def test_a_mode_that_one_sensor_sees_has_no_margin() -> None:
    sensors = [Sensor("lone", C=[1.0, 0.0], R=1.0)] + [Sensor(name, C=[0.0, 1.0], R=1.0) for name in "abc"]
    with pytest.warns(InsecureWarning, match=r"lone has the margin rho = inf"):
        estimator = SparseFusion(Plant(np.eye(2), np.eye(2), sensors))
    margin = estimator.margin(1)
    assert (margin.verdict, margin.sensors, margin.lower) == ("insecure", ("lone",), np.inf)
    assert error(estimator, margin, 1e6) > 1e5
    other = estimator.margin(["a"])
    assert other.lower == pytest.approx(0.5)
    assert error(estimator, other, 1e6) < 10


def test_a_plant_on_which_nobody_can_be_checked_is_refused() -> None:
    sensors = [Sensor("a", C=[1.0, 0.0], R=1.0), Sensor("b", C=[0.0, 1.0], R=1.0)]
    with pytest.raises(DesignError, match=r"would not even show.*use KalmanFilter"):
        SparseFusion(Plant(np.eye(2), np.eye(2), sensors))


@pytest.mark.parametrize("method", [InnovationMixture, MixtureFusion])
def test_methods_that_judge_sensors_by_each_other_warn_where_nobody_could(method: type) -> None:
    two = [Sensor(name, C=[1.0], R=1.0) for name in ("gauge", "probe")]
    with pytest.warns(
        InsecureWarning, match=r"mode 1 \(x1\) does not fade and is seen by 2 sensors, gauge and probe"
    ):
        method(Plant([[1.0]], [[1.0]], two))
    three = [*two, Sensor("third", C=[1.0], R=1.0)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        method(Plant([[1.0]], [[1.0]], three))
        method(Plant([[0.9]], [[1.0]], two))
        KalmanFilter(Plant([[1.0]], [[1.0]], two))


def test_what_is_not_a_number_or_names_of_sensors_is_refused() -> None:
    estimator = SparseFusion(liu())
    with pytest.raises(
        InputError, match=r"attacked: expected names of sensors of the plant, or how many lie"
    ):
        estimator.margin(["sensor 9"])
    with pytest.raises(InputError, match=r"attacked: expected a whole number >= 0, received -1"):
        estimator.margin(-1)


def test_a_mode_that_one_sensor_sees_has_no_margin_in_any_coordinates() -> None:
    for seed in range(40):
        rng = np.random.default_rng(seed)
        T = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        rows = np.column_stack([rng.choice([-2.0, -1.0, 1.0, 2.0], (5, 2)), np.zeros(5)])
        rows[0, 2] = 1.0  # only the first sensor sees the third mode
        sensors = [
            Sensor(f"s{i}", C=row @ T.T, R=float(10 ** rng.uniform(-1, 1))) for i, row in enumerate(rows)
        ]
        with pytest.warns(InsecureWarning, match="s0"):
            estimator = SparseFusion(Plant(T @ np.diag([1.0, 1.02, 1.0]) @ T.T, 0.1 * np.eye(3), sensors))
        assert estimator.margin(1).verdict == "insecure"
        assert estimator.margin(np.int64(1)).sensors == ("s0",)
