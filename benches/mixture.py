"""InnovationMixture against the same beliefs in NumPy, and one fit of scikit-learn's Gaussian mixture."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.mixture import GaussianMixture  # type: ignore[import-untyped]

from benches.timing import Comparison, Contender
from securestate import Belief, InnovationMixture, Plant, Sensor

Float = NDArray[np.float64]
TOLERANCE = 1e-8
#: States, sensors, attacked share, samples, and how many times faster than NumPy it should be.
SIZES = ((1, 15, 0.3, 300, 40.0), (50, 150, 0.3, 12, 8.0), (200, 200, 0.1, 4, 8.0), (200, 200, 0.3, 4, 8.0))
#: Times that one step should go into one fit of scikit-learn.
FIT = 200.0
#: Runs and samples of the batch.
RUNS, STEPS = 200, 100


def steps(quick: bool) -> Iterator[Comparison]:
    """One call per sample."""
    for n, sensors, share, samples, target in SIZES[:1] if quick else SIZES:
        plant, prior, y = attacked(n, sensors, share, samples)
        estimator = InnovationMixture(plant, merge=False)
        rows = list(y)

        def live(filter: Any, rows: list[Float] = rows) -> Float:
            return np.array([filter.step(row).x for row in rows])

        size = f"n={n} N={sensors}, {share:.0%} attacked"
        ours = Contender("our InnovationMixture", live, samples, lambda e=estimator, p=prior: e.start(p))
        theirs = Contender("NumPy", lambda _, a=(plant, prior, y): in_numpy(*a), samples)
        yield Comparison("mixture step", size, ours, theirs, TOLERANCE, target=target)
        if n == 1:
            yield Comparison("mixture step", size, ours, one_fit(y[-1]), target=FIT, alike=False)


def batch(quick: bool) -> Iterator[Comparison]:
    """Many runs at once: throughput of one thread."""
    plant, prior, y = attacked(1, 15, 0.3, STEPS)
    many = np.stack([y] * (20 if quick else RUNS))
    estimator = InnovationMixture(plant)

    def work(_: None) -> Float:
        return estimator.run(many, prior=prior, covariance=False).x

    yield Comparison(
        "mixture batch", "n=1 N=15", Contender("our InnovationMixture", work, many.shape[0] * STEPS), None
    )


def attacked(n: int, sensors: int, share: float, samples: int) -> tuple[Plant, Belief, Float]:
    """A random plant, what is known at its start, and readings; a fixed set adds N(0, 20²) to its own."""
    rng = np.random.default_rng([n, sensors, int(100 * share)])
    A = rng.standard_normal((n, n))
    A *= 0.98 / np.abs(np.linalg.eigvals(A)).max()
    C = rng.standard_normal((sensors, n))
    plant = Plant(A, 0.01 * np.eye(n), [Sensor(f"s{i}", C=row, R=0.01) for i, row in enumerate(C)])
    liars = rng.permutation(sensors) < share * sensors
    x, rows = rng.standard_normal(n), []
    prior = Belief(x, 0.04 * np.eye(n))
    for _ in range(samples):
        noise = 0.1 * rng.standard_normal(sensors) + liars * 20 * rng.standard_normal(sensors)
        rows.append(C @ x + noise)
        x = A @ x + 0.1 * rng.standard_normal(n)
    return plant, prior, np.array(rows)


def one_fit(y: Float) -> Contender:
    """The two clusters of one sample's readings."""
    points = y[:, np.newaxis]

    def work(_: None) -> Float:
        return np.asarray(GaussianMixture(2, random_state=0).fit(points).means_)

    return Contender("scikit-learn, one fit", work, 1)


