"""KalmanFilter against independent libraries, against the textbook and against itself."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from statsmodels.tsa.statespace.kalman_filter import KalmanFilter as StatsmodelsFilter

from securestate import Belief, InputError, MeasurementError, Plant, ResumeError, Sensor, ShapeError
from securestate.estimators import KalmanFilter, Run, Status
from tests.estimators.kalman_cases import random_data, random_plant, some_prior
from tests.reference.kalman import Textbook, textbook_filter

Array = NDArray[np.float64]
CASES = Path(__file__).parent.parent / "cases" / "kalman"
NAMES = ("building", "ieee14", "ieee39", "feedthrough")
TOLERANCE = 1e-9


def golden(name: str) -> dict[str, Array]:
    with np.load(CASES / f"{name}.npz") as data:
        return dict(data)


def plant_of(data: dict[str, Array]) -> Plant:
    sensors = [Sensor(f"s{i}", C=row) for i, row in enumerate(data["C"])]
    return Plant(data["A"], data["Q"], sensors, R=data["R"], B=data["B"], D=data["D"])


def assert_close(got: Array, expected: Array, tolerance: float = TOLERANCE) -> None:
    """Equal relative to the largest number; NaN in the same places."""
    size = np.nanmax(np.abs(expected), initial=0.0)
    np.testing.assert_allclose(got, expected, rtol=0, atol=tolerance * size)


def textbook(plant: Plant, y: Array, u: Array, prior: Belief) -> Textbook:
    assert prior.P is not None
    return textbook_filter(plant, y, u, prior.x, prior.P)


def assert_equals_textbook(run: Run, book: Textbook) -> None:
    assert run.P is not None
    assert_close(run.x, book.x)
    assert_close(run.P, book.P)
    assert_close(run.innovation, book.innovation)
    assert_close(run.innovation_std, book.innovation_std)
    assert_close(run.diagnostics["log_likelihood"], book.log_likelihood)
    assert_close(run.diagnostics["nis"], book.nis)


@pytest.mark.parametrize("name", NAMES)
def test_equals_statsmodels_and_filterpy(name: str) -> None:
    data = golden(name)
    plant = plant_of(data)
    run = KalmanFilter(plant).run(data["Y"], data["U"], Belief(data["x0"], data["P0"]))
    assert run.P is not None
    predicted = np.vstack([data["x0"], run.x[:-1] @ plant.A.T + data["U"][:-1] @ plant.B.T])
    assert_close(predicted, data["sm_predicted"])
    assert_close(run.innovation, data["sm_innov"])
    assert_close(run.P[-1], data["sm_filtered_cov_last"])
    assert_close(run.P[-1], data["fp_cov_last"])
    for column in ("sm_filtered", "fp_filtered"):
        assert_close(run.x, data[column])
    for column in ("sm_llf_obs", "fp_ll"):
        np.testing.assert_allclose(run.diagnostics["log_likelihood"], data[column], rtol=TOLERANCE)


@pytest.mark.parametrize("name", ["ieee14", "ieee39", "feedthrough"])
def test_steady_state_equals_scipys_riccati_solution(name: str) -> None:
    data = golden(name)
    steady = KalmanFilter(plant_of(data)).steady
    assert steady is not None
    assert_close(steady.P_prior, data["P_dare"])
    assert_close(steady.gain, data["K_upd_dare"])


def statsmodels_filter(data: dict[str, Array], y: Array) -> Any:
    filter = StatsmodelsFilter(k_endog=y.shape[1], k_states=len(data["x0"]), tolerance=0)
    filter.bind(np.asfortranarray(y.T))
    filter["design"], filter["obs_cov"], filter["transition"] = data["C"], data["R"], data["A"]
    filter["selection"], filter["state_cov"] = np.eye(len(data["x0"])), data["Q"]
    filter["state_intercept"], filter["obs_intercept"] = data["B"] @ data["U"].T, data["D"] @ data["U"].T
    filter.initialize_known(data["x0"], data["P0"])
    return filter.filter()


@pytest.mark.parametrize("name", NAMES)
def test_partly_missing_samples_equal_statsmodels(name: str) -> None:
    data = golden(name)
    y = data["Y"][:40].copy()
    data["U"] = data["U"][:40]
    rng = np.random.default_rng(5)
    y[rng.random(y.shape) < 0.3] = np.nan
    y[20:24] = np.nan
    run = KalmanFilter(plant_of(data)).run(y, data["U"], Belief(data["x0"], data["P0"]))
    oracle = statsmodels_filter(data, y)
    assert run.P is not None
    assert_close(run.x, oracle.filtered_state.T)
    assert_close(run.P, np.moveaxis(oracle.filtered_state_cov, -1, 0))
    np.testing.assert_allclose(run.diagnostics["log_likelihood"], oracle.llf_obs, rtol=TOLERANCE, atol=1e-9)


@pytest.mark.parametrize("missing", [0.0, 0.2, 0.8])
@pytest.mark.parametrize("seed", range(4))
def test_correlated_noise_with_missing_channels_equals_the_textbook(seed: int, missing: float) -> None:
    plant = random_plant(seed)
    (y, u), prior = random_data(plant, 120, seed, missing=missing), some_prior(plant)
    assert_equals_textbook(KalmanFilter(plant).run(y, u, prior), textbook(plant, y, u, prior))


@pytest.mark.parametrize("varying", ["A", "C", "AC"])
def test_time_varying_plant_equals_the_textbook(varying: str) -> None:
    plant, T, rng = random_plant(3), 60, np.random.default_rng(3)
    A = plant.A + 0.1 * rng.normal(size=(T, 4, 4)) if "A" in varying else plant.A
    C = plant.C + 0.5 * rng.normal(size=(T, 6, 4)) if "C" in varying else plant.C
    sensors = [Sensor(f"s{i}", C=C[..., 2 * i : 2 * i + 2, :]) for i in range(3)]
    varied = Plant(A, plant.Q, sensors, B=plant.B, D=plant.D, R=plant.R)
    (y, u), prior = random_data(varied, T, 3, missing=0.2), some_prior(varied)
    assert_equals_textbook(KalmanFilter(varied).run(y, u, prior), textbook(varied, y, u, prior))


def test_batch_of_a_time_varying_plant_equals_its_runs() -> None:
    plant, T = random_plant(3), 30
    varied = Plant(
        np.repeat(plant.A[None], T, axis=0), plant.Q, plant.sensors, B=plant.B, D=plant.D, R=plant.R
    )
    (y, u), prior = random_data(plant, T, 3), some_prior(plant)
    batch = KalmanFilter(varied).run(np.stack([y, -y]), u, prior)
    np.testing.assert_array_equal(batch.x[1], KalmanFilter(varied).run(-y, u, prior).x)


def test_a_step_beyond_the_horizon_is_refused() -> None:
    plant = Plant(np.ones((3, 1, 1)), [[1.0]], [Sensor("s", C=[1.0], R=1.0)])
    estimator, prior = KalmanFilter(plant), Belief([0.0], [[1.0]])
    live = estimator.start(prior)
    for _ in range(3):
        live.step([0.0])
    with pytest.raises(MeasurementError, match="at most 3 samples"):
        live.step([0.0])
    with pytest.raises(MeasurementError, match="at most 3 samples"):
        estimator.run(np.zeros((2, 4, 1)), prior=prior)


def test_gains_that_settled_return_after_a_gap_and_still_equal_the_textbook() -> None:
    plant = random_plant(1, radius=0.6)
    y, u = random_data(plant, 900, 1)
    y[400:403] = np.nan
    y[600, 2] = np.nan
    prior = some_prior(plant)
    run = KalmanFilter(plant).run(y, u, prior)
    assert run.P is not None
    assert_equals_textbook(run, textbook(plant, y, u, prior))
    assert np.array_equal(run.P[398], run.P[399])  # settled, left and settled again
    assert not np.array_equal(run.P[399], run.P[403])
    assert np.array_equal(run.P[598], run.P[599])


def test_steady_start_equals_the_limit_of_a_long_run() -> None:
    for seed in range(5):
        plant = random_plant(seed)
        estimator = KalmanFilter(plant)
        y, u = random_data(plant, 3000, seed)
        steady = estimator.run(y, u)
        long = estimator.run(y, u, some_prior(plant))
        assert steady.P is not None and long.P is not None and estimator.steady is not None
        assert_close(steady.P[0], estimator.steady.P_posterior)
        assert_close(long.P[-1], steady.P[0])
        assert_close(long.x[-1], steady.x[-1])


def test_reported_covariances_are_positive_semidefinite_in_an_ill_conditioned_plant() -> None:
    A = [[1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.999]]
    sensors = [Sensor(f"s{i}", C=C, R=R) for i, (C, R) in enumerate([([1, 0, 0], 1e-10), ([1, 1, 1], 1e8)])]
    plant = Plant(A, np.diag([0.0, 1e-16, 0.0]), sensors)
    y, _ = random_data(plant, 20_000, 2, missing=0.3)
    P = KalmanFilter(plant).run(y, prior=Belief(np.zeros(3), np.diag([1e6, 1.0, 1e-6]))).P
    assert P is not None
    std = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    assert np.array_equal(P, np.swapaxes(P, 1, 2))
    assert np.linalg.eigvalsh(P / std[:, :, None] / std[:, None, :]).min() > -1e-14


@pytest.mark.parametrize("seed", range(6))
def test_save_and_resume_continue_to_the_bit(seed: int) -> None:
    plant = random_plant(seed, radius=0.5)
    estimator = KalmanFilter(plant)
    y, u = random_data(plant, 300, seed)
    y[100:110, 0] = np.nan
    prior = None if seed % 2 else some_prior(plant)
    whole = estimator.run(y, u, prior)
    live = estimator.start(prior)
    cuts = sorted(np.random.default_rng(seed).choice(300, 5, replace=False))
    parts, last = [], 0
    for cut in [*cuts, 300]:
        parts += [live.step(y[k], u[k]) for k in range(last, cut)]
        live, last = estimator.resume(live.save()), cut
    assert np.array_equal([e.x for e in parts], whole.x)
    assert np.array_equal([e.P for e in parts], whole.P)
    assert [e.diagnostics["log_likelihood"] for e in parts] == list(whole.diagnostics["log_likelihood"])


def test_a_state_of_another_filter_is_refused() -> None:
    blob = KalmanFilter(random_plant(1)).start().save()
    with pytest.raises(ResumeError, match="another"):
        KalmanFilter(random_plant(2)).resume(blob)
    with pytest.raises(ResumeError, match="damaged"):
        KalmanFilter(random_plant(1)).resume(blob[:-9])


BATCH = """
import hashlib
import numpy as np
from securestate.estimators import KalmanFilter
from tests.estimators.kalman_cases import random_data, random_plant, some_prior
plant = random_plant(7)
estimator, digest = KalmanFilter(plant), hashlib.sha256()
for gaps in ("none", "shared", "own"):
    pairs = [random_data(plant, 1100, run, missing=0.1 * (gaps == "own")) for run in range(3)]
    y, u = np.stack([pair[0] for pair in pairs]), np.stack([pair[1] for pair in pairs])
    if gaps == "shared":
        y[:, 500:520, 1] = np.nan
    for prior in (None, some_prior(plant)):
        batch = estimator.run(y, u, prior)
        for run in range(3):
            single = estimator.run(y[run], u[run], prior)
            for name in ("x", "x_std", "P", "trust", "innovation", "innovation_std", "status"):
                np.testing.assert_array_equal(getattr(batch, name)[run], getattr(single, name), strict=True)
            for name, values in batch.diagnostics.items():
                np.testing.assert_array_equal(values[run], single.diagnostics[name])
        digest.update(batch.x.tobytes() + batch.P.tobytes())
