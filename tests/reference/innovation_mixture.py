"""The innovation mixture as in a textbook: dense matrices, inverses, every sensor really left out. Slow.

What a sensor says is kept as its share of the information about the state, an (n, n) matrix and an (n,)
vector, so that sensors with more channels than states need no special care.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from securestate import Plant

Array = NDArray[np.float64]

NO_MEASUREMENT, NOT_CONVERGED, AMBIGUOUS, MAJORITY_SUSPECT = 1, 2, 5, 6


@dataclass
class Textbook:
    """Per sample: x (T, n), P (T, n, n), trust (T, N), attack and its std (T, m), status (T,), diagnostics.

    `margin` is how far the closest decision was from a tie.
    """

    x: Array
    P: Array
    trust: Array
    attack: Array
    attack_std: Array
    status: NDArray[np.int64]
    diagnostics: dict[str, Array]
    margin: float


@dataclass
class Heard:
    """A sensor of which something arrived: its channels, matrices, innovation, and what is known before."""

    sensor: int
    channels: NDArray[np.int64]
    C: Array
    R: Array
    r: Array
    S: Array
    protected: bool
    attacked: float = 0.0

    @property
    def m(self) -> int:
        return len(self.r)

    @property
    def surprise(self) -> Array:
        return np.asarray(np.linalg.solve(np.linalg.cholesky(self.S), self.r))

    def information(self, gamma: float) -> tuple[Array, Array]:
        """What it says if its noise is larger by 1 / gamma."""
        weight = gamma * self.C.T @ np.linalg.inv(self.R)
        return weight @ self.C, weight @ self.r


@dataclass
class Labels:
    """One start: beliefs, what the sensors say, and how it ended."""

    gamma: Array
    sites: list[tuple[Array, Array]]
    gap: float = np.inf
    sweeps: int = 0
    evidence: float = -np.inf
    attacked: tuple[Array, float] = (np.zeros(0), 1.0)


@dataclass
class Settings:
    """As `InnovationMixture` documents them; `margin` collects how close decisions were."""

    form: str = "propagation"
    attacked: str = "learned"
    memory: str = "rate"
    merge: bool = True
    kappa: float = 5.0
    forgetting: float = 0.98
    monitor: float | None = None
    monitor_rate: float = 1e-4
    margin: list[float] = field(default_factory=lambda: [np.inf])

    def decide(self, value: float, threshold: float) -> bool:
        """Whether value > threshold, noting how close it was."""
        self.margin.append(float(abs(value - threshold)))
        return value > threshold


class Past:
    """What is remembered of every sensor."""

    def __init__(self, plant: Plant) -> None:
        N = plant.n_sensors
        self.lies, self.truths = np.zeros(N), np.zeros(N)
        self.lied, self.moves = np.zeros(N), np.zeros((2, 2, N))  # moves[before, after], 1 = lies
        self.drift = np.zeros(plant.m)

    def chain(self) -> tuple[float, float]:
        """Rates of all sensors: to begin and to go on lying."""
        ((hh, ha), (ah, aa)) = self.moves.sum(axis=2)
        return (0.2 + ha) / (1 + hh + ha), (1 + aa) / (2 + ah + aa)

    def attacked(self, i: int, memory: str) -> float:
        if memory != "sticky":
            return float(np.clip((1 + self.lies[i]) / (5 + self.lies[i] + self.truths[i]), 0.02, 0.9))
        begin, stay = self.chain()
        ((hh, ha), (ah, aa)) = self.moves[:, :, i]
        begins, goes_on = (8 * begin + ha) / (8 + hh + ha), (8 * stay + aa) / (8 + ah + aa)
        return float(np.clip(self.lied[i] * goes_on + (1 - self.lied[i]) * begins, 0.002, 0.995))

    def remember(self, gamma: dict[int, float], prior: dict[int, float], s: Settings) -> None:
        forgetting = s.forgetting
        begin, stay = self.chain()
        self.lies, self.truths = forgetting * self.lies, forgetting * self.truths
        self.moves = forgetting * self.moves
        for i, before in enumerate(self.lied):
            joint = np.array(
                [[(1 - before) * (1 - begin), (1 - before) * begin], [before * (1 - stay), before * stay]]
            )
            if i not in gamma:
                self.lied[i] = joint[:, 1].sum()
                continue
            after = np.array([gamma[i], 1 - gamma[i]])
            self.moves[:, :, i] += joint / joint.sum(axis=0) * after
            self.lied[i] = 1 - gamma[i]
            if s.memory == "rate":  # what the belief would be if one in ten samples were a lie
                p = prior[i]
                after = after / [1 - p, p] * [0.9, 0.1]
                after = after / after.sum()
            self.lies[i] += after[1]
            self.truths[i] += after[0]


def innovation_mixture(plant: Plant, y: Array, u: Array, x: Array, P: Array, **settings: Any) -> Textbook:
    """Over y (T, m) in the plant's own units from the belief x, P about x[0|-1] on."""
    s, past, rows, numbers = Settings(**settings), Past(plant), [], []
    for k, (yk, uk) in enumerate(zip(y, u, strict=True)):
        A, C = (M[k] if M.ndim == 3 else M for M in (plant.A, plant.C))
        heard = listen(plant, C, yk - C @ x - plant.D @ uk, P)
        for one in heard:
            one.attacked = past.attacked(one.sensor, s.memory)
        winner, rival = settle(heard, P, s)
        if s.monitor is not None and watch(heard, P, winner, past, s):
            rival = None  # it does not know what the monitor found
        e, posterior = combine(P, winner.sites)
        gamma, weight, apart = winner.gamma, 0.0, 0.0
        if rival is not None:
            weight = special.expit(rival.evidence - winner.evidence)
            other, spread = combine(P, rival.sites)
            apart = float((np.abs(other - e) / np.sqrt(np.diag(posterior))).max())
            difference = other - e
            posterior = (1 - weight) * posterior + weight * spread
            posterior = posterior + weight * (1 - weight) * np.outer(difference, difference)
            e, gamma = e + weight * difference, (1 - weight) * gamma + weight * rival.gamma
        trust, attack, std = report(plant, heard, gamma, winner, P, s)
        x = x + e
        suspected = int((trust < 0.5).sum())
        rows.append((x, posterior, trust, attack, std))
        channels = sum(one.m for one in heard)
        undecided = sum(s.decide(float(g), 1 / 3) and s.decide(2 / 3, float(g)) for g in gamma)
        numbers.append((channels, winner.sweeps, winner.gap, suspected, weight, apart, undecided, len(heard)))
        beliefs = {one.sensor: float(g) for one, g in zip(heard, gamma, strict=True)}
        past.remember(beliefs, {one.sensor: one.attacked for one in heard}, s)
        x, P = A @ x + plant.B @ uk, A @ posterior @ A.T + plant.Q
    table = np.array(numbers, dtype=float).T
    names = ("channels", "sweeps", "gap", "distrusted", "rival")
    diagnostics = dict(zip(names, table[:5], strict=True))
    status = np.array([judge(row, s) for row in table.T])
    return Textbook(
        *(np.array(column) for column in zip(*rows, strict=True)), status, diagnostics, min(s.margin)
    )


