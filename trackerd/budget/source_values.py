"""What the source thesis prints, as far as it is known here: its Tables 4.2 (reprojection RMS, px), 4.3 (d of the gimbals'
centres, mm, at 1000 mm), 4.4 and 4.7 (d of the targets, mm, at 1000 and 500 mm). d is the norm of three mean absolute errors.

What is not known is not there, and is printed as '-'.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SourceTables:
    """The numbers of the tables of one spacing, and their known values by case."""

    reprojection: str
    pose: str
    position: str
    rms_px: Mapping[str, float]
    centre_d_mm: Mapping[str, float]
    target_d_mm: Mapping[str, float]


SOURCE: Mapping[int, SourceTables] = {
    1000: SourceTables(
        reprojection="4.2",
        pose="4.3",
        position="4.4",
        rms_px={"A": 2.9e-5, "E": 0.0110, "F": 0.0351, "G": 0.0878, "H": 0.175},
        centre_d_mm={"A": 0.0039, "B": 0.0039, "C": 0.0039, "D": 0.0039, "E": 0.7749, "F": 2.604, "G": 7.055, "H": 13.29},
        target_d_mm={"A": 0.0039, "B": 0.1033, "C": 0.3763, "D": 3.670, "E": 0.9455, "F": 2.954, "G": 8.984, "H": 15.118},
    ),
    500: SourceTables(
        reprojection="4.5",
        pose="4.6",
        position="4.7",
        rms_px={},
        centre_d_mm={},
        target_d_mm={"A": 0.0025, "B": 0.1677, "C": 0.5835, "D": 5.655, "E": 0.7530, "F": 2.578, "G": 5.926, "H": 12.713},
    ),
}
