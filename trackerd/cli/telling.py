"""What several commands print: rows of figures, and how far the work has come."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table


@contextmanager
def progress(words: str, steps: int) -> Iterator[Callable[[], None]]:
    """Yields what is called after each step; a bar on standard error where that is a terminal."""
    columns = TextColumn(words), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task(words, total=steps)
        yield lambda: bar.advance(task)


def print_rows(name: str, rows: Sequence[tuple[str, str]]) -> None:
    """A table on a terminal, plain lines elsewhere."""
    console = Console()
    if not console.is_terminal:
        for title, words in rows:
            print(f"{title}: {words}")
        return
    table = Table(title=name, show_header=False, title_justify="left")
    for row in rows:
        table.add_row(*row)
    console.print(table)