def judge(row: Array, s: Settings) -> int:
    _, _, gap, suspected, weight, apart, undecided, arrived = row
    if arrived == 0:
        return NO_MEASUREMENT
    if 2 * suspected > arrived:
        return MAJORITY_SUSPECT
    if weight > 0 and s.decide(weight, 0.05) and s.decide(apart, 1.0):
        return AMBIGUOUS
    if undecided > 1 and 2 * undecided >= arrived:
        return AMBIGUOUS
    return NOT_CONVERGED if s.decide(gap, 0.05) else 0


def listen(plant: Plant, C: Array, r: Array, P: Array) -> list[Heard]:
    heard = []
    for i in range(plant.n_sensors):
        at = np.flatnonzero((plant.channel_sensor == i) & ~np.isnan(r))
        if len(at):
            own, R = C[at], plant.R[np.ix_(at, at)]
            S = own @ P @ own.T + R
            heard.append(Heard(i, at, own, R, r[at], S, bool(plant.protected[i])))
    return heard


def combine(P: Array, sites: list[tuple[Array, Array]], without: int | None = None) -> tuple[Array, Array]:
    """Mean and covariance of e ~ N(0, P) after what the sensors say, maybe without one of them."""
    kept = [site for i, site in enumerate(sites) if i != without]
    cov = np.linalg.inv(np.linalg.inv(P) + sum((J for J, _ in kept), np.zeros_like(P)))
    return cov @ sum((h for _, h in kept), np.zeros(len(P))), (cov + cov.T) / 2


def log_normal(v: Array, cov: Array) -> float:
    return float(-0.5 * (v @ np.linalg.solve(cov, v) + np.linalg.slogdet(2 * np.pi * cov)[1]))


def log_cauchy(v: Array, kappa: float) -> float:
    """Student's t with one degree of freedom and scale kappa I."""
    m = len(v)
    constant = special.gammaln((1 + m) / 2) - special.gammaln(0.5) - m / 2 * np.log(np.pi * kappa)
    return float(constant - (1 + m) / 2 * np.log1p(v @ v / kappa))


