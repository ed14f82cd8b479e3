"""A mesh of one's own: an elliptic insole with 16 electrodes, from arrays."""

import matplotlib.pyplot as plt
import numpy as np
import tactus_eit
from scipy.spatial import Delaunay

# 160 points on the rim, a grid inside; an electrode covers four edges of every ten
turn = 2 * np.pi * np.arange(160) / 160
rim = np.c_[0.05 * np.cos(turn), 0.13 * np.sin(turn)]
x, y = np.meshgrid(np.arange(-0.05, 0.05, 0.003), np.arange(-0.13, 0.13, 0.003))
inside = (x / 0.047) ** 2 + (y / 0.127) ** 2 < 1
nodes = np.vstack([rim, np.c_[x[inside], y[inside]]])
electrodes = [[[start + k, start + k + 1] for k in range(4)] for start in range(0, 160, 10)]
mesh = tactus_eit.Mesh(nodes, Delaunay(nodes).simplices, electrodes)
print(mesh, f"{1e4 * mesh.areas.sum():.1f} cm2")

# a contact of 20 ohm on each electrode, and 1 mS per square
protocol = tactus_eit.Protocol.sheffield(16)
forward = tactus_eit.Forward(mesh, protocol, contact=20.0 * mesh.electrode_lengths)
heel = np.hypot(*(mesh.centroids - [0.0, -0.085]).T) < 0.02
ball = np.hypot(*(mesh.centroids - [0.01, 0.07]).T) < 0.02
sigma = np.where(heel, 0.6, np.where(ball, 0.8, 1.0)) * 1e-3
volts = 1e-3 * forward.solve([np.full(len(sigma), 1e-3), sigma])
baseline, frame = volts + np.random.default_rng(1).normal(0.0, 2e-6, volts.shape)

model = tactus_eit.Shapes(forward, sigma0=1e-3, losses_only=True).fit(baseline, noise=2e-6)
change = model.predict(frame)
for name, part in (("heel", heel), ("ball", ball)):
    true, found = sigma[part].mean() / 1e-3 - 1, np.average(change[part], weights=mesh.areas[part])
    print(f"{name}: true {100 * true:.0f} %, found {100 * found:.0f} %")

figure, (left, right) = plt.subplots(1, 2, figsize=(7, 6), sharey=True)
left.triplot(*(1e3 * nodes.T), mesh.triangles, linewidth=0.3, color="0.5")
for number, edges in enumerate(mesh.electrodes):
    left.plot(*(1e3 * nodes[edges].T), "C3", linewidth=3)
    left.annotate(str(number), 1.12e3 * mesh.electrode_centres[number], ha="center", va="center")
left.set(xlim=(-65, 65), ylim=(-150, 150))
drawn = right.tripcolor(*(1e3 * nodes.T), mesh.triangles, facecolors=100 * change, cmap="inferno")
figure.colorbar(drawn, ax=right, label="change of conductance, %")
for axis in (left, right):
    axis.set_aspect("equal")
    axis.set_xlabel("x, mm")
figure.savefig("own-mesh.png", dpi=100, bbox_inches="tight")