def in_numpy(plant: Plant, prior: Belief, y: Float) -> Float:
    """The estimates of `InnovationMixture(plant, merge=False)` for scalar sensors, by NumPy."""
    assert prior.P is not None
    root = np.sqrt(np.diag(plant.R))
    C, kappa, keep = plant.C / root[:, np.newaxis], 5.0, 0.98
    x, P, lied, told, states = prior.x, prior.P, np.zeros(plant.m), np.zeros(plant.m), []
    for row in y:
        r = row / root - C @ x
        p = np.clip((1 + lied) / (5 + lied + told), 0.02, 0.9)
        sample = _Sample(C, np.linalg.inv(P), r, 1 + np.sum(C @ P * C, axis=1), p, kappa)
        u2 = r * r / sample.S
        gate = 1 / (1 + np.exp(np.clip(0.5 * (u2 - np.log(81) - u2 / 81), -50, 50)))
        first, second = sample.settle(gate), sample.settle(np.ones(plant.m))
        best = first
        if np.any((first[0] > 0.5) != (second[0] > 0.5)) and sample.evidence(second) > sample.evidence(first):
            best = second
        gamma, precision, eta, _ = best
        P = np.linalg.inv(sample.information(precision))
        x = x + P @ (C.T @ eta)
        states.append(x)
        x, P = plant.A @ x, plant.A @ P @ plant.A.T + plant.Q
        alone = gamma / (gamma + (1 - gamma) * (1 - p) / p / 9)
        lied, told = keep * lied + 1 - alone, keep * told + alone
    return np.array(states)


class _Sample:
    """One sample of whitened channels."""

    def __init__(self, C: Float, inverse: Float, r: Float, S: Float, p: Float, kappa: float) -> None:
        self.C, self.inverse, self.r, self.S, self.p, self.kappa = C, inverse, r, S, p, kappa
        self.u = r / np.sqrt(S)

    def information(self, precision: Float) -> Float:
        """P^-1 after the sample."""
        return np.asarray(self.inverse + (self.C.T * precision) @ self.C)

    def attacked(self, gamma: Float) -> Float:
        """Log density of an attacked sensor, learned with these beliefs."""
        doubt = 1 - gamma
        mu = doubt @ self.u / (doubt.sum() + 1)
        tau2 = (2 * self.kappa + doubt @ (self.u - mu) ** 2 + mu * mu) / (doubt.sum() + 3)
        return np.asarray(-0.5 * (np.log(tau2 * self.S) + (self.u - mu) ** 2 / tau2))

    def settle(self, gamma: Float) -> tuple[Float, Float, Float, Float]:
        """Beliefs, sites and the density of the attacked at the fixed point."""
        precision, eta = gamma, gamma * self.r
        for sweep in range(15):
            P = np.linalg.inv(self.information(precision))
            CP = self.C @ P
            H, e = np.sum(CP * self.C, axis=1), CP @ (self.C.T @ eta)
            d = 1 / (1 - precision * H)
            h, m = d * H, d * (e - H * eta)
            V, rho = h + 1, self.r - m
            density = self.attacked(gamma)
            odds = np.log(self.p) - np.log1p(-self.p) + density + 0.5 * (np.log(V) + rho * rho / V)
            new = 1 / (1 + np.exp(np.clip(odds, -60, 60)))
            M = new / V * np.maximum(1 - (1 - new) * rho * rho / V, 0)
            fresh = M / (1 - h * M)
            shift = fresh * (m + h * new * rho / V) + new * rho / V
            step = 0.5 if sweep else 1.0
            precision, eta = precision + step * (fresh - precision), eta + step * (shift - eta)
            gap, gamma = np.abs(new - gamma).max(), new
            if gap < 1e-3:
                break
        return gamma, precision, eta, density

    def evidence(self, found: tuple[Float, Float, Float, Float]) -> float:
        """Log evidence of the rounded beliefs, less a penalty without an honest majority."""
        honest, density = found[0] > 0.5, found[3]
        J, h = self.information(honest), self.C.T @ (honest * self.r)
        told = np.where(honest, np.log1p(-self.p) - 0.5 * self.r**2, density + np.log(self.p)).sum()
        few = max(0.0, np.ceil(len(honest) / 2) - honest.sum())
        return float(told - 0.5 * np.linalg.slogdet(J)[1] + 0.5 * h @ np.linalg.solve(J, h) - 1e3 * few)


CASES: dict[str, Callable[[bool], Iterator[Comparison]]] = {"mixture-step": steps, "mixture-batch": batch}
