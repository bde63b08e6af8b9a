"""The parts of the page, in the order in which they are read."""

from __future__ import annotations

from dataclasses import dataclass

from mocap_id.reporting import pins, readings, rising, tables
from mocap_id.reporting.dynamics_shape import BaseEntry
from mocap_id.reporting.encoder import encoder_table
from mocap_id.reporting.material import Material
from mocap_id.reporting.numbers import UNKNOWN, show, show_fixed
from mocap_id.reporting.shape import Summary
from mocap_id.store import Facts

_SHOWN = {
    "wrench", "clock_offset_s", "clock_offset_sd_s", "cop_rms_m", "rivals", "held_out", "advice", "torque", "motion",
    "pins",
}  # fmt: skip
"""Facts of ``dynamics.h5`` that tables of their own show."""


@dataclass(frozen=True)
class Section:
    """A part of the page: paragraphs first, then figures, then tables.

    ``needs`` is the artefact without which it has nothing to say.
    """

    anchor: str
    title: str
    needs: str
    figures: tuple[str, ...] = ()
    grids: tuple[tables.Grid, ...] = ()
    text: tuple[str, ...] = ()


@dataclass(frozen=True)
class Glance:
    """One of the numbers that one looks at first."""

    name: str
    value: str
    remark: str


def sections(material: Material, summary: Summary) -> list[Section]:
    """What the page holds; a refused trial's page is short, so what was never reached is left out."""
    skeleton = "Markers as recorded" if material.skeleton is None else "Skeleton"
    figures = ("skeleton",) if material.skeleton is None else ("skeleton", "recovery")
    parts = [
        Section("skeleton", skeleton, "planar.parquet", figures, (tables.joints(summary), tables.lengths(summary))),
        Section("states", "Joint states", "states.parquet", ("states",), _states(material, summary)),
        Section(
            "repetitions",
            "Repetitions",
            "events.parquet",
            ("repetitions", "phases") if "phases.parquet" in material.artefacts else ("repetitions",),
            (
                rising.repetitions(summary),
                rising.seat_off(summary),
                rising.attempts(summary),
                rising.five_times(summary),
                rising.published(summary),
                rising.load_share(summary),
                rising.compared(material),
            ),
        ),
        Section(
            "wrench",
            "Forces on the ground",
            "wrench.parquet",
            ("wrench",),
            (
                tables.agreement(material, summary),
                tables.held_out(material, summary),
                tables.rivals(material, summary),
                _clock(summary),
                tables.plates(material),
            ),
        ),
        *_motion(material, summary),
        Section(
            "parameters",
            "Inertial parameters",
            "dynamics.h5",
            ("parameters", "point_masses"),
            (tables.base_parameters(material, summary), tables.excitation(summary), _identification(material)),
        ),
        Section(
            "markers",
            "Markers and segments",
            "segments.parquet",
            ("residuals",) if "markers.parquet" in material.artefacts else (),
            (
                tables.markers(material),
                readings.against(material),
                readings.joints(material),
                readings.hypotheses(material),
                _segmentation(material),
            ),
        ),
        Section("origin", "Where these numbers come from", "", (), _origin(material, summary)),
    ]
    return [part for part in parts if not part.needs or part.needs in material.artefacts or material.level != "refused"]


def _motion(material: Material, summary: Summary) -> list[Section]:
    """What moves the masses and what pins would cost; nothing where nothing was identified."""
    if summary.dynamics.motion is None:
        return []
    grids = (pins.cost(material, summary), pins.joints(material, summary), pins.poses(summary))
    return [Section("motion", "Motion of the masses", "dynamics.h5", (), grids, pins.text(material, summary))]


def glance(material: Material, summary: Summary) -> list[Glance]:
    """The numbers that one looks at first; those that are not known are left out."""
    dynamics, segments = summary.dynamics, summary.segments
    mass = next((entry for entry in dynamics.base or () if entry.unit == "kg"), None)
    vertical = (dynamics.wrench or {}).get("Fy")
    band = "" if material.low_pass is None else f", {tables.in_band(material)}"
    found = (
        Glance("segments", _count(segments.count), f"confidence {show_fixed(segments.confidence, 2)}"),
        Glance("re-projection", show(summary.markers.reprojection_rms_mm, 3, "mm"), "rms over the markers"),
        Glance("missing", _scaled(summary.markers.missing_fraction, 100, 1, "%"), "of the marker samples"),
        Glance("repetitions", _count(len(summary.repetitions or ()) or None), "found"),
        Glance("five times", show_fixed(summary.five_times.to_fifth_stand_s, 2, "s"), "to the fifth stand"),
        Glance("mass, plates", show(dynamics.mass_kg, 3, "kg"), "at rest"),
        Glance("mass, identified", show(mass.value if mass else None, 3, "kg"), _mass_remark(mass)),
        Glance("mean CoP", _scaled(dynamics.cop_mean_m, 1e3, 1, "mm"), "along the motion, plates"),
        Glance(
            "vertical force",
            show_fixed(vertical.r2 if vertical else None, 4),
            f"r² of the model{band}",
        ),
        Glance("CoP of the model", _scaled(dynamics.cop_rms_m, 1e3, 1, "mm"), f"rms error{band}"),
        Glance("condition number", show(dynamics.condition_number), _condition_remark(summary)),
        Glance("plates' clock", _scaled(dynamics.clock_offset_s, 1e3, 2, "ms"), "after the cameras'"),
    )
    return [number for number in found if number.value != UNKNOWN]


