"""A first map: one press on the paper's sheet, from simulated voltages."""

import matplotlib.pyplot as plt
import numpy as np
import tactus_eit

protocol = tactus_eit.Protocol.sheffield(26)
fine = tactus_eit.Mesh.sheet(fineness=1.5, seeding=1)
true = tactus_eit.Forward(fine, protocol)
pressed = np.hypot(*(fine.centroids - [0.080, 0.135]).T) < 0.010
volts = 1e-3 * true.solve([fine.sigma0, np.where(pressed, 0.5, 1.0) * fine.sigma0])
frames = np.repeat(volts, [10, 1], axis=0) + np.random.default_rng(1).normal(0.0, 2e-6, (11, len(protocol)))

mesh = tactus_eit.Mesh.sheet()
model = tactus_eit.OneStep(tactus_eit.Forward(mesh, protocol), losses_only=True).fit(frames[:10])
change = model.predict(frames[10])
x, y = 1e3 * mesh.centroids[mesh.region][change.argmin()]
print(f"noise {1e6 * model.noise_:.1f} uV, largest loss {-100 * change.min():.0f} % at ({x:.0f}, {y:.0f}) mm")

plt.figure(figsize=(5, 4.6))
plt.tripcolor(*(1e3 * mesh.nodes.T), mesh.triangles[mesh.region], facecolors=100 * change, cmap="inferno")
plt.plot(*(1e3 * mesh.electrode_centres.T), "ks", markersize=4)
plt.colorbar(label="change of conductance, %")
plt.xlabel("x, mm")
plt.ylabel("y, mm")
plt.axis("equal")
plt.savefig("first-map.png", dpi=100, bbox_inches="tight")
