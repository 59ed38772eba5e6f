"""Small models, records and plants whose truth is known, for the tests of identification."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from securestate import Plant, Sensor
from securestate.identification.forms import Independent, Innovations, Segment

Array = NDArray[np.float64]
CASES = Path(__file__).parent.parent / "cases" / "identification"


def golden(name: str) -> Any:
    """A golden file; lists of numbers become arrays."""
    return _arrays(json.loads((CASES / name).read_text()))


def _arrays(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _arrays(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_arrays(each) for each in value] if isinstance(value[0], dict) else np.array(value)
    return value


def random_model(seed: int, n: int = 2, m: int = 3, q: int = 1, *, radius: float = 0.9) -> Independent:
    """Everything is filled, feedthrough included."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    G = rng.normal(size=(n, n))
    return Independent(
        A,
        rng.normal(size=(n, q)),
        rng.normal(size=(m, n)),
        rng.normal(size=(m, q)),
        G @ G.T / n + 0.1 * np.eye(n),
        rng.uniform(0.5, 2, size=m),
    )


def record(model: Independent, N: int, seed: int, *, settle: int = 100) -> Segment:
    """A record of the model: y (N, m), u (N, q) white."""
    rng = np.random.default_rng(seed)
    n, (m, q) = model.n, model.D.shape
    total = N + settle
    u = rng.normal(size=(total, q))
    w = rng.normal(size=(total, n)) @ np.linalg.cholesky(model.Q + 1e-12 * np.eye(n)).T
    v = rng.normal(size=(total, m)) * np.sqrt(model.r)
    x = np.zeros((total, n))
    for k in range(1, total):
        x[k] = model.A @ x[k - 1] + model.B @ u[k - 1] + w[k - 1]
    return (x @ model.C.T + u @ model.D.T + v)[settle:], u[settle:]


def with_gaps(y: Array, share: float, seed: int) -> Array:
    """The same, this share of the readings missing at random."""
    gappy = y.copy()
    gappy[np.random.default_rng(seed).random(y.shape) < share] = np.nan
    return gappy


def plant_of(model: Independent, **options: Any) -> Plant:
    """One sensor per channel: s1, s2, ..."""
    sensors = [
        Sensor(f"s{i + 1}", C=C, R=r, D=D if np.any(model.D) else None)
        for i, (C, D, r) in enumerate(zip(model.C, model.D, model.r, strict=True))
    ]
    return Plant(model.A, model.Q, sensors, B=model.B if model.B.size else None, **options)


def model_of(plant: Plant) -> Independent:
    return Independent(plant.A, plant.B, plant.C, plant.D, plant.Q, np.diag(plant.R))


def innovations_record(form: Innovations, N: int, seed: int, *, settle: int = 200) -> Array:
    """Y (N, m) of a form without inputs."""
    rng = np.random.default_rng(seed)
    e = rng.normal(size=(N + settle, len(form.S))) @ np.linalg.cholesky(form.S).T
    x, rows = np.zeros(form.n), []
    for one in e:
        rows.append(form.C @ x + one)
        x = form.A @ x + form.K @ one
    return np.array(rows)[settle:]


#: Two slow states that three sensors see, and one of them twice; readings around 200, in tens.
LEVEL, SIZE = np.array([200.0, -5.0, 1000.0, 0.0]), np.array([10.0, 0.1, 300.0, 1.0])
KNOWN = Independent(
    np.array([[0.95, 0.1], [-0.1, 0.9]]),
    np.array([[0.4], [0.2]]),
    np.array([[1.0, 0.0], [0.5, 1.0], [0.0, 1.0], [1.0, -0.5]]),
    np.zeros((4, 1)),
    np.array([[0.3, 0.05], [0.05, 0.2]]),
    np.array([0.4, 0.2, 0.3, 0.5]),
)


def engineering(segment: Segment) -> Segment:
    """A record of `KNOWN` in engineering units; the input around 50."""
    y, u = segment
    return LEVEL + SIZE * y, 50 + 4 * u
