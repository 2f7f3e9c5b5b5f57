"""Types of arrays and of what draws them, named once."""

from typing import Any

import numpy as np
import numpy.typing as npt

ArrayLike = npt.ArrayLike
Anything = npt.NDArray[Any]
Array = npt.NDArray[np.float64]
Single = npt.NDArray[np.float32]
Whole = npt.NDArray[np.int64]
Integers = npt.NDArray[np.integer]  # any width
Index = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]
Gray = npt.NDArray[np.uint16]  # grey values
Picture = npt.NDArray[np.uint8]
Generator = np.random.Generator
