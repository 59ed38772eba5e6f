"""The nouns: a plant, its sensors, and a belief about its state. Checked on construction, immutable afterwards.

    x[k+1] = A x[k] + B ut[k] + w[k],               w ~ N(0, Q)
    y[k]   = offset + scale * (C x[k] + D ut[k] + v[k]),   v ~ N(0, R)
    ut[k]  = (u[k] - input_offset) / input_scale

`y` and `u` are in the engineering units of files; A, B, C, D, Q, R and x are in normalised units.
With the default operating point (offsets 0, scales 1) the two are the same.

n states, m channels (scalar measurements), N sensors (each owns one or more channels), p inputs.
"""

from collections.abc import Iterable, Sequence
from typing import ClassVar, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from securestate import _checks as check
from securestate import _plant_build as build
from securestate._value import Value
from securestate.errors import InputError, PlantError, ShapeError

Array = NDArray[np.float64]


@final
class Sensor(Value):
    """One sensor: one or more scalar channels that can be tampered with only together.

    Args:
        name: the sensor's name; unique in its plant.
        C: how the channels see the state, shape (n,) for one channel, (c, n), or (T, c, n) if it varies in time.
        R: noise of the channels in normalised units: one variance, variances (c,) or a covariance (c, c).
            None if the plant carries the covariance of all channels.
        D: feedthrough of the inputs, shape (p,) for one channel or (c, p).
        protected: True if nobody can tamper with this sensor.
        channels: names of the channels. Default: the sensor's name, or name.1, name.2, ... if there are several.
        offset, scale: operating point, a number or one per channel; scale > 0.
        unit: engineering unit, one text for all channels or one per channel.

    Raises:
        PlantError: names the sensor and argument, what was expected and what came.

    Examples:
        >>> Sensor("flow", C=[[1, 0]], R=0.1)
        Sensor('flow', channels=1)
        >>> Sensor("flow", C=[[1, 0]], R=-0.1)
        Traceback (most recent call last):
        securestate.errors.PlantError: sensor 'flow': R: expected variances > 0 on the diagonal, received -0.1 at [0, 0]
    """

    name: str
    C: Array
    R: Array | None
    D: Array | None
    protected: bool
    channels: tuple[str, ...]
    offset: Array
    scale: Array
    unit: tuple[str, ...]

    def __init__(
        self,
        name: str,
        C: ArrayLike,
        R: ArrayLike | None = None,
        *,
        D: ArrayLike | None = None,
        protected: bool = False,
        channels: Sequence[str] | None = None,
        offset: ArrayLike = 0.0,
        scale: ArrayLike = 1.0,
        unit: str | Sequence[str] = "",
    ) -> None:
        name = check.label("sensor name", name, PlantError)
        at = f"sensor {name!r}: "
        seen = build.observation(f"{at}C", C)
        count = seen.shape[-2]
        self._fill(
            name=name,
            C=seen,
            R=None if R is None else check.covariance(f"{at}R", R, count, "one per channel", PlantError),
            D=None if D is None else build.feedthrough(f"{at}D", D, count),
            protected=check.yes_or_no(f"{at}protected", protected, PlantError),
            channels=build.channel_names(f"{at}channels", channels, name, count),
            offset=check.per_item(f"{at}offset", offset, count, "channel", PlantError),
            scale=check.positive_per_item(f"{at}scale", scale, count, "channel", PlantError),
            unit=build.units(f"{at}unit", unit, count),
        )

    def __repr__(self) -> str:
        return f"Sensor({self.name!r}, channels={len(self.channels)}{', protected' * self.protected})"


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
        offset, scale: (m,); input_offset, input_scale: (p,); protected: (N,) booleans.

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
        owned = _sensors(sensors)
        seen = build.stacked_observation(owned, n)
        build.agree_on_time(dynamics, owned)
        effect, through = build.inputs(B, D, owned, n)
        p = effect.shape[1]
        if input_names is not None and not p:
            build.refuse_names_without_inputs(input_names)
        self._fill(
            A=dynamics,
            Q=check.positive_semidefinite(
                "Q", check.shaped("Q", Q, (n, n), "(n, n)", PlantError), PlantError
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

    def select(self, sensors: Iterable[int]) -> "Plant":
        """Return the same plant with only these sensors (indices from 0), in the given order."""
        kept = list(sensors)
        rows = np.concatenate([np.arange(self.m)[self.channels_of(i)] for i in kept] or [np.arange(0)])
        own_noise = all(sensor.R is not None for sensor in self.sensors)
        own_feedthrough = any(sensor.D is not None for sensor in self.sensors)
        return Plant(
            self.A,
            self.Q,
            [self.sensors[i] for i in kept],
            B=self.B,
            D=None if own_feedthrough else self.D[rows],
            R=None if own_noise else self.R[np.ix_(rows, rows)],
            dt=self.dt,
            state_names=self.state_names,
            input_names=self.input_names or None,
            input_offset=self.input_offset,
            input_scale=self.input_scale,
            name=self.name,
        )

    def __repr__(self) -> str:
        called = f"{self.name!r}, " if self.name else ""
        varying = f"horizon={self.horizon}, " if self.time_varying else ""
        counts = f"n={self.n}, m={self.m}, sensors={self.n_sensors}, inputs={self.n_inputs}"
        return f"Plant({called}{counts}, {varying}dt={self.dt:g} s)"


@final
class Belief(Value):
    """What is believed about the state before the first measurement: x[0] ~ N(x, P).

    Args:
        x: mean, shape (n,), normalised units.
        P: covariance, shape (n, n), symmetric positive semidefinite; None: the steady state of the filter.

    Raises:
        ShapeError: x is not a vector, or P does not fit it.
        InputError: not finite real numbers, or P is not a covariance.

    Examples:
        >>> Belief([0, 0])
        Belief(n=2, P=steady state)
    """

    x: Array
    P: Array | None

    def __init__(self, x: ArrayLike, P: ArrayLike | None = None) -> None:
        mean = check.real_array("x", x, InputError)
        if mean.ndim != 1 or not mean.size:
            raise ShapeError("x", "shape (n,)", f"shape {mean.shape}")
        self._fill(x=mean, P=None if P is None else _belief_covariance(P, len(mean)))

    def __repr__(self) -> str:
        return f"Belief(n={len(self.x)}, P={'steady state' if self.P is None else 'given'})"


def _belief_covariance(P: ArrayLike, n: int) -> Array:
    spread = check.shaped("P", P, (n, n), "to fit x", ShapeError)
    return check.positive_semidefinite("P", spread, InputError)


def _sensors(sensors: object) -> tuple[Sensor, ...]:
    if isinstance(sensors, Sensor) or not isinstance(sensors, Iterable):
        raise PlantError("sensors", "a list of Sensor", check.describe(sensors))
    owned = tuple(sensors)
    for i, sensor in enumerate(owned):
        if not isinstance(sensor, Sensor):
            raise PlantError(f"sensors[{i}]", "a Sensor", check.describe(sensor))
    if not owned:
        raise PlantError("sensors", "at least one Sensor", "none")
    check.distinct("sensors", [sensor.name for sensor in owned], PlantError)
    return owned
