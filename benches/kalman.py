"""KalmanFilter against filterpy, statsmodels and NumPy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter as FilterPy
from numpy.typing import NDArray
from statsmodels.tsa.statespace.kalman_filter import KalmanFilter as Statsmodels

from benches import plants
from benches.timing import Comparison, Contender, fastest
from securestate import Belief, KalmanFilter, Plant

Float = NDArray[np.float64]
TOLERANCE = 1e-8
SIZES = ((4, 5), (10, 20), (30, 60))
#: What statsmodels need not store: everything but the filtered mean, which is compared.
UNUSED = (
    "forecast_mean",
    "forecast_cov",
    "predicted_mean",
    "predicted_cov",
    "filtered_cov",
    "likelihood",
    "gain",
    "smoothing",
    "std_forecast",
)


def steps(quick: bool) -> Iterator[Comparison]:
    """One call per sample, as in a live service."""
    count = 50 if quick else 300
    for n, m in SIZES[:1] if quick else SIZES:
        plant = plants.plant(n, m)
        y = plants.measurements(plant, count)
        size, target = f"n={n} m={m}", 20.0 if n == 4 else None
        ours = _live(plant, y)
        yield Comparison("online step", size, ours, _filterpy(plant, y), TOLERANCE, target)
        yield Comparison("online step", size, ours, _numpy(plant, y), TOLERANCE)
        y = plants.with_gaps(y, 0.05)
        yield Comparison(
            "online step, 5 % missing", size, _live(plant, y), _numpy(plant, y, gaps=True), TOLERANCE
        )


def runs(quick: bool) -> Iterator[Comparison]:
    """A whole record at once."""
    count = 200 if quick else 1000
    for n, m in SIZES[:1] if quick else SIZES:
        plant = plants.plant(n, m)
        clean = plants.measurements(plant, count)
        size = f"n={n} m={m} T={count}"
        for gaps in (False, True):
            y = plants.with_gaps(clean, 0.05) if gaps else clean
            case = "whole run, 5 % missing" if gaps else "whole run"
            ours = _record(plant, y)
            target = 2.0 if n == 10 and not gaps else None
            yield Comparison(case, size, ours, _statsmodels(plant, y), TOLERANCE, target)
            yield Comparison(case, size, ours, _numpy(plant, y, gaps=gaps), TOLERANCE)


def batches(quick: bool) -> Iterator[Comparison]:
    """Many runs of the same plant."""
    count, length = (50, 50) if quick else (500, 100)
    for n, m in SIZES[:1] if quick else SIZES[:2]:
        plant = plants.plant(n, m)
        y = plants.measurements(plant, length, count)
        size = f"n={n} m={m}, {count} runs x {length}"
        for rival in (_numpy_batch_reported(plant, y), _numpy_batch(plant, y)):
            yield Comparison("batch", size, _record(plant, y), rival, TOLERANCE)


def _prior(plant: Plant) -> Belief:
    """Everyone starts from the same wide belief, so nobody starts in steady state."""
    return Belief(np.zeros(plant.n), np.eye(plant.n))


def _live(plant: Plant, y: Float) -> Contender:
    estimator, rows = KalmanFilter(plant), list(y)

    def work(live: Any) -> Float:
        step = live.step
        for row in rows:
            estimate = step(row)
        return estimate.x[np.newaxis]

    return Contender("securestate", work, len(rows), lambda: estimator.start(_prior(plant)))


def _record(plant: Plant, y: Float) -> Contender:
    estimator, prior = KalmanFilter(plant), _prior(plant)

    def work(_: None) -> Float:
        return estimator.run(y, prior=prior, covariance=False).x[..., -1, :].reshape(-1, plant.n)

    return Contender("securestate", work, y.size // plant.m)


def _filterpy(plant: Plant, y: Float) -> Contender:
    """Correct, then predict, as our step does; what is compared is the corrected state."""
    columns = list(y[:, :, np.newaxis])

    def prepare() -> FilterPy:
        live = FilterPy(dim_x=plant.n, dim_z=plant.m)
        live.x, live.P = np.zeros((plant.n, 1)), np.eye(plant.n)
        live.F, live.H, live.Q, live.R = (M.copy() for M in (plant.A, plant.C, plant.Q, plant.R))
        return live

    def work(live: FilterPy) -> Float:
        for column in columns:
            live.update(column)
            live.predict()
        return live.x_post.T

    return Contender("filterpy", work, len(columns), prepare)


def _numpy(plant: Plant, y: Float, *, gaps: bool = False) -> Contender:
    """The filter one would write by hand."""
    A, C, Q, R = plant.A, plant.C, plant.Q, plant.R

    def work(_: None) -> Float:
        x, P = np.zeros(plant.n), np.eye(plant.n)
        for row in y:
            if gaps:
                there = np.flatnonzero(~np.isnan(row))
                row, c, r = row[there], C[there], R[np.ix_(there, there)]
            else:
                c, r = C, R
            cP = c @ P
            K = np.linalg.solve(cP @ c.T + r, cP).T
            after = x + K @ (row - c @ x)
            P = P - K @ cP
            x, P = A @ after, A @ P @ A.T + Q
        return after[np.newaxis]

    return Contender("NumPy", work, len(y))


def _numpy_batch(plant: Plant, y: Float) -> Contender:
    """All runs at once, (runs, n); the gains, which they share, are computed once per sample."""
    A, C, Q, R = plant.A, plant.C, plant.Q, plant.R
    runs, steps, _ = y.shape

    def work(_: None) -> Float:
        X, P = np.zeros((runs, plant.n)), np.eye(plant.n)
        estimates = np.empty((runs, steps, plant.n))
        for k in range(steps):
            CP = C @ P
            K = np.linalg.solve(CP @ C.T + R, CP)
            X = X + (y[:, k] - X @ C.T) @ K
            estimates[:, k] = X
            P = P - K.T @ CP
            X, P = X @ A.T, A @ P @ A.T + Q
        return estimates[:, -1]

    return Contender("NumPy, all runs at once, state only", work, runs * steps)


def _numpy_batch_reported(plant: Plant, y: Float) -> Contender:
    """The same, reporting what ours reports: innovation, its and the state's deviations, NIS, likelihood."""
    A, C, Q, R = plant.A, plant.C, plant.Q, plant.R
    (runs, steps, m), n = y.shape, plant.n

    def work(_: None) -> Float:
        X, P = np.zeros((runs, n)), np.eye(n)
        estimates, innovations = np.empty((runs, steps, n)), np.empty((runs, steps, m))
        x_std, innovation_std = np.empty((steps, n)), np.empty((steps, m))
        nis, log_likelihood = np.empty((runs, steps)), np.empty((runs, steps))
        for k in range(steps):
            CP = C @ P
            S = CP @ C.T + R
            e = y[:, k] - X @ C.T
            solved = np.linalg.solve(S, np.hstack([CP, e.T]))
            K = solved[:, :n]
            nis[:, k] = np.einsum("rm,mr->r", e, solved[:, n:])
            log_likelihood[:, k] = -0.5 * (nis[:, k] + np.linalg.slogdet(2 * np.pi * S)[1])
            X = X + e @ K
            estimates[:, k], innovations[:, k] = X, e
            P = P - K.T @ CP
            x_std[k], innovation_std[k] = np.sqrt(np.diag(P)), np.sqrt(np.diag(S))
            X, P = X @ A.T, A @ P @ A.T + Q
        return estimates[:, -1]

    return Contender("NumPy, all runs at once, same report", work, runs * steps)


