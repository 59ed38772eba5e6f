"""The second moments of JointFusion: what simulation gives, and where the printed ones break."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from securestate import Belief, JointFusion, KalmanFilter, Plant, ProtectedKalman, Sensor
from securestate.estimators import JointMoments, Status
from tests.estimators.joint_cases import (
    PAPER_C,
    PAPER_PAIRS,
    PAPER_PRIOR,
    Array,
    assert_close,
    paper_plant,
    random_data,
    random_plant,
    some_prior,
)


def swinging_plant(T: int) -> Plant:
    """The paper's plant with an A that varies and fades faster, and noise that sensors share."""
    plant = paper_plant()
    swing = 1 + 0.15 * np.sin(np.arange(T) / 3)
    sensors = [Sensor(s.name, C=s.C, protected=s.protected) for s in plant.sensors]
    return Plant(plant.A * 0.9 * np.minimum(swing, 1.0)[:, None, None], plant.Q, sensors, R=plant.R + 0.04)


@dataclass
class Scene:
    """A plant, an eta that switches, and 30 % of the channels missing."""

    fusion: JointFusion
    eta: Array
    heard: Array
    moments: JointMoments


def scene(T: int) -> Scene:
    rng = np.random.default_rng(7)
    eta = np.where(np.arange(T)[:, None] // 5 % 2 == 0, [10.0, 0.5], [0.05, 4.0])
    heard = rng.random((T, 5)) > 0.3
    heard[0] = True
    fusion = JointFusion(swinging_plant(T), eta=eta, pairing=PAPER_PAIRS)
    return Scene(fusion, eta, heard, fusion.moments(T, PAPER_PRIOR, missing=~heard))


@dataclass
class Noise:
    """Unit errors of prior (runs, n), process (runs, T, n), sensors (runs, T, m), injections (runs, T, r)."""

    start: Array
    w: Array
    v: Array
    theta: Array


def random_noise(runs: int, T: int) -> Noise:
    rng = np.random.default_rng(12)
    return Noise(
        *(rng.standard_normal(shape) for shape in ((runs, 4), (runs, T, 4), (runs, T, 5), (runs, T, 2)))
    )


def unit_noise(T: int) -> Noise:
    """One run per error, of such a size that the mean of a product over all runs is its expectation."""
    count = 4 + 11 * T
    unit = np.sqrt(count) * np.eye(count)
    parts = np.split(unit, np.cumsum([4, 4 * T, 5 * T]), axis=1)
    return Noise(
        *(
            part.reshape(count, *shape)
            for part, shape in zip(parts, ((4,), (T, 4), (T, 5), (T, 2)), strict=True)
        )
    )


def simulated(scene: Scene, noise: Noise) -> list[tuple[Array, Array]]:
    """Xtilde (runs, T, n + 1) and phihat (runs, T, 1) of every local by (5) and (6)."""
    plant, T = scene.fusion.plant, len(scene.eta)
    x = noise.start @ np.linalg.cholesky(PAPER_PRIOR.P).T
    w, v = noise.w @ np.linalg.cholesky(plant.Q).T, noise.v @ np.linalg.cholesky(plant.R).T
    theta = noise.theta * np.sqrt(scene.eta)
    F = np.eye(5)[:, 4:]
    X = [np.zeros((len(x), 5)) for _ in range(2)]
    phi = [np.zeros((len(x), 1)) for _ in range(2)]
    errors = [(np.empty((len(x), T, 5)), np.empty((len(x), T, 1))) for _ in range(2)]
    for k in range(T):
        if k:
            x = x @ plant.A[k - 1].T + w[:, k]
        for i, local in enumerate(scene.fusion.locals):
            Aa = np.eye(5)
            if k:
                Aa[:4, :4] = plant.A[k - 1]
            C = np.hstack([PAPER_C[[i, *local.protected_channels]], np.eye(3, 1)])
            truth = np.hstack([x, theta[:, k, i : i + 1]])
            expected = X[i] @ Aa.T + phi[i] @ F.T
            rows = [*local.weak_channels, *local.protected_channels]
            surprise = np.where(scene.heard[k, rows], (truth - expected) @ C.T + v[:, k, rows], 0.0)
            X[i] = expected + surprise @ scene.moments.K[i][k].T
            phi[i] = phi[i] + surprise @ scene.moments.Gamma[i][k].T
            errors[i][0][:, k], errors[i][1][:, k] = truth - X[i], phi[i]
    return errors


def products(errors: list[tuple[Array, Array]], moments: JointMoments) -> list[tuple[Array, Array]]:
    """Means over the runs beside P^X, U, V of both locals, and P_12, all (T, ., .)."""

    def mean(a: Array, b: Array) -> Array:
        return np.einsum("rti,rtj->tij", a, b) / len(a)

    pairs = []
    for i, (X, phi) in enumerate(errors):
        pairs += [(mean(X, X), moments.P_X[i]), (mean(X, phi), moments.U[i]), (mean(phi, phi), moments.V[i])]
    return [*pairs, (mean(errors[0][0][..., :4], errors[1][0][..., :4]), moments.Sigma[:, :4, 4:])]


def test_moments_are_the_expectations_while_a_varies_samples_are_missing_and_eta_switches() -> None:
    now = scene(25)
    for got, expected in products(simulated(now, unit_noise(25)), now.moments):
        assert_close(got, expected, 1e-12)


def test_moments_are_those_of_20000_simulated_runs() -> None:
    now = scene(40)
    for got, expected in products(simulated(now, random_noise(20_000, 40)), now.moments):
        off = np.linalg.norm(got.mean(axis=0) - expected.mean(axis=0)) / np.linalg.norm(expected.mean(axis=0))
        assert off < 0.005


def test_the_printed_cross_covariance_lacks_the_noise_that_locals_share() -> None:
    plant = paper_plant()
    exact, printed = (
        JointFusion(plant, form=form, pairing=PAPER_PAIRS).moments(200, PAPER_PRIOR)
        for form in ("exact", "printed")
    )  # type: ignore[arg-type]
    P12, without = exact.Sigma[-1, :4, 4:], printed.Sigma[-1, :4, 4:]
    assert 0.15 < np.linalg.norm(without - P12) / np.linalg.norm(P12) < 0.25
    # What is printed promises a fused estimate that is better than it can be.
    assert np.trace(printed.P0[-1]) < 0.95 * np.trace(exact.P0[-1])


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(4))
def test_square_root_equals_joseph(seed: int, missing: float) -> None:
    plant, rng = random_plant(seed), np.random.default_rng(seed)
    eta, gone = 10.0 ** rng.uniform(-2, 2, size=(80, 2)), rng.random((80, 6)) < missing
    joseph, root = (
        JointFusion(plant, eta=eta, square_root=square_root).moments(80, some_prior(plant), missing=gone)
        for square_root in (False, True)
    )
    assert_close(root.Sigma, joseph.Sigma, 1e-12)
    # Locals that hear nearly the same are fused by their small differences, which are less sure.
    assert_close(root.P0, joseph.P0, 1e-11 if missing else 1e-12)
    for name in ("K", "Gamma", "P_X", "U", "V"):
        for a, b in zip(getattr(root, name), getattr(joseph, name), strict=True):
            assert_close(a, b, 1e-12)


