"""`python -m benches.secure_fuzz`: no plant and no reading makes SecureFilter fail, whatever it is given.

Random plants of 1 to 6 states and 1 to 12 sensors of one to three channels: noise and units over many
decades, unstable A, singular Q, matrices that vary, sensors that are the same, are protected
or that nobody can check. Readings are sane, missing, or wild up to 1e300; now and then everybody lies or
nobody speaks. Every record is checked (`check`), and some are saved in the middle and resumed.

    python -m benches.secure_fuzz --steps 1000000
"""

from __future__ import annotations

import argparse
import warnings
from collections import Counter
from dataclasses import fields
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from securestate import Belief, Plant, Run, SecureFilter, SecurestateWarning, Sensor, Status

Float = NDArray[np.float64]
#: Samples of a record.
T = 200
#: Status of samples whose numbers may be beyond all bounds.
EXCUSED = (Status.ILL_CONDITIONED,)


def hostile_plant(rng: np.random.Generator) -> Plant:
    """A plant of this seed."""
    n, N = int(rng.integers(1, 7)), int(rng.integers(1, 13))
    A = rng.normal(size=(n, n))
    A *= (
        rng.choice([0.0, rng.uniform(0.3, 0.999), 1.0, rng.uniform(1.0, 1.1)])
        / np.abs(np.linalg.eigvals(A)).max()
    )
    if rng.random() < 0.2:
        A = A * rng.uniform(0.9, 1.1, (T, 1, 1))
    root = rng.normal(size=(n, int(rng.integers(1, n + 1))))
    Q = 10.0 ** rng.uniform(-8, 4) * root @ root.T * (rng.random() < 0.9)
    inputs = int(rng.random() < 0.3)
    wide = 6.0 if rng.random() < 0.5 else 1.0
    sensors: list[Sensor] = []
    for i in range(N):
        if sensors and rng.random() < 0.15:
            twin = sensors[int(rng.integers(len(sensors)))]
            sensors.append(
                Sensor(f"s{i}", C=twin.C, R=twin.R, D=np.zeros((len(twin.C), 1)) if inputs else None)
            )
            continue
        m = int(rng.integers(1, 4))
        noise, C = rng.normal(size=(m, m)), rng.normal(size=(m, n)) * (rng.random((m, n)) < 0.7)
        C[~C.any(axis=1), int(rng.integers(n))] = 1.0
        protected, verifiable = rng.random(2) < (0.1, 0.95)
        sensors.append(
            Sensor(
                f"s{i}",
                C=C,
                R=10.0 ** rng.uniform(-wide, wide) * (noise @ noise.T + 0.01 * np.eye(m)),
                D=rng.normal(size=(m, 1)) if inputs else None,
                scale=10.0 ** rng.uniform(-wide, wide, m),
                offset=rng.normal(size=m),
                protected=bool(protected),
                verifiable=bool(verifiable),
            )
        )
    return Plant(A, Q, sensors, B=rng.normal(size=(n, 1)) if inputs else None)


def truth(plant: Plant, u: Float, rng: np.random.Generator) -> Float:
    """What the sensors of a plant send while nobody lies, (T, m)."""
    x, w = np.zeros((T, plant.n)), rng.multivariate_normal(np.zeros(plant.n), plant.Q, T)
    for k in range(T - 1):
        x[k + 1] = plant.successor(x[k : k + 1], u[k : k + 1], k)[0] + w[k]
    v = rng.multivariate_normal(np.zeros(plant.m), plant.R, T, method="cholesky")
    y: Float = plant.reading(x, u) + plant.scale * v
    return y


