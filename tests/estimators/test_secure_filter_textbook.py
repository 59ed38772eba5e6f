"""The first sample of the secure filter equals expectation propagation by matrices that are inverted.

Of the labels only honest and wild are possible before anything is remembered:

    honest   r_i ~ N(C_i e, R_i), e ~ N(0, P)
    wild     u_i = V_i^-1/2 (r_i - m_i), half N(0, (1 + BROAD) I) and half N(mu, (1 + tau^2) I)

m_i and V_i are what the others expect; mu and tau^2 have a normal-inverse-gamma prior, and learn from others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from securestate import Belief, Plant, SecureFilter
from securestate.estimators.secure_filter import BROAD, onset_probability
from tests.estimators.mixture_cases import Array, random_plant, some_prior

#: What the kernel's `settings.rs` says: weights of the habits, onsets of those that change quickly, deviation
#: of a cluster of lies and its least variance, share of the broad density, sweeps at most, when they end.
WEIGHTS, QUICK = (0.85, 0.075, 0.075), (0.1, 0.4)
CLUSTER, LEAST, SHARE = 1.5, 0.25, 0.5
SWEEPS, TOLERANCE = 15, 1e-3


@dataclass
class Answer:
    """Trust (N,), x and P; how far the last change of a belief was from ending the sweeps or not."""

    trust: Array
    x: Array
    P: Array
    margin: float


def root_of_inverse(V: Array) -> Array:
    """V^-1/2, the symmetric one."""
    values, vectors = np.linalg.eigh(V)
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)


def cluster(m: int, lies: list[tuple[float, Array]]) -> tuple[Array, float]:
    """Mean of these lies in the first m channels, and their spread; before them, one observation at 0."""
    count, mu = sum(weight for weight, _ in lies), np.zeros(m)
    for weight, u in lies:
        mu[: len(u)] += weight * u[:m] / (count + 1)
    square = sum(weight * u @ u for weight, u in lies) - (count + 1) * mu @ mu
    freedom = sum(weight * len(u) for weight, u in lies) + m + 2
    return mu, max((square + 2 * CLUSTER**2) / freedom - 1, LEAST)


def textbook(plant: Plant, y: Array, prior: Belief) -> Answer:
    """Sweeps that begin from what is believed before the sample."""
    assert prior.P is not None
    own = [np.arange(plant.m)[plant.channels_of(i)] for i in range(plant.n_sensors)]
    roots = [np.linalg.inv(np.linalg.cholesky(plant.R[np.ix_(rows, rows)])) for rows in own]
    C = [L @ plant.C[rows] for L, rows in zip(roots, own, strict=True)]
    r = [L @ (y[rows] - plant.C[rows] @ prior.x) for L, rows in zip(roots, own, strict=True)]
    onset = onset_probability(np.array([len(rows) for rows in own]), 1e-3)
    honest = 1 - (WEIGHTS[0] * onset + sum(w * q for w, q in zip(WEIGHTS[1:], QUICK, strict=True)))
    honest[plant.protected] = 1.0
    N = len(own)
    gamma = honest.copy()
    Lambda = [g * np.eye(len(rows)) for g, rows in zip(gamma, own, strict=True)]
    eta = [g * each for g, each in zip(gamma, r, strict=True)]
    information, margin = np.linalg.inv(prior.P), np.inf

    def others(i: int) -> tuple[Array, Array]:
        """Mean and covariance of C_i e from everybody else."""
        J = information + sum(C[j].T @ Lambda[j] @ C[j] for j in range(N) if j != i)
        shift = sum(C[j].T @ eta[j] for j in range(N) if j != i)
        return C[i] @ np.linalg.solve(J, shift), C[i] @ np.linalg.solve(J, C[i].T)

    for sweep in range(SWEEPS):
        views = [others(i) for i in range(N)]
        V = [h + np.eye(len(h)) for _, h in views]
        rho = [r[i] - views[i][0] for i in range(N)]
        u = [root_of_inverse(V[i]) @ rho[i] for i in range(N)]
        wild_before = 1 - gamma
        gap, step = 0.0, 1.0 if sweep == 0 else 0.5
        for i in range(N):
            if plant.protected[i]:
                continue
            m, one = len(u[i]), np.eye(len(u[i]))
            size = np.sqrt(np.linalg.det(V[i]))
            mu, tau2 = cluster(m, [(wild_before[j], u[j]) for j in range(N) if j != i])
            wild = (
                SHARE * multivariate_normal.pdf(u[i], np.zeros(m), (1 + BROAD) * one)
                + (1 - SHARE) * multivariate_normal.pdf(u[i], mu, (1 + tau2) * one)
            ) / size
            plain = multivariate_normal.pdf(rho[i], np.zeros(m), V[i])
            belief = honest[i] * plain / (honest[i] * plain + (1 - honest[i]) * wild)
            gap, gamma[i] = max(gap, abs(belief - gamma[i])), belief
            (mean, h), g = views[i], np.linalg.solve(V[i], rho[i])
            # The mixture of h left as it is and h corrected; a covariance no larger than h.
            first = mean + belief * h @ g
            spread = belief * min(1 - belief, 1 / (rho[i] @ g))
            second = h - h @ (belief * np.linalg.inv(V[i]) - spread * np.outer(g, g)) @ h
            new = np.linalg.inv(second) - np.linalg.inv(h)
            Lambda[i] = (1 - step) * Lambda[i] + step * new
            eta[i] = (1 - step) * eta[i] + step * (np.linalg.solve(second, first) - np.linalg.solve(h, mean))
        margin = min(margin, abs(gap - TOLERANCE))
        if gap < TOLERANCE:
            break
    P = np.linalg.inv(information + sum(C[i].T @ Lambda[i] @ C[i] for i in range(N)))
    return Answer(gamma, prior.x + P @ sum(C[i].T @ eta[i] for i in range(N)), P, margin)


@pytest.mark.parametrize(
    ("n", "channels"), [(1, (1,) * 7), (2, (1, 2, 1, 2, 1, 2, 1)), (3, (1, 2, 1, 3, 1, 2, 1))]
)
def test_the_first_sample_is_expectation_propagation_by_the_book(n: int, channels: tuple[int, ...]) -> None:
    equal, named = 0, 0
    for seed in range(40):
        plant = random_plant(seed, n, channels=channels, inputs=0, protected=("s6",) if seed % 2 else ())
        prior, rng = some_prior(plant), np.random.default_rng([seed, n])
        x = rng.multivariate_normal(prior.x, prior.P)
        y = plant.C @ x + rng.multivariate_normal(np.zeros(plant.m), plant.R)
        liars = np.isin(plant.channel_sensor, rng.permutation(6)[: seed % 3])
        y = y + liars * rng.normal(scale=10, size=plant.m)
        run = SecureFilter(plant).run([plant.denormalise(y)], prior=prior)
        book = textbook(plant, y, prior)
        if run.diagnostics["rival"][0] > 0 or book.margin < 1e-8:
            continue
        if not np.array_equal(run.suspected[0], book.trust < 0.5):
            continue  # another start explains the sample better
        assert run.P is not None
        np.testing.assert_allclose(run.trust[0], book.trust, rtol=0, atol=1e-7)
        np.testing.assert_allclose(run.x[0], book.x, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(run.P[0], book.P, rtol=1e-6, atol=1e-7)
        equal, named = equal + 1, named + int(run.suspected.any())
    assert equal >= 34 and named >= 12, (equal, named)
