"""Drift and uncertainty: the baseline followed through ten days of a session, given as the argument."""

import sys

import matplotlib.pyplot as plt
import numpy as np
import tactus_eit

if len(sys.argv) < 2:
    sys.exit(__doc__)
session = tactus_eit.open_session(sys.argv[1])
hours = (session.times - session.times[0]) / np.timedelta64(1, "h") + 1
forward = tactus_eit.Forward(tactus_eit.Mesh.sheet(), session.protocol)

drift = tactus_eit.Drift(forward).fit(session.baseline, noise=2e-6)
followed = drift.follow(session.voltages, 3600 * hours)
judged = np.array([known["judgement"] for known in followed.known])
night = (hours % 24 >= 12) & (hours % 24 < 20)
for name, part in (("night, something lies on the sheet", night), ("day, the sheet is empty", ~night)):
    words, counts = np.unique(judged[part], return_counts=True)
    print(f"{name}: " + ", ".join(f"{count} {word}" for word, count in zip(words, counts)))

model = tactus_eit.OneStep(forward).fit(session.baseline, noise=2e-6)
tracked = np.abs(model.predict(followed.frames[~night], baselines=followed.baselines[~night])).max(axis=1)
untracked = np.abs(model.predict(session.voltages[~night])).max(axis=1)
print("largest change in maps of the empty sheet, median:")
print(f"{100 * np.median(untracked):.0f} % against the first baseline, {100 * np.median(tracked):.2f} % tracked")

figure, (above, below) = plt.subplots(2, 1, figsize=(8, 5), sharex=True)
above.plot(hours[~night] / 24, 100 * untracked, ".", label="against the first baseline")
above.plot(hours[~night] / 24, 100 * tracked, ".", label="against the tracked baseline")
above.set_ylabel("largest change, %")
above.set_yscale("log")
above.legend()
below.plot(hours / 24, [known["baseline_sd_uv"] for known in followed.known])
below.set_ylabel("uncertainty, uV")
below.set_xlabel("day")
figure.savefig("drift.png", dpi=100, bbox_inches="tight")
