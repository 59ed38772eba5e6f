"""What `identify` returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from securestate._words import count
from securestate.identification.forms import Innovations
from securestate.identification.judge import Verdict
from securestate.identification.order import OrderSearch
from securestate.plant import Plant


@final
@dataclass(frozen=True, eq=False)
class Identified:
    """A plant learned from a history, and how far it can be trusted.

    Attributes:
        plant: to be used; its operating point keeps files in engineering units. A sensor that the others
            cannot
            vouch for is not `verifiable`.
        verdict: judged by samples not used for fitting. Without a held-out record these are the last quarter
            of
            the history, judged with a model of the same order fitted to the rest; the plant is fitted to all.
        search: the orders tried.
        innovations: the best innovations form, in normalised units, channels as in `channels`.
        channels: channels of the innovations form; of several that repeat each other the first.
        likelihoods: log-likelihood in nats per sample over the steps of the last fit; they never fall.
        noise_factor: by how much Q and R were raised so that errors on new data are as large as the plant
            says.
        remarks: what was done to the data, and what stood out, one sentence each.
        samples, missing: of the history: how many, and the share of readings that were missing.
    """

    plant: Plant
    verdict: Verdict
    search: OrderSearch
    innovations: Innovations
    channels: tuple[str, ...]
    likelihoods: tuple[float, ...]
    noise_factor: float
    remarks: tuple[str, ...]
    samples: int
    missing: float

    def __str__(self) -> str:
        return "\n".join([self.headline, *self.verdict.sentences(), *self.remarks])

    @property
    def headline(self) -> str:
        """What was learned, in one sentence."""
        plant = self.plant
        inputs = f" and {count(plant.n_inputs, 'input')}" if plant.n_inputs else ""
        return (
            f"{plant.name or 'A plant'} of {count(plant.n, 'state')} learned from "
            f"{count(self.samples, 'sample')} of {count(plant.m, 'channel')}{inputs}."
        )
