"""A month of a recorded session in pandas: python sessions.py SESSION.tactus"""

import sys

import matplotlib.pyplot as plt
import numpy as np
import tactus_eit

if len(sys.argv) < 2:
    sys.exit(__doc__)
session = tactus_eit.open_session(sys.argv[1])
print(session)
table = session.to_pandas()
readings = table.filter(regex=r"^v\d+$")

day = (session.times - session.times[0]) / np.timedelta64(1, "D")

# every reading relative to the baseline; the median over the sheet is its conductance as a whole
relative = 100 * (readings / session.baseline - 1)
drift = relative.median(axis=1)
days = drift.resample("1D").agg(["min", "median", "max"])
days.index = np.arange(len(days))
print("\nday, change of the readings in %")
print(days.iloc[::7].round(1).to_string())

# how far the readings of each pair of neighbours are from the rest: a contact that fails changes those of its pairs
pairs = session.protocol.inject[:, 0], session.protocol.measure[:, 0]
away = relative.sub(drift, axis=0).abs()
of_pair = {e + 1: away.loc[:, (pairs[0] == e) | (pairs[1] == e)].median(axis=1) for e in range(session.protocol.electrodes)}
last = {e: values.iloc[-24:].median() for e, values in of_pair.items()}
worst = max(last, key=last.get)
print(f"\nelectrodes {worst} and {worst + 1}: {of_pair[worst].iloc[:24].median():.1f} % on day 0, {last[worst]:.0f} % on the last day")

figure, (above, below) = plt.subplots(2, 1, figsize=(8, 5), sharex=True)
above.plot(day, drift, linewidth=0.8)
above.set_ylabel("median, %")
for e, values in of_pair.items():
    below.plot(day, values, linewidth=0.8, color="C3" if e == worst else "0.8", zorder=2 if e == worst else 1)
below.set_ylabel("a pair against the rest, %")
below.set_yscale("log")
below.set_xlabel("day")
figure.savefig("sessions.png", dpi=100, bbox_inches="tight")
