"""The lies of this example: which sensors, from when on, by how much. No randomness.

    python falsify.py OUT.csv

Both sensors are among those that the others can vouch for (see README.md).

* Reactor pressure reads 15 kPa too low from hour 10 on, at once. That is 0.5 % of 2705 kPa and 2.4 times the
  pressure's normal variation: no alarm limit would notice, but an operator would see room to spare.
* Separator temperature drifts upwards from hour 24 on, by 1 °C within 6 hours, and stays there. So does an
  adversary who knows that steps are watched for, and so does an ageing sensor.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Lie:
    """What is added to one channel: it grows in a straight line for `ramp` hours, then stays.

    Attributes:
        channel: column of the data file.
        start, ramp: hours; a ramp of 0 is a step.
        size: what is added in the end, in the channel's unit.
    """

    channel: str
    start: float
    ramp: float
    size: float

    def added(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what is added at each time in seconds, shape (T,)."""
        since = time / 3600 - self.start
        grown = np.clip(since / self.ramp, 0.0, 1.0) if self.ramp else (since >= 0).astype(np.float64)
        return self.size * grown


LIES = (
    Lie("XMEAS 7", start=10.0, ramp=0.0, size=-15.0),  # kPa gauge
    Lie("XMEAS 11", start=24.0, ramp=6.0, size=1.0),  # °C
)


def falsify(clean: pd.DataFrame) -> pd.DataFrame:
    """Return the record as the control room receives it."""
    time = clean["time"].to_numpy(dtype=np.float64)
    lies = {lie.channel: (clean[lie.channel] + lie.added(time)).round(6) for lie in LIES}
    return clean.assign(**lies)


def main(target: Path) -> Path:
    """Write the falsified record."""
    falsify(pd.read_csv(HERE / "data.csv")).to_csv(target, index=False)
    return target


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    print(f"wrote {main(Path(sys.argv[1]))}")
