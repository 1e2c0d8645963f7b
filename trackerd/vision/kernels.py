"""Which kernel fits the circles: the compiled one where numba is installed (extra `fast`), else NumPy's."""

from functools import cache
from types import ModuleType

from trackerd.contract.model import Image
from trackerd.vision import by_numpy, rays
from trackerd.vision.convergence import Converge
from trackerd.vision.curve import View
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import REACH_PX, Circle


@cache
def _compiled() -> ModuleType | None:
    """The first call loads it: half a second and more with numba, half a minute where its cache is cold."""
    try:
        from trackerd.vision import by_numba  # noqa: PLC0415  heavy, and not installed everywhere
    except ImportError:
        return None
    return by_numba


def converge() -> Converge:
    """The kernel in use."""
    compiled = _compiled()
    return by_numpy.converge if compiled is None else compiled.converge


def first_circle(
    image: Image, guess: Circle, noise: NoiseModel, reach_px: float = REACH_PX, view: View | None = None
) -> Circle | None:
    """As rays.first_circle, by the kernel in use."""
    compiled = _compiled()
    find = rays.first_circle if compiled is None else compiled.first_circle
    circle: Circle | None = find(image, guess, noise, reach_px, view)
    return circle


def name() -> str:
    return "numpy" if _compiled() is None else "numba"


def warm_up() -> str:
    """Loads or compiles the kernel, so that no frame has to wait for it; its name."""
    return name()
