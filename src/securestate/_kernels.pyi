"""Types of the compiled kernels."""

from typing import Self, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

@final
class Kernel:
    @property
    def diagnostics(self) -> list[str]: ...

class Filter:
    def __new__(
        cls,
        kernel: Kernel,
        means: Float | None = None,
        covariance: Float | None = None,
        blob: bytes | None = None,
    ) -> Self: ...
    def step(self, y: ArrayLike, u: ArrayLike | None = None) -> Estimate: ...
    def advance(
        self, y: Float, u: Float, steps: int, covariance: bool
    ) -> dict[str, NDArray[np.generic]]: ...
    def save(self) -> bytes: ...

@final
class Estimate:
    @property
    def x(self) -> Float: ...
    @property
    def x_std(self) -> Float: ...
    @property
    def P(self) -> Float: ...
    @property
    def trust(self) -> Float: ...
    @property
    def attack(self) -> Float: ...
    @property
    def innovation(self) -> Float: ...
    @property
    def innovation_std(self) -> Float: ...
    @property
    def suspected(self) -> NDArray[np.bool_]: ...
    @property
    def status(self) -> int: ...
    @property
    def diagnostics(self) -> dict[str, float]: ...
