"""The twin's camera: frames arrive through shared memory with a doorbell (`trackerd.formats.framelink`)."""

from trackerd.formats.settings import CameraSettings


class Settings(CameraSettings):
    """The twin's own offer rules over exposure, rate and region, so that both sides can never differ."""

    socket: str = ""  # path of the twin's Unix socket; the twin tells it when it starts
