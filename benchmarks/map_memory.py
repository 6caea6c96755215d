"""The size of the maps of a comparison: unknowns, numbers, bytes in memory and on disk, and kilobytes a square metre.

    tfg-drake compare paper --methods tfg,grid-nearest --seeds 1 --out compared
    python benchmarks/map_memory.py compared/runs/*/seed-0

Unknowns are the summary's `map_variables`. Numbers are all that the map holds: of a TFG what keyframes tell (graph),
surfaces and frontiers, and free space as star polygons; of a grid the cells of one particle. The particles share what
no scan has changed since they parted: GMapping holds one grid at least and as many as particles at most. Area is what
the map calls free.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from tfg_drake.grid.saved_grid import load_grid
from tfg_drake.mapfile.saved_map import SavedMap, load_map

# A cell is free if its occupancy probability is below FREE.
FREE = 0.35


def arrays(value: Any) -> list[np.ndarray]:
    """All arrays that a message holds."""
    if isinstance(value, np.ndarray):
        return [value]
    if dataclasses.is_dataclass(value):
        return [array for field in dataclasses.fields(value) for array in arrays(getattr(value, field.name))]
    return [array for item in value for array in arrays(item)] if isinstance(value, tuple | list) else []


def of_map(saved: SavedMap) -> tuple[int, dict[str, list[np.ndarray]], float]:
    """Unknowns, arrays by part, and area, m^2."""
    graph, tfg = saved.graph, saved.tfg_graph
    free = [tfg.star_offsets, tfg.star_vertices]
    parts = {"graph": arrays(graph), "free space": free}
    parts["surfaces, frontiers"] = [array for array in arrays(tfg) if all(array is not one for one in free)]
    stars = np.split(saved.tfg.star_vertices, saved.tfg.star_offsets[1:-1])
    area = shapely.union_all([shapely.make_valid(shapely.Polygon(star)) for star in stars if len(star) > 2]).area
    return sum(graph.unknowns.values()), parts, float(area)


def main() -> None:
    """A table of the maps, a row a part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", help="folders with a map.npz or a grid.npz")
    print(f"{'map':40}{'part':20}{'unknowns':>10}{'numbers':>10}{'MB':>8}{'MB disk':>9}{'kB / m2':>9}")
    for run in parser.parse_args().runs:
        if (run / "map.npz").exists():
            unknowns, parts, area = of_map(load_map(run / "map.npz"))
            disk = (run / "map.npz").stat().st_size
        else:
            grid = load_grid(run / "grid.npz")
            area = float(np.count_nonzero(grid.probability < FREE) * grid.resolution**2)
            unknowns, parts = grid.probability.size, {"one particle": [grid.probability]}
            disk = (run / "grid.npz").stat().st_size
        parts = {"all": [array for part in parts.values() for array in part], **parts}
        for part, held in parts.items():
            numbers, size = sum(array.size for array in held), sum(array.nbytes for array in held)
            whole = [f"{unknowns}", f"{disk / 1e6:.2f}"] if part == "all" else ["", ""]
            cells = f"{whole[0]:>10}{numbers:>10}{size / 1e6:>8.2f}{whole[1]:>9}{size / 1e3 / area:>9.2f}"
            print(f"{str(run)[-38:]:40}{part:20}{cells}")


if __name__ == "__main__":
    main()
