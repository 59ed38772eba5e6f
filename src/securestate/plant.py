"""The nouns: a plant, its sensors, a belief about its state. Checked on construction, immutable afterwards.

    x[k+1] = A x[k] + B ut[k] + w[k],                      w ~ N(0, Q)
    y[k]   = offset + scale * (C x[k] + D ut[k] + v[k]),   v ~ N(0, R)
    ut[k]  = (u[k] - input_offset) / input_scale

`y` and `u` are in the engineering units of files; A, B, C, D, Q, R and x are in normalised units.
With the default operating point (offsets 0, scales 1) the two are the same.

n states, m channels (scalar measurements), N sensors (each owns c >= 1 channels), p inputs.

A plant file is TOML. Required are [plant] with A and Q, and at least one [[sensor]] with name and C::

    [plant]
    name = "two tanks"                 # default: empty
    dt = 0.5                           # seconds between samples; default 1
    state_names = ["level 1", "level 2"]   # or one [[state]] with a name per state; default x1, x2, ...
    A = [[0.9, 0.0], [0.1, 0.9]]       # (n, n), or (T, n, n) if it varies
    B = [[0.2], [0.0]]                 # (n, p); left out: no inputs
    Q = [1e-4, 1e-4]                   # (n, n), or the diagonal, or one variance
    # R = [[...], ...]                 # (m, m), only if noise is correlated between sensors
    # D = [[...], ...]                 # (m, p), if not given per sensor
    # arrays = "two-tanks.npz"         # beside this file; any matrix may then be the name of an array in it

    [[input]]                          # one per column of B
    name = "pump"
    offset = 3.0                       # default 0; u in files = offset + scale * input of the model
    scale = 1.5                        # default 1

    [[sensor]]
    name = "gauge 1"
    C = [1.0, 0.0]                     # (n,) for one channel, (c, n), or (T, c, n) if it varies
    R = 0.01                           # one variance, variances (c,), or (c, c)
    D = [0.05]                         # (p,) for one channel or (c, p); left out: no feedthrough
    protected = true                   # nobody can tamper with it; default false

    [[sensor]]
    name = "probe"
    channels = ["probe.low", "probe.high"]   # default: the sensor's name, with .1, .2, ... for several
    C = [[0.0, 1.0], [0.0, 2.0]]
    R = [0.02, 0.03]
    verifiable = false                 # no other sensor can vouch for it; default true
    unit = "cm"                        # or one per channel
    offset = [40.0, 80.0]              # a number or one per channel; y in files = offset + scale * model
    scale = 2.5
"""

import os
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from securestate import _checks as check
from securestate import _plant_build as build
from securestate import _plant_files as files
from securestate import _plant_interop as interop
from securestate import _plant_writer as writer
from securestate._belief import Belief
from securestate._checks import Array
from securestate._sensor import Sensor
from securestate._value import Value
from securestate.errors import InputError, PlantError

__all__ = ["Belief", "Plant", "Sensor"]


