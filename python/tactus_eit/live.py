"""The stream of a running daemon: frames and maps as they come."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ._native import Stream
from .estimators import Quality, Reason
from .parameters import as_positive, as_truth


class LiveFrame(NamedTuple):
    """A frame of the running session.

    sequence: its number, from 1. time: its start, UTC. voltages: V, NaN where a reading is missing: shape (readings,).
    status: why it is missing, as in ``Session.status``: shape (readings,). simulated: whether the voltages are simulated.
    lost: records that were lost just before this one, because they were read too slowly.
    """

    sequence: int
    time: np.datetime64
    voltages: NDArray[np.float64]
    status: NDArray[np.uint8]
    simulated: bool
    lost: int


class LiveMap(NamedTuple):
    """The daemon's map of a frame.

    sequence, time, simulated, lost: as in LiveFrame. values: relative change of conductance: shape (region,). method: its name.
    mesh_hash: as in ``Mesh.hash``. quality: how far it can be believed. tracked, quantities: the daemon's results for the frame and
    the map, as in ``tactus watch --json``; None where there are none. pressure: Pa, shape (region,), and load: N, where the method
    is calibrated.
    """

    sequence: int
    time: np.datetime64
    values: NDArray[np.float64]
    method: str
    mesh_hash: str
    quality: Quality | None
    tracked: dict[str, Any] | None
    quantities: dict[str, Any] | None
    pressure: NDArray[np.float64] | None
    load: float | None
    simulated: bool
    lost: int


class LiveDeviation(NamedTuple):
    """Standard deviation of the map of a frame, relative to the tracked baseline.

    sequence, time, simulated, lost: as in LiveFrame; at most one frame in a second has it, and it comes soon before or after the map.
    values: standard deviation of the change of ln conductance, by the linear model whatever the method of the map, NaN for a
    triangle about which the frame has no information: shape (region,). mesh_hash: as in ``Mesh.hash``.
    """

    sequence: int
    time: np.datetime64
    values: NDArray[np.float64]
    mesh_hash: str
    simulated: bool
    lost: int


class Live:
    """The stream of one session, an iterator of LiveFrame, LiveMap and LiveDeviation. Made by ``connect``; can be used with ``with``.

    Iteration ends with the session: ``ended`` is then the reason. TimeoutError: no record came in time; iteration can continue.
    ConnectionError: the connection to the daemon is lost. ``lost`` is the number of records that were lost so far.
    """

    def __init__(self, stream: Stream, timeout: float | None) -> None:
        self._stream = stream
        self._about = stream.attributes
        self._timeout = timeout
        #: Records of the frame whose map comes next.
        self._beside: dict[str, dict[str, Any]] = {}
        self._lost_beside = 0
        self.lost = 0
        self.ended: str | None = None

    @property
    def session(self) -> str:
        """Id of the session."""
        return str(self._about["session"])

    @property
    def attributes(self) -> dict[str, Any]:
        """address, session, kind, method (empty where there are no maps), path of the session's file, and simulated."""
        names = ("address", "session", "kind", "method", "path", "simulated")
        return {name: self._about[name] for name in names}

    @property
    def baseline(self) -> NDArray[np.float64] | None:
        """The session's baseline, V, NaN where a reading is missing: shape (readings,); None where it has none."""
        return self._about.get("baseline")

    @property
    def baseline_deviation(self) -> NDArray[np.float64] | None:
        """Standard deviation of each reading of the baseline, V: shape (readings,); None where there is none."""
        return self._about.get("baseline_deviation")

    @property
    def nodes(self) -> NDArray[np.float64] | None:
        """Nodes of the maps' triangles, m: shape (nodes, 2); None where there are no maps."""
        return self._about.get("nodes")

    @property
    def triangles(self) -> NDArray[np.int64] | None:
        """Triangles of the maps, in their order: shape (region, 3); None where there are no maps."""
        return self._about.get("triangles")

    @property
    def electrode_centres(self) -> NDArray[np.float64] | None:
        """Centres of the electrodes, m: shape (electrodes, 2); None where there are no maps."""
        return self._about.get("electrode_centres")

    def close(self) -> None:
        """Ends the stream; the session goes on."""
        self._stream.close()

    def __enter__(self) -> Live:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[LiveFrame | LiveMap | LiveDeviation]:
        return self

    def __next__(self) -> LiveFrame | LiveMap | LiveDeviation:
        while self.ended is None:
            record = self._stream.next(self._timeout)
            if record is None:
                raise ConnectionError(
                    f"the daemon ended the stream of {self.session} without the session's end: it has stopped; call connect() again"
                )
            self.lost += record["gap"]
            kind = record["kind"]
            if kind == "frame":
                return self._frame(record)
            if kind == "map":
                return self._map(record)
            if kind == "deviation":
                return self._deviation(record)
            if kind == "end":
                self.ended = record["reason"]
            else:
                self._beside[kind] = record
                self._lost_beside += record["gap"]
        raise StopIteration

    def _frame(self, record: dict[str, Any]) -> LiveFrame:
        return LiveFrame(
            record["sequence"], _time(record), record["voltages"], record["status"], record["simulated"], record["gap"]
        )

    def _map(self, record: dict[str, Any]) -> LiveMap:
        # what belongs to a map that was lost belongs to no other
        beside = {kind: one for kind, one in self._beside.items() if one["sequence"] == record["sequence"]}
        lost = record["gap"] + self._lost_beside
        self._beside, self._lost_beside = {}, 0
        said = {kind: json.loads(one["json"]) for kind, one in beside.items() if "json" in one}
        pressure = beside.get("pressure", {})
        return LiveMap(
            record["sequence"],
            _time(record),
            record["values"],
            record["method"],
            record["mesh_hash"],
            _quality(said["quality"]) if "quality" in said else None,
            said.get("tracked"),
            said.get("quantities"),
            pressure.get("pressure"),
            pressure.get("load"),
            record["simulated"],
            lost,
        )

    def _deviation(self, record: dict[str, Any]) -> LiveDeviation:
        return LiveDeviation(
            record["sequence"], _time(record), record["deviations"], record["mesh_hash"], record["simulated"], record["gap"]
        )

    def __repr__(self) -> str:
        return f"<Live stream of {self.session} at {self._about['address']}>"


