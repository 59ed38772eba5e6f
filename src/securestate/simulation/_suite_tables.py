"""The tables of a suite file and what their keys may be; `suite` says what they mean."""

from __future__ import annotations

import difflib
from typing import Annotated, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)

from securestate._checks import label
from securestate.errors import InputError

Name = Annotated[str, AfterValidator(lambda name: label("it", name, InputError))]
Whole = Annotated[int, Field(ge=0, strict=True)]
Count = Whole | tuple[Whole, Whole]
Positive = Annotated[int, Field(ge=1, strict=True)]
Variance = Annotated[float, Field(gt=0, strict=True, allow_inf_nan=False)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Open(BaseModel):
    """A table whose other keys are arguments of what it describes."""

    model_config = ConfigDict(extra="allow", frozen=True)


class Head(_Table):
    """What counts for the whole suite."""

    runs: Positive
    steps: Positive
    seed: Whole
    name: Name | Literal[""] = ""
    score_from: Whole = 0

    @model_validator(mode="after")
    def _something_counts(self) -> Self:
        if self.score_from >= self.steps:
            raise ValueError("score_from below steps")
        return self


class PlantTable(_Table):
    """A plant or a family."""

    name: Name
    file: str | None = None
    family: str | None = None
    runs_per_plant: Positive = 1


class Choice(_Table):
    """Whom an adversary attacks."""

    drawn: Count | None = None
    redrawn: Count | None = None
    switching: Count | None = None
    every: Positive | None = None
    among: list[str] | None = None

    @property
    def rule(self) -> tuple[str, int | tuple[int, int]]:
        """Which rule, and of how many sensors."""
        rules = {"drawn": self.drawn, "redrawn": self.redrawn, "switching": self.switching}
        (given,) = ((name, count) for name, count in rules.items() if count is not None)
        return given

    @model_validator(mode="after")
    def _one_rule(self) -> Self:
        rules = [self.drawn, self.redrawn, self.switching]
        if sum(rule is not None for rule in rules) != 1 or (self.every is None) != (self.switching is None):
            raise ValueError("one of drawn, redrawn, or switching with every")
        return self


def _form(given: object) -> str:
    """Which form `on` has, so that a mistake is told about that one only."""
    return "name" if isinstance(given, str) else "names" if isinstance(given, list) else "table"


On = Annotated[
    Annotated[str, Tag("name")] | Annotated[list[str], Tag("names")] | Annotated[Choice, Tag("table")],
    Discriminator(_form),
]


class PartTable(_Open):
    """One adversary of several at once."""

    kind: str
    on: On | None = None
    start: Whole | None = None


class AttackTable(_Open):
    """An adversary."""

    name: Name
    kind: str | None = None
    on: On | None = None
    start: Whole | None = None
    parts: Annotated[list[PartTable], Field(min_length=1)] | None = None


class ScenarioTable(_Table):
    """Who meets whom."""

    plant: str
    attacks: list[str] = Field(min_length=1)
    on: On | None = None
    start: Whole | None = None
    runs: Positive | None = None
    prior_variance: Variance | None = None
    label: Name | None = None


class EstimatorTable(_Open):
    """An estimator."""

    method: str
    name: Name | None = None


class SuiteFile(_Table):
    """The whole file."""

    suite: Head
    plant: list[PlantTable] = Field(min_length=1)
    attack: list[AttackTable] = Field(min_length=1)
    scenario: list[ScenarioTable] = []
    estimator: list[EstimatorTable] = []


def first_mistake(error: ValidationError) -> tuple[str, str, str]:
    """Where the first mistake is, what was expected and what came."""
    first = error.errors()[0]
    steps = [f"number {step + 1}" if isinstance(step, int) else step for step in first["loc"]]
    where, received = " ".join(steps) or "suite", repr(first["input"])[:80]
    if first["type"] == "missing":
        return where, "a value", "nothing"
    if first["type"] == "extra_forbidden":
        known = _keys(first["loc"])
        near = difflib.get_close_matches(str(first["loc"][-1]), known, n=1)
        return where, f"a key among {', '.join(known)}", f"an unknown key{f'; {near[0]}?' if near else ''}"
    if first["type"] == "greater_than_equal":
        return where, f"a whole number >= {first['ctx']['ge']}", received
    return where, first["msg"].removeprefix("Value error, "), received


def _keys(place: tuple[int | str, ...]) -> list[str]:
    """The keys of the table in which a key is unknown."""
    tables: dict[str, type[BaseModel]] = {
        "suite": Head,
        "plant": PlantTable,
        "scenario": ScenarioTable,
    }
    inside = SuiteFile if len(place) == 1 else Choice if "table" in place else tables[str(place[0])]
    return list(inside.model_fields)
