"""Error of a joint's centre for several arcs and noises, by circles, rigid bodies and the chain.

A marker, or a body with three markers, swings about a joint of the still base. The frames are evenly spaced over the
arc. Every estimator gets the same trials. 400 trials take about two minutes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from circles import CircleMethod, fit_circles, fit_common_centre
from harness import describe_source, format_table, make_parser, publish, rms

from mocap_id.arrays import ComplexArray, IntArray
from mocap_id.errors import NumericalError
from mocap_id.kinematics.bundle import fit_chain
from mocap_id.kinematics.joint import fit_body, fit_joint, still_body

FRAMES, RADIUS = 200, 0.35
ARCS = tuple(map(float, np.radians([5, 10, 15, 30, 60, 90])))
NOISES = (0.25e-3, 0.5e-3, 1e-3)
BODY, TIGHT = 0.132, 0.05  # m from the centroid to each of the three markers
STUDY = float(np.radians(10))
RESOLVED = 0.25  # of the radius: with a larger bound an arc can hardly be distinguished from a straight line
SINGLE = 10  # single markers per body, since they are fast
BASE: ComplexArray = np.array([0.1 + 0j, -0.1 + 0j, 0.05j])
SEGMENT: IntArray = np.array([0, 0, 0, 1, 1, 1])

CIRCLES: tuple[CircleMethod, ...] = ("kasa", "taubin", "pratt", "geometric")


class Spread(NamedTuple):
    """Distribution of the errors of one estimator, m."""

    bias: float
    sd: float
    rms: float
    along: float  # rms along the line to the markers
    lost: int  # trials without an estimate

    def __str__(self) -> str:
        lost = f" ({self.lost} lost)" if self.lost else ""
        if np.isnan(self.rms):
            return f"{format_millimetres(self.bias)} / {format_millimetres(self.sd)}*{lost}"
        return f"{format_millimetres(self.bias)} / {format_millimetres(self.sd)} / {format_millimetres(self.rms)}{lost}"


def summarise(errors: ComplexArray, *, resolved: bool = True) -> Spread:
    """Return the distribution of errors (trials,); the markers are in direction +i, NaN means no estimate."""
    known = errors[np.isfinite(errors)]
    lost = len(errors) - len(known)
    if not resolved:
        low, middle, high = np.quantile(known.imag, [0.1587, 0.5, 0.8413])
        return Spread(float(middle), float(high - low) / 2, np.nan, np.nan, lost)
    total, along = rms(np.abs(known)), rms(known.imag)
    return Spread(float(known.imag.mean()), float(known.imag.std(ddof=1)), float(total), float(along), lost)


def measure_single_markers(arc: float, noise: float, trials: int) -> list[Spread]:
    """Return the errors of the four circle fits."""
    rng = np.random.default_rng([1, round(1e6 * arc), round(1e6 * noise)])
    clean = make_tracks(arc, np.full(trials, RADIUS * 1j))
    tracks = [add_noise(rng, clean, noise) for _ in range(SINGLE)]
    resolved = compute_circle_bound(arc, noise) < RESOLVED * RADIUS
    found = {each: np.concatenate([fit_circles(one, each).centre for one in tracks]) for each in CIRCLES}
    return [summarise(errors, resolved=resolved or each == "kasa") for each, errors in found.items()]


def format_millimetres(metres: float) -> str:
    """Return millimetres with three digits and at most two decimals."""
    value = 1e3 * metres
    decimals = 0 if abs(value) >= 99.95 else 1 if abs(value) >= 9.995 else 2
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "\N{MINUS SIGN}")


def compute_circle_bound(arc: float, noise: float) -> float:
    """Return the lowest standard deviation that the curvature of one track permits, m."""
    return float(26.8 * noise / (np.sqrt(FRAMES) * arc**2))


def compute_body_bound(arc: float, noise: float, size: float) -> float:
    """Return the lowest standard deviation from the rotation of three markers, ``size`` from their centroid, m."""
    lever = np.sqrt(1 + (RADIUS / size) ** 2)
    return float(np.sqrt(12) * noise * lever / (np.sqrt(3 * FRAMES) * arc))


def make_tracks(arc: float, markers: ComplexArray) -> ComplexArray:
    """Return (F, M) tracks about the origin, with frames in the middle of equal parts of the arc."""
    angle = ((np.arange(FRAMES) + 0.5) / FRAMES - 0.5) * arc
    return np.asarray(np.exp(1j * angle)[:, None] * markers)


def add_noise(rng: np.random.Generator, tracks: ComplexArray, noise: float) -> ComplexArray:
    return np.asarray(tracks + noise * (rng.standard_normal(tracks.shape) + 1j * rng.standard_normal(tracks.shape)))


def fit_by_body(points: ComplexArray) -> complex:
    base, moving = np.flatnonzero(SEGMENT == 0), np.flatnonzero(SEGMENT == 1)
    return fit_joint(still_body(points, base), fit_body(points, moving)).in_parent


def fit_by_chain(points: ComplexArray) -> complex:
    """Return the joint of a chain with one moving segment; return NaN if the fit does not converge."""
    try:
        return complex(fit_chain(points, SEGMENT).centres[0])
    except NumericalError:
        return complex(np.nan)


BODIES: dict[str, Callable[[ComplexArray], complex]] = {
    "Kåsa": lambda points: complex(fit_common_centre(points[:, SEGMENT == 1], "kasa").centre[0]),
    "geometric": lambda points: complex(fit_common_centre(points[:, SEGMENT == 1], "geometric").centre[0]),
    "`fit_joint`": fit_by_body,
    "`fit_chain`": fit_by_chain,
}


def measure_bodies(arc: float, noise: float, size: float, trials: int) -> list[Spread]:
    """Return the errors of the four estimators that use all three markers, a triangle in a random orientation."""
    rng = np.random.default_rng([2, round(1e6 * arc), round(1e6 * noise), round(1e6 * size)])
    corners, found = size * np.exp(2j * np.pi * np.arange(3) / 3), []
    for _ in range(trials):
        moving = make_tracks(arc, RADIUS * 1j + corners * np.exp(2j * np.pi * rng.uniform()))
        points = add_noise(rng, np.concatenate([np.tile(BASE, (FRAMES, 1)), moving], axis=1), noise)
        found.append([fit(points) for fit in BODIES.values()])
    return [summarise(np.array(errors)) for errors in np.array(found).T]


def make_table(head: Sequence[str], cells: Callable[[float, float], list[str]]) -> str:
    """Return a table with a row for every arc, rad, with every noise, m."""
    rows = [[f"{np.degrees(arc):.0f}°", f"{1e3 * noise:g}", *cells(arc, noise)] for arc, noise in product(ARCS, NOISES)]
    return format_table(["arc", "σ", *head], rows, numbers_from=0)


def main() -> None:
    arguments = make_parser(__doc__, trials=400).parse_args()
    trials = arguments.trials

    def measure_one(arc: float, noise: float) -> list[str]:
        bias = RADIUS / (1 + (RADIUS * arc**2 / (26.8 * noise)) ** 2)  # of Kåsa's fit
        bounds = (bias, compute_circle_bound(arc, noise))
        return [*map(format_millimetres, bounds), *map(str, measure_single_markers(arc, noise, trials))]

    def measure_three(arc: float, noise: float) -> list[str]:
        bound = format_millimetres(compute_body_bound(arc, noise, BODY))
        return [bound, *map(str, measure_bodies(arc, noise, BODY, trials))]

    ratios = []  # to the bound, at ten degrees
    for size, noise in product((BODY, TIGHT), NOISES):
        bound = compute_body_bound(STUDY, noise, size)
        cells = [f"{errors.along / bound:.2f}" for errors in measure_bodies(STUDY, noise, size, trials)]
        ratios.append([f"{1e3 * size:.0f} mm", f"{1e3 * noise:g}", format_millimetres(bound), *cells])
    head = ["Kåsa's bias, formula", "bound (sd)", "Kåsa", "Taubin", "Pratt", "geometric"]
    sections = {
        "joint-centres": describe_source(__file__, f"{trials} trials per row ({SINGLE * trials} for single markers)"),
        "joint-centres-marker": make_table(head, measure_one),
        "joint-centres-body": make_table(["bound (sd)", *BODIES], measure_three),
        "joint-centres-ratio": format_table(["body", "σ", "bound (sd)", *BODIES], ratios, numbers_from=0),
    }
    publish(sections, write=arguments.write)


if __name__ == "__main__":
    main()
