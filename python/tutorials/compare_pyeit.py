"""tactus_eit beside pyEIT 1.2: the same mesh, protocol and voltages."""

import time

import matplotlib.pyplot as plt
import numpy as np
import pyeit.eit.jac
import pyeit.eit.protocol
import pyeit.mesh
from pyeit.eit.fem import EITForward
from pyeit.mesh.wrapper import PyEITAnomaly_Circle

import tactus_eit.pyeit

mesh = pyeit.mesh.create(32, h0=0.06)
protocol = pyeit.eit.protocol.create(32, dist_exc=1, step_meas=1, parser_meas="std")
target = PyEITAnomaly_Circle(center=[0.4, 0.3], r=0.15, perm=0.5)
loaded = pyeit.mesh.set_perm(mesh, anomaly=target, background=1.0).perm

# the readings of both, for the same conductance
theirs, ours = EITForward(mesh, protocol), tactus_eit.pyeit.EITForward(mesh, protocol)
v0, v1 = theirs.solve_eit(perm=1.0), theirs.solve_eit(perm=loaded)
change = ours.solve_eit(loaded) - ours.solve_eit(1.0)
print(f"change of the readings: correlation {np.corrcoef(change, v1 - v0)[0, 1]:.4f}")

# the map of pyEIT's readings by both
maps = {}
for name, package in (("pyEIT", pyeit.eit.jac), ("tactus_eit", tactus_eit.pyeit)):
    begin = time.perf_counter()
    jac = package.JAC(mesh, protocol)
    jac.setup(p=0.5, lamb=0.01, method="kotre", perm=1.0, jac_normalized=True)
    ready = time.perf_counter()
    maps[name] = np.real(jac.solve(v1, v0, normalize=True))
    print(f"time of {name}: set-up {1e3 * (ready - begin):.0f} ms, map {1e3 * (time.perf_counter() - ready):.2f} ms")
print(f"maps: correlation {np.corrcoef(*maps.values())[0, 1]:.4f}")

figure, axes = plt.subplots(1, 2, figsize=(9, 4), sharey=True)
for axis, (name, values) in zip(axes, maps.items()):
    drawn = axis.tripcolor(*mesh.node[:, :2].T, mesh.element, facecolors=values / np.abs(values).max(), cmap="RdBu_r", clim=(-1, 1))
    axis.add_patch(plt.Circle((0.4, 0.3), 0.15, fill=False))
    axis.set_title(name)
    axis.set_aspect("equal")
figure.colorbar(drawn, ax=axes, label="change, relative to the largest")
figure.savefig("compare-pyeit.png", dpi=100, bbox_inches="tight")
