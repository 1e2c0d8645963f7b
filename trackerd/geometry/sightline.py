"""Pixel and angles to a line of sight in W, with its covariance."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Array, AxisAngles, Found, Sightline
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import cross
from trackerd.geometry.sphere import centre_and_range


@dataclass(frozen=True, slots=True)
class Instants:
    """When the frame was exposed and when it was complete."""

    exposed: HostNs
    exposed_sigma_ns: float
    received: HostNs


@dataclass(frozen=True, slots=True)
class Seen:
    """A target at known angles."""

    line: Sightline
    jacobian: Array  # (2, 2) d px / d encoder rad (az, el) of the target, fixed in W


def sightline(station: Station, found: Found, angles: AxisAngles, radius_mm: float, instants: Instants) -> Sightline:
    """As `seen`: the line of sight alone."""
    return seen(station, found, angles, radius_mm, instants).line


def seen(station: Station, found: Found, angles: AxisAngles, radius_mm: float, instants: Instants) -> Seen:
    """Line of sight from the entrance pupil to the sphere's centre; `found` is in sensor coordinates.

    The covariance is that of the direction, across it, (3, 3) of rank 2 in rad^2: pixel part by the lens, encoder part by the
    swing of the *target point* about each axis over the range, so that the lever arm's share is in it.
    """
    pose = station.pose(angles.az_rad, angles.el_rad)
    rotation, origin_mm = pose.world_from_camera.rotation, pose.world_from_camera.translation_mm
    d_camera, range_mm = centre_and_range(np.array((found.x_px, found.y_px)), found.r_px, radius_mm, station.lens)
    direction = rotation @ d_camera
    px_per_angle = station.lens.jacobian(d_camera) @ rotation.T  # (2, 3): of a point at unit distance; nothing along it
    angle_per_px = px_per_angle.T @ _inverse(px_per_angle @ px_per_angle.T)
    swing = pose.axes.swing(origin_mm + direction * range_mm) / range_mm
    across = swing - np.outer(direction, direction @ swing)
    encoder_cov = across @ across.T
    line = Sightline(
        station=station.name,
        instant=instants.exposed,
        instant_sigma_ns=instants.exposed_sigma_ns,
        origin_mm=origin_mm,
        direction=direction,
        cov_rad2=angle_per_px @ found.cov_px2[:2, :2] @ angle_per_px.T + angles.sigma_rad**2 * encoder_cov,
        fixed_cov_rad2=angles.fixed_sigma_rad**2 * encoder_cov,
        range_mm=range_mm,
        range_sigma_mm=range_mm * sqrt(float(found.cov_px2[2, 2])) / found.r_px,
        received=instants.received,
    )
    return Seen(line, -px_per_angle @ swing)


def tangent_basis(direction: Array) -> Array:
    """Two unit vectors u and v across a unit direction (3,), as rows (2, 3); u x v is the direction.

    u is level as seen along the axis of W that the direction is farthest from (the first of equals): u = axis x direction,
    normalised. It jumps where that axis changes, so bases of different directions are not to be mixed.
    """
    axis = np.zeros(3)
    axis[int(np.argmin(np.abs(direction)))] = 1.0
    u = cross(axis, direction)
    u /= sqrt(float(u @ u))
    return np.array((u, cross(direction, u)))


def angular_cov(line: Sightline) -> tuple[Array, Array]:
    """The line's covariance as that of two angles: random and fixed part, (2, 2) each in rad^2, in `tangent_basis`.

    To first order the direction is d + a u + b v with (a, b) of this covariance; cov_rad2 = basis.T @ cov @ basis.
    """
    basis = tangent_basis(line.direction)
    return basis @ line.cov_rad2 @ basis.T, basis @ line.fixed_cov_rad2 @ basis.T


def _inverse(matrix: Array) -> Array:
    """Of a (2, 2)."""
    (a, b), (c, d) = matrix.tolist()
    det = a * d - b * c
    return np.array(((d / det, -b / det), (-c / det, a / det)))