def _count(value: int | None) -> str:
    return UNKNOWN if value is None else str(value)


def _scaled(value: float | None, factor: float, decimals: int, unit: str) -> str:
    return show_fixed(None if value is None else factor * value, decimals, unit)


def _mass_remark(mass: BaseEntry | None) -> str:
    sd = None if mass is None else mass.sd
    return "from the motion" if sd is None else f"± {show(sd, 2)} kg, from the motion"


def _condition_remark(summary: Summary) -> str:
    scaled = summary.dynamics.condition_number_scaled
    return "of the regressor" if scaled is None else f"{show(scaled)} with unit-norm columns"


def _states(material: Material, summary: Summary) -> tuple[tables.Grid, ...]:
    return _noise(material, summary), encoder_table(summary)


def _noise(material: Material, summary: Summary) -> tables.Grid:
    facts = material.facts("states.parquet")
    values = {
        "marker noise, one coordinate (mm)": _scaled(summary.noise.marker_sd_m, 1e3, 2, ""),
        "process noise σ_v of each joint (rad/s⁴)": facts.get("sigma_v"),
        "re-projection, rms (mm)": show(summary.markers.reprojection_rms_mm),
        **_but(facts, {"marker_sd_m", "sigma_v", "reprojection_rms_m"}),
    }
    return tables.facts("What the filter settled on", values)


def _clock(summary: Summary) -> tables.Grid:
    dynamics = summary.dynamics
    unheld = dynamics.wrench is not None and dynamics.held_out.model is None
    values = {
        "clock offset, plates after cameras (ms)": _scaled(dynamics.clock_offset_s, 1e3, 2, ""),
        "its standard deviation (ms)": _scaled(dynamics.clock_offset_sd_s, 1e3, 2, ""),
        "clock offset with each repetition left out (ms)": ", ".join(
            _scaled(offset, 1e3, 2, "") for offset in dynamics.held_out.clock_offset_s or ()
        ),
        "centre of pressure, rms error (mm)": _scaled(dynamics.cop_rms_m, 1e3, 1, ""),
        "samples of the fit": dynamics.samples,
        "mass that the plates show (kg)": show(dynamics.mass_kg, 4),
        "mean centre of pressure (mm)": _scaled(dynamics.cop_mean_m, 1e3, 1, ""),
        "not known, because": dynamics.why,
        "no repetition was predicted from the others, because": dynamics.held_out.why if unheld else None,
    }
    return tables.facts("Plates and clock", values)


def _identification(material: Material) -> tables.Grid:
    """What dynamics.h5 says about how the parameters were found, beyond what the other tables show."""
    return tables.facts("Identification", _but(material.facts("dynamics.h5"), _SHOWN))


def _segmentation(material: Material) -> tables.Grid:
    shown = {"names", "joint_names", *readings.SHOWN}
    return tables.facts("Segmentation", _but(material.facts("segments.parquet"), shown))


def _but(facts: Facts, shown: set[str]) -> Facts:
    """The facts that no other table shows."""
    return {key: value for key, value in facts.items() if key not in shown}


def _origin(material: Material, summary: Summary) -> tuple[tables.Grid, ...]:
    """Recording, plane, settings, times, product."""
    planar = dict(material.facts("planar.parquet"))
    planar.pop("bursts", None)  # a stretch a jump: the verdict counts them
    plane = planar.pop("plane", None) or {}
    chain = material.facts("chain.h5")
    return (
        tables.facts("Recording", planar),
        tables.facts("Plane of motion", plane),
        tables.facts("Joint fit", chain),
        tables.facts("Trial as asked for", material.settings),
        tables.facts("Time of each stage (s)", summary.time_s or {}),
        tables.facts("Product", {"mocap-id": material.product}),
    )
