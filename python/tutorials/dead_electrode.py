"""A dead electrode: detected by its readings and left out, and the effect on the map."""

import matplotlib.pyplot as plt
import numpy as np
import tactus_eit

mesh, protocol = tactus_eit.Mesh.sheet(), tactus_eit.Protocol.sheffield(26)
forward = tactus_eit.Forward(mesh, protocol)
centre = np.array([0.080, 0.135])
loaded = np.where(np.hypot(*(mesh.centroids - centre).T) < 0.010, 0.5, 1.0) * mesh.sigma0
baseline, frame = 1e-3 * forward.solve([mesh.sigma0, loaded]) + np.random.default_rng(1).normal(0.0, 2e-6, (2, len(protocol)))

# the wire of electrode 9 breaks after the baseline: its readings are noise
uses = (np.hstack([protocol.inject, protocol.measure]) == 9).any(axis=1)
broken = np.where(uses, np.random.default_rng(2).normal(0.0, 1e-4, len(protocol)), frame)

model = tactus_eit.OneStep(forward, losses_only=True, missing="mask").fit(baseline, noise=2e-6)
(quality,) = model.judge(broken)
print(f"{quality.verdict}: {quality.reasons[0].text}")

# its readings are left out
dead = quality.reasons[0].electrode
masked = np.where((np.hstack([protocol.inject, protocol.measure]) == dead).any(axis=1), np.nan, broken)
maps = {"whole frame": frame, "dead electrode": broken, "left out": masked}
figure, axes = plt.subplots(1, 3, figsize=(10, 3), sharey=True)
for axis, (name, volts) in zip(axes, maps.items()):
    change = model.predict(volts)
    x, y = mesh.centroids[mesh.region][change.argmin()]
    away = 1e3 * np.hypot(x - centre[0], y - centre[1])
    print(f"{name}: {int(model.masked_[0])} readings left out, largest loss {-100 * change.min():.0f} %, {away:.0f} mm from the disc")
    drawn = axis.tripcolor(*(1e3 * mesh.nodes.T), mesh.triangles[mesh.region], facecolors=100 * change, cmap="inferno", clim=(-60, 0))
    axis.plot(*(1e3 * mesh.electrode_centres[9]), "rs")
    axis.set_title(name)
    axis.set_aspect("equal")
figure.colorbar(drawn, ax=axes, label="change, %")
figure.savefig("dead-electrode.png", dpi=90, bbox_inches="tight")
