"""The boards that a camera is shown: where their points are, and what may be told of them from one picture.

Every board has its own right-handed frame: seen from the front x points right, y down and z into the board, as in OpenCV.
Points are numbered row by row.
"""

from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array

Indices: TypeAlias = npt.NDArray[np.intp]

DICTIONARIES = tuple(
    sorted(name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_") and name.isupper())
)
FEWEST_DOTS, MOST_DOTS = 6, 100  # of an array: fewer are matched by chance, more take too long


@dataclass(frozen=True, slots=True)
class Chessboard:
    """`corners`: inner ones, along x and along y. Corner 0 is the one whose inner square is black, where that tells it.

    A board with an even number of columns and an odd one of rows, or the reverse, looks the same from no other side. Others
    do after half a turn (`turns_alike` 2); their corner 0 is the one nearer to the picture's upper left.
    """

    corners: tuple[int, int]
    square_mm: float

    def __post_init__(self) -> None:
        _check_grid("chessboard", self.corners, 3)
        _check_length("square_mm", self.square_mm)

    @property
    def name(self) -> str:
        return f"chessboard {_by(self.corners)}, {self.square_mm:g} mm"

    @property
    def points_mm(self) -> Array:
        return _grid_mm(self.corners, self.square_mm)

    @property
    def turns_alike(self) -> int:
        return 1 if sum(self.corners) % 2 else 2


@dataclass(frozen=True, slots=True)
class Charuco:
    """`squares`: along x and along y. Its points are the inner corners; markers tell which ones are seen, so a part will do.

    `legacy`: the pattern of OpenCV before 4.6, which begins with a marker where the number of rows is even.
    """

    squares: tuple[int, int]
    square_mm: float
    marker_mm: float
    dictionary: str = "4X4_50"
    legacy: bool = False

    def __post_init__(self) -> None:
        _check_grid("ChArUco board", self.squares, 3)
        _check_length("square_mm", self.square_mm)
        _check_length("marker_mm", self.marker_mm)
        if self.marker_mm >= self.square_mm:
            raise ConfigError(f"marker_mm = {self.marker_mm:g}: must be below square_mm = {self.square_mm:g}")
        if self.dictionary not in DICTIONARIES:
            raise ConfigError(f'dictionary = "{self.dictionary}": must be one of {", ".join(DICTIONARIES)}')
        held = len(predefined(self.dictionary).bytesList)
        if self.squares[0] * self.squares[1] // 2 > held:
            raise ConfigError(f'dictionary = "{self.dictionary}": has {held} markers, too few for {_by(self.squares)} squares')

    @property
    def name(self) -> str:
        return f"ChArUco {_by(self.squares)}, {self.square_mm:g} / {self.marker_mm:g} mm, {self.dictionary}"

    @property
    def points_mm(self) -> Array:
        columns, rows = self.squares
        first_mm = np.array((self.square_mm, self.square_mm, 0.0))
        return first_mm + _grid_mm((columns - 1, rows - 1), self.square_mm)

    @property
    def turns_alike(self) -> int:
        return 1


@dataclass(frozen=True, slots=True)
class CircleGrid:
    """Dots, dark on bright or bright on dark; `dots` along x and along y.

    Asymmetric: every second row is shifted by half of the distance in a row, and `spacing_mm` is half of that distance, as in
    OpenCV. A symmetric grid looks the same after half a turn (a square one after each quarter), an asymmetric one with an even
    number of rows, too; their dot 0 is then the one nearer to the picture's upper left.
    """

    dots: tuple[int, int]
    spacing_mm: float
    asymmetric: bool = False

    def __post_init__(self) -> None:
        _check_grid("circle grid", self.dots, 3)
        _check_length("spacing_mm", self.spacing_mm)

    @property
    def name(self) -> str:
        return f"{'asymmetric ' if self.asymmetric else ''}circle grid {_by(self.dots)}, {self.spacing_mm:g} mm"

    @property
    def points_mm(self) -> Array:
        if not self.asymmetric:
            return _grid_mm(self.dots, self.spacing_mm)
        row, column = np.divmod(np.arange(self.dots[0] * self.dots[1]), self.dots[0])
        return np.column_stack((2 * column + row % 2, row, np.zeros(row.size))) * self.spacing_mm

    @property
    def turns_alike(self) -> int:
        if self.asymmetric:
            return 1 if self.dots[1] % 2 else 2
        return 4 if self.dots[0] == self.dots[1] else 2


@dataclass(frozen=True, slots=True)
class DotArray:
    """LEDs or dots anywhere, in one plane or not, at known coordinates (n, 3), in the frame of whoever measured them.

    `facing`: the direction, in the same frame, along which they are seen from: a camera is on that side. It tells a right match
    from a mirrored one. `dark`: dark dots on bright ground instead of bright ones on dark.
    """

    points_mm: Array
    name: str = "dot array"
    facing: tuple[float, float, float] = (0.0, 0.0, -1.0)
    dark: bool = False

    def __post_init__(self) -> None:
        if self.points_mm.ndim != 2 or self.points_mm.shape[1] != 3 or len(self.points_mm) < FEWEST_DOTS:
            raise ConfigError(f"{self.name}: needs {FEWEST_DOTS} points or more, x, y and z of each")
        if len(self.points_mm) > MOST_DOTS:
            raise ConfigError(f"{self.name}: has {len(self.points_mm)} points, at most {MOST_DOTS} are matched")
        if not np.isfinite(self.points_mm).all():
            raise ConfigError(f"{self.name}: a coordinate is no number")
        if not np.linalg.norm(self.facing) > 0.0:
            raise ConfigError(f"{self.name}: facing = {list(self.facing)}: must be a direction")

    @property
    def turns_alike(self) -> int:
        return 1


Board: TypeAlias = Chessboard | Charuco | CircleGrid | DotArray


@dataclass(frozen=True, slots=True)
class Detected:
    """Which of the board's points are seen, (k,), ascending, and where, (k, 2): an integer is a pixel's centre.

    `sigma_px` (k,), of each coordinate, is what the noise of the pixels makes of it, and the least that the detector is known
    to be off; what board and optics add is not in it.
    """

    index: Indices
    q_px: Array
    sigma_px: Array


@dataclass(frozen=True, slots=True)
class Missed:
    """No board, or not enough of it, in words for a person."""

    reason: str


Detection: TypeAlias = Detected | Missed


def predefined(dictionary: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))


def _grid_mm(count: tuple[int, int], step_mm: float) -> Array:
    row, column = np.divmod(np.arange(count[0] * count[1]), count[0])
    return np.column_stack((column, row, np.zeros(row.size))) * step_mm


def _by(count: tuple[int, int]) -> str:
    return f"{count[0]}x{count[1]}"


def _check_grid(what: str, count: tuple[int, int], least: int) -> None:
    if min(count) < least:
        raise ConfigError(f"{what} {_by(count)}: needs at least {least} along each side")


def _check_length(name: str, length_mm: float) -> None:
    if not 0.0 < length_mm < 1e6:
        raise ConfigError(f"{name} = {length_mm:g}: must be a positive number of millimetres")
