"""What `trackerd watch` shows of a message."""

from typing import Any

import pytest

from trackerd.cli.watch import View

MESSAGE: dict[str, Any] = {
    "t_unix_ns": 1_700_000_000_000_000_000,
    "t_published_unix_ns": 1_700_000_000_010_000_000,
    "age_ms": 10.0,
    "state": "tracking",
    "valid": True,
    "reasons": [],
    "position_mm": [1.0, 2.0, 3.0],
    "sigma_mm": [0.01, 0.01, 0.03],
    "velocity_mm_s": [0.0, 0.0, 0.0],
    "stations": ["left", "right"],
    "source": "live",
    "calibration_id": "c-7",
}


def shown(**changes: Any) -> dict[str, str]:
    view = View()
    view.position(MESSAGE | changes)
    return dict(view.rows())


def test_a_calibration_that_is_not_to_be_trusted_is_shown_with_the_reason() -> None:
    notes = ["forced: haste", "unverified: no check points outside the adjustment"]
    rows = shown(calibration={"id": "c-7", "forced": True, "verified": False, "expired": False, "notes": notes})
    assert rows["calibration"] == "forced: haste; unverified: no check points outside the adjustment"
    assert rows["state"] == "tracking, valid"


@pytest.mark.parametrize("changes", [{}, {"calibration": {"id": "c-7", "verified": True, "notes": []}}])
def test_of_a_verified_calibration_and_by_an_older_publisher_only_the_id_is_shown(changes: dict[str, Any]) -> None:
    rows = shown(**changes)
    assert "calibration" not in rows
    assert "calibration c-7" in rows["source"]
