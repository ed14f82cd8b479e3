"""Electrical impedance tomography: forward model, Jacobian, and maps of the change of conductance.

Arrays in, arrays out; SI units; frames in rows; electrodes, nodes and triangles counted from 0.

>>> import numpy as np
>>> import tactus_eit
>>> mesh = tactus_eit.Mesh.disc(electrodes=16, fineness=0.5)
>>> forward = tactus_eit.Forward(mesh, tactus_eit.Protocol.sheffield(16))
>>> before = np.full(len(mesh.triangles), 1e-3)
>>> pressed = np.hypot(*(mesh.centroids - [0.05, 0.0]).T) < 0.03
>>> baseline = 1e-3 * forward.solve(before)
>>> frame = 1e-3 * forward.solve(np.where(pressed, 0.5, 1.0) * before)
>>> maps = tactus_eit.OneStep(forward).fit(baseline, noise=1e-6).predict([frame])
>>> bool(np.hypot(*(mesh.centroids[maps[0].argmin()] - [0.05, 0.0])) < 0.03)
True
"""

from ._native import Forward, Mesh, Protocol, likeness, merit
from .drift import Drift, Followed
from .estimators import Network, OneStep, Quality, Reason, Shapes, TotalVariation
from .live import Live, LiveDeviation, LiveFrame, LiveMap, connect
from .order import OrderCheck, check
from .record import QUALITY_FLAGS, Event, Session, open_session

__all__ = [
    "QUALITY_FLAGS",
    "Drift",
    "Event",
    "Followed",
    "Forward",
    "Live",
    "LiveDeviation",
    "LiveFrame",
    "LiveMap",
    "Mesh",
    "Network",
    "OneStep",
    "OrderCheck",
    "Protocol",
    "Quality",
    "Reason",
    "Session",
    "Shapes",
    "TotalVariation",
    "check",
    "connect",
    "likeness",
    "merit",
    "open_session",
]
