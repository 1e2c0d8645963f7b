"""Blocking calls off the event loop, each in a thread of its own: one that hangs is left behind and never holds up the exit."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from threading import Thread
from typing import TypeVar

T = TypeVar("T")


def run_in_thread(work: Callable[[], T], name: str) -> "asyncio.Future[T]":
    """The outcome of `work`, run in a daemon thread; the thread has ended once the future is done."""
    loop = asyncio.get_running_loop()
    outcome: asyncio.Future[T] = loop.create_future()

    def settle(result: T | None, error: Exception | None) -> None:
        thread.join()
        if outcome.done():
            return
        if error is not None:
            outcome.set_exception(error)
        else:
            outcome.set_result(result)  # type: ignore[arg-type]

    def run() -> None:
        result, error = None, None
        try:
            result = work()
        except Exception as caught:
            error = caught
        with suppress(RuntimeError):  # the loop may be closed under a thread that was left behind
            loop.call_soon_threadsafe(settle, result, error)

    thread = Thread(target=run, name=name, daemon=True)
    thread.start()
    return outcome
