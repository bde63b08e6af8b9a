"""Artefacts in memory: tables, long tables and trees."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias, get_args

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from mocap_id.errors import StoreError
from mocap_id.geometry.spatial_chain import JointKind, SpatialChain, SpatialJoint
from mocap_id.store.provenance import TableSchema, TreeSchema
from mocap_id.verdict import Reason

if TYPE_CHECKING:
    import pandas as pd

Facts: TypeAlias = Mapping[str, Any]
"""Numbers and choices stored beside the data, as JSON values; None if a quantity could not be determined."""

Values: TypeAlias = "np.ndarray[Any, Any]"
"""A column of a table."""

KINDS = {"float64": "fiu", "int64": "iu", "Int64": "iu", "bool": "b", "category": "OU", "str": "OU"}
"""Kinds of numpy types that an array may have in memory, by the type in the schema."""

Node: TypeAlias = "np.ndarray[Any, Any] | str | float | int | Mapping[str, Node]"


@dataclass(frozen=True)
class Table:
    """A Parquet artefact in memory, with its columns as arrays.

    ``columns`` contains arrays (n,) by name. Numbers and truth values have their numpy types; texts are object arrays
    of str. A nullable integer is int64 with -1 where the file has null.
    """

    schema: TableSchema
    columns: Mapping[str, Values]
    facts: Facts = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()

    @classmethod
    def from_frame(
        cls, schema: TableSchema, frame: pd.DataFrame, facts: Facts | None = None, reasons: tuple[Reason, ...] = ()
    ) -> Table:
        """Return a table made of a data frame; missing integers become -1, and missing texts become None."""
        return cls(schema, {str(name): _to_array(frame[name]) for name in frame.columns}, facts or {}, reasons)

    @property
    def length(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values()), ()))

    @property
    def nbytes(self) -> int:
        """Size of the arrays, bytes."""
        return sum(values.nbytes for values in self.columns.values())

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return list(self.columns)

    def __getitem__(self, name: str) -> Values:
        return self.columns[name]

    def stack(self, names: Sequence[str]) -> FloatArray:
        """Return some columns of numbers side by side, (n, len(names))."""
        return np.stack([self.columns[name] for name in names], axis=1).astype(np.float64, copy=False)

    def column(self, name: str, rows: slice = slice(None)) -> Values:
        """Return a column (n,), or the given rows of it."""
        return self.columns[name][rows]

    def with_columns(self, **columns: Values) -> Table:
        """Return a copy of the table in which these columns are replaced or added."""
        return replace(self, columns={**self.columns, **columns})

    @property
    def frame(self) -> pd.DataFrame:
        """The table as a data frame."""
        return _to_frame(self)


@dataclass(frozen=True)
class LongTable:
    """A Parquet artefact in memory with a row for every frame and marker; the rows of a frame are consecutive.

    The schema is ``long``, with the columns ``frame``, ``time`` and ``marker``.
    """

    schema: TableSchema
    frames: IntArray  # (F,) frame numbers
    time: FloatArray  # (F,) s
    labels: Sequence[str]  # M names of markers
    values: Mapping[str, FloatArray | BoolArray]  # all other columns, (F, M)
    facts: Facts = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()

    @property
    def length(self) -> int:
        """Number of rows."""
        return len(self.frames) * len(self.labels)

    @property
    def nbytes(self) -> int:
        """Size of the arrays in ``values``, bytes."""
        return sum(values.nbytes for values in self.values.values())

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return ["frame", "time", "marker", *self.values]

    def column(self, name: str, rows: slice = slice(None)) -> Values:
        """Return a column with a value for every row of the table, or for the given rows."""
        if name == "marker":
            return np.array(self.labels, dtype=object)[self.codes(rows)]
        if name in self.values:
            return self.values[name].reshape(-1)[rows]
        first, last, inside = self._find_frames(rows)
        return np.repeat({"frame": self.frames, "time": self.time}[name][first:last], len(self.labels))[inside]

    def codes(self, rows: slice = slice(None)) -> Values:
        """Return for each of the given rows the index of its marker in ``labels`` (int32)."""
        first, last, inside = self._find_frames(rows)
        return np.tile(np.arange(len(self.labels), dtype=np.int32), last - first)[inside]

    def _find_frames(self, rows: slice) -> tuple[int, int, slice]:
        """Return the index of the first frame of ``rows``, that after the last, and the rows within these frames."""
        start, stop, _ = rows.indices(self.length)
        markers = max(len(self.labels), 1)
        first, last = start // markers, -(-stop // markers)
        return first, last, slice(start - first * markers, stop - first * markers)

    @property
    def frame(self) -> pd.DataFrame:
        """The table as a data frame, with a label in every row."""
        return _to_frame(self)


def _to_array(series: pd.Series[Any]) -> Values:
    """Return a data frame's column as an array, with None for a missing text and -1 for a missing integer."""
    kind = str(series.dtype)
    if kind in ("category", "str", "object", "string"):
        texts = series.astype(object)
        return np.asarray(texts.where(texts.notna(), None), dtype=object)
    if kind == "Int64":
        return np.asarray(series.fillna(-1), dtype=np.int64)
    return np.asarray(series)


