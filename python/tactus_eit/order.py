"""Electrode order and sign of a recording, found by comparing its baseline with the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._native import Forward, as_frames

# a baseline that leaves more than this share of itself unexplained in every order says nothing about the order
LIKE = 0.3
# another order is reported where it leaves less than this share of what the order as given leaves
_BETTER = 0.5
# orders that leave the same but for this share of the baseline cannot be told apart: the model itself is not better; on the
# preset sheet a wrong order leaves 70 % and more
_SAME = 0.03


@dataclass(frozen=True)
class OrderCheck:
    """What ``check`` found.

    ok: whether the electrode order and the signs as given explain the baseline as well as any other.
    rotation, reflected: electrode e of the recording is electrode (rotation + e) of the mesh, or (rotation - e) where
        reflected, modulo their number; of all orders that explain the baseline equally, the one nearest to the given one.
    order: the same as integers of shape (electrodes,), for ``Protocol.renumbered``.
    sign: 1, or -1 where all readings have the opposite sign of the model's.
    magnitudes: whether the readings are magnitudes, and the model's have both signs.
    residual, residual_as_given: share of the baseline (root mean square) that the model leaves unexplained, in that order
        and as given.
    equivalent: number of orders that explain the baseline equally; above 1 the geometry is symmetric, and no baseline can
        tell them apart.
    text: the same in words, with the way to mend it.
    """

    ok: bool
    rotation: int
    reflected: bool
    order: NDArray[np.int64]
    sign: int
    magnitudes: bool
    residual: float
    residual_as_given: float
    equivalent: int
    text: str


def check(baseline: ArrayLike, forward: Forward, *, sigma0: ArrayLike | None = None) -> OrderCheck:
    """Fits rotation, reflection and sign of the electrode order to a baseline.

    baseline: voltages of the sheet without a load, V: shape (readings,), or (frames, readings); NaN is left out.
    forward: the Forward model. sigma0: conductance, S per square, by default that of the mesh, or a uniform one.

    A symmetric geometry looks the same from several electrodes: then the result names how many orders fit equally.

    >>> import tactus_eit
    >>> mesh = tactus_eit.Mesh.sheet(fineness=0.25)
    >>> forward = tactus_eit.Forward(mesh, tactus_eit.Protocol.sheffield(26))
    >>> shifted = forward.protocol.renumbered([(e + 3) % 26 for e in range(26)])
    >>> recorded = tactus_eit.Forward(mesh, shifted).solve(1e-3)
    >>> found = tactus_eit.check(recorded, forward)
    >>> found.ok, found.rotation, found.reflected, found.sign
    (False, 3, False, 1)
    """
    if not isinstance(forward, Forward):
        raise TypeError(f"argument 'forward': it is a {type(forward).__name__}; expected a Forward(mesh, protocol, contact)")
    readings = _mean(as_frames(baseline, "baseline", len(forward.protocol), True))
    if sigma0 is None:
        known = forward.mesh.sigma0
        sigma0 = 1e-3 if known is None else known
    transfer = forward.transfer(sigma0)
    valid = np.isfinite(readings)
    largest = float(np.abs(readings[valid]).max(initial=0.0))
    if largest == 0.0:
        raise ValueError("argument 'baseline': it is zero or missing everywhere; expected voltages in V while the current flows")
    count = len(transfer)
    candidates = [(rotation, reflected) for reflected in (False, True) for rotation in range(count)]
    models = _models(forward, transfer, np.array([order_of(count, *one) for one in candidates]))[:, valid]
    # only shares matter, and squares of extreme readings would overflow
    volts = readings[valid] / largest
    one_sign = bool((volts >= 0).all() or (volts <= 0).all())
    magnitudes = one_sign and bool(((models[0] > 0).any() and (models[0] < 0).any()))
    if magnitudes:
        models, volts = np.abs(models), np.abs(volts)
    gains = (models @ volts) / np.einsum("ij,ij->i", models, models)
    left = np.linalg.norm(volts - gains[:, np.newaxis] * models, axis=1) / np.linalg.norm(volts)
    same = np.flatnonzero(left <= left.min() + _SAME)
    # the nearest to the order as given: not reflected, least rotation
    best = min(same.tolist(), key=lambda one: (candidates[one][1], min(candidates[one][0], count - candidates[one][0])))
    if left[best] > LIKE or left[best] > _BETTER * left[0]:
        best = 0
    rotation, reflected = candidates[best]
    sign = -1 if gains[best] < 0.0 and not magnitudes else 1
    return OrderCheck(
        ok=bool(best == 0 and sign == 1 and not magnitudes),
        rotation=rotation,
        reflected=reflected,
        order=order_of(count, rotation, reflected),
        sign=sign,
        magnitudes=magnitudes,
        residual=float(left[best]),
        residual_as_given=float(left[0]),
        equivalent=int(len(same)),
        text=_text(rotation, reflected, sign, magnitudes, float(left[best]), float(left[0]), len(same)),
    )


def order_of(electrodes: int, rotation: int, reflected: bool) -> NDArray[np.int64]:
    """The electrode of the mesh for each electrode of the recording."""
    steps = np.arange(electrodes, dtype=np.int64)
    return (rotation - steps if reflected else rotation + steps) % electrodes


def _mean(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of the valid readings; NaN where there is none."""
    valid = np.isfinite(rows)
    counts = valid.sum(axis=0)
    sums = np.where(valid, rows, 0.0).sum(axis=0)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def _models(forward: Forward, transfer: NDArray[np.float64], orders: NDArray[np.int64]) -> NDArray[np.float64]:
    """Readings at 1 A, V, of the protocol with renumbered electrodes, from the transfer impedance: a row for each order."""
    drive, sense = (np.moveaxis(orders[:, pairs], 2, 0) for pairs in (forward.protocol.inject, forward.protocol.measure))
    plus, minus = (transfer[end, drive[0]] - transfer[end, drive[1]] for end in sense)
    return np.asarray(plus - minus)


def _text(
    rotation: int, reflected: bool, sign: int, magnitudes: bool, left: float, as_given: float, equivalent: int
) -> str:
    found = []
    if rotation or reflected:
        way = "reflected and rotated" if reflected else "rotated"
        arrow = f"{rotation} - e" if reflected else f"{rotation} + e"
        found.append(
            f"the electrode order is {way}: electrode e of the readings is electrode ({arrow}) of the mesh, which leaves "
            f"{left:.1%} of the baseline unexplained, and the order as given {as_given:.1%}; use protocol.renumbered(order) with "
            "the order that tactus_eit.check returns"
        )
    if sign < 0:
        found.append(
            "the readings have the opposite sign of the model's: leads are reversed, pairs name their minus first, or the "
            "instrument gives magnitudes; pass -baseline and -frames"
        )
    if magnitudes:
        found.append(
            "the readings are magnitudes, all of one sign, and the model's have both: record signed voltages, or multiply them "
            "by numpy.sign(forward.solve(1.0))"
        )
    if not found:
        found.append(f"order and signs fit: {left:.1%} of the baseline is left unexplained")
    if left > LIKE:
        found.append(f"{left:.0%} of the baseline is unexplained: compare mesh, contact, protocol and the order of the readings with the recording")
    if equivalent > 1:
        found.append(f"{equivalent} orders explain the baseline equally: the geometry is symmetric, and only a known load tells them apart")
    return "; ".join(found)
