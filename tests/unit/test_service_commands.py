"""What people may ask of a running cell, and what they are told when they ask for what is not there."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from trackerd.service.commands import Commands


@dataclass
class Station:
    """Takes down what it is told."""

    told: list[Any] = field(default_factory=list)

    def arm(self) -> str:
        self.told.append("arm")
        return "waiting for the target"

    def hold(self, reason: str) -> None:
        self.told.append(reason)

    def select(self, pixel: tuple[float, float] | None, radius_px: float | None) -> None:
        self.told.append(pixel if radius_px is None else (*pixel, radius_px))


@pytest.fixture
def stations() -> dict[str, Station]:
    return {"left": Station(), "right": Station()}


@pytest.fixture
def commands(stations: dict[str, Station]) -> Commands:
    parts = {name: SimpleNamespace(link=station, task=station) for name, station in stations.items()}
    return Commands(parts, None)  # type: ignore[arg-type]


def test_arming_answers_for_each_gimbal_what_is_still_missing(commands: Commands) -> None:
    assert commands.arm({}) == {"gimbals": dict.fromkeys(("left", "right"), "waiting for the target")}


def test_one_gimbal_alone_is_armed_or_held(commands: Commands, stations: dict[str, Station]) -> None:
    assert commands.arm({"gimbal": "left", "hold": False}) == {"gimbals": {"left": "waiting for the target"}}
    assert commands.arm({"gimbal": "right", "hold": True}) == {"gimbals": {"right": "held"}}
    assert (stations["left"].told, stations["right"].told) == (["arm"], ["held by the operator"])


def test_a_target_is_selected_by_pixel_or_left_to_itself(commands: Commands, stations: dict[str, Station]) -> None:
    assert commands.select({"gimbal": "left", "pixel": [1020, 760.5]}) == {"gimbals": {"left": "selected"}}
    assert commands.select({"gimbal": "left", "pixel": None}) == {"gimbals": {"left": "finds its target by itself"}}
    guess = {"gimbal": "left", "pixel": [1020, 760.5], "radius_px": 63}
    assert commands.select(guess) == {"gimbals": {"left": "selected"}}
    assert stations["left"].told == [(1020.0, 760.5), None, (1020.0, 760.5, 63.0)]
    assert stations["right"].told == []


@pytest.mark.parametrize(
    ("command", "request_", "words"),
    [
        ("arm", {"gimbal": "middle"}, r"no gimbal 'middle' \(there are: left, right\)"),
        ("arm", {"gimbal": ["left"]}, r"no gimbal \['left'\]"),
        ("arm", {"gimball": "left"}, r"unknown keys gimball \(known: gimbal, hold\)"),
        ("arm", {"hold": "false"}, "hold 'false': needs true or false"),
        ("arm", {"hold": None}, "hold None: needs true or false"),
        ("select", {"pixel": [1, 2]}, 'needs "gimbal" and "pixel"'),
        ("select", {"gimbal": "left", "pixel": [1, 2], "radius_px": 0}, "needs a number above 0"),
        ("select", {"gimbal": "left", "pixel": None, "radius_px": 60.0}, "and a pixel"),
        ("select", {"gimbal": "left"}, 'needs "gimbal" and "pixel"'),
        ("select", {"gimbal": "left", "pixel": [1]}, r"needs two numbers \[x, y\]"),
        ("select", {"gimbal": "left", "pixel": "1,2"}, r"needs two numbers"),
        ("select", {"gimbal": "left", "pixel": [True, 2]}, r"needs two numbers"),
        ("select", {"gimbal": "left", "pixel": [float("nan"), 2]}, r"needs two numbers"),
        ("select", {"gimbal": "left", "pixel": [10**400, 2]}, r"needs two numbers"),
    ],
)
def test_a_wrong_request_is_refused_in_words_and_nothing_happens(
    commands: Commands, stations: dict[str, Station], command: str, request_: dict[str, Any], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        getattr(commands, command)(request_)
    assert not any(station.told for station in stations.values())