print(digest.hexdigest())
"""


def test_batch_equals_loop_to_the_bit_whatever_the_number_of_threads() -> None:
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", BATCH],
            cwd=CASES.parents[2],
            env=os.environ | {"RAYON_NUM_THREADS": threads},
            stdout=subprocess.PIPE,
            text=True,
        )
        for threads in ("1", "2")
    ]
    one, two = (process.communicate()[0] for process in processes)
    assert one == two and len(one) == 65


def test_nis_has_the_mean_of_chi_square_and_errors_match_p() -> None:
    plant, T, runs = random_plant(4), 400, 50
    rng = np.random.default_rng(4)
    w = rng.multivariate_normal(np.zeros(4), plant.Q, size=(T, runs))
    v = rng.multivariate_normal(np.zeros(6), plant.R, size=(T, runs))
    estimator = KalmanFilter(plant)
    assert estimator.steady is not None
    x = [rng.multivariate_normal(np.zeros(4), estimator.steady.P_prior, size=runs)]
    for k in range(T - 1):
        x.append(x[-1] @ plant.A.T + w[k])
    truth = np.stack(x, axis=1)
    run = estimator.run(truth @ plant.C.T + np.swapaxes(v, 0, 1), np.zeros((T, 2)))
    assert run.P is not None
    nis = run.diagnostics["nis"]
    assert nis.mean() == pytest.approx(6, abs=4 * np.sqrt(12 / nis.size))
    error = run.x - truth
    nees = np.einsum("rti,tij,rtj->rt", error, np.linalg.inv(run.P[0]), error)
    assert nees.mean() == pytest.approx(4, rel=0.05)


def test_engineering_units_change_nothing_but_the_numbers_of_the_file() -> None:
    plain = random_plant(6)
    rng = np.random.default_rng(6)
    offset, scale = rng.normal(size=6) * 100, rng.uniform(0.1, 50, size=6)
    sensors = [
        Sensor(s.name, C=s.C, offset=offset[2 * i : 2 * i + 2], scale=scale[2 * i : 2 * i + 2])
        for i, s in enumerate(plain.sensors)
    ]
    units: dict[str, Any] = {"input_offset": [5.0, -3.0], "input_scale": [2.0, 0.5]}
    filed = Plant(plain.A, plain.Q, sensors, B=plain.B, D=plain.D, R=plain.R, **units)
    (y, u), prior = random_data(plain, 100, 6, missing=0.1), some_prior(plain)
    file_u = np.array([5.0, -3.0]) + u * np.array([2.0, 0.5])
    run = KalmanFilter(filed).run(offset + scale * y, file_u, prior)
    expected = KalmanFilter(plain).run(y, u, prior)
    assert_close(run.x, expected.x)
    assert_close(run.innovation, expected.innovation * scale)
    assert_close(run.innovation_std, expected.innovation_std * scale)
    assert_close(run.diagnostics["log_likelihood"], expected.diagnostics["log_likelihood"])


def test_trust_and_status_say_who_sent_something() -> None:
    plant = random_plant(2)
    y, u = random_data(plant, 4, 2)
    y[1, 0] = np.nan  # one channel of two
    y[2, :2] = np.nan  # the whole sensor
    y[3] = np.nan
    run = KalmanFilter(plant).run(y, u)
    np.testing.assert_array_equal(run.trust, [[1, 1, 1], [1, 1, 1], [np.nan, 1, 1], [np.nan] * 3])
    assert run.status.tolist() == [Status.OK, Status.OK, Status.OK, Status.NO_MEASUREMENT]
    assert run.diagnostics["channels"].tolist() == [6, 5, 4, 0]
    assert run.diagnostics["log_likelihood"][3] == 0
    assert np.isnan(run.attack).all() and not run.suspected.any()
    assert np.isfinite(run.innovation_std).all()


def test_an_unseen_unstable_mode_needs_a_prior_and_ends_ill_conditioned() -> None:
    plant = Plant([[3.0, 0.0], [0.0, 0.5]], np.eye(2), [Sensor("s", C=[0.0, 1.0], R=1.0)])
    estimator = KalmanFilter(plant)
    assert estimator.steady is None and "mode 3" in estimator.no_steady_state
    with pytest.raises(InputError, match="prior: expected a belief with a covariance P"):
        estimator.run([[0.0]])
    run = estimator.run(np.zeros((700, 1)), prior=Belief([0.0, 0.0], np.eye(2)))
    assert run.status[0] == Status.OK and run.status[-1] == Status.ILL_CONDITIONED


def test_infinite_measurements_are_refused_with_their_channel_and_sample() -> None:
    plant = random_plant(2)
    y, u = random_data(plant, 10, 2)
    y[7, 4] = np.inf
    with pytest.raises(MeasurementError, match=r"y: .*inf in channel 4.*sample 7"):
        KalmanFilter(plant).run(y, u)
    with pytest.raises(MeasurementError, match="channel 4"):
        KalmanFilter(plant).start().step(y[7], u[7])


@pytest.mark.parametrize(
    ("shape", "inputs"),
    [((10, 5), (10, 2)), ((6,), (2,)), ((10, 6), (9, 2)), ((10, 6), (10, 3)), ((0, 6), (0, 2))],
)
def test_wrong_shapes_are_refused(shape: tuple[int, ...], inputs: tuple[int, ...]) -> None:
    with pytest.raises(ShapeError, match=r"^[yu]: expected shape .*, received shape"):
        KalmanFilter(random_plant(2)).run(np.zeros(shape), np.zeros(inputs))


def test_a_prior_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"prior\.x: expected shape \(4,\)"):
        KalmanFilter(random_plant(2)).start(Belief(np.zeros(3)))


def test_a_known_initial_state_is_a_prior_of_zero_covariance() -> None:
    plant = random_plant(2)
    y, u = random_data(plant, 30, 2)
    prior = Belief(np.ones(4), np.zeros((4, 4)))
    run = KalmanFilter(plant).run(y, u, prior)
    assert_close(run.x[0], np.ones(4), 0.0)
    assert_equals_textbook(run, textbook(plant, y, u, prior))
