"""The detector as one camera has it: its noise model and lens, told or assumed, and its choice of the limb term."""

import numpy as np

from trackerd.contract.model import Found, Image, Outline
from trackerd.inspection.camera import Camera
from trackerd.vision.convergence import CircleFit
from trackerd.vision.curve import View
from trackerd.vision.fit import fit_circle
from trackerd.vision.limb import LimbChoice
from trackerd.vision.locate import check_image, locate
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import Circle
from trackerd.vision.sphere import SphereFound, sphere_of

FULL_WELL_E = 10_000.0  # of the sensor that is assumed where no configuration tells the camera's gain
DEPTHS = (8, 10, 12, 14, 16)  # bits of real sensors; their pixels are stored in 8 or 16


class Detector:
    """For the images of one camera; `camera` is None where nobody told which it is."""

    def __init__(self, noise: NoiseModel, camera: Camera | None = None, origin_px: tuple[int, int] = (0, 0)) -> None:
        self.noise = noise
        self.camera = camera
        self._origin_px = origin_px
        self._view = None if camera is None else View(camera.lens, origin_px)
        self._limb = LimbChoice()

    @property
    def limb_used(self) -> bool:
        """The rim is so shaded that the edge model has a term for it."""
        return self._limb.used

    def locate(self, image: Image, guess: Circle | None) -> Outline:
        """Near the guess, or everywhere. Raises TypeError and ValueError for what is no image."""
        outline = locate(image, guess, self.noise, view=self._view, limb=self._limb)
        if guess is None and isinstance(outline, Found):  # a search chooses the limb term anew: this is the series' choice
            again = locate(image, place(outline), self.noise, view=self._view, limb=self._limb)
            return again if isinstance(again, Found) else outline
        return outline

    def fit(self, image: Image, found: Found) -> CircleFit | None:
        """Everything about an outline that `locate` has just found."""
        return fit_circle(image, place(found), self.noise, view=self._view, limb=self._limb.used)

    def sphere(self, found: Found) -> SphereFound | None:
        """Where the ball is before the camera, by its radius; None where no configuration tells lens and radius."""
        if self.camera is None:
            return None
        return sphere_of(found, self.camera.lens, self.camera.probe_radius_mm, self._origin_px)


def detector_for(image: Image, camera: Camera | None = None) -> Detector:
    """For pictures like this one. Without a camera: a sensor of 10 ke- and 3 e-, circles for outlines.

    The full scale of deep pixels is that of the least depth that holds the image's brightest one.
    Raises TypeError and ValueError for what is no image, ConfigError for one that is not the camera's.
    """
    check_image(image)
    bits = 8 if image.dtype == np.uint8 else next(depth for depth in DEPTHS if int(image.max()) < 1 << depth)
    full_dn = float((1 << bits) - 1)
    if camera is None:
        return Detector(NoiseModel(gain_e_per_dn=FULL_WELL_E / full_dn, saturation_dn=full_dn))
    noise = NoiseModel(camera.gain_e_per_dn, camera.read_noise_e, full_dn)
    return Detector(noise, camera, camera.origin_of(image))


def place(found: Found) -> Circle:
    return found.x_px, found.y_px, found.r_px