def log_attacked(one: Heard, mu: Array, tau2: float, s: Settings) -> float:
    """Log density of the innovation of an attacked sensor."""
    log_det = np.linalg.slogdet(one.S)[1]
    if s.attacked == "student":
        return log_cauchy(one.surprise, s.kappa) - 0.5 * log_det
    return log_normal(one.surprise - mu[: one.m], tau2 * np.eye(one.m)) - 0.5 * log_det


def learn(heard: list[Heard], gamma: Array, s: Settings) -> tuple[Array, float]:
    """The normal of what attacked sensors send, prior: one observation at 0, scale kappa."""
    widest = max((one.m for one in heard), default=0)
    total, count = np.zeros(widest), np.zeros(widest)
    for one, g in zip(heard, gamma, strict=True):
        total[: one.m] += (1 - g) * one.surprise
        count[: one.m] += 1 - g
    mu = total / (count + 1)
    square = sum(
        (1 - g) * ((one.surprise - mu[: one.m]) ** 2).sum() for one, g in zip(heard, gamma, strict=True)
    )
    return mu, float((2 * s.kappa + square + mu @ mu) / (count.sum() + widest + 2))


def begin(heard: list[Heard], beliefs: list[float]) -> Labels:
    gamma = np.array([1.0 if one.protected else g for one, g in zip(heard, beliefs, strict=True)])
    return Labels(gamma, [one.information(g) for one, g in zip(heard, gamma, strict=True)])


def gate(one: Heard, s: Settings) -> float:
    """Belief from the innovation alone, against a broad density."""
    if s.form == "propagation":
        odds = log_normal(one.surprise, 81 * np.eye(one.m)) - log_normal(one.surprise, np.eye(one.m))
    else:
        odds = log_cauchy(one.surprise, s.kappa) - log_normal(one.surprise, np.eye(one.m))
    return float(1 / (1 + np.exp(np.clip(odds, -50, 50))))


def sweep(heard: list[Heard], P: Array, labels: Labels, s: Settings) -> None:
    """Every belief against what the others say, all at once."""
    labels.attacked = learn(heard, labels.gamma, s)
    gamma, sites = labels.gamma.copy(), list(labels.sites)
    for i, one in enumerate(heard):
        if one.protected:
            continue
        e, cov = combine(P, labels.sites, without=i)
        V, rho = one.C @ cov @ one.C.T + one.R, one.r - one.C @ e
        odds = log_attacked(one, *labels.attacked, s) - log_normal(rho, V)
        odds += np.log(one.attacked) - np.log1p(-one.attacked)
        gamma[i] = 1 / (1 + np.exp(np.clip(odds, -700, 700)))
        if s.form == "belief":
            sites[i] = one.information(gamma[i])
        else:
            step = 1.0 if labels.sweeps == 0 else 0.5
            J, h = tilt(one, e, cov, V, rho, gamma[i])
            sites[i] = ((1 - step) * sites[i][0] + step * J, (1 - step) * sites[i][1] + step * h)
    labels.gap = float(np.abs(gamma - labels.gamma).max(initial=0.0))
    labels.gamma, labels.sites, labels.sweeps = gamma, sites, labels.sweeps + 1


def tilt(one: Heard, e: Array, cov: Array, V: Array, rho: Array, gamma: float) -> tuple[Array, Array]:
    """What the sensor says if the state shall have the moments of its mixture of honest and attacked."""
    gain, s = cov @ one.C.T, np.linalg.solve(V, rho)
    honest = e + gain @ s
    mean = gamma * honest + (1 - gamma) * e
    between = min(1 - gamma, 1 / (rho @ s))  # no more spread than makes the information zero
    moments = cov - gamma * gain @ (np.linalg.inv(V) - between * np.outer(s, s)) @ gain.T
    J = np.linalg.inv(moments)
    return J - np.linalg.inv(cov), J @ mean - np.linalg.solve(cov, e)


def settle(heard: list[Heard], P: Array, s: Settings) -> tuple[Labels, Labels | None]:
    """The best of all starts at their ends, and the rival to merge."""
    starts = [begin(heard, [gate(one, s) for one in heard]), begin(heard, [1.0] * len(heard))]
    if s.form == "belief":
        for _ in range(8):
            for start in starts:
                sweep(heard, P, start, s)
            if not s.decide(max(start.gap for start in starts), 1e-4):
                break
    else:
        for start in starts:
            sweep_to_the_end(heard, P, start, s)
    if s.form == "propagation" and same(starts[0], starts[1]) and not complement_counts(heard, starts[0], s):
        return starts[0], None
    for start in starts:
        weigh(heard, P, start, s)
    winner = best(starts, s)
    if complement_counts(heard, winner, s):
        opposite = begin(heard, [float(g <= 0.5) for g in winner.gamma])
        sweep_to_the_end(heard, P, opposite, s)
        weigh(heard, P, opposite, s)
        starts.append(opposite)
        winner = best(starts, s)
    rivals = [start for start in starts if not same(start, winner)] if s.merge else []
    rival = max(rivals, key=lambda one: one.evidence, default=None)
    if rival is None or not s.decide(special.expit(rival.evidence - winner.evidence), 0.01):
        return winner, None
    return winner, rival


