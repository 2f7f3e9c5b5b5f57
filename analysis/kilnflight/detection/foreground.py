"""What every 2D detector asks of a foreground."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError

LARGEST = 1e9  # far beyond any grey value, and safe in float32


def check_foreground(foreground: npt.NDArray[np.generic], where: str) -> npt.NDArray[Any]:
    """Return the foreground as an array, or raise an `InputError`.

    Raises
    ------
    InputError
        If it is not 2D, is not made of integers or floats, or a float is not finite (or
        beyond any grey value).
    """
    image = np.asarray(foreground)
    if image.ndim != 2:
        raise InputError(f"{where}: the foreground has shape {image.shape}; pass (rows, cols).")
    if image.dtype.kind not in "uif":
        raise InputError(f"{where}: the foreground is of {image.dtype}; pass integers or floats.")
    # compiled code takes the machine's byte order, and no half floats
    kind = np.dtype(np.float32) if image.dtype == np.float16 else image.dtype.newbyteorder("=")
    image = image.astype(kind, copy=False)
    least, most = (image.min(), image.max()) if image.size else (0, 0)  # NaN if one is
    if image.dtype.kind == "f" and not -LARGEST < least <= most < LARGEST:
        row, col = (int(i) for i in np.argwhere(~(np.abs(image) < LARGEST))[0])
        raise InputError(
            f"{where}: the foreground is {image[row, col]} at row {row}, col {col}; "
            "set such pixels to 0 before the call."
        )
    return image
