"""Types of arrays, of tables and of what draws them, named once."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:  # slow to import
    from pandas import DataFrame

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
Pair = tuple[Array, Array]
Named = dict[str, Anything]
Facts = dict[str, Any]  # by name
Numbers = dict[str, float]  # by name
Texts = Sequence[str]
Words = npt.NDArray[np.str_]
Tables = Mapping[str, "DataFrame"]  # by name
Shape = tuple[int, ...]
TwoInts = tuple[int, int]
Two = tuple[float, float]
