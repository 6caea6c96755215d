import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.config import TagSensorConfig
from tfg_drake.messages import replace
from tfg_drake.planning.candidates import sees_known_jointly, thin_candidates
from tfg_drake.slam.goal_graph import empty_map as empty_estimate
from tfg_drake.tfg.graph import empty_map


@given(st.lists(st.booleans(), max_size=60), st.integers(1, 40))
def test_candidates_are_thinned_evenly_and_frontiers_come_first(sees, count):
    nodes = 3 * np.arange(len(sees))
    flags = np.array(sees, dtype=np.int64)
    kept = thin_candidates(nodes, flags, count)
    assert len(kept) == len(np.unique(kept)) == min(count, len(nodes))
    assert (np.diff(kept) > 0).all()
    assert set(kept) <= set(nodes)
    seeing = set(nodes[flags > 0])
    assert len(seeing & set(kept)) == min(len(seeing), count)
    for of in (sorted(seeing), sorted(set(nodes) - seeing)):
        gaps = np.diff(np.flatnonzero(np.isin(of, kept)))
        assert not len(gaps) or np.ptp(gaps) <= 1


def test_a_place_is_judged_anew_where_all_it_sees_is_known_jointly_whatever_stands_behind_walls():
    p_ML = np.array([[3.0, 0.0], [5.5, 0.0]])
    facing = np.array([[-1.0, 0.0], [-1.0, 0.0]])
    of_both = replace(empty_estimate(), ids=np.array([1, 2]), p_ML=p_ML, local=np.array([0, 1]))
    of_first = replace(of_both, local=np.array([0]))
    open_hall = replace(empty_map(), facing=facing, segments=np.array([[3.0, -0.1, 3.0, 0.1]]))
    walled = replace(open_hall, segments=np.array([[4.0, -3.0, 4.0, 3.0], [3.0, -0.1, 3.0, 0.1]]))
    beside = np.array([[1.0, 0.5]])
    sensor = TagSensorConfig()
    for estimate, tfg, expected in ((of_both, open_hall, True), (of_first, open_hall, False), (of_first, walled, True)):
        assert sees_known_jointly(beside, estimate, tfg, sensor).tolist() == [expected]
    # The robot left from elsewhere: its map does not say.
    elsewhere = replace(of_first, X_MD=np.array([20.0, 0.0, 0.0]))
    assert sees_known_jointly(beside, elsewhere, walled, sensor).tolist() == [False]
