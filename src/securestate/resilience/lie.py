"""A lie that moves like the plant: some sensors claim that the state is x + d, and d obeys d[k+1] = A d[k].

Nothing in the dynamics contradicts it; only sensors that see d and do not lie can. So it is what a
certificate
shows: the worst set of sensors, and the direction in which they should push.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from securestate._checks import real_array, whole_number
from securestate.errors import InputError
from securestate.plant import Plant
from securestate.resilience.eigenspaces import Array, Field

#: A lie along a mode at least this large ends at its direction; others begin there.
LASTING = 0.9


@final
@dataclass(frozen=True, eq=False)
class Lie:
    """What sensors add to their readings so that the state seems to be x + d.

    Attributes:
        plant: whose sensors they are.
        sensors: names of those that lie.
        d: (n,), the direction at the last sample, or at the first if it fades by more than 10 % per sample;
            all sensors together see one standard deviation of it.
        V, J: d moves in the span of V, (n, g), with A V = V J.
    """

    plant: Plant
    sensors: tuple[str, ...]
    d: Array
    V: Array
    J: Array

    def shift(self, samples: int, size: float = 1.0) -> Array:
        """d[k], (samples, n), with d = size * `d` at the last or the first sample.

        Raises:
            InputError: samples is not a whole number >= 1, or size no finite number.
        """
        whole_number("samples", samples, 1, InputError)
        if np.ndim(real_array("size", size, InputError)):
            raise InputError("size", "one number", repr(size))
        lasting = bool(np.abs(np.linalg.eigvals(self.J)).min() >= LASTING)
        step = np.linalg.inv(self.J) if lasting else self.J
        parts = [size * np.linalg.lstsq(self.V, self.d, rcond=None)[0]]
        for _ in range(samples - 1):
            parts.append(step @ parts[-1])
        moved: Array = np.array(parts[::-1] if lasting else parts) @ self.V.T
        return moved

    def readings(self, samples: int, size: float = 1.0) -> Array:
        """What is added to y, (samples, m), in the units of the sensors; zero for those that do not lie.

        Raises:
            InputError: as for `shift`.
        """
        lying = np.isin(self.plant.sensor_names, self.sensors)[self.plant.channel_sensor]
        said = self.shift(samples, size) @ self.plant.C.T * self.plant.scale
        return np.where(lying, said, 0.0)


def lie_along(plant: Plant, X: Array, sensors: tuple[int, ...], d: Field, V: Field) -> Lie:
    """The lie of some sensors along d in the span of V, an invariant subspace of A, real or complex.

    Args:
        X: (m, n), the sensors in units of their noise.
        sensors: who lies, counted from 0.
        d: (n,); of a complex direction the real or imaginary part is taken, whichever the sensors see more
            of.
        V: (n, g).
    """
    basis = np.linalg.qr(np.hstack([V.real, V.imag]) if np.iscomplexobj(V) else V)[0]
    keep = np.linalg.matrix_rank(np.hstack([V.real, V.imag])) if np.iscomplexobj(V) else basis.shape[1]
    basis = basis[:, :keep]
    parts = [d.real, d.imag] if np.iscomplexobj(d) else [d]
    seen = [float(np.linalg.norm(X @ part)) for part in parts]
    direction = parts[int(np.argmax(seen))] / max(seen)
    return Lie(
        plant, tuple(plant.sensor_names[i] for i in sensors), direction, basis, basis.T @ plant.A @ basis
    )
