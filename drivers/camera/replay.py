"""A recorded camera: a folder of images in the order of their names, the n-th being frame n."""

from pathlib import Path

from trackerd.formats.settings import CameraSettings


class Settings(CameraSettings):
    folder: Path  # BMP, TIFF, PNG or PGM files, 8 or 16 bits, all of width_px x height_px
    csv: Path | None = None  # columns frame,t_ns: the recorded mid-exposure; default: n / frame_rate_hz
