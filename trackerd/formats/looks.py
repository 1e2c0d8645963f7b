"""What a capture asks of the gimbals at one stop of the mover: where each is to look."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from trackerd.contract.model import Array
from trackerd.formats.mover import Stop

Face = Literal[1, 2]
FACES: tuple[Face, Face] = (1, 2)


@dataclass(frozen=True, slots=True)
class Look:
    """The axes' nominal angles that show the probe at a pixel of the sensor; encoder angles."""

    number: int  # of the place in the image, from 0
    face: Face
    q_px: Array  # (2,)
    az_rad: float
    el_rad: float


@dataclass(frozen=True, slots=True)
class Errand:
    """A stop, and by gimbal the looks there."""

    stop: Stop
    looks: Mapping[str, tuple[Look, ...]]

    def view(self, look: Look) -> str:
        """The name of a look's view in the dataset."""
        return f"{self.stop.name}.{look.face}.{look.number}"
