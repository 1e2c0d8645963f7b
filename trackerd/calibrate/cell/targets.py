"""What the cameras looked at: points of bodies. A body is the world, a board in one place, a lamp array, or a mover."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array
from trackerd.geometry.rigid import Rigid

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Body:
    """What its points move with.

    `world_from_body` is exact where `fixed`, else a start value, or None: found without a guess. A mover's points are
    R_flange ball + t_flange in the mover's base: its ball in the flange is unknown with `ball_sigma_mm` (0: exact; inf: only a
    start value).
    """

    name: str
    world_from_body: Rigid | None = None
    fixed: bool = False
    ball_mm: Array | None = None  # (3,) in the flange; None: no mover
    ball_sigma_mm: float = np.inf


WORLD = Body("world", Rigid.identity(), fixed=True)


@dataclass(frozen=True, slots=True)
class Targets:
    """m points. In its body's frame a point is p_mm + flange @ ball + error, the error having covariance cov_mm2.

    A `free` point is unknown: p_mm is a start value or NaN, the covariance does not count.
    """

    bodies: tuple[Body, ...]
    names: tuple[str, ...]  # (m), each once
    body: Indices  # (m,) into bodies
    p_mm: Array  # (m, 3) in the body; the flange's position for a mover
    cov_mm2: Array  # (m, 3, 3), 0: exact
    free: npt.NDArray[np.bool_]  # (m,)
    flange: Array  # (m, 3, 3): R_base_from_flange of a mover's pose, 0 for every other point
    bar_points: Indices = field(default_factory=lambda: np.zeros((0, 2), np.intp))  # (b, 2) its ends
    bar_mm: Array = field(default_factory=lambda: np.zeros(0))  # (b,) length
    bar_sigma_mm: Array = field(default_factory=lambda: np.zeros(0))  # (b,)

    def __len__(self) -> int:
        return len(self.names)


def known_points(
    p_mm: npt.ArrayLike, names: Sequence[str] | None = None, cov_mm2: npt.ArrayLike = 0.0, body: Body = WORLD
) -> Targets:
    """Points (m, 3) known in the world, or in a body that is given (a board, a lamp array).

    `cov_mm2`: 0 for exact ones, one variance, variances (m,), or covariances (m, 3, 3). Names default to BODY:0, BODY:1...
    """
    p = np.asarray(p_mm, float)
    if p.ndim != 2 or p.shape[1] != 3 or not len(p):
        raise ConfigError(f"targets of {body.name}: points must be (m, 3), not {p.shape}")
    if not np.isfinite(p).all():
        raise ConfigError(f"targets of {body.name}: point {int(np.argmin(np.isfinite(p).all(axis=1)))} is not finite")
    cov = _covariances(np.asarray(cov_mm2, float), len(p), body.name)
    return _checked(body, names, p, cov, np.zeros(len(p), bool), np.zeros((len(p), 3, 3)))


def board(
    name: str, p_board_mm: npt.ArrayLike, world_from_board: Rigid | None = None, names: Sequence[str] | None = None
) -> Targets:
    """One placement of a board whose pose is unknown; names default to NAME:0, NAME:1... Points need not lie in a plane."""
    return known_points(p_board_mm, names, body=Body(name, world_from_board))


def unknown_points(names: Sequence[str], p_mm: npt.ArrayLike | None = None) -> Targets:
    """Points of the world of which nothing is known but that they stand still; p_mm (m, 3) are start values."""
    count = len(names)
    p = np.full((count, 3), np.nan) if p_mm is None else np.asarray(p_mm, float)
    return _checked(WORLD, names, p, np.zeros((count, 3, 3)), np.ones(count, bool), np.zeros((count, 3, 3)))


def mover(
    name: str,
    rotations: npt.ArrayLike,
    translations_mm: npt.ArrayLike,
    ball_mm: npt.ArrayLike,
    *,
    ball_sigma_mm: float = np.inf,
    sigma_mm: float = 0.0,
    world_from_base: Rigid | None = None,
    fixed: bool = False,
    names: Sequence[str] | None = None,
) -> Targets:
    """The ball of a machine or robot at m poses, base from flange: rotations (m, 3, 3), translations_mm (m, 3).

    `sigma_mm` is what each axis of a single position is off by (a CNC 0.005, a robot 0.65). `fixed` makes its base the world
    when no world_from_base is given.
    """
    r, t = np.asarray(rotations, float), np.asarray(translations_mm, float)
    if t.ndim != 2 or t.shape[1] != 3 or r.shape != (len(t), 3, 3):
        raise ConfigError(f"mover {name}: rotations must be (m, 3, 3) and translations (m, 3), not {r.shape} and {t.shape}")
    if not (np.isfinite(t).all() and np.allclose(r @ r.transpose(0, 2, 1), np.eye(3), atol=1e-6)):
        raise ConfigError(f"mover {name}: a pose is not finite, or its rotation is none")
    if sigma_mm < 0.0 or ball_sigma_mm < 0.0:
        raise ConfigError(f"mover {name}: a sigma must be 0 or more")
    pose = Rigid.identity() if fixed and world_from_base is None else world_from_base
    body = Body(name, pose, fixed, np.asarray(ball_mm, float), ball_sigma_mm)
    cov = np.broadcast_to(np.eye(3) * sigma_mm**2, (len(t), 3, 3)).copy()
    return _checked(body, names, t, cov, np.zeros(len(t), bool), r)


def join(*parts: Targets) -> Targets:
    """Several targets as one. Bodies of the same name must be the same."""
    bodies: list[Body] = []
    for body in (body for part in parts for body in part.bodies):
        same = [other for other in bodies if other.name == body.name]
        if same and same[0] is not body and (body.ball_mm is not None or _pose_key(same[0]) != _pose_key(body)):
            raise ConfigError(f"targets: body {body.name} is there twice, and differs")
        if not same:
            bodies.append(body)
    index = {body.name: i for i, body in enumerate(bodies)}
    names = tuple(name for part in parts for name in part.names)
    _check_names(names)
    starts = np.cumsum([0, *(len(part) for part in parts)])
    return Targets(
        bodies=tuple(bodies),
        names=names,
        body=np.array([index[part.bodies[b].name] for part in parts for b in part.body], np.intp),
        p_mm=np.concatenate([part.p_mm for part in parts]),
        cov_mm2=np.concatenate([part.cov_mm2 for part in parts]),
        free=np.concatenate([part.free for part in parts]),
        flange=np.concatenate([part.flange for part in parts]),
        bar_points=np.concatenate([part.bar_points + start for part, start in zip(parts, starts, strict=False)]),
        bar_mm=np.concatenate([part.bar_mm for part in parts]),
        bar_sigma_mm=np.concatenate([part.bar_sigma_mm for part in parts]),
    )


def with_bars(targets: Targets, ends: Sequence[tuple[str, str]], length_mm: npt.ArrayLike, sigma_mm: npt.ArrayLike) -> Targets:
    """Adds bars: known distances between two points each. Lengths and sigmas: (b,), or one number for all."""
    index = {name: i for i, name in enumerate(targets.names)}
    missing = sorted({name for pair in ends for name in pair if name not in index})
    if missing:
        raise ConfigError(f"bars: point {', '.join(missing)}: no target has this name")
    length = np.broadcast_to(np.asarray(length_mm, float), (len(ends),))
    sigma = np.broadcast_to(np.asarray(sigma_mm, float), (len(ends),))
    if not (np.isfinite(length).all() and np.isfinite(sigma).all() and length.min() > 0.0 and sigma.min() > 0.0):
        raise ConfigError("bars: lengths and sigmas must be finite and above 0")
    pairs = np.array([(index[a], index[b]) for a, b in ends], np.intp).reshape(-1, 2)
    return replace(
        targets,
        bar_points=np.concatenate([targets.bar_points, pairs]),
        bar_mm=np.concatenate([targets.bar_mm, length]),
        bar_sigma_mm=np.concatenate([targets.bar_sigma_mm, sigma]),
    )


def _pose_key(body: Body) -> tuple[object, ...]:
    pose = body.world_from_body
    return (
        body.fixed,
        None if pose is None else (pose.rotation.tobytes(), pose.translation_mm.tobytes()),
        body.ball_mm is None,
    )


def _checked(
    body: Body, names: Sequence[str] | None, p_mm: Array, cov_mm2: Array, free: npt.NDArray[np.bool_], flange: Array
) -> Targets:
    labels = tuple(f"{body.name}:{i}" for i in range(len(p_mm))) if names is None else tuple(str(name) for name in names)
    if len(labels) != len(p_mm):
        raise ConfigError(f"targets of {body.name}: {len(labels)} names for {len(p_mm)} points")
    _check_names(labels)
    if body.fixed and body.world_from_body is None:
        raise ConfigError(f"body {body.name}: it is fixed, so it needs its pose")
    return Targets((body,), labels, np.zeros(len(p_mm), np.intp), p_mm, cov_mm2, free, flange)


def _check_names(names: Sequence[str]) -> None:
    if len(set(names)) != len(names):
        twice = next(name for name in names if list(names).count(name) > 1)
        raise ConfigError(f"targets: point {twice} is there twice")


def _covariances(cov: Array, count: int, body: str) -> Array:
    if cov.ndim < 2:
        cov = np.broadcast_to(cov, (count,))[:, None, None] * np.eye(3)
    if cov.shape != (count, 3, 3):
        raise ConfigError(f"targets of {body}: covariances must be (m, 3, 3), not {cov.shape}")
    if not np.isfinite(cov).all() or np.linalg.eigvalsh(cov).min() < -1e-12 * max(float(np.abs(cov).max()), 1e-30):
        raise ConfigError(f"targets of {body}: a covariance is not finite, or not positive semidefinite")
    return np.array(cov)
