"""Which kernel fits the circles: the compiled one where numba is installed (extra `fast`), else NumPy's."""

from functools import cache

from trackerd.vision import by_numpy
from trackerd.vision.convergence import Converge


@cache
def converge() -> Converge:
    """The kernel in use. The first call loads it: half a second and more with numba, some seconds where its cache is cold."""
    try:
        from trackerd.vision import by_numba  # noqa: PLC0415  heavy, and not installed everywhere
    except ImportError:
        return by_numpy.converge
    return by_numba.converge


def name() -> str:
    return "numpy" if converge() is by_numpy.converge else "numba"


def warm_up() -> str:
    """Loads or compiles the kernel, so that no frame has to wait for it; its name."""
    return name()
