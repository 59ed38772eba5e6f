"""The parts of a plant, checked against each other: clean data comes back, or PlantError is raised."""

from collections.abc import Iterable, Sequence

import numpy as np

from securestate import _checks as check
from securestate._checks import Array
from securestate._sensor import Sensor
from securestate.errors import PlantError


def dynamics(value: object) -> Array:
    """Return A with shape (n, n) or (T, n, n), n and T at least 1."""
    numbers = check.real_array("A", value, PlantError)
    square = numbers.ndim in (2, 3) and numbers.shape[-1] == numbers.shape[-2]
    if not square or not numbers.size:
        raise PlantError("A", "shape (n, n) or (T, n, n)", f"shape {numbers.shape}")
    return numbers


def names(argument: str, value: object, prefix: str, count: int) -> tuple[str, ...]:
    """Return names that differ; by default prefix1, prefix2, ..."""
    if value is None:
        return tuple(f"{prefix}{i}" for i in range(1, count + 1))
    given = check.labels(argument, value, count, PlantError)
    check.distinct(argument, given, PlantError)
    return given


def refuse_names_without_inputs(value: object) -> None:
    """Refuse input names that no B and no D belong to; an empty list is fine."""
    if check.labels("input_names", value, None, PlantError):
        raise PlantError("input_names", "no names, as there is neither B nor D", check.describe(value))


def owned_sensors(sensors: object) -> tuple[Sensor, ...]:
    """Return the sensors of a plant: at least one, with names that differ."""
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


def stacked_observation(sensors: Sequence[Sensor], n: int) -> Array:
    """Return C of all sensors, (m, n) or (T, m, n)."""
    for sensor in sensors:
        if sensor.C.shape[-1] != n:
            raise PlantError(
                f"sensor {sensor.name!r}: C", f"{n} columns, one per state of A", f"shape {sensor.C.shape}"
            )
    horizons = {len(s.C): s.name for s in sensors if s.C.ndim == 3}
    if len(horizons) > 1:
        (first, one), (second, other) = list(horizons.items())[:2]
        raise PlantError(f"sensor {other!r}: C", f"{first} samples like sensor {one!r}", f"{second} samples")
    if not horizons:
        return np.concatenate([s.C for s in sensors])
    (length,) = horizons
    return np.concatenate([np.broadcast_to(s.C, (length, *s.C.shape[-2:])) for s in sensors], axis=1)


def agree_on_time(A: Array, sensors: Sequence[Sensor]) -> None:
    """Refuse an A and a C that vary over different numbers of samples."""
    for sensor in sensors:
        if A.ndim == 3 and sensor.C.ndim == 3 and len(A) != len(sensor.C):
            raise PlantError(
                f"sensor {sensor.name!r}: C", f"{len(A)} samples on its time axis, like A", f"{len(sensor.C)}"
            )


def inputs(B: object, D: object, sensors: Sequence[Sensor], n: int) -> tuple[Array, Array]:
    """Return B (n, p) and D (m, p); what is not given is zero, and p is 0 if neither is given."""
    m = sum(len(sensor.channels) for sensor in sensors)
    through = _plant_feedthrough(D, sensors, m)
    p = 0 if through is None else through.shape[1]
    effect = np.zeros((n, p)) if B is None else check.real_array("B", B, PlantError)
    if effect.ndim != 2 or len(effect) != n:
        raise PlantError("B", f"shape ({n}, p), n from A", f"shape {effect.shape}")
    if through is None:
        return effect, np.zeros((m, effect.shape[1]))
    if effect.shape[1] != p:
        raise PlantError("D", f"{effect.shape[1]} columns, one per input of B", f"shape {through.shape}")
    return effect, through


def _plant_feedthrough(D: object, sensors: Sequence[Sensor], m: int) -> Array | None:
    owners = [(sensor.name, sensor.D) for sensor in sensors if sensor.D is not None]
    if not owners:
        return None if D is None else _full_feedthrough(D, m)
    first, block = owners[0]
    if D is not None:
        raise PlantError("D", "D on the plant or on its sensors", f"both (sensor {first!r} has one)")
    p = block.shape[1]
    for name, other in owners:
        if other.shape[1] != p:
            raise PlantError(
                f"sensor {name!r}: D", f"{p} columns like sensor {first!r}", f"shape {other.shape}"
            )
    return np.concatenate([np.zeros((len(s.channels), p)) if s.D is None else s.D for s in sensors])


def _full_feedthrough(D: object, m: int) -> Array:
    numbers = check.real_array("D", D, PlantError)
    if numbers.ndim != 2 or len(numbers) != m:
        raise PlantError("D", f"shape ({m}, p), a row per channel", f"shape {numbers.shape}")
    return numbers


def noise(R: object, sensors: Sequence[Sensor]) -> Array:
    """Return R (m, m), from the plant or as blocks from the sensors."""
    m = sum(len(sensor.channels) for sensor in sensors)
    has = [sensor.name for sensor in sensors if sensor.R is not None]
    lacks = [sensor.name for sensor in sensors if sensor.R is None]
    if R is not None:
        if has:
            raise PlantError("R", "R on the plant or on its sensors", f"both (sensor {has[0]!r} has one)")
        return check.covariance("R", R, m, "a row per channel", PlantError)
    if lacks:
        raise PlantError(f"sensor {lacks[0]!r}: R", "a noise covariance, here or on the plant", "none")
    full = np.zeros((m, m))
    start = 0
    for sensor in sensors:
        stop = start + len(sensor.channels)
        full[start:stop, start:stop] = sensor.R
        start = stop
    return full
