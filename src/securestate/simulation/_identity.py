"""What tells scenarios and recipes apart, in this process and in any other: hashes of their content."""

from __future__ import annotations

import functools
import hashlib
import inspect
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from securestate.plant import Belief, Plant

PACKAGE = __name__.split(".")[0]


class NamelessError(Exception):
    """Something has no identity in another process: a lambda, or an object that we cannot look into."""


def digest(*parts: str) -> str:
    """Hash of texts, each with its length, so that their borders count."""
    total = hashlib.sha256()
    for part in parts:
        data = part.encode("utf-8", "surrogatepass")
        total.update(len(data).to_bytes(8, "little") + data)
    return total.hexdigest()


def content(value: Plant | Belief) -> str:
    """Hash of every attribute of a plant or a belief."""
    total = hashlib.sha256()
    for name, held in sorted(vars(value).items()):
        if name != "sensors":  # all they say is in the other attributes
            array = isinstance(held, np.ndarray)
            total.update(f"{name} {held.shape if array else held!r}".encode())
            total.update(held.tobytes() if array else b"")
    return total.hexdigest()


def identity(value: Any) -> str:
    """A text that equal values share and others do not, the same in every process.

    Raises:
        NamelessError: there is none.
    """
    if isinstance(value, Plant | Belief):
        return content(value)
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        return digest("array", value.dtype.str, repr(value.shape), value.tobytes().hex())
    if isinstance(value, list | tuple):
        return digest(type(value).__name__, *map(identity, value))
    if isinstance(value, Mapping):
        return digest("mapping", *sorted(identity(pair) for pair in value.items()))
    if isinstance(value, functools.partial):
        return digest("partial", *map(identity, (value.func, value.args, value.keywords)))
    if inspect.isclass(value) or inspect.isroutine(value):
        return _named(value)
    if isinstance(value, Enum) or not is_dataclass(value):
        return _plain(value)
    if set(vars(value)) - {f.name for f in fields(value)}:
        raise NamelessError(f"a {type(value).__name__} with attributes that are no fields")
    return digest(_named(type(value)), *(identity((f.name, getattr(value, f.name))) for f in fields(value)))


def _plain(value: Any) -> str:
    """A number, a text, None, or a member of an enumeration."""
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic | Enum):
        return digest(f"{type(value).__module__}.{type(value).__qualname__}", repr(value))
    raise NamelessError(f"a {type(value).__name__}")


def _named(thing: Any) -> str:
    """Where a class or function is found, with its source if that is not ours."""
    module, name = getattr(thing, "__module__", None), getattr(thing, "__qualname__", "<")
    if module is None or "<" in name or inspect.ismethod(thing):
        raise NamelessError(name)
    if module.split(".")[0] == PACKAGE:
        return digest(module, name)
    read = identity(_read(thing))
    try:
        return digest(module, name, inspect.getsource(thing), read)
    except (OSError, TypeError):  # typed in, or not written in Python
        return digest(module, name, read)


def _read(thing: Any) -> list[tuple[str, Any]]:
    """The values that the code of a function, or of a class, reads from its module: constants, not code."""
    functions = vars(thing).values() if inspect.isclass(thing) else [thing]
    found: dict[str, Any] = {}
    for function in (each for each in functions if inspect.isfunction(each)):
        for name in function.__code__.co_names:
            value = function.__globals__.get(name)
            if name in function.__globals__ and not (inspect.ismodule(value) or callable(value)):
                found[name] = value
    return sorted(found.items())


@functools.cache
def code_key() -> str:
    """Hash of this package's code, kernels included: results of other code are not continued."""
    folder = Path(__file__).parents[1]
    total = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.suffix in (".py", ".so", ".pyd")):
        total.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return total.hexdigest()