def _to_frame(table: Table | LongTable) -> pd.DataFrame:
    """Return a data frame with the schema's types: repeated texts as categories, -1 of a nullable integer as NA."""
    import pandas as pd  # noqa: PLC0415  a run needs no data frames

    kinds = {column.name: column.dtype for column in table.schema.columns}
    series: dict[str, Any] = {}
    for name in table.names:
        if name == "marker" and isinstance(table, LongTable):
            labels, ranks = np.unique(np.array(table.labels, dtype=str), return_inverse=True)
            series[name] = pd.Categorical.from_codes(ranks[table.codes()], pd.Index(labels, dtype="str"))
            continue
        values, kind = table.column(name), kinds.get(name)
        if kind == "category":
            series[name] = pd.Categorical(values)
        elif kind == "str":
            series[name] = pd.array(values, dtype="str")
        elif kind == "Int64":
            series[name] = pd.arrays.IntegerArray(np.asarray(values), np.asarray(values) < 0)
        else:
            series[name] = values
    return pd.DataFrame(series)


@dataclass(frozen=True)
class Tree:
    """An HDF5 artefact in memory: nested mappings of names to arrays, strings and numbers."""

    schema: TreeSchema
    data: Mapping[str, Node]
    facts: Facts = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()

    @property
    def nbytes(self) -> int:
        """Always 0, because trees are small."""
        return 0

    def array(self, path: str) -> Values:
        """Return the node at ``group/name`` as an array; KeyError if it does not exist."""
        node: Any = self.data
        for name in path.split("/"):
            node = node[name]
        return np.asarray(node)

    def numbers(self, path: str, shape: tuple[int, ...] = (-1,)) -> FloatArray:
        """Return a node as float64 of this shape; an array without rows if the node does not exist."""
        return np.asarray(self.array(path), np.float64).reshape(shape) if self.has(path) else np.zeros((0, *shape[1:]))

    def integers(self, path: str) -> IntArray:
        """Return a node as a vector of int64; empty if the node does not exist."""
        return np.asarray(self.array(path), np.int64).reshape(-1) if self.has(path) else np.zeros(0, dtype=np.int64)

    def texts(self, path: str) -> tuple[str, ...]:
        """Return a node as texts; empty if the node does not exist."""
        return tuple(map(str, self.array(path).reshape(-1))) if self.has(path) else ()

    def has(self, path: str) -> bool:
        """Return whether the node at ``group/name`` exists."""
        node: Any = self.data
        for name in path.split("/"):
            if not isinstance(node, Mapping) or name not in node:
                return False
            node = node[name]
        return True


Artefact: TypeAlias = Table | LongTable | Tree


def freeze(artefact: Artefact) -> Artefact:
    """Return an artefact with read-only arrays."""
    arrays = {Table: ("columns",), LongTable: ("frames", "time", "values"), Tree: ("data",)}[type(artefact)]
    return replace(artefact, **{name: _make_read_only(getattr(artefact, name)) for name in arrays})


