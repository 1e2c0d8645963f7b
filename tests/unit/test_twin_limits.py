"""Whatever is commanded, the axes keep their limits and the controller its rules."""

from typing import Any

from emulators.twin_rig import MS, Rig
from hypothesis import given, settings
from hypothesis import strategies as st

from trackerd.contract.model import AxisMode, GimbalFlag
from trackerd.formats import gimbal_map as gm

AXES = {"max_deg_s": 60.0, "max_deg_s2": 800.0, "az_limits_deg": (-8.0, 4.0), "el_limits_deg": (-4.0, 8.0)}
SLACK = 1.0 + 1e-9

records = st.fixed_dictionaries(
    {
        "after_ms": st.integers(1, 120),
        "control": st.integers(0, 0xFF),
        "mode": st.sampled_from(AxisMode),
        "az": st.floats(-0.3, 0.3),
        "el": st.floats(-0.3, 0.3),
        "az_rate": st.floats(-3.0, 3.0),
        "el_rate": st.floats(-3.0, 3.0),
        "cmd_time_us": st.integers(0, gm.LOW_WORD),
        "watchdog_ms": st.integers(0, 0xFFFF),
    }
)


@settings(max_examples=40, deadline=None)
@given(commands=st.lists(records, min_size=1, max_size=25))
def test_limits_hold_for_any_commands(commands: list[dict[str, Any]]) -> None:
    rig = Rig(axes=AXES)
    rig.enable(1)
    t_ms, speed = 1, (0.0, 0.0)
    for command in commands:
        fields = dict(command)
        after_ms = fields.pop("after_ms")
        for _ in range(after_ms):
            t_ms += 1
            speed = check_step(rig, t_ms, speed)
        rig.send(t_ms, **fields)
        check_flags(rig.flags(t_ms), rig.controller.fault)


def check_step(rig: Rig, t_ms: int, before_rad_s: tuple[float, float]) -> tuple[float, float]:
    rates_rad_s = rig.rates(t_ms)
    angles_rad = rig.axes.motion(t_ms * MS)[0]
    for rate, last, angle, (low, high) in zip(rates_rad_s, before_rad_s, angles_rad, rig.axes.limits_rad, strict=True):
        assert low - 1e-12 <= angle <= high + 1e-12
        assert abs(rate) <= rig.axes.max_rad_s * SLACK
        assert abs(rate - last) <= rig.axes.max_rad_s2 * 1e-3 * SLACK + 1e-12
    return rates_rad_s


def check_flags(flags: GimbalFlag, fault: int) -> None:
    if flags & GimbalFlag.FOLLOWING:
        assert flags & GimbalFlag.ENABLED
        assert not flags & (GimbalFlag.COMM_LOST | GimbalFlag.FAULT)
    assert bool(flags & GimbalFlag.FAULT) == (fault != 0)


def test_the_same_commands_give_the_same_records() -> None:
    def run() -> list[bytes]:
        rig = Rig(encoder={"white_arcsec": 2.0, "fixed_arcsec": 1.0, "latch_jitter_us": 5.0}, seed=3)
        rig.send(1, gm.LATCH_ENABLE | gm.LATCH_ZERO)
        rig.line.start(MS)
        rig.send(2, gm.ENABLE)
        told = []
        for t_ms in range(5, 300, 5):
            rig.follow(t_ms, az=0.05 * t_ms / 1000.0, az_rate=0.05, bits=gm.VELOCITY_VALID | gm.LATCH_ENABLE)
            told.append(rig.controller.status(t_ms * MS))
        return told

    assert run() == run()
