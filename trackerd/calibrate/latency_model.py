"""The linear model of a sweep: offsets in the image by the latency of each axis, beside free functions of the angles."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from trackerd.calibrate.sweep import Sweep
from trackerd.contract.errors import Undetermined
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station

Mask: TypeAlias = npt.NDArray[np.bool_]

DEGREE = 8  # of each encoder's function of its angle: two of its waves over the sweep
TURNING = 0.1  # of the highest speed: a hysteresis turns round within it
ALIKE = 1e-9  # relative length below which a function of the angles is one of the others


@dataclass(frozen=True, slots=True)
class Model:
    """Whitened, two rows a frame (n, 2, ...): offsets of the target from where the angles have it, and terms for them."""

    offsets: Array  # (n, 2)
    late: Array  # (n, 2, 2) per s of latency of az and el
    angles: Array  # (n, 2, p) functions of the angles, and a slow drift of the target
    hysteresis: Array  # (n, 2, 2) per rad to either side, of az and el
    smear: Array  # (n, 2, 2) per rad at the highest speed, with the square of the speed: of az and el
    root: Array  # (n, 2, 2) whitens pixels
    jacobian: Array  # (n, 2, 2) d px / d encoder rad
    offsets_px: Array  # (n, 2) as they are

    def left_over(self, offset_s: Array, kept: Mask) -> Array:
        """Whitened, (n, 2), of all frames; the functions of the angles are fitted to those that are kept."""
        return np.asarray(self.offsets - self.late @ offset_s - self.angles @ self.free(offset_s, kept))

    def free(self, offset_s: Array, kept: Mask) -> Array:
        """(p,) the functions of the angles."""
        y = self.offsets - self.late @ offset_s
        return np.asarray(np.linalg.lstsq(rows(self.angles, kept), y[kept].ravel(), rcond=ALIKE)[0], np.float64)

    def angles_of(self, left: Array) -> Array:
        """Whitened offsets (n, 2) as errors of the encoders' angles, in rad."""
        return -np.asarray(np.linalg.solve(self.root @ self.jacobian, left[:, :, None])[..., 0], np.float64)


@dataclass(frozen=True, slots=True)
class Fit:
    value: Array  # (k,)
    cov: Array  # (k, k)
    share: Array  # (k,) of each term's squared length that the other terms do not imitate


def model_of(station: Station, sweep: Sweep, range_mm: float) -> Model:
    poses: list[tuple[float, float]] = [(az, el) for az, el in sweep.angles_rad.tolist()]
    seen_at = [station.point_at(q, az, el, range_mm) for q, (az, el) in zip(sweep.q_px, poses, strict=True)]
    target = np.mean(seen_at, axis=0)
    offsets = sweep.q_px - np.array([station.pixel(target, az, el) for az, el in poses])
    return _model(sweep, offsets, np.array([station.pixel_jacobian(target, az, el) for az, el in poses]))


def rescaled(model: Model, sweep: Sweep, offset_s: Array, kept: Mask) -> Model:
    """With the pixels per radian that the sweep itself shows: 1 % off in focal length or range would be 1 % of the latency."""
    slopes = _plane_slopes(sweep)
    free = model.free(offset_s, kept)[: 2 * slopes.shape[1]].reshape(-1, 2)
    return _model(sweep, model.offsets_px, model.jacobian + np.einsum("kj,nka->nja", free, slopes))


def _model(sweep: Sweep, offsets_px: Array, jacobian: Array) -> Model:
    cov = sweep.cov_px2 + sweep.sigma_rad**2 * jacobian @ jacobian.transpose(0, 2, 1)
    try:
        root = np.linalg.inv(np.linalg.cholesky(cov))
    except np.linalg.LinAlgError as err:
        raise Undetermined("a frame's pixel has a covariance that is not positive") from err
    speed = sweep.rates_rad_s / np.abs(sweep.rates_rad_s).max(axis=0)
    return Model(
        offsets=(root @ offsets_px[:, :, None])[..., 0],
        late=root @ (-jacobian * sweep.rates_rad_s[:, None, :]),
        angles=root @ _functions(sweep, jacobian),
        hysteresis=root @ (-jacobian * np.tanh(speed / TURNING)[:, None, :]),
        smear=root @ (-jacobian * (speed * np.abs(speed))[:, None, :]),
        root=root,
        jacobian=jacobian,
        offsets_px=offsets_px,
    )


def fitted(terms: Array, beside: Array, offsets: Array, kept: Mask) -> Fit:
    """Least squares of some terms beside others whose values nobody asks for; these may imitate each other."""
    wanted, free = rows(terms, kept), rows(beside, kept)
    basis = _basis(free)
    own = wanted - basis @ (basis.T @ wanted)
    share = (own**2).sum(axis=0) / (wanted**2).sum(axis=0)
    cov = np.asarray(np.linalg.pinv(own.T @ own, rcond=1e-12, hermitian=True), np.float64)
    return Fit(cov @ (own.T @ offsets[kept].ravel()), cov, share)


def rank(terms: Array, kept: Mask) -> int:
    return len(_basis(rows(terms, kept)).T)


def rows(terms: Array, kept: Mask) -> Array:
    return terms[kept].reshape(-1, terms.shape[2])


def _basis(columns: Array) -> Array:
    lengths = np.sqrt((columns**2).sum(axis=0))
    u, s, _ = np.linalg.svd(columns[:, lengths > 0.0] / lengths[lengths > 0.0], full_matrices=False)
    return np.asarray(u[:, s > ALIKE * s[0]], np.float64)


def _functions(sweep: Sweep, jacobian: Array) -> Array:
    """(n, 2, p): of the image, quadratic in both angles; the target's slow drift; of each encoder, of its own angle."""
    a, e = _scaled(sweep).T
    t = 2.0 * (sweep.t_s - sweep.t_s[0]) / (sweep.t_s[-1] - sweep.t_s[0]) - 1.0
    planes = np.stack((np.ones_like(a), a, e, a * a, a * e, e * e, t, t * t), axis=1)
    image = np.einsum("nk,ij->nikj", planes, np.eye(2)).reshape(len(a), 2, -1)
    waves = [_waves(axis)[:, None, :] * jacobian[:, :, i : i + 1] for i, axis in enumerate((a, e))]
    return np.concatenate((image, *waves), axis=2)


def _plane_slopes(sweep: Sweep) -> Array:
    """Of the functions of the image by the angles, (n, 6, 2) per rad."""
    a, e = _scaled(sweep).T
    nought, one = np.zeros_like(a), np.ones_like(a)
    by_a = np.stack((nought, one, nought, 2.0 * a, e, nought), axis=1)
    by_e = np.stack((nought, nought, one, nought, a, 2.0 * e), axis=1)
    return np.asarray(np.stack((by_a, by_e), axis=2) * (2.0 / np.ptp(sweep.angles_rad, axis=0)), np.float64)


def _scaled(sweep: Sweep) -> Array:
    """Both angles, (n, 2), to -1 .. 1."""
    return np.asarray(2.0 * (sweep.angles_rad - sweep.angles_rad.min(axis=0)) / np.ptp(sweep.angles_rad, axis=0) - 1.0)


def _waves(angle: Array) -> Array:
    """Beyond the quadratic, which the image has: Legendre's polynomials of a scaled angle, (n, ...)."""
    return np.asarray(np.polynomial.legendre.legvander(angle, DEGREE)[:, 3:], np.float64)
