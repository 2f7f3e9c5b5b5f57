"""Execution of all notebooks that are out of date, in an order that saves time.

A notebook runs again if its text, the package, the reference data, its settings or the
fetched data changed, or a figure that it saved is gone. What a run was made of stands
in ``<build>/<stem>.stamp``. ``make`` calls this.
"""

import hashlib
import os
import signal
import subprocess
import sys
import time
from argparse import ArgumentParser
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from execute import parse_parameters

from kilnflight.checks import InputError
from kilnflight.store import paths
from kilnflight.store.cache import PACKAGE, write_whole

# The longest begin, by number; in a full run 12 is as long as 24, for which it waits.
LONGEST = ("23", "24", "22", "20", "12", "50", "10", "32", "43", "60", "45", "56", "54")
COMPILES = "23"  # compiles what those of the kiln share, once for all of them
CAMPAIGNS = "50"  # detects in all campaigns; the others of 50 to 59 take its tables
SUMMARY = ("00", "01")  # collect what the others conclude
LABELLED = "12"  # shows its results beside those of the next
BESIDE = ("20", "22", "24")
MANY_PROCESSES = ("50", "56")  # get all processes in a full run, which is large
EXTERNAL = (
    "KILNFLIGHT_EXTERNAL",
    "KILNFLIGHT_RECORDINGS",
    "KILNFLIGHT_LABELLED",
    "KILNFLIGHT_FIGURES",
)
FETCHED = Path("build/external.txt")  # says what of the authors' data is there
POLL_S = 0.05  # pause between two looks at what runs
SHOWN = 10  # longest notebooks in the table of a full run


@dataclass(frozen=True)
class Plan:
    """What is run: notebooks of a scale with their parameters, into a folder.

    Parameters
    ----------
    sources
        Texts of the notebooks.
    scale
        "quick", "standard" or "full".
    jobs
        Notebooks side by side.
    parameters
        ``name=value`` for all, ``NN.name=value`` for notebook NN.
    build
        Folder of the executed notebooks.
    """

    sources: Sequence[Path]
    scale: str
    jobs: int
    parameters: Sequence[str]
    build: Path

    def arguments(self, source: Path) -> list[str]:
        """Return the parameters of a notebook."""
        given = [f"scale={self.scale}"]
        if self.scale == "full" and number(source) in MANY_PROCESSES:
            given.append(f"{number(source)}.jobs={self.jobs}")
        return [*given, *self.parameters]

    def given(self, source: Path) -> dict[str, object]:
        """Return the parameters of a notebook by name."""
        stems = [each.stem for each in self.sources]
        return parse_parameters(self.parameters, source.stem, stems)

    def stamp(self, source: Path) -> str:
        """Return a hash of all that a notebook's result depends on."""
        named = [os.environ.get(name, "") for name in EXTERNAL]
        fetched = FETCHED.read_text("utf-8") if FETCHED.is_file() else ""
        text = source.read_text("utf-8")
        parts = [text, sources_hash(), self.given(source), named, fetched]
        return hashlib.sha256(repr(parts).encode()).hexdigest()

    def is_current(self, source: Path) -> bool:
        """Return whether a notebook has run with all that it depends on."""
        stamp = self.build / f"{source.stem}.stamp"
        saved = self.build / f"{source.stem}.saved"
        executed = self.build / f"{source.stem}.ipynb"
        if not (executed.is_file() and stamp.is_file()):
            return False
        files = saved.read_text().splitlines() if saved.is_file() else []
        there = all(Path(file).is_file() for file in files)
        return there and stamp.read_text("utf-8") == self.stamp(source)


def number(source: Path) -> str:
    """Return the two digits that a notebook's name begins with."""
    return source.stem[:2]


