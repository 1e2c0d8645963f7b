"""What the options of a command take: numbers and places, refused in words."""

from argparse import ArgumentTypeError
from math import isfinite, nan


def seconds(text: str) -> float:
    value = number(text)
    if not 0 < value < 1e9:
        raise ArgumentTypeError(f"{text!r}: needs a positive number of seconds")
    return value


def count(text: str) -> int:
    value = number(text)
    if not 1 <= value < 1e9 or value != int(value):
        raise ArgumentTypeError(f"{text!r}: needs a whole number, 1 or above")
    return int(value)


def circle(text: str) -> tuple[float, ...]:
    circle = tuple(number(part) for part in text.split(","))
    if len(circle) != 3 or not all(map(isfinite, circle)) or circle[2] <= 0.0:
        raise ArgumentTypeError(f"{text!r}: needs X,Y,R, as in 1020,760,60")
    return circle


def pixel(text: str) -> object:
    if text == "auto":
        return text
    pixel = [number(part) for part in text.split(",")]
    if len(pixel) != 2 or not all(map(isfinite, pixel)):
        raise ArgumentTypeError(f"{text!r}: needs X,Y, as in 1020,760, or auto")
    return pixel


def number(text: str) -> float:
    """NaN for what is none."""
    try:
        return float(text)
    except ValueError:
        return nan
