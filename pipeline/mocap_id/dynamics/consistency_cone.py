"""Physical consistency without a grid: all planar bodies that can exist, as second-order cones.

A planar link can exist if and only if m·Izz ≥ mx² + my² and m ≥ 0. This is a second-order cone, and equals the set of
point masses anywhere in the plane. A mass that tends to zero can have any first moment if it is far enough away. Masses
inside a box meet more conditions: mx / m and my / m are between the sides of the box, and Izz is at most that of masses
at the corners with the same centre of mass:

    Izz ≤ (x₀ + x₁) mx + (y₀ + y₁) my - (x₀ x₁ + y₀ y₁) m.

This is the limit of point masses on finer and finer grids over the box.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray

LENGTH = 0.3
"""Unit of length with which the parameters of a segment have similar magnitudes, m."""
UNITS = np.array([1.0, LENGTH, LENGTH, LENGTH**2])
"""Divisors of a link's m, mx, my and Izz that convert all four to kg."""
FAR = 10.0
"""Distance up to which masses are searched without a box, m."""
ConeKind: TypeAlias = Literal["round", "flat", "semidefinite"]


@dataclass(frozen=True)
class ConeBodies:
    """Possible links, given by their full parameters (:class:`~mocap_id.dynamics.optimality.BodyCone`)."""

    mapping: FloatArray  # (b, 4(n + 1)) matrix M of eq. 4.24, from full parameters to the parameters of the problem.
    # (n + 1, 2, 2) lowest and highest corner of each link in its frame, m; None for masses anywhere
    boxes: FloatArray | None = None

    @property
    def links(self) -> int:
        """Number of links, base included."""
        return int(self.mapping.shape[1] // 4)

    @property
    def units(self) -> FloatArray:
        """Divisors (4(n + 1),) of the full parameters that convert all of them to kg."""
        return np.tile(UNITS, self.links)

    def sides(self) -> tuple[FloatArray, tuple[tuple[ConeKind, int], ...]]:
        """Return rows (r, 4(n + 1)) whose products with a body must be in cones, and the kind and size of each cone.

        The size of a round or a flat cone is its number of rows. Round (second-order) cones are first.
        """
        round_, flat = self.round_sides(), self.flat_sides()
        cones: list[tuple[ConeKind, int]] = [("round", 4) for _ in round_]
        return np.vstack([*round_, flat]), (*cones, ("flat", len(flat)))

    def is_limited(self, link: int) -> bool:
        """Return whether the cone limits the link's first moments: the link has a box, or its Izz has an effect."""
        return self.boxes is not None or bool(self.mapping[:, 4 * link + 3].any())

    def round_sides(self) -> FloatArray:
        """Return four rows, (l, 4, 4(n + 1)), for each of the l links that the cone limits.

        Their products with a body, (m + J, m - J, 2 mx / L, 2 my / L), kg, must be in a second-order cone. J is
        Izz / L², with any length L.
        """
        limited = [link for link in range(self.links) if self.is_limited(link)]
        rows = np.zeros((len(limited), 4, 4 * self.links))
        for row, link in zip(rows, limited, strict=True):
            row[:, 4 * link : 4 * link + 4] = (
                np.array([[1, 0, 0, 1], [1, 0, 0, -1], [0, 2, 0, 0], [0, 0, 2, 0]]) / UNITS
            )
        return rows

    def flat_sides(self) -> FloatArray:
        """Return rows (r, 4(n + 1)) whose products, kg, must not be negative: masses, and conditions of the boxes."""
        rows = np.zeros((self.links, 6, 4 * self.links))
        for link, row in enumerate(rows):
            own = slice(4 * link, 4 * link + 4)
            row[0, 4 * link] = 1.0
            if self.boxes is not None:
                (x0, y0), (x1, y1) = self.boxes[link] / LENGTH
                walls = [[-x0, 1, 0, 0], [x1, -1, 0, 0], [-y0, 0, 1, 0], [y1, 0, -1, 0]]
                row[1:, own] = np.array([*walls, [-(x0 * x1 + y0 * y1), x0 + x1, y0 + y1, -1]]) / UNITS
        used = rows if self.boxes is not None else rows[:, :1]
        return used.reshape(-1, 4 * self.links)

    def measure_violation(self, body: FloatArray) -> float:
        """Return the largest violation of any condition, kg, divided by the total mass."""
        sides = self.round_sides() @ body
        short = [*(np.linalg.norm(sides[:, 1:], axis=1) - sides[:, 0]), *(-(self.flat_sides() @ body))]
        return float(np.max([0.0, *short])) / max(self.mass(body), 1e-300)

    def mass(self, body: FloatArray) -> float:
        """Return the total mass, kg."""
        return float(np.abs(body[::4]).sum())

    def find_cheapest(self, prices: FloatArray) -> FloatArray:
        """Return, for each link, the parameters of 1 kg where it costs least, as columns (4(n + 1), n + 1).

        ``prices`` (4(n + 1),) has four coefficients c for each link; 1 kg at (x, y) costs c₀ + c₁x + c₂y + c₃(x² + y²).
        """
        columns = np.zeros((len(prices), self.links))
        for link in range(self.links):
            _, mx, my, izz = prices[4 * link : 4 * link + 4]
            (x0, y0), (x1, y1) = [[-FAR] * 2, [FAR] * 2] if self.boxes is None else self.boxes[link]
            x, y = _find_minimum(mx, izz, x0, x1), _find_minimum(my, izz, y0, y1)
            columns[4 * link : 4 * link + 4, link] = 1.0, x, y, x * x + y * y
        return columns

    def settle(self, body: FloatArray) -> FloatArray:
        """Return the body with negative masses set to 0 and an Izz that is too small increased (rounding errors)."""
        links = body.reshape(-1, 4).copy()
        links[:, 0] = np.maximum(links[:, 0], 0.0)
        first = np.sum(links[:, 1:3] ** 2, axis=1)
        for link in filter(self.is_limited, range(self.links)):
            least = first[link] / links[link, 0] if links[link, 0] > 0.0 else 0.0
            links[link, 3] = max(links[link, 3], least)
        return links.reshape(-1)


def _find_minimum(linear: float, square: float, low: float, high: float) -> float:
    """Return the point between two ends at which linear·x + square·x² is least."""
    inside = [] if square <= 0.0 else [float(np.clip(-linear / (2 * square), low, high))]
    return min([low, high, *inside], key=lambda x: linear * x + square * x * x)
