"""Noise as a pure function: the same seed and key give the same draw, in whatever order they are asked for."""

from math import cos, log, pi, sqrt
from zlib import crc32

MASK = (1 << 64) - 1
GOLDEN = 0x9E37_79B9_7F4A_7C15


def key(seed: int, *labels: str | int) -> int:
    """A 64-bit key for a stream of draws; labels name whose it is."""
    mixed = mix(seed)
    for label in labels:
        mixed = mix(mixed ^ (crc32(label.encode()) if isinstance(label, str) else label & MASK))
    return mixed


def mix(value: int) -> int:
    """SplitMix64 (Steele, Lea, Flood 2014): one step, whose output bits depend on all bits of the input."""
    z = (value + GOLDEN) & MASK
    z = ((z ^ (z >> 30)) * 0xBF58_476D_1CE4_E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D0_49BB_1331_11EB) & MASK
    return z ^ (z >> 31)


def uniform(stream: int, draw: int) -> float:
    """In (0, 1]; the draw with number `draw` (any int) of a stream."""
    return ((mix(stream ^ (draw & MASK)) >> 11) + 1) * 2.0**-53


def normal(stream: int, draw: int) -> float:
    """Standard normal (Box-Muller)."""
    first = mix(stream ^ (draw & MASK))
    u = ((first >> 11) + 1) * 2.0**-53
    v = (mix(first) >> 11) * 2.0**-53
    return sqrt(-2.0 * log(u)) * cos(2.0 * pi * v)
