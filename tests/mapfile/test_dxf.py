import dataclasses
import io

import ezdxf
import numpy as np

from tfg_drake.mapfile.dxf import FACING, LAYERS, dxf_text
from tfg_drake.mapfile.in_world import landmarks_in_world, tfg_in_world


def test_ezdxf_reads_the_map_back(small_map):
    tfg, (p_WL, _) = tfg_in_world(small_map), landmarks_in_world(small_map)
    drawing = ezdxf.read(io.StringIO(dxf_text(dataclasses.replace(small_map, doubtful=np.array([13])))))
    assert not drawing.audit().errors
    assert drawing.units == ezdxf.units.M
    assert {layer.dxf.name for layer in drawing.layers} >= LAYERS.keys()
    space = drawing.modelspace()

    def flat(*points):
        return np.array([[p.x, p.y] for p in points])

    # None of the small map's surfaces goes on in another.
    for layer, some in (("WALL", tfg.segment_kind < 2), ("SURFACE", tfg.segment_kind == 2)):
        found = [flat(line.dxf.start, line.dxf.end).tolist() for line in space.query(f'LINE[layer=="{layer}"]')]
        expected = tfg.segments[some].reshape(-1, 2, 2).tolist()
        np.testing.assert_allclose(sorted(found), sorted(expected), atol=1e-9)
    (frontier,) = space.query('POINT[layer=="FRONTIER"]')
    np.testing.assert_allclose(flat(frontier.dxf.location), [[5.0, 1.0]], atol=1e-9)
    for layer, rows in (("TAG", [0, 1, 2]), ("DOUBTFUL_TAG", [3])):
        points = space.query(f'POINT[layer=="{layer}"]')
        np.testing.assert_allclose(flat(*(point.dxf.location for point in points)), p_WL[rows])
        ends = flat(*(line.dxf.end for line in space.query(f'LINE[layer=="{layer}"]')))
        np.testing.assert_allclose(ends, p_WL[rows] + FACING * tfg.facing[rows])
        assert [text.dxf.text for text in space.query(f'TEXT[layer=="{layer}"]')] == [str(10 + row) for row in rows]


def test_ezdxf_is_left_as_it_was(small_map):
    assert dxf_text(small_map) == dxf_text(small_map)
    assert ezdxf.options.write_fixed_meta_data_for_testing is False
