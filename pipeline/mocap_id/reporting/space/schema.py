"""Entries of ``summary.json`` for a trial in space."""

from __future__ import annotations

from mocap_id.reporting.summary_entry import Entry


class AngleEntry(Entry):
    """Statistics of one angle over the samples in which it is known and has a meaning, degrees.

    Plane and axial rotation of the shoulder have no meaning within 15° of an elevation of 0 or 180°; ``used_share`` is
    the share of the samples outside this neighbourhood and outside gaps. ``interval_deg`` is the 95 % interval of
    ``range_deg``, which is ``high_deg`` minus ``low_deg``. ``sd_deg`` is the typical standard deviation of a change of
    the angle, ``constant_sd_deg`` that of a constant error by the landmarks; the interval holds both.
    """

    low_deg: float | None
    high_deg: float | None
    range_deg: float | None
    interval_deg: list[float] | None
    sd_deg: float | None
    constant_sd_deg: float | None
    used_share: float
    why: str | None


class LandmarkEntry(Entry):
    """An anatomical landmark in the frame of its segment, and the standard deviation of each coordinate."""

    segment: str
    local_m: list[float] | None
    sd_m: float | None
    why: str | None


class WorkspaceEntry(Entry):
    """Volume that the arm can reach."""

    volume_m3: float | None = None
    interval_m3: list[float] | None = None
    box_deg: dict[str, list[float]] | None = None
    why: str | None


class CurlsEntry(Entry):
    """Number of complete curls and of failed attempts."""

    count: int | None = None
    partial: int | None = None
    why: str | None
