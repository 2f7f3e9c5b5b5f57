"""Functions that numba compiles; their machine code is kept on disk."""

from typing import Any

from numba import njit
from numba.core import event
from tqdm import tqdm

compiled = njit(cache=True)


class _Shown(event.Listener):
    """Counts the functions that are compiled from now on, in a bar."""

    def __init__(self) -> None:
        self.bar = tqdm(desc="compiling", unit=" functions", disable=None)

    def on_start(self, event: Any) -> None:
        """Do nothing, as the bar counts what is done."""

    def on_end(self, event: Any) -> None:
        """Count a function."""
        self.bar.update()


def show_compiling() -> None:
    """Count compiled functions in a bar, if standard error is a terminal."""
    event.register("numba:compile", _Shown())
