"""A simulated balance board in the place of the force plate: four cells, and stamps as a wireless link gives them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.simulation.scene import Scene

_GRAVITY = 9.81
_WIDTH, _DEPTH, _HEIGHT = 0.433, 0.238, 0.053  # m: distances of the cells, and their depth below the surface
_SIGNS = np.array([[-1, 1], [1, 1], [-1, -1], [1, -1]])  # right and top of the cells tl, tr, bl, br
_PERIOD, _JITTER = 0.011, 0.001  # s between samples
_STAMP, _DELAY = 0.01, 0.004  # s: step of the stamps, and mean delay of the link
_STALLS, _STALL = 0.004, 0.06  # share of the samples after which the link stalls, and the longest stall, s
_STEP_KG, _NOISE_KG, _TARE_KG, _GAIN = 0.1, 0.05, 0.15, 0.005
_CENTRE_M, _YAW = 0.02, 0.02
TURNS = {"forwards": 0.0, "left": np.pi / 2, "backwards": np.pi, "right": -np.pi / 2}


@dataclass(frozen=True)
class SimulatedBoard:
    """Where a board stands, and its errors.

    Parameters
    ----------
    clock_offset : float
        The row at ``time_s`` was taken at ``time_s + clock_offset`` on the markers' clock, on average, s.
    top : str
        Where its top points, seen by the person.
    centre : (float, float)
        Its centre from that of the plate, forwards and to the left, m.
    yaw : float
        Error of its direction, rad.
    tare, gain : tuples of 4 floats
        Reading without load, kg, and factor on the load, of the cells tl, tr, bl, br.
    """

    clock_offset: float
    top: str
    centre: tuple[float, float]
    yaw: float
    tare: tuple[float, ...]
    gain: tuple[float, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values for truth.json."""
        return asdict(self) | {"cells_below_surface_m": _HEIGHT}


def draw_board(rng: np.random.Generator, clock_offset: float) -> SimulatedBoard:
    """Return a random board, a little displaced and turned, with random errors of zero and gain of its cells."""
    return SimulatedBoard(
        clock_offset,
        str(rng.choice(list(TURNS))),
        (float(rng.uniform(-_CENTRE_M, _CENTRE_M)), float(rng.uniform(-_CENTRE_M, _CENTRE_M))),
        float(rng.uniform(-_YAW, _YAW)),
        tuple(rng.normal(0.0, _TARE_KG, 4).tolist()),
        tuple((1.0 + rng.normal(0.0, _GAIN, 4)).tolist()),
    )


def board_csv(rng: np.random.Generator, scene: Scene, board: SimulatedBoard) -> str:
    """Return CSV text: time_s, tl_kg, tr_kg, bl_kg, br_kg."""
    steps = np.maximum(rng.normal(_PERIOD, _JITTER, int(scene.motion.duration / _PERIOD) + 1), _PERIOD / 2)
    steps += np.where(rng.random(len(steps)) < _STALLS, rng.uniform(0.0, _STALL, len(steps)), 0.0)
    time = np.cumsum(steps)
    time = time[time < scene.motion.duration]
    late = np.maximum.accumulate(time + rng.exponential(_DELAY, len(time)))
    stamps = np.round(late / _STAMP) * _STAMP
    stamps -= np.mean(stamps - time) + board.clock_offset
    cells = _cells(*scene.load_on_plate(scene.at(time)), scene, board)
    readings = cells * board.gain + board.tare + rng.normal(0.0, _NOISE_KG, cells.shape)
    rows = np.column_stack([stamps, np.round(readings / _STEP_KG) * _STEP_KG])
    lines = [",".join((f"{row[0]:.4f}", *(f"{value:.1f}" for value in row[1:]))) for row in rows]
    return "\n".join(["time_s,tl_kg,tr_kg,bl_kg,br_kg", *lines]) + "\n"


def _cells(force: FloatArray, moment: FloatArray, scene: Scene, board: SimulatedBoard) -> FloatArray:
    """Return the loads (T, 4) of the cells, kg, under a force and a moment about the plate's surface, lab axes."""
    forwards = -scene.plane.axes[0, :2]  # people face the plane's -x
    left = np.array([-forwards[1], forwards[0]])
    angle = TURNS[board.top] + board.yaw
    top = np.cos(angle) * forwards + np.sin(angle) * left
    right = np.array([top[1], -top[0]])
    at = np.array([*(board.centre[0] * forwards + board.centre[1] * left), -_HEIGHT])
    about = moment - np.cross(at, force)
    pressure = np.column_stack([-about[:, 1], about[:, 0]]) / force[:, 2:]
    share = np.stack([pressure @ right / (_WIDTH / 2), pressure @ top / (_DEPTH / 2)], axis=1)
    return np.asarray(force[:, 2:] / 4 * np.prod(1.0 + _SIGNS * share[:, None], axis=2) / _GRAVITY)
