"""Read a simulated run's folder as arrays: how the errors of position and tags compare with what was stated.

tfg-drake explore house --headless --out runs/analysed
python examples/analyse.py runs/analysed

The folder may be one of a comparison, such as comparison/runs/grid-nearest/seed-0: a grid has no landmarks, and a
comparison keeps no ports.mcap.
"""

import sys

import numpy as np

import tfg_drake
from tfg_drake.comparison.curves import scan_coverage
from tfg_drake.diagrams.missions.errors import KnownWorld
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.storage.trajectory import poses_at

run = tfg_drake.load_run(sys.argv[1])
print(run.summary["outcome"], "after", run.summary["sim_time_s"], "s")

if not len(run.true_stamps):
    sys.exit(f"{run.folder}: no truth.tum, as of a real robot or a replay; name the folder of a simulated run")
# The truth has stamps of its own.
true = poses_at(run.stamps, run.true_stamps, run.X_WB_true)
error = np.hypot(*(run.X_WB - true)[:, :2].T)
for quarter in np.array_split(np.arange(len(error)), 4):
    begin, end = run.stamps[quarter[[0, -1]]]
    print(f"{begin:5.0f} to {end:3.0f} s: position error {error[quarter].mean():.3f} m")

scenario = LoadScenario(run.folder / "scenario.yaml")
world, scan = MakeWorld(scenario.world), scenario.scan
places = KnownWorld(world, scenario).counted_places()
rows, share = scan_coverage(run.X_WB_true, places, world.walls, scan.range, scan.field_of_view)
for time, seen in zip(run.true_stamps[rows][::100], share[::100], strict=True):
    print(f"{time:5.0f} s: {seen:.3f} of the area seen")

walls = "a grid" if run.summary["walls_mapped"] is None else f"{run.summary['walls_mapped']} walls"
print(f"{walls}, {run.summary['surface_coverage_5cm']:.3f} of the surface within 5 cm")
if run.map is not None and len(run.map.ids):
    deviation = np.sqrt(np.trace(run.map.landmark_covariance, axis1=1, axis2=2))
    print(f"tags: RMSE {run.summary['landmark_rmse_m']:.3f} m, stated {np.sqrt(np.mean(deviation**2)):.3f} m")
if run.map is not None and len(run.map.ids) and (run.folder / "ports.mcap").exists():
    tags = run.port("tags.detections")
    seen, times = np.unique(tags["ids"], return_counts=True)
    print(f"{len(tags['time'])} frames; tag {seen[times.argmax()]} was seen {times.max()} times")

gains = [(s["predicted_gain"], s["realised_gain"]) for s in run.stages if s["predicted_gain"] is not None]
print("gain at goals, nats, predicted and realised:", np.round(np.mean(gains, axis=0), 1) if gains else "no goal yet")
