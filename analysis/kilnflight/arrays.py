"""Types of arrays, named once."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Single = npt.NDArray[np.float32]
Whole = npt.NDArray[np.int64]
Integers = npt.NDArray[np.integer]  # any width
Index = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]
Picture = npt.NDArray[np.uint8]
