"""No gimbal at all: two constant angles, so that a static stereo pair is a cell too."""

from trackerd.formats.settings import GimbalSettings


class Settings(GimbalSettings):
    az_deg: float = 0.0  # encoder angles
    el_deg: float = 0.0
