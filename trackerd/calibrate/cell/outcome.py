"""From the adjusted state to what the caller gets."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trackerd.calibrate.cell.adjust import Adjusted
from trackerd.calibrate.cell.covariance import covariance_of, points_covariance
from trackerd.calibrate.cell.known import Flags, names_of
from trackerd.calibrate.cell.problem import Problem
from trackerd.calibrate.cell.result import BodyFound, CellResult, Rejected, Residuals
from trackerd.calibrate.cell.state import BODY_COLUMNS, STATION_COLUMNS, inverse_2, points_in_world, stations_of
from trackerd.calibrate.cell.weights import Flags as PointFlags
from trackerd.calibrate.cell.weights import offsets
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid


@dataclass(frozen=True, slots=True)
class Solved:
    """With the last weights, 1 or 0."""

    problem: Problem
    adjusted: Adjusted
    allowed: Flags  # station columns that were free
    bad_views: PointFlags
    dof: int


def result_of(solved: Solved, stations: Sequence[Station], stand_tilt_rad: float, warnings: Sequence[str]) -> CellResult:
    problem, adjusted = solved.problem, solved.adjusted
    covariance = covariance_of(problem, adjusted.normal, adjusted.columns.free)
    tilts = STATION_COLUMNS * np.arange(problem.layout.stations)[:, None] + np.arange(3)
    covariance[tilts, tilts] += stand_tilt_rad**2
    end = problem.layout.bodies_at
    known = np.flatnonzero(np.diag(covariance)[:end] > 0.0)
    names = names_of(stations)
    points = points_in_world(adjusted.state, problem.targets, np.arange(len(problem.targets)))[0]
    unseen = problem.targets.free & (problem.layout.slot < 0)
    points[unseen] = np.nan
    chi2 = adjusted.normal.cost
    return CellResult(
        stations=stations_of(adjusted.state, stations),
        parameters=tuple(names[i] for i in known),
        covariance=covariance[np.ix_(known, known)],
        chi2=chi2,
        dof=solved.dof,
        forced=any(text.startswith("forced") for text in warnings),
        residuals=_residuals(solved),
        rejected=_rejected(solved),
        bodies=_bodies(solved, covariance),
        points_mm=points,
        points_cov_mm2=points_covariance(problem, adjusted.state, covariance),
        warnings=tuple(warnings),
        iterations=adjusted.iterations,
    )


def _residuals(solved: Solved) -> Residuals:
    problem, linear = solved.problem, solved.adjusted.linear
    o = problem.observations
    normal, weights = solved.adjusted.normal, solved.adjusted.weights
    correction = -np.einsum("vij,vj->vi", inverse_2(normal.encoder_information), normal.encoder_gradient)
    px = o.q_px - linear.q_px - np.einsum("nai,ni->na", linear.encoder, correction[o.view])
    left = np.eye(2) * o.sigma_px[:, None, None] ** 2 - weights.point[:, None, None] * (
        linear.encoder @ inverse_2(normal.encoder_information)[o.view] @ linear.encoder.transpose(0, 2, 1)
    )
    spread = np.eye(2) * problem.encoder_sigma_rad[:, None, None] ** 2 - inverse_2(normal.encoder_information)
    used = weights.point > 0.0
    return Residuals(
        px=px,
        whitened=_whitened(px, left),
        encoder_rad=correction,
        encoder_whitened=_whitened(correction, spread),
        used=used,
        used_view=np.bincount(o.view, used, problem.v) > 0,
    )


def _whitened(values: Array, covariances: Array) -> Array:
    """cov^-1/2 value by the eigenvectors; a direction without any spread has none."""
    eigenvalues, vectors = np.linalg.eigh(covariances)
    least = 1e-9 * np.maximum(eigenvalues[:, 1:], 1e-300)
    share = np.where(eigenvalues > least, 1.0 / np.sqrt(np.maximum(eigenvalues, least)), 0.0)
    return np.asarray(np.einsum("nij,nj,nkj,nk->ni", vectors, share, vectors, values))


def _rejected(solved: Solved) -> tuple[Rejected, ...]:
    problem, weights = solved.problem, solved.adjusted.weights
    o, names = problem.observations, problem.targets.names
    found = offsets(problem, solved.adjusted.linear, weights)
    whole = [
        Rejected(o.views[v], None, float(np.sqrt(found.view[v])), "its angles are off what its image points ask for")
        for v in np.flatnonzero(solved.bad_views).tolist()
    ]
    rows = np.flatnonzero((weights.point == 0.0) & ~solved.bad_views[o.view]).tolist()
    single = np.bincount(o.view, minlength=problem.v) == 1
    return (
        *whole,
        *(
            Rejected(
                o.views[o.view[i]],
                names[o.point[i]],
                float(np.sqrt(found.point[i])),
                "the image point or the angles are off what the rest says"
                if single[o.view[i]]
                else "the image point is off what the rest of its view says",
            )
            for i in rows
        ),
    )


def _bodies(solved: Solved, covariance: Array) -> dict[str, BodyFound]:
    state, layout = solved.adjusted.state, solved.problem.layout
    found = {}
    for b in np.unique(solved.problem.targets.body[solved.problem.observations.point]).tolist():
        body = solved.problem.targets.bodies[b]
        at = layout.bodies_at + BODY_COLUMNS * b
        ball = body.ball_mm is not None
        found[body.name] = BodyFound(
            Rigid(state.r_world_from_body[b], state.t_world_from_body[b]),
            covariance[at : at + 6, at : at + 6],
            state.ball_mm[b] if ball else None,
            covariance[at + 6 : at + 9, at + 6 : at + 9] if ball else None,
        )
    return found