def smallest(P: Array) -> float:
    """Smallest eigenvalue of any of the matrices (T, n, n), relative to the sizes of their rows."""
    std = np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 1e-300))
    return float(np.linalg.eigvalsh(P / std[:, :, None] / std[:, None, :]).min())


@pytest.mark.parametrize("square_root", [False, True])
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_moments_stay_covariances_where_variances_span_22_decades(square_root: bool, missing: float) -> None:
    plant, rng = random_plant(4), np.random.default_rng(4)
    precise = Plant(plant.A, plant.Q, plant.sensors, B=plant.B, D=plant.D, R=1e-10 * plant.R)
    fusion = JointFusion(precise, eta=1e12, square_root=square_root)
    gone = rng.random((500, 6)) < missing
    moments = fusion.moments(500, some_prior(plant), missing=gone)
    assert not moments.broken.any()
    for P in (*moments.P_X, moments.P0, moments.Sigma):
        assert smallest(P) > -1e-13
    y = np.where(gone[:, 3:], np.nan, 0.0)
    alone = KalmanFilter(precise.select([2, 3])).run(y, np.zeros((500, 2)), some_prior(plant)).P
    assert alone is not None
    np.testing.assert_allclose(
        np.trace(moments.P0, axis1=1, axis2=2), np.trace(alone, axis1=1, axis2=2), rtol=1e-6
    )