def sources_hash() -> str:
    """Return a hash of the package, its fits and the reference data."""
    files = [
        *PACKAGE.rglob("*.py"),
        *PACKAGE.rglob("*.csv"),
        *paths.reference().rglob("*.csv"),
    ]
    files += paths.root().glob("identify/*.py")
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(f"{file.name} {file.stat().st_size} ".encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def waits_for(source: Path, stale: Collection[Path], scale: str) -> set[Path]:
    """Return the notebooks that have to be done before one begins.

    Parameters
    ----------
    source
        Notebook.
    stale
        All that are run.
    scale
        In a full run notebook 50 has many processes, and nothing runs beside it.
    """
    own = number(source)
    others = set(stale) - {source}
    if own in SUMMARY:
        return {each for each in others if number(each) not in SUMMARY}
    first = []
    if not own.startswith("4"):
        first.append(COMPILES)
    if own.startswith("5"):
        first.append(CAMPAIGNS)
    if own == LABELLED:
        first += BESIDE
    waited = {each for each in others if number(each) in first}
    if own == CAMPAIGNS and scale == "full":
        late = ("5", *SUMMARY)
        waited |= {each for each in others if not each.stem.startswith(late)}
    return waited


def run_all(plan: Plan, wanted: Sequence[Path]) -> int:
    """Execute the notebooks that are out of date; return the exit status.

    After the first failure no other begins. A summary runs again after any other.
    """
    stale = [source for source in wanted if not plan.is_current(source)]
    if not stale:
        return 0
    stale += [each for each in wanted if number(each) in SUMMARY]
    order = {name: k for k, name in enumerate(LONGEST)}
    waiting = sorted(
        dict.fromkeys(stale), key=lambda each: order.get(number(each), len(order))
    )
    before = {each: waits_for(each, waiting, plan.scale) for each in waiting}
    plan.build.mkdir(parents=True, exist_ok=True)
    write_whole(plan.build / "ran", b"")  # the pages are older now
    running: dict[Path, subprocess.Popen[bytes]] = {}
    begun: dict[Path, float] = {}
    done = set[Path]()
    status = 0
    print(f"{len(before)} notebooks{time_left(plan, waiting)}", flush=True)
    try:
        while running or (waiting and not status):
            ready = [source for source in waiting if before[source] <= done]
            if ready and not status and len(running) < plan.jobs:
                waiting.remove(ready[0])
                running[ready[0]] = _started(plan, ready[0])
                begun[ready[0]] = time.monotonic()
                continue
            time.sleep(POLL_S)
            for source, process in list(running.items()):
                if process.poll() is not None:
                    del running[source]
                    done.add(source)
                    status = status or process.returncode
                    if process.returncode == 0:
                        stamp = plan.build / f"{source.stem}.stamp"
                        write_whole(stamp, plan.stamp(source).encode())
                        took = f"{time.monotonic() - begun[source]:.0f}"
                        write_whole(seconds_of(plan, source), took.encode())
                        left = time_left(plan, [*waiting, *running])
                        told = f"{len(done)} of {len(before)} notebooks done{left}"
                        print(told, flush=True)
    finally:  # an interruption leaves lines of processes that stop
        for process in running.values():
            process.send_signal(signal.SIGINT)
            process.wait()
    if plan.scale == "full" and not (status or plan.parameters):
        save_times(plan)
    return status


def seconds_of(plan: Plan, source: Path) -> Path:
    """Return the file with the seconds that a notebook took last."""
    return plan.build / f"{source.stem}.seconds"


def save_times(plan: Plan) -> None:
    """Save the minutes of the longest notebooks as figures/full-run.csv.

    Nothing is saved before all have run.
    """
    if not all(seconds_of(plan, source).is_file() for source in plan.sources):
        return
    # Imported late: slow, and not needed where nothing is out of date.
    import pandas as pd

    from kilnflight.publication import figures

    seconds = {
        source.stem: float(seconds_of(plan, source).read_text())
        for source in plan.sources
    }
    minutes = pd.Series(seconds, name="minutes").div(60).rename_axis("notebook")
    shown = minutes.nlargest(SHOWN)
    shown.loc["the others"] = minutes.sum() - shown.sum()
    figures.save(
        "full-run",
        shown.round(1).reset_index(),
        caption="Minutes of each of the longest notebooks in the last full run.",
        provenance=figures.trace("tools/schedule", {"scale": plan.scale}, mark=""),
    )


def time_left(plan: Plan, waiting: Sequence[Path]) -> str:
    """Return about how long some notebooks take, by their last run; else nothing."""
    files = [seconds_of(plan, source) for source in waiting]
    if not files or not all(file.is_file() for file in files):
        return ""
    seconds = [float(file.read_text()) for file in files]
    left = max(sum(seconds) / plan.jobs, *seconds, 0.0)
    return f", about {left / 60:.0f} minutes left" if left > 90 else ", soon done"


def _started(plan: Plan, source: Path) -> subprocess.Popen[bytes]:
    """Return the process that executes a notebook."""
    (plan.build / f"{source.stem}.stamp").unlink(missing_ok=True)
    command = [sys.executable, "tools/execute.py", str(source)]
    command += ["--build", str(plan.build)]
    for parameter in plan.arguments(source):
        command += ["-p", parameter]
    return subprocess.Popen(command)


def main(arguments: Sequence[str] | None = None) -> int:
    """Execute what is out of date and return the exit status."""
    parser = ArgumentParser(prog="python tools/schedule.py")
    parser.add_argument("scale")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=[], metavar="NN")
    parser.add_argument("--parameters", nargs="*", default=[], metavar="name=value")
    parser.add_argument("--build", type=Path, help="folder (default: build/SCALE)")
    options = parser.parse_args(arguments)
    sources = sorted(Path("notebooks").glob("[0-9][0-9]_*.py"))
    plan = Plan(
        sources=sources,
        scale=options.scale,
        jobs=options.jobs,
        parameters=options.parameters,
        build=options.build or Path("build", options.scale),
    )
    wanted = [
        each for each in sources if number(each) in options.only or not options.only
    ]
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        for source in sources:  # a wrong one is told before any begins
            plan.given(source)
        return run_all(plan, wanted)
    except InputError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    raise SystemExit(main())
