"""Types of the compiled kernels."""

from typing import Any, Self, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from securestate.plant import Plant

_Float = NDArray[np.float64]

__all__ = [
    "Estimate",
    "Filter",
    "Kernel",
    "PenaltySolver",
    "adaptive_joint",
    "augmented",
    "bias_leads",
    "bias_monitor",
    "detector",
    "innovation_mixture",
    "joint_fusion",
    "joint_moments",
    "kalman",
    "mixture_fusion",
    "protected_kalman",
    "secure_filter",
    "simulate",
    "smooth",
    "sparse_fusion",
]

@final
class Kernel:
    @property
    def diagnostics(self) -> list[str]: ...

class Filter:
    def __new__(
        cls,
        kernel: Kernel,
        means: _Float | None = None,
        covariance: _Float | None = None,
        blob: bytes | None = None,
    ) -> Self: ...
    def step(self, y: ArrayLike, u: ArrayLike | None = None) -> Estimate: ...
    def advance(self, y: _Float, u: _Float, steps: int, covariance: bool) -> dict[str, NDArray[Any]]: ...
    def react(
        self,
        clean: _Float,
        opened: _Float,
        gain: _Float,
        u: _Float,
        means: _Float,
        plant: Plant,
        covariance: bool,
    ) -> tuple[dict[str, NDArray[Any]], _Float]: ...
    def save(self) -> bytes: ...

@final
class Estimate:
    @property
    def x(self) -> _Float: ...
    @property
    def x_std(self) -> _Float: ...
    @property
    def P(self) -> _Float: ...
    @property
    def trust(self) -> _Float: ...
    @property
    def attack(self) -> _Float: ...
    @property
    def attack_std(self) -> _Float: ...
    @property
    def innovation(self) -> _Float: ...
    @property
    def innovation_std(self) -> _Float: ...
    @property
    def suspected(self) -> NDArray[np.bool_]: ...
    @property
    def status(self) -> int: ...
    @property
    def diagnostics(self) -> dict[str, float]: ...

@final
class PenaltySolver:
    def __new__(cls, hessian: _Float, starts: list[int], gamma: _Float) -> Self: ...
    def solve(self, linear: _Float, energy: float) -> tuple[_Float, int, float]: ...

def sparse_fusion(design: dict[str, object]) -> Kernel: ...
def kalman(plant: Plant, prior: _Float | None) -> Kernel: ...
def adaptive_joint(
    plant: Plant, prior: _Float | None, *, window: int, gate: float, quantiles: _Float
) -> Kernel: ...
def augmented(
    plant: Plant,
    prior: _Float | None,
    *,
    states: int,
    weak: list[int],
    start: _Float,
    quantiles: _Float,
    forgetting: tuple[float, _Float] | None,
) -> Kernel: ...
def bias_leads(
    plant: Plant,
    filter: tuple[_Float, _Float, _Float],
    *,
    statistic: tuple[int, float, float],
    news: _Float,
) -> tuple[NDArray[np.int64], _Float, _Float]: ...
def bias_monitor(
    plant: Plant,
    filter: tuple[_Float, _Float, _Float],
    *,
    statistic: tuple[int, float, float],
    decision: tuple[float, float, int, float, float],
) -> Kernel: ...
def detector(
    plant: Plant,
    prior: _Float | None,
    *,
    rule: str,
    quantiles: _Float,
    local: list[tuple[_Float, _Float, _Float, _Float, _Float, _Float, _Float]],
) -> Kernel: ...
def innovation_mixture(
    plant: Plant,
    prior: _Float | None,
    *,
    form: str,
    attacked: str,
    memory: str,
    merge: bool,
    kappa: float,
    forgetting: float,
    cap: int,
    tolerance: float,
    student: tuple[float, _Float],
    monitor: tuple[float | None, _Float],
) -> Kernel: ...
def secure_filter(
    plant: Plant,
    prior: _Float | None,
    *,
    onset: _Float,
    steady: float,
    deviations: _Float,
    without: list[str],
) -> Kernel: ...
def simulate(
    plant: Plant,
    q: _Float,
    r: _Float,
    feedback: _Float | None,
    x: _Float,
    u: _Float,
    y: _Float,
    noise: _Float,
) -> None: ...
def smooth(
    model: tuple[_Float, _Float, _Float, _Float, _Float], drive: _Float, y: _Float
) -> dict[str, Any]: ...
def protected_kalman(
    plant: Plant, protected: tuple[Plant, _Float | None, list[int]], quantiles: _Float
) -> Kernel: ...
def joint_fusion(
    plant: Plant,
    stacks: list[tuple[list[int], list[int]]],
    *,
    eta: _Float,
    adaptive: tuple[int, float] | None,
    detector: tuple[_Float | None, str, _Float, list[Any]] | None,
    form: str,
    fusion: str,
    protected: tuple[Plant, _Float | None, list[int]] | None,
    quantiles: _Float,
    prior: _Float | None,
) -> tuple[Kernel, bool]: ...
def joint_moments(
    plant: Plant,
    stacks: list[tuple[list[int], list[int]]],
    *,
    eta: _Float,
    form: str,
    fusion: str,
    prior: _Float,
    heard: NDArray[np.bool_],
) -> dict[str, Any]: ...
def mixture_fusion(
    plant: Plant,
    prior: _Float | None,
    local: _Float | None,
    *,
    epsilon: float | None,
    literal: bool,
    start: int,
    init: str,
    precise: bool,
    prior_floor: bool,
    cap: int,
) -> Kernel: ...
