"""Reconstruction with the conventions of scikit-learn: parameters in the constructor, learned attributes end in ``_``."""

from __future__ import annotations

import importlib.util
import inspect
import json
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._native import Forward, Maps, as_frames
from .order import LIKE, OrderCheck, check
from .parameters import as_positive, as_progress, as_truth, as_word

_Self = TypeVar("_Self", bound="_Estimator")


class Reason(NamedTuple):
    """Why a map is not sound: kind, electrode (from 0, None where it names none), and text, which counts electrodes from 1.

    kind: "dead_electrode", "noise", "noisy_pair", "gains", "unexplained", "at_electrode", "outside_region", "noise_limit",
    "loss_above_one", "own_misfit" or "novelty".
    """

    kind: str
    electrode: int | None
    text: str


class Quality(NamedTuple):
    """How far a map can be believed. verdict: "sound", "doubtful" or "unreliable", with the reasons."""

    verdict: str
    reasons: tuple[Reason, ...]


class _Estimator:
    """What all methods share: parameters, the baseline, maps."""

    forward: Forward
    losses_only: bool
    sigma0: ArrayLike | None
    current: float
    missing: str
    check_order: bool

    baseline_: NDArray[np.float64]
    sigma0_: NDArray[np.float64]
    noise_: float | None
    method_: str
    notes_: list[str]
    order_: OrderCheck | None
    masked_: NDArray[np.int64]
    _maps: Maps

    @classmethod
    def _names(cls) -> list[str]:
        return list(inspect.signature(cls).parameters)

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """The parameters of the constructor by name. ``deep`` is there for scikit-learn and changes nothing."""
        return {name: getattr(self, name) for name in self._names()}

    def set_params(self: _Self, **params: Any) -> _Self:
        """Sets parameters of the constructor; the next ``fit`` uses them. Returns self."""
        names = self._names()
        for name in params:
            if name not in names:
                raise ValueError(
                    f"argument '{name}': {type(self).__name__} has no such parameter; expected one of {', '.join(names)}"
                )
        for name, value in params.items():
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        given = ", ".join(f"{name}={value!r}" for name, value in self.get_params().items())
        return f"{type(self).__name__}({given})"

    def _settings(self) -> dict[str, Any]:
        """The settings of the engine; each subclass adds its own."""
        return {"loss_only": as_truth("losses_only", self.losses_only)}

    def fit(self: _Self, baseline: ArrayLike, *, noise: float | None = None) -> _Self:
        """Prepares the maps: one forward solution, one Jacobian, one factorisation. Ctrl-C ends it. Returns self.

        baseline: voltages of the sheet without a load, V, signed: shape (readings,), or (frames, readings), whose mean is
            taken.
        noise: standard deviation of one reading, V; by default from the frames of the baseline where there are several.

        Sets ``baseline_`` (readings,), ``sigma0_`` (triangles,), ``noise_`` (V, or None), ``method_``, ``notes_``, and
        ``order_``, the result of ``check`` (None with ``check_order=False``). Warns where the model explains too little of the
        baseline in any order; a symmetric geometry looks the same from several electrodes, ``notes_`` then says so.
        """
        if not isinstance(self.forward, Forward):
            raise TypeError(
                f"argument 'forward': it is a {type(self.forward).__name__}; expected a Forward(mesh, protocol, contact)"
            )
        settings = json.dumps(self._settings())
        rows = self._rows("baseline", baseline)
        sigma0 = self.forward.mesh.sigma0 if self.sigma0 is None else self.sigma0
        order = None
        if as_truth("check_order", self.check_order):
            order = check(rows, self.forward, sigma0=sigma0)
            if not order.ok:
                raise ValueError(f"argument 'baseline': {order.text}; check_order=False leaves this check out")
            if order.residual > LIKE:
                warnings.warn(f"argument 'baseline': {order.text}", stacklevel=2)
        self._maps = Maps(self.forward, settings, sigma0, self.current, noise, rows)
        self.order_ = order
        self.baseline_ = self._maps.baseline
        self.sigma0_ = self._maps.sigma0
        self.noise_ = self._maps.deviation if noise is None else float(noise)
        self.method_ = self._maps.method
        self.notes_ = self._maps.notes
        if order is not None and order.equivalent > 1:
            self.notes_.append(order.text)
        return self

    def predict(
        self,
        frames: ArrayLike,
        *,
        baselines: ArrayLike | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> NDArray[np.float64]:
        """Maps of frames: relative changes of conductance of the triangles of ``mesh.region``; -1: all conductance is lost.

        frames: voltages, V, signed: shape (frames, readings), or (readings,). Returns (frames, region), or (region,).
        baselines: one for each frame, of the same shape, instead of ``baseline_``: see ``Drift``.
        progress: called after each frame with the number of frames that are done, and of all; what it raises ends the work, as
        Ctrl-C does.
        Sets ``masked_``, the number of readings left out of each frame: shape (frames,).
        """
        called = as_progress(progress)
        fitted = self._fitted()
        rows = self._rows("frames", frames)
        others = None if baselines is None else self._rows("baselines", baselines)
        maps, self.masked_ = fitted.maps(rows, others, called)
        return maps[0] if np.ndim(frames) == 1 else maps

    def judge(self, frames: ArrayLike, *, progress: Callable[[int, int], object] | None = None) -> list[Quality]:
        """How far the map of each frame can be believed, a Quality for each: shapes and progress as in ``predict``.

        Compares the frames with the model of the whole sheet and with the noise: a dead electrode, a change of a contact,
        readings that no map explains. Makes the maps for that, so it takes longer than ``predict``.
        """
        called = as_progress(progress)
        judged = self._fitted().judged(self._rows("frames", frames), called)
        return [Quality(verdict, tuple(Reason(*reason) for reason in reasons)) for verdict, reasons in judged]

    @property
    def noise_figure_(self) -> float | None:
        """Signal-to-noise ratio of the readings over that of the map of a small load; None where it is not defined."""
        return self._fitted().noise_figure()

    def _fitted(self) -> Maps:
        if not hasattr(self, "_maps"):
            raise RuntimeError(f"this {type(self).__name__} has no baseline yet: call fit(baseline, noise=...) first")
        return self._maps

    def _rows(self, name: str, volts: ArrayLike) -> NDArray[np.float64]:
        mask = as_word("missing", self.missing, "refuse", "mask") == "mask"
        return as_frames(volts, name, len(self.forward.protocol), mask)


class OneStep(_Estimator):
    """One-step difference reconstruction: the linear least-squares map, precomputed; a frame costs one product.

    forward: the Forward model, with mesh, protocol and contact impedances.
    prior: "noser", "tikhonov", "laplace" or "gaussian". exponent: of NOSER, by default 0.25.
    length: correlation length of the Gaussian prior, m, by default 0.01.
    lam: "evidence" or "l-curve", a strength for each frame; "noise", one from the noise; or lambda itself, above 0.
    noise_figure: the strength that has this noise figure, instead of ``lam``.
    losses_only: bounds maps to -1 <= change <= 0.
    unknowns: "sheet", or "region": the sheet outside of mesh.region does not change.
    sigma0: conductance at the baseline, S per square: a number or shape (triangles,); by default that of the mesh, or a
        uniform one fitted to the baseline.
    current: A. missing: "refuse", or "mask": NaN in readings stands for a missing one.
    check_order: compares the baseline with the model before maps are made, see ``check``.

    >>> import tactus_eit
    >>> mesh = tactus_eit.Mesh.disc(electrodes=16, fineness=0.5)
    >>> forward = tactus_eit.Forward(mesh, tactus_eit.Protocol.sheffield(16))
    >>> model = tactus_eit.OneStep(forward, prior="tikhonov").fit(1e-3 * forward.solve(1e-3))
    >>> model.predict(model.baseline_).shape == mesh.region.shape
    True
    """

    def __init__(
        self,
        forward: Forward,
        *,
        prior: str = "noser",
        exponent: float | None = None,
        length: float | None = None,
        lam: str | float = "evidence",
        noise_figure: float | None = None,
        losses_only: bool = False,
        unknowns: str = "sheet",
        sigma0: ArrayLike | None = None,
        current: float = 1e-3,
        missing: str = "refuse",
        check_order: bool = True,
    ) -> None:
        self.forward = forward
        self.prior = prior
        self.exponent = exponent
        self.length = length
        self.lam = lam
        self.noise_figure = noise_figure
        self.losses_only = losses_only
        self.unknowns = unknowns
        self.sigma0 = sigma0
        self.current = current
        self.missing = missing
        self.check_order = check_order

    def _settings(self) -> dict[str, Any]:
        settings = {"method": "one-step", **super()._settings(), **_strength(self.lam, self.unknowns)}
        prior = as_word("prior", self.prior, "noser", "tikhonov", "laplace", "gaussian")
        if prior != "noser":
            settings["prior"] = prior
        for name, value, of in (("exponent", self.exponent, "noser"), ("length", self.length, "gaussian")):
            if value is not None and prior != of:
                raise ValueError(f"argument '{name}': prior is '{prior}'; expected '{of}', the only prior with this argument")
        if self.exponent is not None:
            settings["exponent"] = as_positive("exponent", self.exponent)
        if self.length is not None:
            settings["length_mm"] = 1e3 * as_positive("length", self.length)
        if self.noise_figure is not None:
            if self.lam != "evidence":
                raise ValueError("argument 'noise_figure': 'lam' is given too; expected one of both")
            settings["noise_figure"] = as_positive("noise_figure", self.noise_figure)
            del settings["choose"]
        return settings


class TotalVariation(_Estimator):
    """Total variation: the map with the shortest borders among those that explain the readings, to a stated gap.

    gap: the objective is within this share of its minimum. lam: "evidence" or "l-curve", a strength for each frame; "noise",
    one from the noise; or alpha, the penalty of a jump of 1 along 1 m of border, above 0. The other parameters are those of
    OneStep.

    >>> import tactus_eit
    >>> mesh = tactus_eit.Mesh.disc(electrodes=16, fineness=0.5)
    >>> forward = tactus_eit.Forward(mesh, tactus_eit.Protocol.sheffield(16))
    >>> tactus_eit.TotalVariation(forward).set_params(gap=1e-2).get_params()["gap"]
    0.01
    """

    def __init__(
        self,
        forward: Forward,
        *,
        lam: str | float = "evidence",
        gap: float = 1e-3,
        losses_only: bool = False,
        unknowns: str = "sheet",
        sigma0: ArrayLike | None = None,
        current: float = 1e-3,
        missing: str = "refuse",
        check_order: bool = True,
    ) -> None:
        self.forward = forward
        self.lam = lam
        self.gap = gap
        self.losses_only = losses_only
        self.unknowns = unknowns
        self.sigma0 = sigma0
        self.current = current
        self.missing = missing
        self.check_order = check_order

    def _settings(self) -> dict[str, Any]:
        settings = {"method": "tv", **super()._settings(), **_strength(self.lam, self.unknowns)}
        return {**settings, "gap": as_positive("gap", self.gap)}


class Shapes(_Estimator):
    """Loads of few shapes, by the full forward model: discs, a ring, a bar or a smooth load where these explain a frame,
    else total variation.

    The closest of all methods to true loads; a frame takes some tenths of a second. ``fit`` needs the noise, stated or from
    several frames of the baseline. losses_only: no map has a gain; by default a map has gains if losses alone leave too much of
    its frame unexplained. The other parameters are those of OneStep.

    >>> import tactus_eit
    >>> mesh = tactus_eit.Mesh.disc(electrodes=16, fineness=0.5)
    >>> tactus_eit.Shapes(tactus_eit.Forward(mesh, tactus_eit.Protocol.sheffield(16))).get_params()["losses_only"]
    False
    """

    def __init__(
        self,
        forward: Forward,
        *,
        losses_only: bool = False,
        sigma0: ArrayLike | None = None,
        current: float = 1e-3,
        missing: str = "refuse",
        check_order: bool = True,
    ) -> None:
        self.forward = forward
        self.losses_only = losses_only
        self.sigma0 = sigma0
        self.current = current
        self.missing = missing
        self.check_order = check_order

    def _settings(self) -> dict[str, Any]:
        return {"method": "best", **super()._settings()}

    def fit(self: _Self, baseline: ArrayLike, *, noise: float | None = None) -> _Self:
        """As in OneStep; the noise must be known."""
        if noise is None and np.ndim(baseline) < 2:
            raise ValueError(
                "argument 'noise': it is missing; expected the standard deviation of one reading in V, or several frames as 'baseline'"
            )
        return super().fit(baseline, noise=noise)


class Network(_Estimator):
    """A trained model from a file: what ``tactus-lab train`` writes (.safetensors), or a network trained elsewhere (.onnx).

    forward: the Forward model; mesh and protocol must be those that the model was trained for. path: the file.
    losses_only: clips maps to losses. The other parameters are those of OneStep. Nothing is trained here: ``fit`` loads the
    file and takes the baseline.

    An ONNX network has one f32 input, (frame - baseline) / max(abs(baseline)) of all readings, and one f32 output, the relative
    change of conductance of the triangles of ``mesh.region``; all other dimensions are 1 or open. Its metadata properties
    "tactus.survey" and "tactus.geometry" are compared with ``protocol.hash`` and ``mesh.hash`` if the file has them. It is run by the
    ONNX Runtime of the package onnxruntime, or by the library that the variable ORT_DYLIB_PATH names.
    """

    def __init__(
        self,
        forward: Forward,
        path: str | os.PathLike[str],
        *,
        losses_only: bool = False,
        sigma0: ArrayLike | None = None,
        current: float = 1e-3,
        missing: str = "refuse",
        check_order: bool = True,
    ) -> None:
        self.forward = forward
        self.path = path
        self.losses_only = losses_only
        self.sigma0 = sigma0
        self.current = current
        self.missing = missing
        self.check_order = check_order

    def _settings(self) -> dict[str, Any]:
        if not isinstance(self.path, (str, os.PathLike)):
            raise TypeError(f"argument 'path': it is a {type(self.path).__name__}; expected the path of a model file")
        path = os.fspath(self.path)
        if not os.path.isfile(path):
            raise FileNotFoundError(f"argument 'path': there is no file {path!r}; expected a model file, e.g. of tactus-lab train")
        if path.lower().endswith(".onnx"):
            _find_onnx_runtime(path)
        return {"file": path, **super()._settings()}


def _find_onnx_runtime(path: str) -> None:
    """Names the library of the package onnxruntime to the engine, where the user has named none."""
    if os.environ.get("ORT_DYLIB_PATH"):
        return
    # not imported: only its library is used
    spec = importlib.util.find_spec("onnxruntime")
    for folder in spec.submodule_search_locations or [] if spec else []:
        for library in sorted(Path(folder, "capi").glob("libonnxruntime.*")):
            os.environ["ORT_DYLIB_PATH"] = str(library)
            return
    raise ImportError(
        f"{path!r} is run by ONNX Runtime, which is not installed: pip install onnxruntime, or name its library in the environment "
        "variable ORT_DYLIB_PATH"
    )


def _strength(lam: str | float, unknowns: str) -> dict[str, Any]:
    """The settings of the hyper-parameter and of what is unknown."""
    settings: dict[str, Any] = {"unknowns": as_word("unknowns", unknowns, "sheet", "region")}
    if isinstance(lam, str):
        settings["choose"] = as_word("lam", lam, "evidence", "l-curve", "noise", "or a number above 0")
    else:
        settings["lambda"] = as_positive("lam", lam)
    return settings
