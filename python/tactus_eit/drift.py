"""The baseline of a sheet that drifts, followed through its frames."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._native import Forward, Tracker, as_frames
from .parameters import as_progress


class Followed(NamedTuple):
    """What ``Drift.follow`` found.

    baselines: the baseline with the drift until each frame, V: shape (frames, readings).
    frames: the frames, NaN where a reading is missing or uses a faulty electrode, V: shape (frames, readings).
    known: a dict for each frame, with the fields of the stream's ``tracked``: judgement ("empty", "loaded" or "unknown"), known,
        reason, place with its 95 % ellipse in mm, loads, masked (electrodes, from 1), and others.
    """

    baselines: NDArray[np.float64]
    frames: NDArray[np.float64]
    known: list[dict[str, Any]]


class Drift:
    """Follows the baseline of a sheet: frames without a load correct it, a load stops the correction until it is taken away.

    forward: the Forward model. sigma0: conductance at the baseline, as in OneStep. current: A.

    >>> import numpy, tactus_eit
    >>> mesh = tactus_eit.Mesh.disc(electrodes=16, fineness=0.5)
    >>> forward = tactus_eit.Forward(mesh, tactus_eit.Protocol.sheffield(16))
    >>> baseline = 1e-3 * forward.solve(1e-3)
    >>> drift = tactus_eit.Drift(forward).fit(baseline, noise=2e-6)
    >>> drift.follow([1.001 * baseline], times=[600.0]).known[0]["judgement"]
    'empty'
    """

    _tracker: Tracker

    def __init__(self, forward: Forward, *, sigma0: ArrayLike | None = None, current: float = 1e-3) -> None:
        if not isinstance(forward, Forward):
            raise TypeError(f"argument 'forward': it is a {type(forward).__name__}; expected a Forward(mesh, protocol, contact)")
        self.forward = forward
        self.sigma0 = sigma0
        self.current = current

    def fit(self, baseline: ArrayLike, *, noise: float | None = None, time: float = 0.0) -> Drift:
        """Fits the sheet to its baseline, recorded without a load. Returns self.

        baseline: V, signed: shape (readings,), or (frames, readings), whose mean is taken; no reading may be missing.
        noise: standard deviation of one reading, V; by default from the frames of the baseline where there are several.
        time: of the baseline, s, on the clock of the frames.
        """
        rows = self._rows("baseline", baseline, missing=False)
        sigma0 = self.forward.mesh.sigma0 if self.sigma0 is None else self.sigma0
        self._tracker = Tracker(self.forward, sigma0, self.current, noise, rows, time)
        return self

    def follow(
        self, frames: ArrayLike, times: ArrayLike, *, progress: Callable[[int, int], object] | None = None
    ) -> Followed:
        """Follows frames in order; the next call continues from the last frame of this one.

        frames: V, signed, NaN where a reading is missing: shape (frames, readings), or (readings,). times: s, ascending: shape
        (frames,), or a number for one frame. progress: as in ``OneStep.predict``. Ctrl-C ends it between two frames; those before it
        have been followed.
        """
        called = as_progress(progress)
        rows = self._rows("frames", frames, missing=True)
        baselines, masked, known = self._fitted().follow(rows, np.atleast_1d(np.asarray(times)), called)
        return Followed(baselines, masked, [json.loads(each) for each in known])

    def state(self) -> str:
        """The state that later results depend on, as text; after ``restore`` they are the same bit for bit."""
        return self._fitted().state()

    def restore(self, state: str) -> Drift:
        """Continues from a state of the same sheet and baseline. Returns self."""
        if not isinstance(state, str):
            raise TypeError(f"argument 'state': it is a {type(state).__name__}; expected the text that state() returned")
        self._fitted().restore(state)
        return self

    def _fitted(self) -> Tracker:
        if not hasattr(self, "_tracker"):
            raise RuntimeError("this Drift has no baseline yet: call fit(baseline, noise=...) first")
        return self._tracker

    def _rows(self, name: str, volts: ArrayLike, *, missing: bool) -> NDArray[np.float64]:
        return as_frames(volts, name, len(self.forward.protocol), missing)