def sweep_to_the_end(heard: list[Heard], P: Array, labels: Labels, s: Settings) -> None:
    cap, tolerance = (15, 1e-3) if s.form == "propagation" else (8, 1e-4)
    for _ in range(cap):
        sweep(heard, P, labels, s)
        if not s.decide(labels.gap, tolerance):
            break


def best(starts: list[Labels], s: Settings) -> Labels:
    """The largest evidence; starts that ended alike are no tie."""
    winner = starts[0]
    for start in starts[1:]:
        if start.evidence > winner.evidence:
            winner = start
    for start in starts:
        if start is not winner and not same(start, winner):
            s.decide(winner.evidence, start.evidence)
    return winner


def same(one: Labels, other: Labels) -> bool:
    return bool(((one.gamma > 0.5) == (other.gamma > 0.5)).all())


def complement_counts(heard: list[Heard], labels: Labels, s: Settings) -> bool:
    """Whether neither the labels nor their opposite leave a minority honest."""
    protected = np.array([one.protected for one in heard], dtype=bool)
    honest = (protected | (labels.gamma > 0.5)).sum()
    turned = (protected | (labels.gamma <= 0.5)).sum()
    return bool(s.merge and len(heard) > 1 and 2 * honest >= len(heard) and 2 * turned >= len(heard))


def weigh(heard: list[Heard], P: Array, labels: Labels, s: Settings) -> None:
    """Log evidence of the rounded labels: the honest jointly, the attacked one by one."""
    for gamma in labels.gamma:
        s.decide(float(gamma), 0.5)
    honest = [one for one, g in zip(heard, labels.gamma, strict=True) if g > 0.5]
    liars = [one for one, g in zip(heard, labels.gamma, strict=True) if g <= 0.5]
    log = sum(np.log1p(-one.attacked) for one in honest if not one.protected)
    log += sum(np.log(one.attacked) + log_attacked(one, *labels.attacked, s) for one in liars)
    if honest:
        C, r = np.vstack([one.C for one in honest]), np.concatenate([one.r for one in honest])
        S = C @ P @ C.T
        at = 0
        for one in honest:
            S[at : at + one.m, at : at + one.m] += one.R
            at += one.m
        log += log_normal(r, S)
    labels.evidence = float(log - 1e3 * max(0, (len(heard) + 1) // 2 - len(honest)))


def watch(heard: list[Heard], P: Array, labels: Labels, past: Past, s: Settings) -> bool:
    """Averages of what the others do not expect; a minority that is too far off is not believed.

    Returns whether there is one.
    """
    assert s.monitor is not None
    excess = np.zeros(len(heard))
    for i, one in enumerate(heard):
        e, cov = combine(P, labels.sites, without=i)
        V = one.C @ cov @ one.C.T + one.R
        off = np.linalg.solve(np.linalg.cholesky(V), one.r - one.C @ e)
        past.drift[one.channels] *= s.monitor
        past.drift[one.channels] += (1 - s.monitor) * np.clip(off, -4, 4)
        square = (past.drift[one.channels] ** 2).sum() * (1 + s.monitor) / (1 - s.monitor)
        excess[i] = 0.0 if one.protected else square / stats.chi2.ppf(1 - s.monitor_rate, one.m)
    found = [i for i in np.argsort(-excess)[: max(len(heard) - 1, 0) // 2] if s.decide(float(excess[i]), 1.0)]
    for i in found:
        labels.gamma[i] = 0.0
        labels.sites[i] = heard[i].information(0.0)
    return bool(found)


def report(
    plant: Plant, heard: list[Heard], gamma: Array, labels: Labels, P: Array, s: Settings
) -> tuple[Array, Array, Array]:
    """Trust (N,), attack and its deviation (m,)."""
    trust = np.full(plant.n_sensors, np.nan)
    attack, std = np.full(plant.m, np.nan), np.full(plant.m, np.nan)
    for i, one in enumerate(heard):
        trust[one.sensor], attack[one.channels] = gamma[i], 0.0
        if s.decide(0.5, float(gamma[i])):
            e, cov = combine(P, labels.sites, without=i)
            attack[one.channels] = one.r - one.C @ e
            std[one.channels] = np.sqrt(np.diag(one.C @ cov @ one.C.T + one.R))
    return trust, attack, std