def connect(
    address: str | None = None,
    *,
    session: str | None = None,
    frames: bool = True,
    maps: bool = False,
    deviations: bool = False,
    ring: int = 64,
    timeout: float | None = None,
) -> Live:
    """Follows the session that ``tactusd`` runs: an iterator of frames, maps and their standard deviations, as they come.

    address: "system", "session" or "unix:PATH"; by default the first of the daemon's usual addresses that has one. session: the id
    of a session that runs; by default the running one, or the next that starts. frames, maps, deviations: what to receive; standard
    deviations of maps come only where the daemon tracks the baseline.
    ring: records, 1 to 4096, that the daemon holds for this reader; then it drops the oldest, counted in ``lost``. The daemon never waits.
    timeout: s, for the session to start and for each record; by default without limit. Ctrl-C ends the wait.

    Raises ConnectionError where no daemon is, PermissionError, LookupError for a session that does not run, or TimeoutError.

    for frame in tactus_eit.connect(timeout=60):
        print(frame.sequence, model.predict(frame.voltages).min())
    """
    for name, given in (("address", address), ("session", session)):
        if given is not None and not isinstance(given, str):
            raise TypeError(f"argument '{name}': it is a {type(given).__name__}; expected a text, or None")
    frames, maps, deviations = as_truth("frames", frames), as_truth("maps", maps), as_truth("deviations", deviations)
    if not (frames or maps or deviations):
        raise ValueError("argument 'maps': it is False, and 'frames' and 'deviations' too; expected one of them to be True")
    if isinstance(ring, bool) or not isinstance(ring, (int, np.integer)):
        raise TypeError(f"argument 'ring': it is a {type(ring).__name__}; expected a number of records from 1 to 4096")
    if not 1 <= ring <= 4096:
        raise ValueError(f"argument 'ring': it is {ring}; expected a number of records from 1 to 4096")
    if timeout is not None:
        timeout = as_positive("timeout", timeout)
    return Live(Stream(address, session, frames, maps, deviations, int(ring), timeout), timeout)


def _time(record: dict[str, Any]) -> np.datetime64:
    return np.datetime64(record["wall_ns"], "ns")


def _quality(said: dict[str, Any]) -> Quality:
    def reason(one: dict[str, Any]) -> Reason:
        electrode = one.get("electrode")
        return Reason(one["kind"], None if electrode is None else electrode - 1, one["text"])

    return Quality(said["verdict"], tuple(reason(one) for one in said["reasons"]))
