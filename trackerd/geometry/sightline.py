"""Pixel and angles to a line of sight in W, with its covariance."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import AxisAngles, Found, Sightline
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import cross
from trackerd.geometry.sphere import centre_and_range


@dataclass(frozen=True, slots=True)
class Instants:
    """When the frame was exposed and when it was complete."""

    exposed: HostNs
    exposed_sigma_ns: float
    received: HostNs


def sightline(station: Station, found: Found, angles: AxisAngles, radius_mm: float, instants: Instants) -> Sightline:
    """Line of sight from the entrance pupil to the sphere's centre; `found` is in sensor coordinates.

    The covariance is that of the direction, across it, (3, 3) of rank 2 in rad^2: pixel part by the lens, encoder part by the
    swing of the *target point* about each axis over the range, so that the lever arm's share is in it.
    """
    world_from_camera = station.world_from_camera(angles.az_rad, angles.el_rad)
    d_camera, range_mm = centre_and_range(np.array((found.x_px, found.y_px)), found.r_px, radius_mm, station.lens)
    direction = world_from_camera.rotate(d_camera)
    p_mm = world_from_camera.translation_mm + direction * range_mm

    px_per_angle = station.lens.jacobian(d_camera)  # (2, 3): of a point at unit distance
    angle_per_px = px_per_angle.T @ np.linalg.inv(px_per_angle @ px_per_angle.T)
    pixel_part = world_from_camera.rotation @ angle_per_px
    axes = station.axes(angles.az_rad, angles.el_rad)
    swing = np.column_stack((cross(axes.az, p_mm - axes.p_az_mm), cross(axes.el, p_mm - axes.p_el_mm))) / range_mm
    across = np.eye(3) - np.outer(direction, direction)
    pixel_part, swing = across @ pixel_part, across @ swing
    encoder_cov = swing @ swing.T
    return Sightline(
        station=station.name,
        instant=instants.exposed,
        instant_sigma_ns=instants.exposed_sigma_ns,
        origin_mm=world_from_camera.translation_mm,
        direction=direction,
        cov_rad2=pixel_part @ found.cov_px2[:2, :2] @ pixel_part.T + angles.sigma_rad**2 * encoder_cov,
        fixed_cov_rad2=angles.fixed_sigma_rad**2 * encoder_cov,
        range_mm=range_mm,
        range_sigma_mm=range_mm * sqrt(float(found.cov_px2[2, 2])) / found.r_px,
        received=instants.received,
    )
