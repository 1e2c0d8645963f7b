"""One image through the detector, with everything that a person may want to see of it: numbers only, nothing is drawn here."""

from dataclasses import dataclass
from math import ceil, erfc, sqrt

import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Array, Found, Image, Missed, Outline
from trackerd.inspection.detector import Detector, detector_for
from trackerd.vision.annulus import gather, ring_for
from trackerd.vision.convergence import CircleFit
from trackerd.vision.curve import angles
from trackerd.vision.locate import SEARCHED_PX
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import Circle
from trackerd.vision.search import candidates
from trackerd.vision.verify import edge_sectors


@dataclass(frozen=True, slots=True)
class Look:
    """Where the detector looked without finding a ball, and why that is none."""

    circle: Circle
    reason: str


@dataclass(frozen=True, slots=True)
class Examination:
    """What the detector made of one image. Coordinates are the image's own, an integer is a pixel's centre."""

    name: str
    image: Image
    detector: Detector
    outline: Outline
    fit: CircleFit | None  # None where nothing was found
    looks: tuple[Look, ...]  # where it looked in vain

    @property
    def found(self) -> Found | None:
        return self.outline if isinstance(self.outline, Found) else None

    @property
    def noise(self) -> NoiseModel:
        return self.detector.noise

    @property
    def full_dn(self) -> float:
        return self.noise.saturation_of(int(np.iinfo(self.image.dtype).max))


@dataclass(frozen=True, slots=True)
class Edges:
    """The edge of each sector as it was found, (S,): on the fitted outline, but for the offset."""

    angle_rad: Array  # from x towards y
    outline_px: Array  # (S, 2)
    edge_px: Array  # (S, 2)
    kept: npt.NDArray[np.bool_]  # the sectors that speak for the outline
    weight: Array  # 0 to 1
    sigma_px: Array  # of the offset


@dataclass(frozen=True, slots=True)
class Profile:
    """All pixels round the outline, (n,): distance from it (outwards) and grey value; and the fitted edge, (m,)."""

    distance_px: Array
    level_dn: Array
    kept: npt.NDArray[np.bool_]  # in a sector that speaks for the outline
    edge_distance_px: Array
    edge_dn: Array  # as between the median levels on both sides
    shaded: bool  # the fit has a term for the ball's rim besides, which differs all round and is not in `edge_dn`


def examine(image: Image, guess: Circle | None = None, detector: Detector | None = None, name: str = "") -> Examination:
    """Raises TypeError and ValueError for what is no image, as `locate` does."""
    detector = detector or detector_for(image)
    outline = detector.locate(image, guess)
    if isinstance(outline, Missed):
        return Examination(name, image, detector, outline, None, tuple(_looks(image, guess, detector, outline.reason)))
    fit = detector.fit(image, outline)
    return Examination(name, image, detector, outline, fit, ())


def edges(fit: CircleFit, noise: NoiseModel) -> Edges:
    angle, outline_px = angles(len(fit.weight)), fit.outline_px
    away = np.column_stack((np.cos(angle), np.sin(angle)))
    return Edges(
        angle,
        outline_px,
        outline_px + fit.sectors.offset_px[:, None] * away,
        edge_sectors(fit.lit_sectors, noise),
        fit.weight / max(float(fit.weight.max()), 1e-9),
        np.asarray(1.0 / np.sqrt(fit.sectors.information), np.float64),
    )


def profile(examination: Examination) -> Profile | None:
    """None where nothing was found."""
    fit, image = examination.fit, examination.image
    if fit is None:
        return None
    pixels = ring_for(fit.r_px, fit.sigma_px)
    column, row = round(fit.x_px), round(fit.y_px)
    seen = gather(image, pixels, column, row)
    distance = np.hypot(pixels.dx + column - fit.x_px, pixels.dy + row - fit.y_px)
    distance = distance - np.hypot(*(fit.outline_px - (fit.x_px, fit.y_px)).T)[:, None]
    kept = np.broadcast_to(edge_sectors(fit.lit_sectors, examination.noise)[:, None], distance.shape)
    real = seen.weight > 0.0
    reach = float(ceil(np.abs(distance[real]).max(initial=1.0)))
    along = np.linspace(-reach, reach, 400)
    return Profile(distance[real], seen.level[real], kept[real], along, _edge(fit, along, examination), len(fit.limb_dn) > 0)


def _edge(fit: CircleFit, distance_px: Array, examination: Examination) -> Array:
    """The model of the fit between the median levels of the sectors that speak for the outline."""
    found = examination.found
    assert found is not None  # who has a fit was found
    t = distance_px / fit.sigma_px + fit.sigma_px / (2.0 * fit.r_px)
    share = np.array([0.5 * erfc(value / sqrt(2.0)) for value in t.tolist()])
    return np.asarray(found.outside_dn + (found.inside_dn - found.outside_dn) * share)


def _looks(image: Image, guess: Circle | None, detector: Detector, reason: str) -> list[Look]:
    if guess is not None:
        return [Look(guess, reason)]
    looks = []
    for circle in candidates(image, SEARCHED_PX):
        outline = detector.locate(image, circle)
        why = (
            outline.reason
            if isinstance(outline, Missed)
            else f"{100 * outline.coverage:.0f} % of it are too few unless guessed"
        )
        looks.append(Look(circle, why))
    return looks