def _statsmodels(plant: Plant, y: Float) -> Contender:
    """Time invariant, so that it too reuses the gains once they settle, and storing only what is compared.

    The best of its methods: conventional, univariate (channel after channel), collapsed (to n channels).
    """
    methods: tuple[dict[str, bool], ...] = (
        {},
        {"filter_univariate": True},
        {"filter_univariate": True, "filter_conventional": False},
        {"filter_collapsed": True},
        {"filter_collapsed": True, "filter_univariate": True},
    )
    return fastest([_statsmodels_with(plant, y, method) for method in methods])


def _statsmodels_with(plant: Plant, y: Float, method: dict[str, bool]) -> Contender:
    model = Statsmodels(k_endog=plant.m, k_states=plant.n)
    model.bind(np.asfortranarray(y.T.copy()))
    model["design"], model["transition"] = plant.C, plant.A
    model["selection"], model["state_cov"], model["obs_cov"] = np.eye(plant.n), plant.Q, plant.R
    model.initialize_known(np.zeros(plant.n), np.eye(plant.n))
    model.set_filter_method(**method)
    model.set_conserve_memory(**{f"memory_no_{what}": True for what in UNUSED})

    def work(_: None) -> Float:
        model._filter()  # without the wrapper that copies everything for its results object
        return np.asarray(model._kalman_filter.filtered_state)[np.newaxis, :, -1]

    name = " + ".join(key.removeprefix("filter_") for key, on in method.items() if on) or "conventional"
    return Contender(f"statsmodels ({name})", work, len(y))


CASES: dict[str, Callable[[bool], Iterator[Comparison]]] = {
    "kalman-step": steps,
    "kalman-run": runs,
    "kalman-batch": batches,
}