def _make_read_only(data: Any) -> Any:
    """Return read-only views of an array, or of all arrays in a mapping."""
    if isinstance(data, np.ndarray):
        view = data.view()
        view.flags.writeable = False
        return view
    return {name: _make_read_only(item) for name, item in data.items()} if isinstance(data, Mapping) else data


@dataclass(frozen=True)
class Trajectories:
    """Marker trajectories of ``planar.parquet``: F frames of M markers.

    The arrays of the artefact are not copied; a method copies only the markers and frames that it returns.
    """

    planar: LongTable  # the artefact
    # times of unreliable samples: the fact ``bad_stretches`` of ``segments.parquet``
    bad: Sequence[Mapping[str, Any]] = ()

    @property
    def frames(self) -> IntArray:
        """(F,) frame numbers of the recording."""
        return self.planar.frames

    @property
    def time(self) -> FloatArray:
        """(F,) time on the recording's clock, s."""
        return self.planar.time

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Labels of the M markers."""
        return tuple(self.planar.labels)

    @property
    def rate(self) -> float:
        """Frames per second."""
        return float(self.planar.facts["rate_hz"])

    @cached_property
    def bursts(self) -> BoolArray:
        """(F, M) whether a sample is in a burst (the fact ``bursts``: a jump away and back) or in a bad stretch."""
        out = np.zeros((len(self.frames), len(self.labels)), dtype=np.bool_)
        bursts = self.planar.facts.get("bursts", {})
        stretches = [(label, first, last) for label, times in bursts.items() for first, last in times]
        stretches += [(each["marker"], each["first_s"], each["last_s"]) for each in self.bad]
        for label, first, last in stretches:
            inside = slice(np.searchsorted(self.time, first), np.searchsorted(self.time, last, "right"))
            out[inside, self.labels.index(label)] = True
        return out

    def read_positions(
        self,
        markers: IntArray | slice = slice(None),
        frames: IntArray | slice = slice(None),
        axes: str = "xyz",
        *,
        keep_bursts: bool = False,
    ) -> FloatArray:
        """Return the positions of some markers in some frames as an array (frames, markers, axes), m.

        ``markers`` and ``frames`` are indices. Bursts and bad stretches are NaN, unless ``keep_bursts`` is true. The
        array is a copy.
        """
        columns = [np.asarray(self.planar.values[name][frames, markers], np.float64) for name in axes]
        positions = np.stack(columns, axis=2)
        if not keep_bursts:
            positions[self.bursts[frames, markers]] = np.nan
        return positions

    def read_plane(self) -> ComplexArray:
        """Return the positions (F, M) ``x + i y`` of all markers, m; NaN also in bursts and bad stretches."""
        positions = self.planar.values["x"] + 1j * self.planar.values["y"]
        positions[self.bursts] = np.nan
        return positions

    def read_track(self, marker: int) -> FloatArray:
        """Return the positions (F, 3) of one marker, m; NaN also in bursts and bad stretches."""
        return self.read_positions(np.array([marker]))[:, 0]


class Skeleton:
    """The chain in ``chain.h5`` of a trial in the plane: n joints, M assigned markers; StoreError for one in space."""

    def __init__(self, tree: Tree) -> None:
        if tree.has("joints/kind"):
            raise StoreError(
                "this run is in space (`space: 3d`), but this command needs a run in the plane, a chain of hinges. "
                "docs/space.md lists what a run in space can be used for"
            )
        self.joints = tree.texts("joints/name")
        self.parents = tree.integers("joints/parent")  # (n,)
        self.centres = tree.numbers("joints/centre", (-1, 2))  # (n, 2)
        self.covariance = tree.numbers("joints/covariance", (-1, 2, 2))  # (n, 2, 2)
        self.arc = tree.numbers("joints/arc")  # (n,)
        self.segments = tree.texts("segments/name")  # n + 1, base first
        self.lengths = tree.numbers("segments/length")  # (n - 1,) of segments 1 … n - 1
        self.lengths_sd = tree.numbers("segments/length_sd")  # (n - 1,)
        self.markers = tree.texts("markers/name")
        self.marker_segment = tree.integers("markers/segment")  # (M,)
        self.local = tree.numbers("markers/local", (-1, 2))  # (M, 2)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, or ``joint 1``, ``joint 2`` … if the tree has no names."""
        return self.joints or tuple(f"joint {j}" for j in range(1, len(self.centres) + 1))

    @property
    def centre_sd(self) -> FloatArray:
        """(n, 2) standard deviation of each coordinate of the joint centres, m."""
        variance = np.diagonal(self.covariance, axis1=1, axis2=2)
        return np.sqrt(np.where(variance >= 0, variance, np.nan))

    @property
    def tip(self) -> FloatArray:
        """(2,) end of the last segment in the segment's frame, m: the centroid of its markers, or 0 if it has none."""
        own = self.local[self.marker_segment == len(self.joints)]
        return own.mean(axis=0) if len(own) else np.zeros(2)


