"""One sensor of a plant, checked on construction."""

from collections.abc import Sequence
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from securestate import _checks as check
from securestate._checks import Array
from securestate._value import Value
from securestate.errors import PlantError


@final
class Sensor(Value):
    """One sensor: one or more scalar channels that can be tampered with only together.

    Args:
        name: the sensor's name; unique in its plant.
        C: how the channels see the state, shape (n,) for one channel, (c, n), or (T, c, n) if it varies.
        R: noise of the channels in normalised units: one variance, variances (c,) or a covariance (c, c).
            None if the plant carries the covariance of all channels.
        D: feedthrough of the inputs, shape (p,) for one channel or (c, p).
        protected: True if nobody can tamper with this sensor.
        verifiable: False if no other sensor can vouch for this one, so that nothing but the plant's
            expectation speaks for or against it. Its trust is then NaN wherever it is not suspected, unless
            it is protected.
        channels: names of the channels. Default: the sensor's name, or name.1, name.2, ... for several.
        offset, scale: operating point, a number or one per channel; scale > 0.
        unit: engineering unit, one text for all channels or one per channel.

    Raises:
        PlantError: names the sensor and argument, what was expected and what came.

    Examples:
        >>> Sensor("flow", C=[[1, 0]], R=0.1)
        Sensor('flow', channels=1)
        >>> Sensor("flow", C=[[1, 0]], R=0.1, scale=0)
        Traceback (most recent call last):
        securestate.errors.PlantError: sensor 'flow': scale: expected numbers > 0, received 0.0
    """

    name: str
    C: Array
    R: Array | None
    D: Array | None
    protected: bool
    verifiable: bool
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
        verifiable: bool = True,
        channels: Sequence[str] | None = None,
        offset: ArrayLike = 0.0,
        scale: ArrayLike = 1.0,
        unit: str | Sequence[str] = "",
    ) -> None:
        name = check.label("sensor name", name, PlantError)
        at = f"sensor {name!r}: "
        seen = _observation(f"{at}C", C)
        count = seen.shape[-2]
        self._fill(
            name=name,
            C=seen,
            R=None if R is None else check.covariance(f"{at}R", R, count, "one per channel", PlantError),
            D=None if D is None else _feedthrough(f"{at}D", D, count),
            protected=check.yes_or_no(f"{at}protected", protected, PlantError),
            verifiable=check.yes_or_no(f"{at}verifiable", verifiable, PlantError),
            channels=_channel_names(f"{at}channels", channels, name, count),
            offset=check.per_item(f"{at}offset", offset, count, "channel", PlantError),
            scale=check.positive_per_item(f"{at}scale", scale, count, "channel", PlantError),
            unit=_units(f"{at}unit", unit, count),
        )

    def from_sample(self, first: int) -> "Sensor":
        """Return the same sensor, counted from sample `first` on."""
        return self if self.C.ndim == 2 else self.replaced(C=self.C[first:])

    def replaced(self, **changes: Any) -> "Sensor":
        """Return the same sensor with other arguments; a new name also renames its channels."""
        same = dict(vars(self))
        if "name" in changes:
            old, new = self.name, changes["name"]
            same["channels"] = [
                new + channel[len(old) :] if channel.startswith(old) else f"{new} {channel}"
                for channel in self.channels
            ]
        return Sensor(**(same | changes))

    def __repr__(self) -> str:
        marks = ", protected" * self.protected + ", not verifiable" * (not self.verifiable)
        return f"Sensor({self.name!r}, channels={len(self.channels)}{marks})"


def _observation(argument: str, value: object) -> Array:
    """Return C with shape (c, n) or (T, c, n), no channel blind to every state at all times."""
    numbers = check.real_array(argument, value, PlantError)
    if numbers.ndim == 1 and numbers.size:
        numbers = numbers[None, :]
    if numbers.ndim not in (2, 3) or not numbers.size:
        raise PlantError(argument, "shape (n,), (c, n) or (T, c, n)", f"shape {numbers.shape}")
    blind = ~np.any(numbers, axis=-1)
    blind = blind if numbers.ndim == 2 else blind.all(axis=0)
    if blind.any():
        raise PlantError(argument, "channels that see some state", f"row {int(np.argmax(blind))} all zero")
    return numbers


def _feedthrough(argument: str, value: object, count: int) -> Array:
    """Return D of one sensor with shape (c, p)."""
    numbers = check.real_array(argument, value, PlantError)
    if numbers.ndim == 1:
        numbers = numbers[None, :]
    if numbers.ndim != 2 or len(numbers) != count:
        raise PlantError(argument, f"shape ({count}, p)", f"shape {numbers.shape}")
    return numbers


def _channel_names(argument: str, value: object, name: str, count: int) -> tuple[str, ...]:
    """Return the names of a sensor's channels; by default its own name, numbered if there are several."""
    if value is None:
        return (name,) if count == 1 else tuple(f"{name}.{i}" for i in range(1, count + 1))
    channels = check.labels(argument, value, count, PlantError)
    check.distinct(argument, channels, PlantError)
    return channels


def _units(argument: str, value: object, count: int) -> tuple[str, ...]:
    """Return one unit per channel; one text stands for all."""
    if isinstance(value, str):
        return (check.label(argument, value, PlantError, empty=True),) * count
    return check.labels(argument, value, count, PlantError, empty=True)
