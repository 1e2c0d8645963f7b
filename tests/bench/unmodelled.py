"""What no parameter of the calibration describes, as displacements in the image: (at the calibration, afterwards)."""

from collections.abc import Callable

import numpy as np
from made_cells import Effect, Noise

from trackerd.calibrate.cell.model import Linear
from trackerd.calibrate.cell.options import ARCSEC
from trackerd.contract.model import Array

BetweenEffect = Callable[[np.random.Generator], tuple[Effect, Effect]]
WHITE = Noise(0.1, 2.0 * ARCSEC)
SHARP = Noise(0.1, 0.2 * ARCSEC)  # encoders believed to be better than they are
TILT_RAD = np.radians(0.001)
LAMP_MM = np.array((0.0, -800.0, -500.0))


def nothing(linear: Linear, stations: Array, angles: Array, p_mm: Array) -> Array:
    return np.zeros_like(linear.q_px)


def no_effect(rng: np.random.Generator) -> tuple[Effect, Effect]:
    return nothing, nothing


def flexure(size_rad: float) -> BetweenEffect:
    """The camera sags with the elevation: a turn about EL of size x sin(el)."""

    def sag(linear: Linear, stations: Array, angles: Array, p_mm: Array) -> Array:
        return linear.encoder[:, :, 1] * (size_rad * np.sin(angles[:, 1]))[:, None]

    return lambda rng: (sag, sag)


def wobble(size_rad: float, cycles: int) -> BetweenEffect:
    """The AZ axis tumbles: its base turns about y and z of W as a function of az."""

    def effect(rng: np.random.Generator) -> tuple[Effect, Effect]:
        phase = rng.uniform(0.0, 2.0 * np.pi, 2)

        def tumble(linear: Linear, stations: Array, angles: Array, p_mm: Array) -> Array:
            at = cycles * angles[:, 0] + phase[stations]
            return size_rad * (linear.station[:, :, 1] * np.cos(at)[:, None] + linear.station[:, :, 2] * np.sin(at)[:, None])

        return tumble, tumble

    return effect


def tilt(during: bool) -> BetweenEffect:
    """The left stand tilts by 0.001 deg: for half of the calibration's views (those of points on one side), or after it."""

    def effect(rng: np.random.Generator) -> tuple[Effect, Effect]:
        direction = rng.normal(0.0, 1.0, 3)
        turn = TILT_RAD * direction / np.linalg.norm(direction)

        def leaning(linear: Linear, stations: Array, angles: Array, p_mm: Array) -> Array:
            return np.where((stations == 0)[:, None], linear.station[:, :, :3] @ turn, 0.0)

        def half(linear: Linear, stations: Array, angles: Array, p_mm: Array) -> Array:
            return np.where((p_mm[:, 0] > 0.0)[:, None], leaning(linear, stations, angles, p_mm), 0.0)

        return (half, leaning) if during else (nothing, leaning)

    return effect


def encoder_ripple(size_rad: float, cycles: int) -> BetweenEffect:
    """Both axes read size x cos(cycles x angle) too much."""

    def effect(rng: np.random.Generator) -> tuple[Effect, Effect]:
        phase = rng.uniform(0.0, 2.0 * np.pi, (2, 2))

        def ripple(linear: Linear, stations: Array, angles: Array, p_mm: Array) -> Array:
            return np.einsum("nai,ni->na", linear.encoder, size_rad * np.cos(cycles * angles + phase[stations]))

        return ripple, ripple

    return effect


def glowing(size_mm: float) -> BetweenEffect:
    """A translucent ball looks displaced towards the lamp."""

    def shift(linear: Linear, stations: Array, angles: Array, p_mm: Array) -> Array:
        to_lamp = LAMP_MM - p_mm
        return size_mm * np.einsum("nai,ni->na", linear.world, to_lamp / np.linalg.norm(to_lamp, axis=1, keepdims=True))

    return lambda rng: (shift, shift)


ROOT_2 = float(np.sqrt(2.0))
EFFECTS: dict[str, tuple[Noise, BetweenEffect, float]] = {  # the last is what the calibration is told of the stands
    "none": (WHITE, no_effect, 0.0),
    "EL flexure, 60 arcsec x sin(el)": (WHITE, flexure(60.0 * ARCSEC), 0.0),
    "bearing wobble 3 arcsec, 2 a turn": (WHITE, wobble(3.0 * ARCSEC, 2), 0.0),
    "bearing wobble 3 arcsec, 16 a turn": (WHITE, wobble(3.0 * ARCSEC, 16), 0.0),
    "left stand tilts 0.001 deg half-way through": (WHITE, tilt(True), 0.0),
    "left stand tilts 0.001 deg afterwards": (WHITE, tilt(False), 0.0),
    "the same, stand_tilt_rad = 0.0005 deg": (WHITE, tilt(False), TILT_RAD / 2.0),
    "36/rev encoders, 2 arcsec, said 0.2 white": (SHARP, encoder_ripple(2.0 * ROOT_2 * ARCSEC, 36), 0.0),
    "36/rev encoders, 2 arcsec, said 2 white": (WHITE, encoder_ripple(2.0 * ROOT_2 * ARCSEC, 36), 0.0),
    "translucent ball, 0.05 mm towards the lamp": (WHITE, glowing(0.05), 0.0),
    "translucent ball, 0.5 mm towards the lamp": (WHITE, glowing(0.5), 0.0),
}
