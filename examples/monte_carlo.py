"""The same mission on many seeds: how its errors spread. One seed is one run, to the bit."""

import numpy as np

import tfg_drake
from tfg_drake.storage.trajectory import poses_at

rows = []
for seed in range(5):
    mission = tfg_drake.explore("corridor", seed=seed, until=90.0)
    stamps, X_WB = mission.X_WB
    # The truth has stamps of its own.
    off = X_WB - poses_at(stamps, *mission.X_WB_true)
    rows.append(np.hypot(off[:, 0], off[:, 1]).mean())
    print(f"seed {seed}: {mission}, position error {rows[-1]:.4f} m")
print(f"mean {np.mean(rows):.4f} m, standard deviation {np.std(rows):.4f} m")
