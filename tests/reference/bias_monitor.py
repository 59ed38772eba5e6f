"""The bias monitor, slow: every number from its definition, nothing updated that can be summed.

No channel of `y` need arrive. Units are those of the normalised plant.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from securestate import Plant

Float = NDArray[np.float64]
WINDOW, KAPPA, MARGIN, PERSIST, FURTHER, DROP, MOST, FORGOTTEN = 40, 1.5, 4.0, 3, 6.0, 9.0, 4, 0.1


@dataclass(eq=False)
class Step:
    """A step on one channel: its signatures from `onset` on."""

    channel: int
    onset: int
    z: Float
    s: list[Float] = field(default_factory=list)
    w: Float = field(default_factory=lambda: np.zeros(0))

    def at(self, t: int) -> Float:
        return self.s[t - self.onset] if t >= self.onset else np.zeros_like(self.s[0])

    def since(self, t: int) -> list[Float]:
        return self.s[t - self.onset :]


class Textbook:
    """One record, sample by sample."""

    def __init__(self, plant: Plant, limit: float, gamma: float = 1.0) -> None:
        self.plant, self.limit, self.gamma = plant, limit, gamma
        A, C = plant.A, plant.C
        P = linalg.solve_discrete_are(A.T, C.T, plant.Q, plant.R)
        self.S = C @ P @ C.T + plant.R
        self.K = P @ C.T @ np.linalg.inv(self.S)
        self.P = P - self.K @ C @ P
        self.L = np.linalg.cholesky(self.S)
        self.owner = plant.channel_sensor
        m, n = plant.m, plant.n
        self.signature = np.zeros((WINDOW, m, m))  # [j, :, i]
        Z = np.zeros((n, m))
        for j in range(WINDOW):
            R = np.eye(m) - C @ Z
            self.signature[j] = np.linalg.solve(self.L, R)
            Z = A @ (Z + self.K @ R)
        self.energy = np.cumsum((self.signature**2).sum(axis=1), axis=0)  # [k - 1, i]
        self.x = np.zeros(n)
        self.news: list[Float] = []
        self.steps: list[Step] = []
        self.past: list[int] = []
        # What was known, by least squares, of the steps that stand in `base` at sample `since`.
        self.base: list[Step] = []
        self.since, self.G0, self.h0 = -1, np.zeros((0, 0)), np.zeros(0)
        self.b, self.V = np.zeros(0), np.zeros((0, 0))

    def fill(self, e: Float, absent: NDArray[np.bool_]) -> Float:
        """The mean of what is absent given the rest."""
        if not absent.any():
            return e
        e = e.copy()
        here = ~absent
        e[absent] = (
            self.S[np.ix_(absent, here)] @ np.linalg.solve(self.S[np.ix_(here, here)], e[here])
            if here.any()
            else 0.0
        )
        return e

    def extend(self, step: Step, absent: NDArray[np.bool_], t: int) -> None:
        if step.s:
            step.z = self.plant.A @ step.w
        r = self.fill(np.eye(self.plant.m)[step.channel] - self.plant.C @ step.z, absent)
        step.s.append(np.linalg.solve(self.L, r))
        step.w = step.z + self.K @ r
        assert step.onset + len(step.s) == t + 1

    def solve(self) -> None:
        """Least squares of all steps; the weakest leave until all that stay are significant."""
        t = len(self.news)
        while self.steps:
            size = len(self.steps)
            G, h = np.zeros((size, size)), np.zeros(size)
            for a, one in enumerate(self.steps):
                known = one in self.base
                first = self.since + 1 if known else one.onset
                h[a] = np.vdot(one.since(first), self.news[first:t])
                if known:
                    h[a] += self.h0[self.base.index(one)]
                for b, other in enumerate(self.steps):
                    both = known and other in self.base
                    first = self.since + 1 if both else max(one.onset, other.onset)
                    G[a, b] = np.vdot(one.since(first), other.since(first))
                    if both:
                        G[a, b] += self.G0[self.base.index(one), self.base.index(other)]
            self.V = self.gamma * np.linalg.inv(G)
            self.b = np.linalg.solve(G, h)
            strength = self.b**2 / np.diag(self.V)
            weakest = int(np.argmin(strength))
            if strength[weakest] >= DROP:
                return
            self.forget(weakest)
        self.b, self.V = np.zeros(0), np.zeros((0, 0))

    def forget(self, index: int) -> None:
        gone = self.steps.pop(index)
        if gone in self.base:
            at = self.base.index(gone)
            self.base.pop(at)
            self.G0 = np.delete(np.delete(self.G0, at, 0), at, 1)
            self.h0 = np.delete(self.h0, at)

    def scores(self) -> tuple[Float, NDArray[np.int64]]:
        """g_i and the k that attains it, per channel."""
        t = len(self.news)
        clean = [
            self.news[k] - sum((b * step.at(k) for b, step in zip(self.b, self.steps, strict=True)), 0.0)
            for k in range(max(0, t - WINDOW), t)
        ]
        g = np.empty((len(clean), self.plant.m))
        for k in range(1, len(clean) + 1):
            c = np.einsum("jai,ja->i", self.signature[:k], clean[len(clean) - k :])
            g[k - 1] = c**2 / (self.gamma * self.energy[k - 1]) - 2 * KAPPA * np.log(WINDOW / k)
        return g.max(axis=0), g.argmax(axis=0) + 1

    def settle(self) -> None:
        """Two steps on one channel that the filter cannot tell apart any more become one, or none."""
        for f in range(len(self.steps)):
            for e in range(f):
                if self.settled(e, f):
                    self.join(e, f)
                    return

    def settled(self, e: int, f: int) -> bool:
        one, other, now = self.steps[e], self.steps[f], len(self.news) - 1
        old = min(len(one.s), len(other.s)) > WINDOW
        apart = float(np.linalg.norm(one.at(now) - other.at(now)))
        return (
            one.channel == other.channel and old and min(abs(self.b[e]), abs(self.b[f])) * apart < FORGOTTEN
        )

    def join(self, e: int, f: int) -> None:
        one, other, total = self.steps[e], self.steps[f], self.b[e] + self.b[f]
        T = np.eye(len(self.b))
        T[e, f] = 1.0
        significant = total**2 >= DROP * (T @ self.V @ T.T)[e, e]
        if significant:
            start = min(one.onset, other.onset)
            share, rest = self.b[e] / total, self.b[f] / total
            times = range(start, len(self.news))
            joined = Step(one.channel, start, share * one.z + rest * other.z)
            joined.s = [share * one.at(k) + rest * other.at(k) for k in times]
            joined.w = share * one.w + rest * other.w
            self.steps[e] = joined
        kept = [i for i in range(len(self.b)) if i != f and (significant or i != e)]
        self.b, self.V = (T @ self.b)[kept], (T @ self.V @ T.T)[np.ix_(kept, kept)]
        self.steps = [self.steps[i] for i in kept]
        self.base, self.since = list(self.steps), len(self.news) - 1
        self.G0 = self.gamma * np.linalg.inv(self.V)
        self.h0 = self.G0 @ self.b

    def step(self, y: Float, u: Float) -> dict[str, Any]:
        plant, t = self.plant, len(self.news)
        absent = np.isnan(y)
        raw = y - plant.C @ self.x - plant.D @ u
        for known in self.steps:
            self.extend(known, absent, t)
        remaining = raw + sum(
            (b * plant.C @ step.z for b, step in zip(self.b, self.steps, strict=True)), np.zeros(plant.m)
        )
        e = self.fill(raw, absent)
        self.news.append(np.linalg.solve(self.L, e))
        self.solve()
        per_channel, onset = self.scores()
        g = np.array([per_channel[self.owner == i].max() for i in range(plant.n_sensors)])
        winner = int(g.argmax())
        ahead = g[winner] - np.delete(g, winner).max()
        others = any(self.owner[step.channel] != winner for step in self.steps)
        high = g[winner] > self.limit + (FURTHER if others else 0.0)
        nameable = ahead > MARGIN and not plant.uncheckable[winner] and len(self.steps) < MOST
        self.past = [*self.past, winner if high and nameable else -1][-PERSIST:]
        if self.past == [winner] * PERSIST:
            self.past = []
            channel = int(np.where(self.owner == winner, per_channel, -np.inf).argmax())
            first = t + 1 - int(onset[channel])
            named = Step(channel, first, np.zeros(plant.n))
            for k in range(first, t + 1):
                self.extend(named, np.zeros(plant.m, dtype=bool), k)
            self.steps.append(named)
            self.solve()
        self.settle()
        x = self.x + self.K @ e
        told = self.told(absent, x)
        told |= {"innovation": remaining, "ratio": g[winner], "leader": winner, "steps": len(self.steps)}
        told["ambiguous"] = high and not nameable
        self.x = plant.A @ x + plant.B @ u
        return told

    def told(self, absent: NDArray[np.bool_], x: Float) -> dict[str, Any]:
        plant = self.plant
        attack = np.where(absent, np.nan, 0.0)
        attack_std = np.full(plant.m, np.nan)
        suspected = np.zeros(plant.n_sensors, dtype=bool)
        for channel in np.flatnonzero(~absent):
            own = np.array([step.channel == channel for step in self.steps], dtype=bool)
            total = float(self.b[own].sum())
            variance = float(self.V[np.ix_(own, own)].sum())
            if own.any() and total**2 >= DROP * variance:
                attack[channel], attack_std[channel] = total, np.sqrt(variance)
                suspected[self.owner[channel]] = True
        W = np.array([step.w for step in self.steps]).reshape(len(self.steps), plant.n).T
        return {
            "x": x - W @ self.b,
            "P": self.P + W @ self.V @ W.T,
            "attack": attack,
            "attack_std": attack_std,
            "suspected": suspected,
        }

    def run(self, y: Float, u: Float) -> dict[str, NDArray[Any]]:
        samples = [self.step(*sample) for sample in zip(y, u, strict=True)]
        return {name: np.array([sample[name] for sample in samples]) for name in samples[0]}
