"""`python tests/bench/vision`: what the detector reaches, beside its limits and beside everybody else on the same images.

Errors are judged against each frame's own Cramér-Rao bound, times against a blur in the same run; both are told with the
limits that the project has set itself. The scenes depend on --seed and nothing else.
"""

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2

sys.path.insert(0, str(Path(__file__).parent))

from absent import absent_table
from accuracy import Judged, failures_table, judge, ours_table, peers_tables, reasons_table
from acquisition import acquisition_table
from figure import draw
from limits import LIMITS
from peers import ABSENT
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from speed import Yardstick, fit_table, peers_table
from still import still_table
from tables import WIDTH, Table
from trials import Trial, timed_trials, trials

from trackerd.vision import kernels

FRAMES, QUICK = 400, 40
STILL, EMPTY, FULL, TIMED = 500, 3000, 120, 60  # frames of the other sections, at FRAMES a category
BUILD = Path(__file__).parents[3] / "build" / "bench"

Advance = Callable[[], object]


class Bench:
    """What was asked for, and where it is told."""

    def __init__(self, asked: Namespace) -> None:
        self.asked = asked
        self.console = Console(width=WIDTH, highlight=False)
        self.progress = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), transient=True,
            console=Console(stderr=True),
        )  # fmt: skip
        self.yardstick = Yardstick()

    def run(self) -> None:
        self.console.print(f"kernel: {kernels.warm_up()}, seed {self.asked.seed}, {self.asked.frames} frames a category")
        if ABSENT:
            self.console.print(f"[bold]{ABSENT}[/]")
        with self.progress:
            self._accuracy([name for name in LIMITS if self._wanted(name)])
            if self._wanted("still"):
                with self._frames("still", self._scaled(STILL)) as frames:
                    still_table(frames).print(self.console)
            if self._wanted("empty"):
                with self._frames("empty", self._scaled(EMPTY)) as frames:
                    absent_table(frames, self.asked.peers).print(self.console)
            if self._wanted("acquisition"):
                count = self._scaled(FULL)
                with self._task("acquisition", count) as advance:
                    acquisition_table(self.asked.seed, count, self.yardstick, advance).print(self.console)
            if self._wanted("time"):
                self._time()

    def _accuracy(self, categories: list[str]) -> None:
        judged: list[Judged] = []
        for category in categories:
            with self._frames(category, self.asked.frames) as frames:
                judged.append(judge(category, frames, self.asked.peers))
        if not judged:
            return
        tables = [ours_table(judged), *(peers_tables(judged) if self.asked.peers else ()), reasons_table(judged)]
        self._print(*tables, failures_table(judged))
        draw(judged, self.asked.figure)
        self.console.print(f"\nfigure: {self.asked.figure}")

    def _time(self) -> None:
        with self._task("time", 1) as advance:
            frames = timed_trials(self.asked.seed, TIMED)
            self._print(fit_table(frames, self.yardstick), peers_table(frames, self.yardstick))
            advance()

    def _print(self, *tables: Table) -> None:
        for table in tables:
            table.print(self.console)

    def _wanted(self, name: str) -> bool:
        return not self.asked.only or name in self.asked.only

    def _scaled(self, count: int) -> int:
        return max(round(count * self.asked.frames / FRAMES), 20)

    @contextmanager
    def _frames(self, category: str, count: int) -> Iterator[Iterator[Trial]]:
        with self._task(category, count) as advance:
            yield trials(category, self.asked.seed, count, self.asked.cache, advance)

    @contextmanager
    def _task(self, name: str, count: int) -> Iterator[Advance]:
        task = self.progress.add_task(name, total=count)
        yield lambda: self.progress.advance(task)
        self.progress.remove_task(task)


def _asked() -> Namespace:
    parser = ArgumentParser(prog="python tests/bench/vision", description=__doc__.splitlines()[0])
    names = [*LIMITS, "still", "empty", "acquisition", "time"]
    parser.add_argument("--seed", type=int, default=1, help="of scenes, noise and guesses: another one is another set of all")
    parser.add_argument("--frames", type=int, default=FRAMES, help="of each category; the other sections scale with it")
    parser.add_argument("--quick", action="store_const", dest="frames", const=QUICK, help=f"the same as --frames {QUICK}")
    parser.add_argument("--only", action="append", choices=names, metavar="NAME", help=f"any of: {', '.join(names)}")
    parser.add_argument("--no-peers", action="store_false", dest="peers", help="ours alone")
    parser.add_argument("--figure", type=Path, default=BUILD / "vision.png", help="where k by category is drawn (PNG or SVG)")
    parser.add_argument("--cache", type=Path, help="a folder in which rendered scenes are kept for the next run")
    return parser.parse_args()


if __name__ == "__main__":
    cv2.setNumThreads(1)
    Bench(_asked()).run()
