import numpy as np
import pytest

from tfg_drake.tfg.frontier import in_front, no_points, novel, points_of

FACE = [2.0, 0.0, -2.0, 0.0]  # its front is below it
OPPOSITE = [-2.0, -0.8, 2.0, -0.8]  # its front is above it
BACK_TO_BACK = [-2.0, 0.1, 2.0, 0.1]  # the other side of the same wall


@pytest.mark.parametrize("mapped_again", [-0.08, 0.0, 0.08])
@pytest.mark.parametrize(("others", "share"), [([], 1.0), ([BACK_TO_BACK], 1.0), ([OPPOSITE], 1.0 / 3.0)])
def test_a_place_is_narrow_by_what_faces_it_and_not_by_its_own_surface_mapped_again(mapped_again, others, share):
    p, normal = np.array([[0.3, mapped_again]]), np.array([[0.0, -1.0]])
    front = in_front(p, normal, np.array([FACE, *others]), 0.2)
    np.testing.assert_allclose(front, p + share * 0.2 * normal)


def test_a_point_that_a_surface_explains_keeps_no_open_one_away():
    wall, toward = np.array([[0.0, 0.0, 1.0, 0.0]]), np.array([[0.0, -1.0]])

    def at(x):
        return points_of(0, np.array([[x, 0.0]]), toward, np.ones(1))

    on_wall, beside, again, far = at(0.95), at(1.2), at(1.25), at(2.0)
    assert novel(beside, on_wall, wall).tolist() == [True]
    assert novel(again, beside, wall).tolist() == [False]
    assert novel(on_wall, beside, wall).tolist() == [False]
    assert novel(far, beside, wall).tolist() == [True]
    assert novel(beside, no_points(), wall).tolist() == [True]
