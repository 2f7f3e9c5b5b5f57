"""Functions that numba compiles; their machine code is kept on disk."""

from numba import njit

compiled = njit(cache=True)
