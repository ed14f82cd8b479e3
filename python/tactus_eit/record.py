"""Recorded sessions as arrays, read by the engine's own reader."""

from __future__ import annotations

import os
import warnings
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ._native import Protocol, SessionFile, quality_flags

if TYPE_CHECKING:
    import pandas
    import xarray

#: The words of the bits of ``Session.quality``, from the lowest.
QUALITY_FLAGS: tuple[str, ...] = tuple(quality_flags())

#: What the numbers of ``Session.status`` mean.
_STATUS = {0: "ok", 1: "overload", 3: "not_measured"}


class Event(NamedTuple):
    """An event of a session: time (UTC), machine-readable kind, and text for people."""

    time: np.datetime64
    kind: str
    text: str


class Session:
    """A recorded session with all its parts. Frames are read when an array is first asked for, and kept.

    Made by ``open_session``. With 598 readings a frame takes 5.4 kB: choose ``first`` and ``last`` for sessions of months.
    """

    def __init__(self, path: str | os.PathLike[str], *, first: int = 1, last: int | None = None) -> None:
        for name, value, least in (("first", first, 1), ("last", last, first)):
            if value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
                raise TypeError(f"argument '{name}': it is a {type(value).__name__}; expected the number of a frame, from 1")
            if not least <= value < 2**63:
                raise ValueError(f"argument '{name}': it is {value}; expected the number of a frame from {least}")
        self._file = SessionFile(path)
        self._first = int(first)
        self._last = None if last is None else int(last)

    @cached_property
    def _frames(self) -> dict[str, Any]:
        frames = self._file.frames(self._first, self._last)
        for fault in frames["damaged"]:
            warnings.warn(f"a frame is left out: {fault}", RuntimeWarning, stacklevel=3)
        return frames

    @property
    def voltages(self) -> NDArray[np.float64]:
        """Voltages, V, NaN where a reading is missing: shape (frames, readings)."""
        return self._column("voltages")

    @property
    def status(self) -> NDArray[np.uint8]:
        """Why a reading is missing: 0 ok, 1 overload, 3 not measured: shape (frames, readings)."""
        return self._column("status")

    @property
    def times(self) -> NDArray[np.datetime64]:
        """Start of each frame, UTC, datetime64[us]: shape (frames,)."""
        return self._column("time_us").astype("datetime64[us]")

    @property
    def monotonic(self) -> NDArray[np.float64]:
        """Start of each frame by the clock of the recording process, s: shape (frames,)."""
        return self._column("monotonic")

    @property
    def duration(self) -> NDArray[np.float64]:
        """From the first step to the last reading of each frame, s: shape (frames,)."""
        return self._column("duration")

    @property
    def sequence(self) -> NDArray[np.int64]:
        """Number of each frame, from 1: shape (frames,)."""
        return self._column("sequence")

    @property
    def current(self) -> NDArray[np.float64]:
        """Injected current of each frame, A: shape (frames,)."""
        return self._column("current")

    @property
    def quality(self) -> NDArray[np.uint8]:
        """Violated checks of each frame, a bit for each word of ``QUALITY_FLAGS``; 0: none: shape (frames,)."""
        return self._column("quality")

    @property
    def damaged(self) -> list[str]:
        """Frames that cannot be read, a sentence each; they are left out of the arrays."""
        return list(self._frames["damaged"])

    @property
    def events(self) -> list[Event]:
        """Events in order."""
        return [Event(np.datetime64(time, "us"), kind, text) for time, kind, text in self._file.events]

    @property
    def baseline(self) -> NDArray[np.float64] | None:
        """The baseline, V, NaN where a reading is missing: shape (readings,); None where there is none."""
        return self._file.baseline

    @property
    def baseline_deviation(self) -> NDArray[np.float64] | None:
        """Standard deviation of each reading of the baseline, V: shape (readings,); None where there is none."""
        return self._file.baseline_deviation

    @property
    def protocol(self) -> Protocol:
        """The protocol of the readings."""
        return self._file.protocol

    @property
    def attributes(self) -> dict[str, Any]:
        """Metadata: id, kind, started, closed, simulated, note, build, hashes, configuration."""
        return self._file.attributes

    def __len__(self) -> int:
        return len(self._file)

    def __repr__(self) -> str:
        about = self.attributes
        return f"<Session {about['id']}, {about['kind']}, {len(self)} frames of {len(self.protocol)} readings>"

    def to_xarray(self) -> xarray.Dataset:
        """The session as an xarray.Dataset with dimensions time, reading and pole, units as attributes. Needs xarray."""
        try:
            import xarray
        except ImportError as cause:
            raise ImportError("to_xarray needs xarray: pip install xarray") from cause
        data: dict[str, Any] = {
            "voltage": (("time", "reading"), self.voltages, {"units": "V"}),
            "status": (
                ("time", "reading"),
                self.status,
                {"flag_values": list(_STATUS), "flag_meanings": " ".join(_STATUS.values())},
            ),
            "quality": (
                ("time",),
                self.quality,
                {"flag_masks": [1 << bit for bit in range(len(QUALITY_FLAGS))], "flag_meanings": " ".join(QUALITY_FLAGS)},
            ),
            "current": (("time",), self.current, {"units": "A"}),
            "inject": (("reading", "pole"), self.protocol.inject),
            "measure": (("reading", "pole"), self.protocol.measure),
        }
        for name, values in (("baseline", self.baseline), ("baseline_deviation", self.baseline_deviation)):
            if values is not None:
                data[name] = (("reading",), values, {"units": "V"})
        attributes = {name: "" if value is None else value for name, value in self.attributes.items()}
        attributes["simulated"] = int(attributes["simulated"])
        return xarray.Dataset(
            data,
            coords={
                "time": self.times,
                "sequence": ("time", self.sequence),
                "reading": np.arange(len(self.protocol)),
                "pole": ["plus", "minus"],
            },
            attrs=attributes,
        )

    def to_pandas(self) -> pandas.DataFrame:
        """The session as a pandas.DataFrame: index time (UTC), columns sequence, quality, v000, v001, ... in V. Needs pandas."""
        try:
            import pandas
        except ImportError as cause:
            raise ImportError("to_pandas needs pandas: pip install pandas") from cause
        columns = [f"v{reading:03d}" for reading in range(len(self.protocol))]
        index = pandas.DatetimeIndex(self.times, name="time").tz_localize("UTC")
        frame = pandas.DataFrame(self.voltages, index=index, columns=columns)
        about = pandas.DataFrame({"sequence": self.sequence, "quality": self.quality}, index=index)
        return pandas.concat([about, frame], axis=1)

    def _column(self, name: str) -> NDArray[Any]:
        column: NDArray[Any] = self._frames[name]
        return column


def open_session(path: str | os.PathLike[str], *, first: int = 1, last: int | None = None) -> Session:
    """Opens a session file, ``ID.tactus``, with the parts that continue it; a session that is being recorded can be opened too.

    first, last: numbers of the first and last frame that are read, from 1; by default all.
    Raises FileNotFoundError or OSError, naming what is wrong with the file.
    """
    return Session(path, first=first, last=last)
