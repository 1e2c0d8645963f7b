"""The compiled kernel of the circle fit says what the reference says, of every kind of picture; and which one is used."""

import sys
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from vision_pictures import NOISE, Ball

from trackerd.contract.model import Missed
from trackerd.geometry.lens import Lens
from trackerd.vision import by_numpy, kernels, rays
from trackerd.vision.convergence import CircleFit, Converge
from trackerd.vision.curve import View
from trackerd.vision.fit import fit_circle
from trackerd.vision.noise import NoiseModel
from trackerd.vision.verify import LEAST_COVERAGE, edge_sectors, verified

SEEDS = 8
Circle = tuple[float, float, float]


@pytest.fixture(scope="module")
def compiled() -> Converge:
    pytest.importorskip("numba")
    from trackerd.vision import by_numba

    return by_numba.converge


def smeared(ball: Ball) -> np.ndarray:
    ways = np.linspace(-4.0, 4.0, 9)
    return np.asarray(np.mean([Ball(ball.x_px + 0.6 * w, ball.y_px + 0.8 * w).clean for w in ways], axis=0))


def with_noise(clean: np.ndarray, seed: int) -> np.ndarray:
    return np.clip(np.rint(clean + np.random.default_rng(seed).normal(0.0, 1.7, clean.shape)), 0, 255).astype(np.uint8)


def sixteen_bits(ball: Ball, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, 24.0, ball.clean.shape)
    return np.clip(ball.clean * 16.0 + noise, 0, 4095).astype(np.uint16)


Picture = Callable[[int], np.ndarray]
DEEP = NoiseModel(39.0 / 16.0, 3.0, saturation_dn=4095.0)
SMEARED = smeared(Ball())


def taken(ball: Ball) -> tuple[Ball, Picture, NoiseModel]:
    return ball, ball.noisy, NOISE


CASES: dict[str, tuple[Ball, Picture, NoiseModel]] = {
    "plain": taken(Ball()),
    "stem": taken(Ball(stem=True)),
    "clutter": taken(Ball(stem=True, clutter=True)),
    "low contrast": taken(Ball(contrast_dn=12.0)),
    "dark": taken(Ball(contrast_dn=-45.0)),
    "small": taken(Ball(r_px=12.0)),
    "smallest": taken(Ball(r_px=5.0)),
    "large": taken(Ball(r_px=150.0)),
    "out of focus": taken(Ball(blur_px=2.5)),
    "cut by the border": taken(Ball(x_px=38.4)),
    "cut by a corner": taken(Ball(x_px=28.4, y_px=441.0)),
    "saturated": taken(Ball(background_dn=90.0, contrast_dn=190.0)),
    "nothing there": taken(Ball(contrast_dn=0.0, clutter=True)),
    "mostly outside": taken(Ball(x_px=-40.0)),
    "smeared": (Ball(), lambda seed: with_noise(SMEARED, seed), NOISE),
    "16 bits": (Ball(stem=True), lambda seed: sixteen_bits(Ball(stem=True), seed), DEEP),
    "16 bits, saturated": (
        Ball(contrast_dn=210.0),
        lambda seed: sixteen_bits(Ball(background_dn=90.0, contrast_dn=210.0), seed),
        DEEP,
    ),
}


def starts(ball: Ball) -> Iterator[tuple[int, Circle]]:
    for seed in range(SEEDS):
        x, y, r = np.random.default_rng(100 + seed).uniform(-1.0, 1.0, 3).tolist()
        yield seed, (ball.x_px + 1.5 * x, ball.y_px + 1.5 * y, ball.r_px * (1.0 + 0.02 * r))