def joint_columns(table: Table, name: str, joints: int) -> FloatArray:
    """Return the columns ``name_1`` … ``name_n`` side by side, (T, n), for n = ``joints``."""
    if joints == 0:
        return np.zeros((table.length, 0))
    return table.stack([f"{name}_{j}" for j in range(1, joints + 1)])


def joint_count(states: Table) -> int:
    """Return the number of joints in ``states.parquet``."""
    return sum(name.startswith("theta_") for name in states.names)


Rejected: TypeAlias = Sequence[tuple[str, float, float]]
"""Fact ``rejected`` of states.parquet and poses.parquet: segment, first and last time, s, of each stretch in which over
half of the visible markers of the segment are not used (`markers-rejected`)."""


def find_measured(time: FloatArray, rejected: Rejected, segments: Collection[str]) -> BoolArray:
    """Return True (T,) except in the ``rejected`` stretches of ``segments``.

    The motion is bridged in these stretches, and nothing there is an event, a highest point or a peak.
    """
    measured = np.ones(len(time), dtype=np.bool_)
    for segment, first, last in rejected:
        if segment in segments:
            measured &= (time < first) | (time > last)
    return measured


@dataclass(frozen=True)
class JointStates:
    """The joint states of ``states.parquet``: T samples, n joints, rad and s."""

    time: FloatArray  # (T,)
    mean: FloatArray  # (T, n, 3) angle, velocity, acceleration
    sd: FloatArray  # (T, n, 3)
    observed: BoolArray  # (T, n)

    @classmethod
    def from_table(cls, table: Table) -> JointStates:
        """Return the states of ``states.parquet``."""
        joints, orders = joint_count(table), ("theta", "dtheta", "ddtheta")
        mean, sd = (
            np.stack([joint_columns(table, f"{prefix}{order}", joints) for order in orders], axis=-1)
            for prefix in ("", "sd_")
        )
        return cls(table["time"], mean, sd, joint_columns(table, "observed", joints).astype(np.bool_))

    @property
    def angles(self) -> FloatArray:
        """(T, n) joint angles, rad."""
        return self.mean[..., 0]


class IdentifiedDynamics:
    """The parameters of ``dynamics.h5``: b base parameters, p point masses, SI units.

    The vectors of base parameters are (b,), or empty if this was not judged.
    """

    def __init__(self, tree: Tree) -> None:
        self.names = tree.texts("base/name")
        self.value, self.sd = tree.numbers("base/value"), tree.numbers("base/sd")
        self.units, self.verdicts = tree.texts("base/unit"), tree.texts("base/verdict")
        self.relative_sd, self.excitation = tree.numbers("base/relative_sd"), tree.numbers("base/excitation")
        self.own_share, self.prior_share = tree.numbers("base/own_share"), tree.numbers("base/prior_share")
        # (b, 4(n + 1)); (b, 0) where nothing was identified
        regrouping, count = tree.numbers("base/regrouping"), len(self.names)
        self.regrouping = regrouping.reshape(count, -1) if regrouping.size else np.zeros((count, 0))
        self.reference = tree.numbers("full/reference")  # (4(n + 1),)
        self.grid_segment = tree.integers("grid/segment")  # (p,)
        self.grid_position = tree.numbers("grid/position", (-1, 2))  # (p, 2)
        self.grid_mass = tree.numbers("grid/mass")  # (p,)

    @property
    def base_reference(self) -> FloatArray:
        """(b,) base parameters of the allometric body (eq. 4.24); NaN if a parameter in them has no reference."""
        if not self.regrouping.size or self.regrouping.shape[1] != len(self.reference):
            return np.full(len(self.names), np.nan)
        known = np.isfinite(self.reference)
        value = self.regrouping[:, known] @ self.reference[known]
        return np.where(np.any(self.regrouping[:, ~known] != 0, axis=1), np.nan, value)


