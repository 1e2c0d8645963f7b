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


def millimetres(text: str) -> float:
    return _positive(text, "a positive number of millimetres")


def micrometres(text: str) -> float:
    return _positive(text, "a positive number of micrometres")


def size(text: str) -> tuple[int, int]:
    """Columns and rows."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdecimal() and 0 < int(part) < 1000 for part in parts):
        raise ArgumentTypeError(f"{text!r}: needs COLUMNSxROWS, as in 9x6")
    return int(parts[0]), int(parts[1])


def whole(text: str) -> int:
    value = number(text)
    if not 0 <= value < 1e15 or value != int(value):
        raise ArgumentTypeError(f"{text!r}: needs a whole number, 0 or above")
    return int(value)


def positive(text: str) -> float:
    return _positive(text, "a number above 0")


def names(text: str) -> tuple[str, ...]:
    """Parted by commas."""
    found = tuple(name.strip() for name in text.split(","))
    if not all(found):
        raise ArgumentTypeError(f"{text!r}: needs names parted by commas")
    return found


def circle(text: str) -> tuple[float, ...]:
    circle = tuple(number(part) for part in text.split(","))
    if len(circle) != 3 or not all(map(isfinite, circle)) or circle[2] <= 0.0:
        raise ArgumentTypeError(f"{text!r}: needs X,Y,R, as in 1020,760,60")
    return circle


def box(text: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The lower and the upper corner."""
    values = [number(part) for part in text.split(",")]
    if len(values) != 6 or not all(map(isfinite, values)) or any(a > b for a, b in zip(values[:3], values[3:], strict=True)):
        raise ArgumentTypeError(
            f"{text!r}: needs X,Y,Z,X,Y,Z, the lower corner first, as in --volume=-200,-200,-150,200,200,150"
        )
    return tuple(values[:3]), tuple(values[3:])


def pixel(text: str) -> object:
    if text == "auto":
        return text
    pixel = [number(part) for part in text.split(",")]
    if len(pixel) != 2 or not all(map(isfinite, pixel)):
        raise ArgumentTypeError(f"{text!r}: needs X,Y, as in 1020,760, or auto")
    return pixel


def _positive(text: str, what: str) -> float:
    value = number(text)
    if not 0 < value < 1e9:
        raise ArgumentTypeError(f"{text!r}: needs {what}")
    return value


def number(text: str) -> float:
    """NaN for what is none."""
    try:
        return float(text)
    except ValueError:
        return nan
