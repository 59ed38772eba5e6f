"""The controller (64)-(68) that is to give (69)."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from papers._report import Value
from papers.chen2022.setting import Setting


def controller(setting: Setting) -> dict[str, Value]:
    """Stability of A_c + B_c K_c as printed, of any K_c that rounds to the printed one, and of (69)."""
    choice = setting.config["controller"]
    A_c, B_c, K_c = (np.array(choice[name]) for name in ("A_c", "B_c", "K_c"))
    modes = np.linalg.eigvals(A_c + B_c @ K_c)
    rng = np.random.default_rng(choice["seed"])
    rounded = K_c + choice["rounding"] * rng.uniform(-1, 1, (choice["draws"], *K_c.shape))
    growth = np.linalg.eigvals(A_c + B_c @ rounded).real.max(axis=1)
    share = float((growth < 0).mean())
    sampled = np.linalg.eigvals(expm(choice["period"] * (A_c + B_c @ K_c)))
    return {
        "controller.growth": Value(float(modes.real.max())),
        "controller.radius": Value(float(np.abs(sampled).max())),
        "controller.period": Value(float(2 * np.pi / np.abs(modes.imag).max())),
        "controller.stable share": Value(share, float(np.sqrt(share * (1 - share) / choice["draws"]))),
        "controller.radius of (69)": Value(float(np.abs(np.linalg.eigvals(setting.plant.A)).max())),
    }
