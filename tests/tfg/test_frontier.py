import numpy as np
import pytest

from tfg_drake.tfg.frontier import in_front

FACE = [2.0, 0.0, -2.0, 0.0]  # its front is below it
OPPOSITE = [-2.0, -0.8, 2.0, -0.8]  # its front is above it
BACK_TO_BACK = [-2.0, 0.1, 2.0, 0.1]  # the other side of the same wall


@pytest.mark.parametrize("mapped_again", [-0.08, 0.0, 0.08])
@pytest.mark.parametrize(("others", "share"), [([], 1.0), ([BACK_TO_BACK], 1.0), ([OPPOSITE], 1.0 / 3.0)])
def test_a_place_is_narrow_by_what_faces_it_and_not_by_its_own_surface_mapped_again(mapped_again, others, share):
    p, normal = np.array([[0.3, mapped_again]]), np.array([[0.0, -1.0]])
    front = in_front(p, normal, np.array([FACE, *others]), 0.2)
    np.testing.assert_allclose(front, p + share * 0.2 * normal)
