"""The swing of both axes about the probe, which tells how late their angles are."""

from math import asin, pi, radians, sin

from trackerd.formats.twin import SweepSettings


def beside(sweep: SweepSettings, t_ns: int) -> tuple[float, float]:
    """How far both axes (az, el) are from their aim at an instant, in rad; they begin there, at full speed."""
    t_s = t_ns * 1e-9
    return (
        radians(sweep.az_deg) * _wave(sweep.kind, sweep.az_hz * t_s),
        radians(sweep.el_deg) * _wave(sweep.kind, sweep.el_hz * t_s),
    )


def _wave(kind: str, turns: float) -> float:
    wave = sin(2.0 * pi * turns)
    return wave if kind == "sine" else asin(wave) * 2.0 / pi
