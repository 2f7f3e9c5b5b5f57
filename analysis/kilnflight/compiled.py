"""Functions that numba compiles; their machine code is kept on disk."""

from functools import cache
from typing import Any

from numba import njit
from numba.core import event
from tqdm import tqdm

compiled = njit(cache=True)


class _Shown(event.Listener):
    """Says once that functions are compiled, and counts them in a bar."""

    bar: Any = None

    def on_start(self, event: Any) -> None:
        """Say it."""
        if self.bar is None:
            print("Functions are compiled, once: up to a minute.", flush=True)
            self.bar = tqdm(desc="compiling", unit=" functions", disable=None)

    def on_end(self, event: Any) -> None:
        """Count a function."""
        self.bar.update()


@cache  # one listener, however often it is called
def show_compiling() -> None:
    """Show from now on that functions are compiled; the bar only in a terminal."""
    event.register("numba:compile", _Shown())