#: Share of samples missing and eta per sample: where the printed form breaks down.
BREAKS: dict[str, tuple[float, Any]] = {
    "30 % missing, eta 10": (0.3, np.full((3000, 2), 10.0)),
    "50 % missing, eta 1": (0.5, np.full((3000, 2), 1.0)),
    "eta from 10 to 0.01": (0.0, np.where(np.arange(3000)[:, None] < 100, 10.0, 0.01) * np.ones(2)),
}


@pytest.mark.parametrize("case", BREAKS)
def test_the_printed_form_breaks_down_and_says_so_and_the_exact_one_does_not(case: str) -> None:
    share, eta = BREAKS[case]
    plant, rng = paper_plant(), np.random.default_rng(1)
    y, _ = random_data(plant, 3000, 1)
    y[rng.random(y.shape) < share] = np.nan
    printed = JointFusion(plant, eta=eta, form="printed", pairing=PAPER_PAIRS).run(y, prior=PAPER_PRIOR)
    alone = ProtectedKalman(plant).run(y, prior=PAPER_PRIOR)
    broken = printed.status == Status.BROKEN_DOWN
    assert broken.any() and not broken[0]
    if case == "eta from 10 to 0.01":
        np.testing.assert_array_equal(np.flatnonzero(broken), np.arange(100, 3000))
    assert printed.P is not None and alone.P is not None
    for name in ("x", "x_std", "P", "attack", "attack_std"):
        np.testing.assert_array_equal(getattr(printed, name)[broken], getattr(alone, name)[broken])
    sent = ~np.isnan(y)
    for values in (
        printed.x,
        printed.P,
        printed.innovation_std,
        printed.innovation[sent],
        printed.attack[sent],
    ):
        assert np.isfinite(values).all()
    assert all(np.isfinite(values).all() for values in printed.diagnostics.values())
    exact = JointFusion(plant, eta=eta, pairing=PAPER_PAIRS)
    assert not (exact.run(y, prior=PAPER_PRIOR).status == Status.BROKEN_DOWN).any()
    moments = exact.moments(3000, PAPER_PRIOR, missing=~sent)
    assert not moments.broken.any()
    for P in (*moments.P_X, moments.Sigma, moments.P0):
        assert smallest(P) > -1e-12


@pytest.mark.parametrize("seed", range(8))
def test_no_local_is_worse_than_the_protected_sensors_alone_and_a_large_eta_makes_it_equal(seed: int) -> None:
    plant = random_plant(seed)
    prior, alone = some_prior(plant), plant.select([2, 3])
    P = KalmanFilter(alone).run(np.zeros((30, 3)), np.zeros((30, 2)), prior).P
    assert P is not None
    for eta in (0.0, 0.1, 10.0, 1e8):
        Sigma = JointFusion(plant, eta=eta).moments(30, prior).Sigma
        for own in (Sigma[:, :3, :3], Sigma[:, 3:, 3:]):
            assert np.linalg.eigvalsh(P - own).min() > -1e-12 * P.max()
            if eta == 1e8:
                assert_close(own, P, 1e-6)


@pytest.mark.parametrize("fusion", ["optimal", "average", "covariance-intersection"])
def test_weights_sum_to_one_and_the_optimal_ones_are_no_worse_than_any_local(fusion: Any) -> None:
    for square_root in (False, True):
        plant = random_plant(11)
        y, _ = random_data(plant, 50, 11, missing=0.3)
        design = JointFusion(plant, eta=[0.3, 3.0], fusion=fusion, square_root=square_root)
        moments = design.moments(50, some_prior(plant), missing=np.isnan(y))
        G, Sigma = moments.G, moments.Sigma
        np.testing.assert_allclose(G[:, :, :3] + G[:, :, 3:], np.tile(np.eye(3), (50, 1, 1)), atol=1e-11)
        np.testing.assert_allclose(moments.P0, G @ Sigma @ np.swapaxes(G, 1, 2), atol=1e-12)
        if fusion == "optimal":
            for own in (Sigma[:, :3, :3], Sigma[:, 3:, 3:]):
                assert np.linalg.eigvalsh(own - moments.P0).min() > -1e-12


def test_the_first_sample_without_readings_keeps_the_prior() -> None:
    moments = JointFusion(paper_plant()).moments(
        1, Belief(np.zeros(4), np.eye(4)), missing=np.ones(5, dtype=bool)
    )
    np.testing.assert_array_equal(moments.P0[0], np.eye(4))
    np.testing.assert_array_equal(moments.Sigma[0], np.tile(np.eye(4), (2, 2)))
