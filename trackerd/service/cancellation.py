"""A cancellation that a library has swallowed is still wanted.

asyncio.wait_for of Python 3.11, which pymodbus waits with, loses it when the awaited reply arrives in the same turn of the loop
(cpython issue 86296); pymodbus itself may turn it into an error of its own.
"""

import asyncio


def is_cancelled() -> bool:
    """Somebody has asked the current task to end."""
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0


def end_if_cancelled() -> None:
    if is_cancelled():
        raise asyncio.CancelledError
