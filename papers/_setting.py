"""What every reproduction has: a configuration, the scale of its simulations, a plant."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from securestate import Plant


@dataclass(frozen=True)
class BaseSetting:
    """Plant and configuration of one run of a program. `size` is "full" or "quick"."""

    folder: ClassVar[Path]
    size: str

    @cached_property
    def config(self) -> dict[str, Any]:
        return tomllib.loads((self.folder / "config.toml").read_text(encoding="utf-8"))

    @cached_property
    def scale(self) -> dict[str, int]:
        """How many runs of what."""
        return self.config[self.size]

    @cached_property
    def plant(self) -> Plant:
        return Plant.load(self.folder / "plant.toml")
