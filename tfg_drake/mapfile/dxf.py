"""A map as a DXF drawing in metres of the world frame W. Needs ezdxf (extra `export`)."""

from __future__ import annotations

import io

import ezdxf
from ezdxf.enums import TextEntityAlignment

from tfg_drake.mapfile.in_world import landmarks_in_world, tfg_in_world
from tfg_drake.mapfile.saved_map import KINDS, SavedMap
from tfg_drake.mapfile.wall_lines import wall_lines

# The layers with their colours by AutoCAD's numbers: black or white, grey, green, violet, blue.
LAYERS = {"WALL": 7, "SURFACE": 8, "TAG": 94, "DOUBTFUL_TAG": 200, "FRONTIER": 5}
# Length of the line in the direction that a tag faces, and height of its number, m.
FACING, NUMBER = 0.2, 0.12


def dxf_text(saved: SavedMap) -> str:
    """The file's contents, the same on any day: walls with a landmark as lines that each stand once, surfaces without a
    landmark apart, tags as points with their number and a line to the side that they face, frontiers as points."""
    before, text = ezdxf.options.write_fixed_meta_data_for_testing, io.StringIO()
    ezdxf.options.write_fixed_meta_data_for_testing = True  # else the time and random identifiers
    try:
        _drawing(saved).write(text)
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = before
    return text.getvalue()


def _drawing(saved: SavedMap) -> ezdxf.document.Drawing:
    tfg, drawing = tfg_in_world(saved), ezdxf.new("R2010", units=ezdxf.units.M)
    space = drawing.modelspace()
    for name, colour in LAYERS.items():
        drawing.layers.add(name, color=colour)
    bare = tfg.segment_kind == KINDS.index("bare_surface")
    for layer_name, of_part in (("WALL", ~bare), ("SURFACE", bare)):
        for line in wall_lines(tfg.segments[of_part]):
            space.add_line(line[:2], line[2:], {"layer": layer_name})
    for p in tfg.frontiers:
        space.add_point(p, {"layer": "FRONTIER"})
    columns = (saved.ids.tolist(), landmarks_in_world(saved)[0], tfg.facing, saved.is_doubtful.tolist())
    for tag, p, f, doubtful in zip(*columns, strict=True):
        layer = {"layer": "DOUBTFUL_TAG" if doubtful else "TAG"}
        space.add_point(p, layer)
        space.add_line(p, p + FACING * f, layer)
        number = space.add_text(str(tag), height=NUMBER, dxfattribs=layer)
        number.set_placement(p + 2.0 * FACING * f, align=TextEntityAlignment.MIDDLE_CENTER)
    return drawing
