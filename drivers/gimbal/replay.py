"""A recorded gimbal: a table of the encoders' angles at each frame's mid-exposure."""

from pathlib import Path

from trackerd.formats.settings import GimbalSettings


class Settings(GimbalSettings):
    csv: Path  # columns gimbal,frame,t_ns,az_rad,el_rad; the rows of other gimbals are left alone
