"""Basler cameras through pypylon, real ones and pylon's own emulated ones alike."""

from pathlib import Path
from typing import Literal

from trackerd.formats.settings import CameraSettings


class Settings(CameraSettings):
    serial: str = ""  # as printed on the camera; empty: the only one that is connected; 0815-0000... are emulated by pylon
    trigger: Literal["free", "line1", "line2", "line3", "line4"] = "free"  # free: exposes at frame_rate_hz by itself
    folder: Path | None = None  # emulation only: BMP or TIFF files played once, in the order of their names
