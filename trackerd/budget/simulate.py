"""The readings of one trial: what the cameras saw and the encoders said, with the noise of its case."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from trackerd.budget.settings import Case
from trackerd.budget.stage import Sight, Stage
from trackerd.contract.model import Array
from trackerd.formats.twin import EncoderSettings
from trackerd.sim.encoder import EncoderMap
from trackerd.sim.noise import key as stream_key

Readings = Mapping[str, Sight]  # by station; `Sight` with noise


@dataclass(frozen=True, slots=True, order=True)
class TrialKey:
    """Whose noise it is: the same key gives the same noise, whoever asks, in whatever order."""

    layout: str
    case: str
    trial: int


def readings(stage: Stage, case: Case, key: TrialKey, seed: int) -> Readings:
    """Every pixel coordinate and every angle is read with independent normal noise, and every axis has an encoder of its own.

    What an encoder is off by as a function of its angle is drawn anew in each trial: 1, 2, 36 and 360 cycles a turn.
    """
    words = (seed >> 32, seed & 0xFFFF_FFFF, crc32(key.layout.encode()), crc32(key.case.encode()), key.trial)
    noise = np.random.default_rng(np.random.SeedSequence(words))
    settings = EncoderSettings(fixed_arcsec=case.encoder_fixed_arcsec)
    return {
        name: _read(sight, case, noise, [EncoderMap(settings, stream_key(*words, name, axis)) for axis in ("az", "el")])
        for name, sight in stage.sights.items()
    }


def _read(sight: Sight, case: Case, noise: np.random.Generator, maps: Sequence[EncoderMap]) -> Sight:
    def angles(exact: Array) -> Array:
        fixed = [[error(angle) for error, angle in zip(maps, pair, strict=True)] for pair in exact.reshape(-1, 2).tolist()]
        white = case.encoder_sigma_rad * noise.standard_normal(exact.shape)
        return np.asarray(exact + np.reshape(fixed, exact.shape) + white)

    def pixels(exact: Array) -> Array:
        return np.asarray(exact + case.pixel_sigma_px * noise.standard_normal(exact.shape))

    return Sight(
        view_rad=angles(sight.view_rad),
        view_px=pixels(sight.view_px),
        looks_rad=angles(sight.looks_rad),
        looks_px=pixels(sight.looks_px),
        targets_rad=angles(sight.targets_rad),
        targets_px=pixels(sight.targets_px),
    )
