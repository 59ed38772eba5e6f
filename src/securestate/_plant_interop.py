"""State-space systems of other libraries, told by their attributes, so that none of them is needed."""

from collections.abc import Iterable, Sequence
from typing import Any

from securestate import _checks as check
from securestate._sensor import Sensor
from securestate.errors import PlantError


def plant_arguments(
    system: object,
    Q: object,
    R: object,
    sensor_names: Sequence[str] | None,
    state_names: Sequence[str] | None,
    input_names: Sequence[str] | None,
    protected: Iterable[str],
    name: str | None,
) -> dict[str, Any]:
    """Return the arguments of `Plant` for a discrete-time system: one sensor per output."""
    A, B, C, D = (_matrix(system, key) for key in "ABCD")
    outputs = _labels(system, "output", sensor_names, len(C), "y")
    safe = check.labels("protected", protected, None, PlantError)
    for unknown in set(safe) - set(outputs):
        raise PlantError("protected", f"names among {', '.join(outputs)}", repr(unknown))
    return {
        "A": A,
        "Q": Q,
        "sensors": [Sensor(o, row, protected=o in safe) for o, row in zip(outputs, C, strict=True)],
        "B": B,
        "D": D,
        "R": R,
        "dt": _sample_time(system),
        "state_names": _labels(system, "state", state_names, len(A), "x"),
        "input_names": _labels(system, "input", input_names, B.shape[1], "u"),
        "name": str(getattr(system, "name", None) or "") if name is None else name,
    }


def _matrix(system: object, key: str) -> check.Array:
    matrix = getattr(system, key, None)
    if matrix is None:
        advice = "a discrete-time state-space system with A, B, C, D (convert a transfer function first)"
        raise PlantError("sys", advice, type(system).__name__)
    numbers = check.real_array(f"sys.{key}", matrix, PlantError)
    if numbers.ndim != 2:
        raise PlantError(f"sys.{key}", "two dimensions", f"shape {numbers.shape}")
    return numbers


def _sample_time(system: object) -> float:
    dt = getattr(system, "dt", None)
    if dt is True:  # both libraries: discrete, sample time not said
        return 1.0
    if dt is None or (not isinstance(dt, bool) and dt == 0):
        advice = "a discrete-time system; sample a continuous one first (sample_system, to_discrete)"
        raise PlantError("sys", advice, f"dt={dt}")
    return check.positive_number("sys.dt", dt, PlantError)


def _labels(
    system: object, kind: str, given: Sequence[str] | None, count: int, prefix: str
) -> tuple[str, ...]:
    """Return the names given, else those of the system, else prefix1, prefix2, ..."""
    argument = {"output": "sensor_names", "state": "state_names", "input": "input_names"}[kind]
    if given is not None:
        return check.labels(argument, given, count, PlantError)
    own = getattr(system, f"{kind}_labels", None)
    if own is not None:
        return check.labels(f"sys.{kind}_labels", own, count, PlantError)
    return tuple(f"{prefix}{i}" for i in range(1, count + 1))