def hostile_data(plant: Plant, u: Float, rng: np.random.Generator) -> Float:
    """Readings of a trajectory or far from any, lies of all kinds, gaps; (T, m)."""
    free = ~plant.protected[plant.channel_sensor]
    deviation = plant.scale * np.sqrt(np.diag(plant.R))
    if rng.random() < 0.7:
        y = truth(plant, u, rng)
    else:
        y = plant.offset + deviation * rng.normal(size=(T, plant.m)) * 10.0 ** rng.uniform(-1, 3)
    if rng.random() < 0.5:
        liars = (rng.random(plant.n_sensors) < 0.4)[plant.channel_sensor] & free
        kinds = np.stack([np.full(T, 30.0), 0.1 * np.arange(T), rng.normal(size=T) * 10, np.full(T, 1e5)])
        y[:, liars] += (deviation * kinds[rng.integers(4)][:, np.newaxis])[:, liars]
    wild = ((rng.random(y.shape) < 0.03) | (rng.random((T, 1)) < 0.03)) & free
    y[wild] = rng.choice([-1.0, 1.0], wild.sum()) * 10.0 ** rng.uniform(0, 300, wild.sum())
    y[rng.random(T) < 0.02] = 0.0
    y[(rng.random(y.shape) < 0.05) | (rng.random((T, 1)) < 0.03)] = np.nan
    silent = int(rng.integers(plant.m))
    y[T // 2 : T // 2 + int(rng.integers(1, T // 3)), silent] = np.nan
    return y


def check(seed: int) -> tuple[list[str], Counter[str]]:
    """What is wrong with the record of this seed, and how often each status came."""
    rng = np.random.default_rng([seed, 20])
    plant = hostile_plant(rng)
    u = rng.normal(size=(T, plant.n_inputs))
    y = hostile_data(plant, u, rng)
    prior = Belief(rng.normal(size=plant.n), 10.0 ** rng.uniform(-6, 8) * np.eye(plant.n))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SecurestateWarning)
        estimator = SecureFilter(plant, false_alarm_rate=10.0 ** rng.uniform(-6, -1))
    given = u if plant.n_inputs else None
    run = estimator.run(y, given, prior)
    wrong = faults(run, y)
    if rng.random() < 0.2:
        cut = int(rng.integers(1, T))
        live = estimator.start(prior)
        live.run(y[:cut], None if given is None else given[:cut])
        rest = estimator.resume(live.save()).run(y[cut:], None if given is None else given[cut:])
        for name in (field.name for field in fields(run) if isinstance(getattr(run, field.name), np.ndarray)):
            if not np.array_equal(getattr(rest, name), getattr(run, name)[cut:], equal_nan=True):
                wrong.append(f"{name} is another after a resume at {cut}")
    return wrong, Counter(Status(int(status)).name for status in run.status)


def faults(run: Run, y: Float) -> list[str]:
    """What a run must not do, and this one does."""
    assert run.P is not None
    plant, sent = run.plant, ~np.isnan(y)
    spoke = np.stack([sent[:, plant.channels_of(i)].any(axis=1) for i in range(plant.n_sensors)], axis=1)
    finite = np.isfinite(np.concatenate([run.x[..., np.newaxis], run.P], axis=2)).all(axis=(1, 2))
    largest = np.abs(np.where(finite[:, None, None], run.P, 0.0)).max(axis=(1, 2))
    lowest = np.linalg.eigvalsh(np.where(finite[:, None, None], run.P, 0.0)).min(axis=1)
    trust = np.where(plant.uncheckable & ~run.suspected & np.isnan(run.trust), 1.0, run.trust)
    excused = np.isin(run.status, EXCUSED)
    claims = {
        "x and P are finite or the status says so": finite | excused,
        "P is symmetric": ~finite | (run.P.swapaxes(1, 2) == run.P).all(axis=(1, 2)),
        "P is positive": lowest >= -1e-9 * largest,
        "x_std is the root of P's diagonal": ~finite
        | np.isclose(run.x_std**2, np.diagonal(run.P, axis1=1, axis2=2), rtol=1e-9, atol=0).all(axis=1),
        "trust is in [0, 1] where something arrived": ((trust >= 0) & (trust <= 1)) | ~spoke,
        "trust is NaN where nothing arrived": spoke | np.isnan(run.trust),
        "suspected is trust < 1/2": run.suspected == (run.trust < 0.5),
        "protected sensors are believed": ~(run.suspected & plant.protected),
        "attack is a number where something arrived": ~np.isnan(run.attack) == sent,
        "attack is 0 where nobody is suspected": run.suspected[:, plant.channel_sensor]
        | ~sent
        | (run.attack == 0),
        "attack_std is a number where somebody is suspected": ~np.isnan(run.attack_std)
        == (run.suspected[:, plant.channel_sensor] & sent),
        "nothing heard is NO_MEASUREMENT": spoke.any(axis=1)
        | np.isin(run.status, (Status.NO_MEASUREMENT, *EXCUSED)),
    }
    return [
        f"not so at {np.argwhere(~holds)[0]}: {claim}" for claim, holds in claims.items() if not holds.all()
    ]


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser("python -m benches.secure_fuzz", description="Hard data.")
    parser.add_argument("--steps", type=int, default=1_000_000, help="samples in all")
    parser.add_argument("--seed", type=int, default=0, help="of the first record")
    options = parser.parse_args(arguments)
    begin, counts, bad = perf_counter(), Counter[str](), 0
    records = max(1, options.steps // T)
    for seed in range(options.seed, options.seed + records):
        wrong, statuses = check(seed)
        counts += statuses
        bad += bool(wrong)
        for fault in wrong:
            print(f"seed {seed}: {fault}", flush=True)
    print(f"{records * T} steps, {bad} records at fault, {perf_counter() - begin:.0f} s, {dict(counts)}")
    raise SystemExit(bool(bad))


if __name__ == "__main__":
    main()
