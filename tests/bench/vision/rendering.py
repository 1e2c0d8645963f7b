"""Pictures made by processes, and kept in a folder where one is given: rendering takes most of the bench's time."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from multiprocessing import get_context
from os import environ
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Array
from trackerd.sim.bound import bound
from trackerd.sim.picture import Picture, Truth, expected, truth
from trackerd.sim.sensor import Sensor

Frame = tuple[npt.NDArray[np.float32], Truth | None, Array | None, Sensor]


@dataclass(frozen=True, slots=True)
class Rendered:
    expected_dn: npt.NDArray[np.float32]
    truth: Truth | None
    bound_px2: Array | None

    def frame(self, sensor: Sensor) -> Frame:
        return self.expected_dn, self.truth, self.bound_px2, sensor


@contextmanager
def rendering(processes: int) -> Iterator[Callable[..., "Future[Any]"]]:
    """Processes of one thread each; they inherit the setting for their linear algebra."""
    before = environ.get("OPENBLAS_NUM_THREADS")
    environ["OPENBLAS_NUM_THREADS"] = "1"
    try:
        with ProcessPoolExecutor(processes, get_context("spawn"), cv2.setNumThreads, (1,)) as pool:
            yield pool.submit
    finally:
        environ.pop("OPENBLAS_NUM_THREADS")
        if before is not None:
            environ["OPENBLAS_NUM_THREADS"] = before


def rendered(picture: Picture, sensor: Sensor, cache: Path | None) -> Rendered:
    if cache is None:
        return _render(picture, sensor)
    file = cache / f"{sha256(repr((picture, sensor)).encode()).hexdigest()[:24]}.npz"
    if file.exists():
        with np.load(file) as kept:
            return Rendered(kept["expected_dn"], truth(picture) if picture.probe_mm else None, kept.get("bound_px2"))
    fresh = _render(picture, sensor)
    arrays = {"expected_dn": fresh.expected_dn}
    if fresh.bound_px2 is not None:
        arrays["bound_px2"] = fresh.bound_px2
    cache.mkdir(parents=True, exist_ok=True)
    begun = file.with_suffix(f".{np.random.default_rng().integers(1 << 62)}.npz")  # so that nobody reads half a file
    np.savez(begun, **arrays)
    begun.rename(file)
    return fresh


@lru_cache(maxsize=1)
def _render(picture: Picture, sensor: Sensor) -> Rendered:
    light = expected(picture).astype(np.float32)
    if picture.probe_mm is None:
        return Rendered(light, None, None)
    return Rendered(light, truth(picture), bound(picture, sensor))