NEAR_GIMBAL = float(1 / np.sin(np.radians(15)))
"""Largest ``isb_condition`` with which plane of elevation and axial rotation of the shoulder have a meaning.
``isb_condition`` is larger if the elevation is within 15° of a pole (0° or 180°)."""

MEANINGLESS_AT_POLE = ("shoulder_plane", "shoulder_axial")
"""Angles that have no meaning near a pole."""

_JOINT_ARRAYS: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("centre", "glide", "rest", "long_axis"), (-1, 3)),
    **dict.fromkeys(("covariance", "offset", "glide_covariance", "untwisted"), (-1, 3, 3)),
    "axes_covariance": (-1, 2, 3, 3),
}
"""Shapes of arrays in chain.h5 that are also fields of a joint, by name."""


def is_skeleton(facts: Facts) -> bool:
    """Return whether the facts of ``planar.parquet`` describe a skeleton in place of markers."""
    return "skeleton" in facts


class SpatialSkeleton:
    """The chain in ``chain.h5`` of a trial in space: n joints, M markers, L landmarks."""

    def __init__(self, tree: Tree) -> None:
        self.segments = tree.texts("segments/name")  # n + 1, base first
        parents, known = tree.integers("joints/parent"), tree.integers("joints/known")
        axes, slide_sd = tree.numbers("joints/axes", (-1, 2, 3)), tree.numbers("joints/slide_sd")
        arrays = {name: tree.numbers(f"joints/{name}", shape) for name, shape in _JOINT_ARRAYS.items()}
        joints = tuple(
            SpatialJoint(
                kind=next(kind for kind in get_args(JointKind) if kind == text),
                parent=int(parents[k]),
                first_axis=axes[k, 0],
                second_axis=axes[k, 1],
                slide_sd=float(slide_sd[k]),
                known=bool(known[k]),
                **{name: values[k] for name, values in arrays.items()},
            )
            for k, text in enumerate(tree.texts("joints/kind"))
        )
        self.joints = tree.texts("joints/name") or tuple(f"joint {k}" for k in range(1, len(joints) + 1))
        self.arc = tree.numbers("joints/arc")  # (n,) rad
        length, sd = tree.numbers("segments/length"), tree.numbers("segments/length_sd")
        # Without anatomy, only segments between two joints have a length.
        measured = self.segments if len(length) == len(self.segments) else self.segments[1 : 1 + len(length)]
        # Length and standard deviation by segment, m
        self.lengths = {name: (float(a), float(b)) for name, a, b in zip(measured, length, sd, strict=True)}
        self.chain = SpatialChain(
            joints,
            tree.integers("markers/segment"),
            tree.numbers("markers/local", (-1, 3)),
            tree.integers("markers/on_glide").astype(np.bool_),
            tree.numbers("markers/skin"),
            tree.numbers("markers/skin_sd"),
        )
        self.markers = tree.texts("markers/name")
        self.landmarks = tree.texts("landmarks/name")
        self.landmark_segment = tree.integers("landmarks/segment")  # (L,)
        self.landmark_local = tree.numbers("landmarks/local", (-1, 3))  # (L, 3)
        self.landmark_sd = tree.numbers("landmarks/sd")  # (L,)

    @property
    def marker_segment(self) -> IntArray:
        """(M,) segment of each marker."""
        return self.chain.segment

    def locate_tip(self, segment: int) -> FloatArray:
        """Return the tip (3,) of a segment without a child, in its own frame, m: the centroid of its markers, or 0."""
        own = self.chain.local[self.chain.segment == segment]
        return np.asarray(own.mean(axis=0)) if len(own) else np.zeros(3)


