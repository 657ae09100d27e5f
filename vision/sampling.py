"""Grey between pixels."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from vision.jit import lean

Picture: TypeAlias = npt.NDArray[np.float32]
"""(H, W) float32 picture, or its slope."""


@lean
def sample(grey: Picture, u: float, v: float) -> float:
    """Bilinear grey value; outside the picture its border value."""
    rows, columns = grey.shape
    u = min(max(u, 0.0), columns - 1.001)
    v = min(max(v, 0.0), rows - 1.001)
    iu = int(u)
    iv = int(v)
    fu = u - iu
    fv = v - iv
    top = (1.0 - fu) * grey[iv, iu] + fu * grey[iv, iu + 1]
    low = (1.0 - fu) * grey[iv + 1, iu] + fu * grey[iv + 1, iu + 1]
    value: float = (1.0 - fv) * top + fv * low
    return value
