"""Plants and records for the tests of joint fusion."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from securestate import Belief, JointFusion, Plant, Sensor
from securestate.estimators import Run
from tests.reference.joint_fusion import Adaptive, Textbook, joint_fusion

Array = NDArray[np.float64]

PAPER_A = block_diag([[-0.837, 0.5427], [-0.5427, -0.837]], 0.9851, 0.9556)
PAPER_C = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [1, 0, 0, 1], [0, 0, 1, 1], [0, 1, 1, 0]], dtype=float)
PAPER_PAIRS = {"s1": ["s3", "s4"], "s2": ["s3", "s5"]}
#: The paper starts one step before its first sample.
PAPER_PRIOR = Belief(np.zeros(4), PAPER_A @ PAPER_A.T + np.diag([0.1, 0.2, 0.3, 0.2]))


def paper_plant() -> Plant:
    sensors = [Sensor(f"s{i + 1}", C=row, R=0.1, protected=i > 1) for i, row in enumerate(PAPER_C)]
    return Plant(PAPER_A, np.diag([0.1, 0.2, 0.3, 0.2]), sensors)


def random_plant(seed: int, *, n: int = 3, radius: float = 0.9, **changes: Any) -> Plant:
    """Two sensors that may lie, of two and one channels, and two that do not; noise that all share."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    noise = rng.normal(size=(6, 6))
    sensors = [
        Sensor(f"s{i}", C=rng.normal(size=(height, n)), protected=i > 1)
        for i, height in enumerate((2, 1, 2, 1))
    ]
    settings: dict[str, Any] = {
        "B": rng.normal(size=(n, 2)),
        "D": rng.normal(size=(6, 2)),
        "R": noise @ noise.T / 6 + 0.2 * np.eye(6),
    }
    return Plant(A, 0.3 * np.eye(n) + 0.1, sensors, **(settings | changes))


def varying_plant(seed: int, T: int) -> Plant:
    plant, rng = random_plant(seed), np.random.default_rng(seed)
    sensors = [
        Sensor(s.name, C=s.C + 0.3 * rng.normal(size=(T, *s.C.shape)), protected=s.protected)
        for s in plant.sensors
    ]
    A = plant.A + 0.1 * rng.normal(size=(T, *plant.A.shape))
    return Plant(A, plant.Q, sensors, B=plant.B, D=plant.D, R=plant.R)


def random_data(plant: Plant, T: int, seed: int, *, missing: float = 0.0) -> tuple[Array, Array]:
    """Readings and inputs; everything arrives in the first two samples, else Sigma would have no inverse."""
    rng = np.random.default_rng(seed)
    y, u = 3 * rng.normal(size=(T, plant.m)), rng.normal(size=(T, plant.n_inputs))
    gone = rng.random(y.shape) < missing
    gone[:2] = False
    y[gone] = np.nan
    return y, u


def some_prior(plant: Plant) -> Belief:
    root = np.random.default_rng(99).normal(size=(plant.n, plant.n))
    return Belief(np.arange(plant.n, dtype=float), root @ root.T + np.eye(plant.n))


def textbook(
    fusion: JointFusion, y: Array, u: Array, prior: Belief, eta: Array | Adaptive, *, printed: bool = False
) -> Textbook:
    """In the units of C x; `eta` (T, r) or (r,) in those of the sensors."""
    plant = fusion.plant
    assert prior.P is not None
    if not isinstance(eta, Adaptive):
        widths = [len(local.weak_channels) for local in fusion.locals]
        channels = [channel for local in fusion.locals for channel in local.weak_channels]
        each = np.broadcast_to(eta, (len(y), len(widths)))
        eta = np.repeat(each, widths, axis=1) / plant.scale[channels] ** 2
    stacks = [local.stack for local in fusion.locals]
    normal = plant.normalise(y), plant.normalise_input(u)
    return joint_fusion(plant, stacks, *normal, prior.x, prior.P, eta, printed=printed)


def assert_close(got: Array, expected: Array, tolerance: float) -> None:
    """Equal relative to the largest number; NaN in the same places."""
    size = np.nanmax(np.abs(expected), initial=0.0)
    np.testing.assert_allclose(got, expected, rtol=0, atol=tolerance * size)


def assert_equals_textbook(fusion: JointFusion, run: Run, book: Textbook, tolerance: float = 1e-8) -> None:
    plant = fusion.plant
    assert run.P is not None
    assert_close(run.x, book.x, tolerance)
    assert_close(run.P, book.P0, tolerance)
    assert_close(run.innovation, book.innovation * plant.scale, tolerance)
    for i, local in enumerate(fusion.locals):
        channels = list(local.weak_channels)
        gone, scale = np.isnan(run.innovation[:, channels]), plant.scale[channels]
        attack = np.where(gone, np.nan, book.X[i][:, plant.n :] * scale)
        assert_close(run.attack[:, channels], attack, tolerance)
        variance = np.diagonal(book.P_X[i], axis1=1, axis2=2)[:, plant.n :]
        std = np.where(gone, np.nan, np.sqrt(np.maximum(variance, 0)) * scale)
        assert_close(run.attack_std[:, channels], std, tolerance)
