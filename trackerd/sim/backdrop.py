"""What is in a frame besides the probe: a background that stands still in the world, and the noise of the sensor."""

import cv2
import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Array
from trackerd.formats.twin import LookSettings
from trackerd.geometry.lens import Lens
from trackerd.sim.noise import mix

Floats = npt.NDArray[np.float32]

TILE_PX = 512  # after which the background repeats
BANK = 1 << 20  # places in the bank of noise at which a frame may begin


class Backdrop:
    """A texture far away: a turn of the camera shifts it, by parts of a pixel too."""

    def __init__(self, look: LookSettings, lens: Lens, reference: Array, size_px: tuple[int, int], seed: int) -> None:
        """`reference` (3, 3) is the rotation world_from_camera whose picture begins at the tile's origin."""
        self._lens = lens
        self._reference = reference
        self._size_px = size_px
        width, height = size_px
        tile = look.background_dn + look.texture_dn * _texture(look.texture_px, seed)
        self._tile = np.pad(tile, ((0, height + 2), (0, width + 2)), mode="wrap").astype(np.float32)

    def draw(self, rotation: Array, out: Floats) -> None:
        """The background as seen by a camera with this rotation world_from_camera."""
        boresight = self._reference.T @ rotation[:, 2]
        x = self._lens.fx_px * boresight[0] / boresight[2] % TILE_PX
        y = self._lens.fy_px * boresight[1] / boresight[2] % TILE_PX
        width, height = self._size_px
        cv2.getRectSubPix(self._tile, self._size_px, (x + (width - 1) / 2.0, y + (height - 1) / 2.0), patch=out)


class SensorNoise:
    """Photon and read noise, and the rounding to 8 bits. A bank of normal deviates is drawn once and begun anywhere."""

    def __init__(self, look: LookSettings, shape: tuple[int, int], seed: int) -> None:
        self._seed = seed
        self._per_dn = 1.0 / look.gain_e_per_dn
        self._read_dn2 = (look.read_noise_e / look.gain_e_per_dn) ** 2
        rng = np.random.default_rng(seed)
        self._bank = rng.standard_normal(BANK + shape[0] * shape[1], dtype=np.float32)
        self._sigma = np.empty(shape, np.float32)

    def expose(self, dn: Floats, frame_id: int, out: npt.NDArray[np.uint8]) -> None:
        """Variance in DN^2: signal / gain + (read noise / gain)^2."""
        begin = mix(self._seed ^ frame_id) % BANK
        deviates = self._bank[begin : begin + dn.size].reshape(dn.shape)
        sigma = self._sigma
        cv2.addWeighted(dn, self._per_dn, dn, 0.0, self._read_dn2, dst=sigma)
        cv2.sqrt(sigma, sigma)
        cv2.multiply(sigma, deviates, dst=sigma)
        cv2.add(dn, sigma, dst=out, dtype=cv2.CV_8U)


def _texture(blur_px: float, seed: int) -> Array:
    """(TILE_PX, TILE_PX) blurred noise of mean 0 and rms 1 whose edges fit together."""
    spectrum = np.fft.rfft2(np.random.default_rng(seed).standard_normal((TILE_PX, TILE_PX)))
    fy, fx = np.fft.fftfreq(TILE_PX)[:, None], np.fft.rfftfreq(TILE_PX)[None, :]
    spectrum *= np.exp(-2.0 * (np.pi * blur_px) ** 2 * (fx * fx + fy * fy))
    spectrum[0, 0] = 0.0
    texture = np.fft.irfft2(spectrum, s=(TILE_PX, TILE_PX))
    return np.asarray(texture / texture.std())
