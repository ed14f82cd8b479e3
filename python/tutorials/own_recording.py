"""A recording of one's own, from CSV files: the folder of a recording as the argument."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tactus_eit

if len(sys.argv) < 2:
    sys.exit(__doc__)
folder = Path(sys.argv[1])
frames = np.loadtxt(folder / "frames.csv", delimiter=",", skiprows=1)
pairs = np.loadtxt(folder / "protocol.csv", delimiter=",", skiprows=1, usecols=(1, 2, 3, 4), dtype=int)
print(f"{len(frames)} frames of {frames.shape[1]} readings, {1e3 * np.abs(frames).min():.1f} to {1e3 * np.abs(frames).max():.0f} mV")

protocol = tactus_eit.Protocol.from_pairs(pairs[:, 0:2], pairs[:, 2:4])
forward = tactus_eit.Forward(tactus_eit.Mesh.sheet(), protocol)
model = tactus_eit.OneStep(forward, losses_only=True)

# what happens with voltages without sign, and with electrodes counted from another one
turned = protocol.renumbered([(e + 7) % 26 for e in range(26)])
shifted = 1e-3 * tactus_eit.Forward(forward.mesh, turned).solve(forward.mesh.sigma0)
for text, wrong in (("magnitudes", np.abs(frames[0])), ("electrodes shifted by 7", shifted)):
    try:
        model.fit(wrong)
    except ValueError as error:
        print(f"\n{text}: {error}")

found = tactus_eit.check(frames[0], forward)
print(f"\nas recorded: {100 * found.residual:.1f} % of the baseline unexplained")
changes = model.fit(frames[0], noise=2e-6).predict(frames[1:5])

figure, axes = plt.subplots(1, 4, figsize=(11, 3), sharey=True)
x, y, shown = *(1e3 * forward.mesh.nodes.T), forward.mesh.triangles[forward.mesh.region]
for axis, change in zip(axes, changes):
    drawn = axis.tripcolor(x, y, shown, facecolors=100 * change, cmap="inferno", clim=(-40, 0))
    axis.set_aspect("equal")
figure.colorbar(drawn, ax=axes, label="change, %")
figure.savefig("own-recording.png", dpi=100, bbox_inches="tight")
