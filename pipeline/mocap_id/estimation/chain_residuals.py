"""Residuals of the markers in their segments' frames, without the part that follows the posture, and their spectra."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray
from mocap_id.estimation.smoothing import States
from mocap_id.geometry.planar import segment_poses

_LEAST = 10  # frames per unknown of a regression
_WINDOW = 4.0  # s
_MOST = 400  # windows of a median spectrum


@dataclass(frozen=True)
class ChainResiduals:
    """Residuals of the markers from the chain.

    Parameters
    ----------
    states : States
    used_markers : (F, M, 2) array
        Markers used for the states, plane frame, m; NaN elsewhere.
    rate : float
        Frames per second.
    """

    states: States
    used_markers: FloatArray
    rate: float

    @cached_property
    def _poses(self) -> tuple[FloatArray, FloatArray]:
        return segment_poses(self.states.mean[..., 0], self.states.chain.centres)

    @cached_property
    def _posture(self) -> FloatArray:
        """Orthonormal basis (F, P) of the quadratic functions of the angles; zero where an angle is not given."""
        angles = self.states.mean[..., 0]
        centred = np.nan_to_num(angles - np.nanmean(angles, axis=0))
        n = centred.shape[1]
        products = [centred[:, i] * centred[:, j] for i in range(n) for j in range(i, n)]
        basis = np.column_stack([np.ones(len(centred)), centred, *products])
        basis[~np.isfinite(angles).all(axis=1)] = 0
        return np.asarray(np.linalg.qr(basis)[0])

    def columns(self) -> Iterator[tuple[int, ComplexArray, BoolArray]]:
        """Yield each marker with enough samples: its number, its residual (F,) in m, and where it is used (F,).

        The residual is interpolated in gaps. A part that is a quadratic function of the joint angles is removed: sliding
        skin accounts for it (:mod:`mocap_id.kinematics.skin_slides`).
        """
        turn, origin = self._poses
        every = np.arange(len(turn))
        for k, (segment, local) in enumerate(zip(self.states.chain.segment, self.states.chain.local, strict=True)):
            back = np.exp(-1j * turn[:, segment])
            away = self.used_markers[:, k] - origin[:, segment]
            off = (away[:, 0] + 1j * away[:, 1]) * back - complex(*local)
            seen: BoolArray = np.isfinite(off)
            basis = self._posture[seen]
            if np.count_nonzero(seen) < _LEAST * basis.shape[1]:
                continue
            known = off[seen]
            known -= basis @ np.linalg.lstsq(basis.T @ basis, basis.T @ known, rcond=None)[0]
            filled = np.interp(every, every[seen], known.real) + 1j * np.interp(every, every[seen], known.imag)
            yield k, filled, seen

    def median_spectrum(self) -> tuple[FloatArray, FloatArray]:
        """Return frequencies (P,), Hz, and the median of the markers' power spectra (P,), m²/Hz; empty if too short.

        Only windows in which a marker has no gap count. The median is not affected by bursts.
        """
        found = [part for _, off, seen in self.columns() for part in spectra(off, self.rate, seen)]
        if not found:
            return np.empty(0), np.empty(0)
        return frequencies(len(self.used_markers), self.rate), np.asarray(np.median(found[:: -(-len(found) // _MOST)], axis=0))


def spectra(series: ComplexArray | FloatArray, rate: float, seen: BoolArray | None = None) -> list[FloatArray]:
    """Return the power spectra (P,) of the windows of a series (F,), a coordinate of it if it is complex.

    Parameters
    ----------
    series : (F,) array
    rate : float
        Hz.
    seen : (F,) bool array, optional
        Windows with a frame that is not seen are left out.
    """
    size = _window(len(series), rate)
    taper = np.hanning(size)
    found = []
    for first in range(0, len(series) - size + 1, max(size // 2, 1)):
        own = slice(first, first + size)
        if seen is None or seen[own].all():
            power = np.abs(np.fft.fft((series[own] - np.mean(series[own])) * taper)) ** 2
            both = power[1 : size // 2] + power[: size // 2 : -1][: size // 2 - 1]
            found.append(both / (rate * np.sum(taper**2)) / (2 if np.iscomplexobj(series) else 1))
    return found


def frequencies(count: int, rate: float) -> FloatArray:
    """Return the frequencies (P,) of :func:`spectra` of a series of this length, Hz."""
    size = _window(count, rate)
    return np.arange(1, size // 2) * rate / size


def _window(count: int, rate: float) -> int:
    return max(min(round(_WINDOW * rate), count) // 2 * 2, 4)
