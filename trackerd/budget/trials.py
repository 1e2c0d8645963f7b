"""The Monte-Carlo: every layout, every case, so many trials; on one process or several, with one and the same result."""

import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from typing import TypeVar

import cv2

from trackerd.budget.adjustment import Bound, bound_of, by_adjustment
from trackerd.budget.outcome import Outcome
from trackerd.budget.settings import BudgetSettings
from trackerd.budget.simulate import TrialKey, readings
from trackerd.budget.source_method import by_source_method
from trackerd.budget.stage import Stage, make_stage
from trackerd.contract.errors import Degenerate, Undetermined

CHUNK = 10  # trials a worker takes at once

Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class Trial:
    """Both methods on the same readings of the one view. None: it ended in a refusal."""

    source: Outcome | None
    adjusted: Outcome | None


@dataclass(frozen=True, slots=True)
class CaseRun:
    """All trials of one case in one layout, and the bound for each set of points."""

    layout: str
    case: str
    trials: tuple[Trial, ...]
    bounds: tuple[Bound, ...]


@dataclass(frozen=True, slots=True)
class _Job:
    layout: str
    case: str
    trials: tuple[int, ...] = ()
    draws: tuple[int, ...] = ()  # whose bounds are asked for


def count_of(settings: BudgetSettings) -> int:
    """How often `progress` will be called: trials and bounds."""
    each = settings.trials + min(settings.points.draws, settings.trials)
    return len(settings.layout) * len(settings.case) * each


def run(settings: BudgetSettings, workers: int, progress: Callable[[int], None] = lambda _: None) -> list[CaseRun]:
    """In the order of layouts and cases. `progress` is told how many trials and bounds are done with each call.

    Raises ConfigError where a layout cannot see its points.
    """
    draws = range(settings.points.draw, settings.points.draw + min(settings.points.draws, settings.trials))
    for layout in settings.layout:
        for draw in draws:
            _stage(settings, layout, draw)  # refused here, before any process is started
    jobs = list(_jobs(settings, draws))
    answers: dict[_Job, tuple[Sequence[Trial], Sequence[Bound]]] = {}
    for job, answer in _answers(settings, jobs, workers):
        answers[job] = answer
        progress(len(job.trials) + len(job.draws))
    return [
        _joined(layout, case, [answers[job] for job in jobs if (job.layout, job.case) == (layout, case)])
        for layout in settings.layout
        for case in settings.case
    ]


def _joined(layout: str, case: str, parts: Sequence[tuple[Sequence[Trial], Sequence[Bound]]]) -> CaseRun:
    trials = tuple(trial for part, _ in parts for trial in part)
    return CaseRun(layout, case, trials, tuple(each for _, bounds in parts for each in bounds))


def _jobs(settings: BudgetSettings, draws: Sequence[int]) -> Iterator[_Job]:
    for layout in settings.layout:
        for case in settings.case:
            yield _Job(layout, case, draws=tuple(draws))
            for start in range(0, settings.trials, CHUNK):
                yield _Job(layout, case, tuple(range(start, min(start + CHUNK, settings.trials))))


def _answers(
    settings: BudgetSettings, jobs: Sequence[_Job], workers: int
) -> Iterator[tuple[_Job, tuple[Sequence[Trial], Sequence[Bound]]]]:
    if workers == 1:
        for job in jobs:
            yield job, _work(settings, job)
        return
    pool = ProcessPoolExecutor(workers, get_context("spawn"), _settle)
    try:
        futures = {pool.submit(_work, settings, job): job for job in jobs}
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _settle() -> None:
    """A worker has one core, and ends when it is told to: Ctrl-C is the parent's to answer."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)


def _work(settings: BudgetSettings, job: _Job) -> tuple[Sequence[Trial], Sequence[Bound]]:
    case = settings.case[job.case]
    bounds = [bound_of(_stage(settings, job.layout, draw), case) for draw in job.draws]
    return [_trial(settings, TrialKey(job.layout, job.case, number)) for number in job.trials], bounds


def _trial(settings: BudgetSettings, key: TrialKey) -> Trial:
    stage = _stage(settings, key.layout, settings.points.draw + key.trial % settings.points.draws)
    case = settings.case[key.case]
    read = readings(stage, case, key, settings.seed)
    source, start = _or_refused(lambda: by_source_method(stage, read)) or (None, None)
    return Trial(source, _or_refused(lambda: by_adjustment(stage, read, case, start)))


def _or_refused(method: Callable[[], Answer]) -> Answer | None:
    try:
        return method()
    except (Degenerate, Undetermined):
        return None


@lru_cache(maxsize=64)
def _stage_from(text: str, layout: str, draw: int) -> Stage:
    return make_stage(BudgetSettings.model_validate_json(text), layout, draw)


def _stage(settings: BudgetSettings, layout: str, draw: int) -> Stage:
    """Made once in each process: aiming at every point costs as much as a trial."""
    return _stage_from(settings.model_dump_json(), layout, draw)
