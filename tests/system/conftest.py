"""One daemon for the tests of a module, where its state allows."""

from collections.abc import Iterator

import pytest
from system.cell import LONG_DWELL, PATIENT, Cell, running_cell

from trackerd.vision import kernels


@pytest.fixture(scope="session", autouse=True)
def machine_code() -> None:
    """Made before any daemon is waited for: it takes longer than a start may."""
    kernels.warm_up()


@pytest.fixture(scope="module")
def still_cell() -> Iterator[Cell]:
    """The probe stands still, so that the axes can be proved again after a fault."""
    with running_cell('twin.path.kind="still"', "service.restart_s=[0.2,0.5]", *PATIENT) as cell:
        yield cell


@pytest.fixture
def following(still_cell: Cell) -> Cell:
    if not all(station["axes"]["armed"] for station in still_cell.status()["stations"].values()):
        still_cell.trackerd("arm")  # a test that failed half-way fails alone
    still_cell.axes("following")
    still_cell.valid_fix()
    return still_cell


@pytest.fixture(scope="module")
def slow_cell() -> Iterator[Cell]:
    """The probe moves: a position that is older than it says is wrong soon, and the probe is still in view after a second."""
    with running_cell("twin.path.radius_mm=60", "twin.path.speed_mm_s=8", LONG_DWELL, *PATIENT) as cell:
        cell.axes("following")
        cell.wait("truth", lambda m: abs(m["velocity_mm_s"][0]) + abs(m["velocity_mm_s"][1]) > 7.9)
        yield cell


@pytest.fixture
def moving(slow_cell: Cell) -> Cell:
    slow_cell.axes("following")
    slow_cell.valid_fix()
    return slow_cell
