"""Voltages of two real tanks: the folder with ktc2023 and uottawa2005 as the argument."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tactus_eit

if len(sys.argv) < 2:
    sys.exit(__doc__)
data = Path(sys.argv[1])


def recording(folder, prefix):
    """The protocol, and the frames by name; the first one is the tank without a target."""
    pairs = np.loadtxt(folder / f"{prefix}protocol.csv", delimiter=",", skiprows=1, usecols=(1, 2, 3, 4), dtype=int)
    table = np.loadtxt(folder / f"{prefix}frames.csv", delimiter=",", skiprows=1, dtype=str)
    return tactus_eit.Protocol.from_pairs(pairs[:, :2], pairs[:, 2:]), dict(zip(table[:, 0], table[:, 1:].astype(float)))


figure, axes = plt.subplots(2, 4, figsize=(10, 5))


def draw(axis, mesh, values, title):
    axis.tripcolor(*mesh.nodes.T, mesh.triangles[mesh.region], facecolors=values, cmap="RdBu_r", norm=plt.matplotlib.colors.CenteredNorm())
    axis.set(title=title, aspect="equal", xticks=[], yticks=[])


# Ottawa: golf balls in a tank of 30 cm; the instrument gives magnitudes, so that the engine is given their negative
protocol, frames = recording(data / "uottawa2005", "")
mesh = tactus_eit.Mesh.disc(radius=0.15, electrodes=16)
forward = tactus_eit.Forward(mesh, protocol)
try:
    tactus_eit.OneStep(forward).fit(next(iter(frames.values())))
except ValueError as error:
    print(f"{error}\n")
truth = np.loadtxt(data / "uottawa2005" / "truth.csv", delimiter=",", skiprows=1, dtype=str)
baseline, *rest = [-one for one in frames.values()]
maps = tactus_eit.OneStep(forward).fit(baseline).predict(rest)
for column, (name, change) in enumerate(zip(list(frames)[1:], maps)):
    x, y = 100 * mesh.centroids[mesh.region][change.argmin()]
    true = [f"({float(x):.0f}, {float(y):.0f})" for frame, _, x, y, _ in truth if frame == name]
    print(f"Ottawa {name}: largest loss at ({x:.0f}, {y:.0f}) cm; balls at {' and '.join(true)} cm")
    draw(axes[0, column], mesh, change, name)
axes[0, 3].axis("off")

# Kuopio: targets in a tank of 23 cm, with pictures of the truth: 0 water, 1 resistive, 2 conductive
protocol, frames = recording(data / "ktc2023", "adj16_")
mesh = tactus_eit.Mesh.disc(radius=0.115, electrodes=16, arc_deg=5.625, first_deg=84.375)
baseline, *rest = frames.values()
maps = tactus_eit.OneStep(tactus_eit.Forward(mesh, protocol)).fit(baseline).predict(rest)
points, areas = mesh.centroids[mesh.region], mesh.areas[mesh.region]
for column, (name, change) in enumerate(zip(list(frames)[1:], maps)):
    labels = np.array([list(line) for line in (data / "ktc2023" / f"truth_{name}.txt").read_text().split()], dtype=int)
    line, place = (128 * (1 - points[:, 1] / 0.115)).astype(int), (128 * (1 + points[:, 0] / 0.115)).astype(int)
    truth = np.array([0.0, -1.0, 1.0])[labels[line, place]]
    like = tactus_eit.likeness(change, truth, areas)["correlation"]
    print(f"Kuopio {name}: correlation with the picture {like:.2f}")
    draw(axes[1, column], mesh, change, name)
    axes[1, column].tricontour(*points.T, truth, levels=[-0.5, 0.5], colors="k", linewidths=0.7)
figure.savefig("real-tanks.png", dpi=100, bbox_inches="tight")