class MeasuredPoses:
    """The poses of S segments in ``poses.parquet`` of a trial in space, T samples, in the frame of the trial."""

    def __init__(self, table: Table) -> None:
        ending = "_qw"
        self.time: FloatArray = table["time"]  # (T,)
        self.segments = tuple(name.removesuffix(ending) for name in table.names if name.endswith(ending))
        self.origin = self._stack(table, "x", "y", "z")  # (T, S, 3)
        self.quaternion = self._stack(table, "qw", "qx", "qy", "qz")  # (T, S, 4) w, x, y, z
        self.observed = self._stack(table, "observed")[..., 0].astype(np.bool_)  # (T, S)
        self.rejected: Rejected = table.facts.get("rejected", ())

    def _stack(self, table: Table, *endings: str) -> FloatArray:
        columns = [table.stack([f"{name}_{ending}" for ending in endings]) for name in self.segments]
        return np.stack(columns, axis=1) if columns else np.zeros((table.length, 0, len(endings)))

    def find_measured(self, *segments: str) -> BoolArray:
        """Return True (T,) except where markers of ``segments`` are rejected; see :func:`find_measured`."""
        return find_measured(self.time, self.rejected, segments)

    @cached_property
    def rotation(self) -> FloatArray:
        """(T, S, 3, 3) rotation from the segment's frame to the frame of the trial; NaN if not known."""
        w, x, y, z = np.moveaxis(self.quaternion, -1, 0)
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        return np.moveaxis(np.array(rows), (0, 1), (-2, -1))

    def locate_points(self, segment: int, local: FloatArray) -> FloatArray:
        """Return the positions (T, K, 3) in the frame of the trial, m, of points (K, 3) that are fixed in a segment."""
        rotated = np.einsum("tij,kj->tki", self.rotation[:, segment], local)
        return np.asarray(self.origin[:, segment, None] + rotated)

    def compute_rotation(self, parent: int, child: int) -> FloatArray:
        """Return the rotation (T, 3, 3) of a joint, from the child's frame to the parent's."""
        return np.asarray(np.swapaxes(self.rotation[:, parent], -1, -2) @ self.rotation[:, child])


class SpatialAngles:
    """The angles of ``angles.parquet``: T samples, A angles, rad and s."""

    def __init__(self, table: Table) -> None:
        self.time: FloatArray = table["time"]  # (T,)
        self.names = tuple(name.removeprefix("sd_dd") for name in table.names if name.startswith("sd_dd"))
        # (T, A, 3) angle, velocity, acceleration, and standard deviation of the errors that vary within a trial, due
        # to camera and skin
        self.mean, self.sd = (
            self._stack(table, *(f"{prefix}{order}" for order in ("", "d", "dd"))) for prefix in ("", "sd_")
        )
        # (T, A) standard deviation of the error that is constant in a trial, due to the landmarks
        self.constant_sd = self._stack(table, "constant_sd_")[..., 0]
        # (T,) 1 / sin(elevation); NaN without landmarks
        known = "isb_condition" in table.names
        self.condition = np.asarray(table["isb_condition"] if known else np.full(table.length, np.nan), np.float64)

    def _stack(self, table: Table, *prefixes: str) -> FloatArray:
        columns = [table.stack([f"{prefix}{name}" for prefix in prefixes]) for name in self.names]
        return np.stack(columns, axis=1) if columns else np.zeros((table.length, 0, len(prefixes)))

    @property
    def near_gimbal(self) -> BoolArray:
        """(T,) whether plane of elevation and axial rotation of the shoulder have no meaning in a sample."""
        return np.asarray(self.condition > NEAR_GIMBAL)

    def find_usable(self, name: str) -> BoolArray:
        """Return for every sample (T,) whether the angle ``name`` is finite and has a meaning."""
        known: BoolArray = np.isfinite(self.mean[:, self.names.index(name), 0])
        return known & ~self.near_gimbal if name in MEANINGLESS_AT_POLE else known