def assert_same(one: CircleFit | None, other: CircleFit | None, noise: NoiseModel) -> None:
    if one is None or other is None:
        assert one is other
        return
    assert (other.x_px, other.y_px, other.r_px) == pytest.approx((one.x_px, one.y_px, one.r_px), abs=1e-6)
    assert (other.sigma_px, other.chi2, other.clipped) == pytest.approx((one.sigma_px, one.chi2, one.clipped), rel=1e-6)
    scale = np.sqrt(np.outer(np.diag(one.cov_px2), np.diag(one.cov_px2)))
    assert np.abs((other.cov_px2 - one.cov_px2) / scale).max() < 1e-6
    assert other.settled is one.settled
    assert np.allclose(other.weight, one.weight, rtol=0.0, atol=1e-6)
    assert np.array_equal(edge_sectors(other.sectors, noise), edge_sectors(one.sectors, noise))
    assert np.allclose(other.sectors.chi2, one.sectors.chi2, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", CASES)
def test_both_kernels_find_the_same_circle(name: str, compiled: Converge) -> None:
    ball, picture, noise = CASES[name]
    for seed, start in starts(ball):
        image = picture(seed)
        assert_same(
            fit_circle(image, start, noise, kernel=by_numpy.converge), fit_circle(image, start, noise, kernel=compiled), noise
        )


@pytest.mark.parametrize("name", CASES)
def test_both_kernels_see_the_same_first_circle(name: str, compiled: Converge) -> None:
    from trackerd.vision import by_numba

    ball, picture, noise = CASES[name]
    for seed, (x, y, r) in starts(ball):
        image, guess = picture(seed), (x + 3.0, y - 2.0, 1.03 * r)
        one, other = rays.first_circle(image, guess, noise), by_numba.first_circle(image, guess, noise)
        assert (one is None) is (other is None)
        assert one is None or other == pytest.approx(one, abs=1e-4)  # single precision; the fit takes it to the same end


def test_both_kernels_see_the_same_first_circle_through_a_wide_lens(compiled: Converge) -> None:
    from trackerd.vision import by_numba

    view = View(Lens((640, 480), 600.0, 600.0, 60.0, 40.0, (-0.1, 0.0, 0.0, 0.0, 0.0)))
    ball = Ball()
    guess = (ball.x_px + 2.0, ball.y_px + 1.0, ball.r_px)
    one, other = (first(ball.noisy(1), guess, NOISE, view=view) for first in (rays.first_circle, by_numba.first_circle))
    assert one is not None
    assert other == pytest.approx(one, abs=1e-4)


@pytest.mark.parametrize("pixel", [np.uint8, np.uint16])
@pytest.mark.parametrize("fill", ["flat", "black", "white", "random"])
def test_both_kernels_refuse_the_same_pictures(fill: str, pixel: type, compiled: Converge) -> None:
    greatest = np.iinfo(pixel).max
    level = {"flat": 80, "black": 0, "white": greatest}.get(fill)
    for seed in range(SEEDS):
        random = np.random.default_rng(seed)
        image = random.integers(0, greatest, (200, 240)) if level is None else np.full((200, 240), level)
        start = (random.uniform(-20, 260), random.uniform(-20, 220), random.uniform(4, 130))
        for kernel in (by_numpy.converge, compiled):
            fit = fit_circle(image.astype(pixel), start, NOISE, kernel=kernel)
            assert fit is None or isinstance(verified(fit, NOISE, LEAST_COVERAGE), Missed)
            assert fit is None or fill == "random"


def test_any_view_of_an_image_is_taken(compiled: Converge) -> None:
    ball = Ball()
    image, start = ball.noisy(1), (ball.x_px, ball.y_px, ball.r_px)
    wide = np.zeros((480, 700), np.uint8)
    wide[:, 20:660] = image
    locked = image.copy()
    locked.flags.writeable = False
    packed = np.frombuffer(b"\0" + sixteen_bits(ball, 1).tobytes(), np.uint16, offset=1) if sys.byteorder == "little" else None
    expected = fit_circle(image, start, NOISE, kernel=compiled)
    for view in (wide[:, 20:660], locked, np.asfortranarray(image)):
        assert_same(expected, fit_circle(view, start, NOISE, kernel=compiled), NOISE)
    if packed is not None:  # 16 bits that begin at an odd address
        crooked = packed.reshape(image.shape)
        assert_same(
            fit_circle(crooked.copy(), start, DEEP, kernel=compiled), fit_circle(crooked, start, DEEP, kernel=compiled), DEEP
        )


def test_the_compiled_kernel_is_used_where_numba_is_installed() -> None:
    pytest.importorskip("numba")
    assert kernels.warm_up() == kernels.name() == "numba"


def test_without_numba_the_reference_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    for name in ("by_numba", "compiled"):
        monkeypatch.delitem(sys.modules, f"trackerd.vision.{name}", raising=False)
    monkeypatch.delattr("trackerd.vision.by_numba", raising=False)
    kernels._compiled.cache_clear()
    try:
        assert kernels.warm_up() == kernels.name() == "numpy"
    finally:
        kernels._compiled.cache_clear()
