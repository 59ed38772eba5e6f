"""From a model in normalised units to a plant with names, units and an operating point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from securestate import _checks as check
from securestate.errors import InputError
from securestate.identification.forms import Independent
from securestate.identification.history import History
from securestate.identification.prepare import Prepared
from securestate.plant import Plant, Sensor

Array = NDArray[np.float64]

#: Least variance of what tells two channels apart that repeat each other, as a share of the channel's
#: variance.
APART = 1e-3


def grouped(
    history: History, prepared: Prepared, sensors: Mapping[str, Sequence[str]] | None
) -> dict[str, list[int]]:
    """Channels of every sensor, by name, in the order of the history; channels left out are in none.

    Args:
        sensors: channels by sensor; a channel in no sensor is one of its own.
    Raises:
        InputError: names `sensors` if a channel is unknown, in two sensors, or a name is taken.
    """
    names = history.channel_names
    owner = {channel: channel for channel in names}
    for sensor, channels in (sensors or {}).items():
        check.label("sensors", sensor, InputError)
        for channel in check.labels(f"sensors[{sensor!r}]", channels, None, InputError):
            if channel not in owner:
                raise InputError(f"sensors[{sensor!r}]", "channels of the history", repr(channel))
            if owner[channel] != channel:
                raise InputError("sensors", "every channel in one sensor", f"{channel!r} in two")
            owner[channel] = sensor
    joined = dict(owner)
    for group in prepared.groups:  # what repeats each other is one sensor, with all that belongs to it
        members = list(dict.fromkeys(joined[names[i]] for i in group.channels))
        if len(members) > 1:
            whole = " + ".join(members)
            joined = {channel: whole if sensor in members else sensor for channel, sensor in joined.items()}
    found: dict[str, list[int]] = {}
    for i in sorted(i for group in prepared.groups for i in group.channels):
        found.setdefault(joined[names[i]], []).append(i)
    return found


def assemble(
    model: Independent, history: History, prepared: Prepared, sensors: Mapping[str, list[int]], name: str
) -> Plant:
    """The plant of a model whose channels are the groups of `prepared`.

    Channels that repeat each other see the same state, and share one noise; what tells them apart is added.
    """
    place = {
        i: (g, sign)
        for g, group in enumerate(prepared.groups)
        for i, sign in zip(group.channels, group.signs, strict=True)
    }
    noise = _noise(model, history, prepared)
    made = []
    for sensor, channels in sensors.items():
        rows, signs = zip(*(place[i] for i in channels), strict=True)
        turned = np.array(signs)[:, None]
        made.append(
            Sensor(
                sensor,
                C=model.C[list(rows)] * turned,
                R=noise[np.ix_(channels, channels)],
                D=model.D[list(rows)] * turned if np.any(model.D) else None,
                channels=[history.channel_names[i] for i in channels],
                unit=[history.units[i] for i in channels],
                offset=prepared.offset[channels],
                scale=prepared.scale[channels],
            )
        )
    used = prepared.inputs
    return Plant(
        model.A,
        model.Q,
        made,
        B=model.B if len(used) else None,
        dt=1.0 if history.dt is None else history.dt,
        input_names=[history.input_names[i] for i in used] if len(used) else None,
        input_offset=prepared.input_offset if len(used) else 0.0,
        input_scale=prepared.input_scale if len(used) else 1.0,
        name=name,
    )


def _noise(model: Independent, history: History, prepared: Prepared) -> Array:
    """Noise covariance of all channels of the history; rows of channels left out are not used."""
    R = np.eye(len(history.channel_names))
    z = np.vstack([(y - prepared.offset) / prepared.scale for y, _ in history.segments])
    for r, group in zip(model.r, prepared.groups, strict=True):
        rows, signs = list(group.channels), np.array(group.signs)
        shared = np.full((len(rows), len(rows)), r)
        if len(rows) > 1:
            turned = z[np.isfinite(z[:, rows]).all(axis=1)][:, rows] * signs
            apart = turned - turned.mean(axis=1, keepdims=True)
            shared = shared + apart.T @ apart / len(apart) + APART * np.eye(len(rows))
        R[np.ix_(rows, rows)] = shared * np.outer(signs, signs)
    return R


def scaled_noise(plant: Plant, factor: float) -> Plant:
    """The same plant with every noise larger by this factor, as a variance: the same gains, larger errors."""
    sensors = [sensor.replaced(R=None if sensor.R is None else factor * sensor.R) for sensor in plant.sensors]
    return plant.replaced(Q=factor * plant.Q, sensors=sensors, R=_shared(sensors, factor * plant.R))


def marked(plant: Plant, verifiable: Mapping[str, bool]) -> Plant:
    """The same plant, its sensors marked as verifiable or not."""
    sensors = [sensor.replaced(verifiable=verifiable[sensor.name]) for sensor in plant.sensors]
    return plant.replaced(sensors=sensors)


def with_matrices(plant: Plant, model: Independent) -> Plant:
    """The same plant with the matrices of this model, whose channels are the plant's."""
    sensors = []
    for i, sensor in enumerate(plant.sensors):
        rows = plant.channels_of(i)
        R = None if sensor.R is None else np.diag(model.r[rows])
        sensors.append(sensor.replaced(C=model.C[rows], R=R, D=None))
    R = _shared(sensors, np.diag(model.r))
    return plant.replaced(A=model.A, B=model.B, Q=model.Q, sensors=sensors, D=model.D, R=R)


def _shared(sensors: Sequence[Sensor], R: Array) -> Array | None:
    """R of the plant, None if every sensor carries its own."""
    return None if all(sensor.R is not None for sensor in sensors) else R
