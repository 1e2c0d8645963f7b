"""What a cell's configuration tells of a camera whose pictures are looked at: noise, lens, the probe before it."""

from dataclasses import dataclass

from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Image
from trackerd.formats.calibration import load_calibration
from trackerd.formats.config import CellConfig
from trackerd.formats.settings import CameraSettings
from trackerd.geometry.lens import Lens


@dataclass(frozen=True, slots=True)
class Camera:
    """One camera of a cell."""

    name: str
    gain_e_per_dn: float
    read_noise_e: float
    image_px: tuple[int, int]  # width, height
    origin_px: tuple[int, int]  # sensor coordinates of the image's first pixel
    lens: Lens
    probe_radius_mm: float

    def origin_of(self, image: Image) -> tuple[int, int]:
        """Where the image is on the sensor: it is the configured region, or all of it. Raises ConfigError for another size."""
        height, width = image.shape
        if (width, height) == self.image_px:
            return self.origin_px
        if (width, height) == self.lens.sensor_px:
            return (0, 0)
        sizes = " or ".join(f"{w} x {h}" for w, h in (self.image_px, self.lens.sensor_px))
        raise ConfigError(f"[camera.{self.name}]: its pictures have {sizes} px, this one has {width} x {height}")


def camera_of(cell: CellConfig, name: str | None = None, station: str | None = None) -> Camera:
    """By its own name, by its station's, or the only one. Raises ConfigError."""
    if name is None and station is not None and station in cell.gimbals:
        name = cell.gimbals[station].camera
    if name is None and len(cell.cameras) == 1:
        name = next(iter(cell.cameras))
    names = ", ".join(cell.cameras)
    if name is None:
        raise ConfigError(f"{cell.path.name}: which camera? --camera NAME, one of {names}")
    if name not in cell.cameras:
        raise ConfigError(f"{cell.path.name}: --camera {name}: no such camera (there are: {names})")
    return _camera(cell, name, cell.cameras[name])


def _camera(cell: CellConfig, name: str, settings: CameraSettings) -> Camera:
    carried_by = next((station for station, gimbal in cell.gimbals.items() if gimbal.camera == name), None)
    stations = load_calibration(cell.calibration).stations
    if carried_by not in stations:
        raise ConfigError(f"{cell.path.name} [camera.{name}]: no gimbal carries it, so no calibration tells its lens")
    return Camera(
        name,
        settings.gain_e_per_dn,
        settings.read_noise_e,
        (settings.width_px, settings.height_px),
        (settings.offset_x_px, settings.offset_y_px),
        stations[carried_by].lens,
        cell.probe.radius_mm,
    )
