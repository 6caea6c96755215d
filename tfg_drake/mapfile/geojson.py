"""A map as GeoJSON, in metres of the world frame W instead of degrees. Needs shapely (extra `export`)."""

from __future__ import annotations

import json
import math
from typing import Any

import shapely

from tfg_drake.geometry.se2 import transform
from tfg_drake.mapfile.in_world import landmarks_in_world, stars_of, tfg_in_world
from tfg_drake.mapfile.saved_map import KINDS, SavedMap
from tfg_drake.slam.walls import known_walls

# W as a local coordinate system in metres, in OGC's WKT; without it a reader assumes degrees.
CRS = 'LOCAL_CS["W",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'


def geojson_text(saved: SavedMap) -> str:
    """The file's contents: features whose property `layer` is free_space, surface, wall, frontier or tag. A wall
    is a landmark, sigma_m the deviation of either end across it."""
    tfg, (p_WL, covariance) = tfg_in_world(saved), landmarks_in_world(saved)
    free = shapely.union_all([shapely.make_valid(shapely.Polygon(star), method="structure") for star in stars_of(tfg)])
    features = [_feature(free, "free_space", area_m2=free.area)] if not free.is_empty else []
    for piece, kind, ends in zip(tfg.segments, tfg.segment_kind.tolist(), tfg.segment_ids.tolist(), strict=True):
        features.append(_feature(shapely.LineString(piece.reshape(2, 2)), "surface", kind=KINDS[kind], landmarks=ends))
    ids, p_ME, across = known_walls(saved.graph)
    for wall, ends, sigma in zip(ids.tolist(), p_ME, across.tolist(), strict=True):
        line = shapely.LineString(transform(saved.X_WM, ends))
        features.append(_feature(line, "wall", id=wall, length_m=line.length, sigma_m=sigma))
    for p, length in zip(tfg.frontiers, tfg.frontier_length.tolist(), strict=True):
        features.append(_feature(shapely.Point(p), "frontier", length_m=length))
    columns = (saved.ids.tolist(), p_WL, covariance.tolist(), tfg.facing.tolist(), saved.is_doubtful.tolist())
    for tag, p, ((xx, xy), (_, yy)), f, doubtful in zip(*columns, strict=True):
        known = {"cov_xx_m2": xx, "cov_xy_m2": xy, "cov_yy_m2": yy, "doubtful": doubtful}
        known["facing_rad"] = math.atan2(f[1], f[0]) if any(f) else None
        features.append(_feature(shapely.Point(p), "tag", id=tag, **known))
    crs = json.dumps({"type": "name", "properties": {"name": CRS}})
    lines = ",\n".join(map(json.dumps, features))  # a feature a line
    return f'{{"type": "FeatureCollection", "crs": {crs}, "features": [\n{lines}\n]}}\n'


def _feature(geometry: Any, layer: str, **known: object) -> dict[str, object]:
    return {"type": "Feature", "geometry": shapely.geometry.mapping(geometry), "properties": {"layer": layer, **known}}