@final
class Plant(Value):
    """A plant with its sensors.

    Args:
        A: dynamics, shape (n, n), or (T, n, n) if they vary in time.
        Q: covariance of what is added to the state per step, shape (n, n), symmetric positive semidefinite.
        sensors: one or more `Sensor`, with different names.
        B: effect of the inputs, shape (n, p). None: no inputs, or zeros if there is a D.
        D: feedthrough of all channels, shape (m, p); or give it per sensor.
        R: noise covariance of all channels, shape (m, m), for noise that is correlated between sensors
            (one variance or variances (m,) also do); or give it per sensor.
        dt: seconds between samples, > 0.
        state_names, input_names: default x1, x2, ... and u1, u2, ...
        input_offset, input_scale: operating point of the inputs, a number or one per input; scale > 0.
        name: of the plant; may be empty.

    Attributes:
        C: (m, n), or (T, m, n) if any sensor's C varies in time; B (n, p), D (m, p) with p >= 0; R (m, m).
        n, m, n_sensors, n_inputs: counts. time_varying; horizon: T, or None for a plant that does not vary.
        channel_names (m), sensor_names (N), units (m): text. channel_sensor (m,): owner of every channel.
        offset, scale: (m,); input_offset, input_scale: (p,); protected, verifiable: (N,) booleans.

    Raises:
        PlantError: names the argument, what was expected and what came.

    Examples:
        >>> Plant([[1, 1], [0, 1]], [[0, 0], [0, 1]], [Sensor("position", C=[1, 0], R=4)], dt=0.5)
        Plant(n=2, m=1, sensors=1, inputs=0, dt=0.5 s)
    """

    _not_compared: ClassVar[frozenset[str]] = frozenset(
        {"sensors"}
    )  # all they say is in the other attributes

    A: Array
    Q: Array
    C: Array
    R: Array
    B: Array
    D: Array
    sensors: tuple[Sensor, ...]
    state_names: tuple[str, ...]
    channel_names: tuple[str, ...]
    sensor_names: tuple[str, ...]
    input_names: tuple[str, ...]
    units: tuple[str, ...]
    channel_sensor: NDArray[np.int64]
    offset: Array
    scale: Array
    input_offset: Array
    input_scale: Array
    protected: NDArray[np.bool_]
    verifiable: NDArray[np.bool_]
    dt: float
    name: str

    def __init__(
        self,
        A: ArrayLike,
        Q: ArrayLike,
        sensors: Iterable[Sensor],
        *,
        B: ArrayLike | None = None,
        D: ArrayLike | None = None,
        R: ArrayLike | None = None,
        dt: float = 1.0,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
        input_offset: ArrayLike = 0.0,
        input_scale: ArrayLike = 1.0,
        name: str = "",
    ) -> None:
        dynamics = build.dynamics(A)
        n = dynamics.shape[-1]
        owned = build.owned_sensors(sensors)
        seen = build.stacked_observation(owned, n)
        build.agree_on_time(dynamics, owned)
        effect, through = build.inputs(B, D, owned, n)
        p = effect.shape[1]
        if input_names is not None and not p:
            build.refuse_names_without_inputs(input_names)
        self._fill(
            A=dynamics,
            Q=check.positive_semidefinite(
                "Q", check.shaped("Q", Q, (n, n), ", n from A", PlantError), PlantError
            ),
            C=seen,
            R=build.noise(R, owned),
            B=effect,
            D=through,
            sensors=owned,
            state_names=build.names("state_names", state_names, "x", n),
            channel_names=tuple(channel for sensor in owned for channel in sensor.channels),
            sensor_names=tuple(sensor.name for sensor in owned),
            input_names=build.names("input_names", input_names, "u", p),
            units=tuple(unit for sensor in owned for unit in sensor.unit),
            channel_sensor=np.repeat(np.arange(len(owned), dtype=np.int64), [len(s.channels) for s in owned]),
            offset=np.concatenate([sensor.offset for sensor in owned]),
            scale=np.concatenate([sensor.scale for sensor in owned]),
            input_offset=check.per_item("input_offset", input_offset, p, "input", PlantError),
            input_scale=check.positive_per_item("input_scale", input_scale, p, "input", PlantError),
            protected=np.array([sensor.protected for sensor in owned], dtype=np.bool_),
            verifiable=np.array([sensor.verifiable for sensor in owned], dtype=np.bool_),
            dt=check.positive_number("dt", dt, PlantError),
            name=check.label("name", name, PlantError, empty=True),
        )
        check.distinct("channels of the sensors", self.channel_names, PlantError)

    @property
    def n(self) -> int:
        """Number of states."""
        return int(self.A.shape[-1])

    @property
    def m(self) -> int:
        """Number of channels (scalar measurements)."""
        return len(self.channel_names)

    @property
    def n_sensors(self) -> int:
        """Number of sensors."""
        return len(self.sensors)

    @property
    def n_inputs(self) -> int:
        """Number of inputs; may be 0."""
        return int(self.B.shape[1])

    @property
    def uncheckable(self) -> NDArray[np.bool_]:
        """(N,): sensors that may lie and that no other can vouch for; trust in them is only ever distrust."""
        alone: NDArray[np.bool_] = ~(self.verifiable | self.protected)
        return alone

    @property
    def time_varying(self) -> bool:
        """True if A or C has a leading time axis."""
        return self.horizon is not None

    @property
    def horizon(self) -> int | None:
        """Number of samples that a time-varying plant describes; None for a plant that does not vary."""
        return next((int(array.shape[0]) for array in (self.A, self.C) if array.ndim == 3), None)

    def channels_of(self, sensor: int) -> slice:
        """Return where the channels of one sensor, counted from 0, lie among all channels."""
        if not 0 <= sensor < self.n_sensors:
            raise InputError("sensor", f"an index in 0..{self.n_sensors - 1}", str(sensor))
        start, stop = np.searchsorted(self.channel_sensor, [sensor, sensor + 1])
        return slice(int(start), int(stop))

    def normalise(self, y: Array) -> Array:
        """Turn measurements (..., m) from file units into the units of C x."""
        return (y - self.offset) / self.scale

    def denormalise(self, y: Array) -> Array:
        """Turn measurements (..., m) from the units of C x into file units."""
        return self.offset + self.scale * y

    def normalise_input(self, u: Array) -> Array:
        """Turn inputs (..., p) from file units into the units of B and D."""
        return (u - self.input_offset) / self.input_scale

    def reading(self, x: Array, u: Array, first: int = 0) -> Array:
        """Return what sensors without noise would send, C x + D u in file units, (..., T, m).

        Args:
            x: states of successive samples, (..., T, n); `first` is the number of the first one, which counts
                where C varies in time.
            u: inputs, (..., T, p), file units.
        """
        C = self.C[first : first + x.shape[-2]] if self.C.ndim == 3 else self.C
        seen: Array = np.einsum("...ij,...j->...i", C, x) + self.normalise_input(u) @ self.D.T
        return self.denormalise(seen)

    def successor(self, x: Array, u: Array, first: int = 0) -> Array:
        """Return where states move without noise, A x + B u, (..., T, n); arguments as for `reading`."""
        A = self.A[first : first + x.shape[-2]] if self.A.ndim == 3 else self.A
        moved: Array = np.einsum("...ij,...j->...i", A, x) + self.normalise_input(u) @ self.B.T
        return moved

    def select(self, sensors: Iterable[int]) -> "Plant":
        """Return the same plant with only these sensors (indices from 0), in the given order."""
        kept = list(sensors)
        rows = np.concatenate([np.arange(self.m)[self.channels_of(i)] for i in kept] or [np.arange(0)])
        return self._with(self.A, [self.sensors[i] for i in kept], rows)

    def with_sensors(self, extra: Iterable[Sensor]) -> "Plant":
        """Return the same plant with more sensors, whose noise depends on no other sensor's.

        Raises:
            PlantError: a name is taken, C does not fit, or a sensor comes without R.
        """
        more = list(extra)
        noise = [sensor.R for sensor in more if sensor.R is not None]
        if len(noise) < len(more):
            bare = next(sensor.name for sensor in more if sensor.R is None)
            raise PlantError(f"sensor {bare!r}: R", "a noise covariance", "None")
        D = np.vstack(
            [self.D, *(np.zeros((len(s.channels), self.n_inputs)) if s.D is None else s.D for s in more)]
        )
        R = block_diag(self.R, *noise)
        plain = [sensor.replaced(R=None, D=None) for sensor in (*self.sensors, *more)]
        return self._copy(self.A, plain, D, R)

    def with_protected(self, sensors: Iterable[int]) -> "Plant":
        """Return the same plant with these sensors (indices from 0) protected, too."""
        chosen = set(sensors)
        kept = [s.replaced(protected=True) if i in chosen else s for i, s in enumerate(self.sensors)]
        return self._with(self.A, kept, np.arange(self.m))

    def from_sample(self, first: int) -> "Plant":
        """Return the same plant counted from sample `first` on; itself if it does not vary in time."""
        if self.horizon is None:
            return self
        if not 0 <= check.whole_number("first", first, 0, InputError) < self.horizon:
            raise InputError("first", f"a sample in 0..{self.horizon - 1}", str(first))
        A = self.A[first:] if self.A.ndim == 3 else self.A
        return self._with(A, [sensor.from_sample(first) for sensor in self.sensors], np.arange(self.m))

    def _with(self, A: Array, sensors: list[Sensor], rows: NDArray[np.int64]) -> "Plant":
        """Return the same plant with these dynamics and sensors, whose channels are `rows` of this one."""
        own_noise = all(sensor.R is not None for sensor in self.sensors)
        own_feedthrough = any(sensor.D is not None for sensor in self.sensors)
        D = None if own_feedthrough else self.D[rows]
        return self._copy(A, sensors, D, None if own_noise else self.R[np.ix_(rows, rows)])

    def _copy(self, A: Array, sensors: list[Sensor], D: Array | None, R: Array | None) -> "Plant":
        return self.replaced(A=A, sensors=sensors, D=D, R=R)

    def replaced(self, **changes: Any) -> "Plant":
        """Return the same plant with other arguments. R and D go with the sensors if these carry their
        own.
        """
        sensors = changes.get("sensors", self.sensors)
        same: dict[str, Any] = {
            "A": self.A,
            "Q": self.Q,
            "sensors": sensors,
            "B": self.B,
            "D": None if any(sensor.D is not None for sensor in sensors) else self.D,
            "R": None if all(sensor.R is not None for sensor in sensors) else self.R,
            "dt": self.dt,
            "state_names": self.state_names,
            "input_names": self.input_names or None,
            "input_offset": self.input_offset,
            "input_scale": self.input_scale,
            "name": self.name,
        }
        return Plant(**(same | changes))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Plant":
        """Read a plant file; the format is described in `securestate.plant`.

        Raises:
            PlantError: names the file and the key, what was expected and what came.
        """
        target = files.plant_path(path)
        with files.naming(target):
            return cls(**files.plant_arguments(target))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a plant file that `load` reads back exactly; large matrices go to an .npz file beside it.

        Raises:
            PlantError: the path does not end in .toml, or cannot be written; no partial file is left behind.
        """
        writer.write_plant(self, files.plant_path(path))

    @classmethod
    def from_control(
        cls,
        sys: object,
        Q: ArrayLike,
        R: ArrayLike,
        *,
        sensor_names: Sequence[str] | None = None,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
        protected: Iterable[str] = (),
        name: str | None = None,
    ) -> "Plant":
        """Turn a discrete-time python-control StateSpace into a plant, one sensor per output.

        Args:
            sys: the system; dt must be a number of seconds. dt=True (sample time not said) is taken as 1 s.
            Q: process noise (n, n). R: measurement noise, one variance, variances (m,) or (m, m).
            sensor_names, state_names, input_names, name: default: those of the system.
            protected: names of the sensors that nobody can tamper with.

        Raises:
            PlantError: not in state-space form, continuous, no sample time, or anything `Plant` refuses.
        """
        return cls(
            **interop.plant_arguments(sys, Q, R, sensor_names, state_names, input_names, protected, name)
        )

    @classmethod
    def from_scipy(
        cls,
        sys: object,
        Q: ArrayLike,
        R: ArrayLike,
        *,
        sensor_names: Sequence[str] | None = None,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
        protected: Iterable[str] = (),
        name: str | None = None,
    ) -> "Plant":
        """Turn a scipy.signal.dlti in state-space form into a plant, one sensor per output.

        The arguments are those of `from_control`; names default to y1, y2, ..., x1, ... and u1, ...
        """
        return cls(
            **interop.plant_arguments(sys, Q, R, sensor_names, state_names, input_names, protected, name)
        )

    def __repr__(self) -> str:
        called = f"{self.name!r}, " if self.name else ""
        varying = f"horizon={self.horizon}, " if self.time_varying else ""
        counts = f"n={self.n}, m={self.m}, sensors={self.n_sensors}, inputs={self.n_inputs}"
        return f"Plant({called}{counts}, {varying}dt={self.dt:g} s)"
