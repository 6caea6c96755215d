"""Submaps far from the robot are inactive: split and merged, the content stays the same, and little is touched."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tfg_drake.tfg.submaps import LEAST_VIEWS, SLACK, extended, rearranged, to_activate, undivided, whole

REACH = 20.0


def split(content, views, stays):
    """Content is a dictionary of what each view noted."""
    assert sorted(content) == views.tolist()
    return {k: content[k] for k in views[stays]}, {k: content[k] for k in views[~stays]}


def merge(contents, views):
    for content, theirs in zip(contents, views, strict=True):
        assert sorted(content) == theirs.tolist()
    return dict(item for content in contents for item in content.items())


def drive(X_MA):
    """The content after all views, and which were active at each."""
    submaps, active = undivided({}), []
    for k in range(len(X_MA)):
        submaps = rearranged(submaps, to_activate(submaps.submap, X_MA[: k + 1], REACH), split, merge)
        submaps = extended(submaps, submaps.active | {k: f"view {k}"}, k + 1)
        active.append(submaps.views)
    return submaps, active


def line(x):
    return np.stack([x, 0.0 * x, 0.0 * x], axis=1)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0)), min_size=1, max_size=60))
def test_nothing_is_lost_and_all_within_reach_is_active(places):
    X_MA = np.column_stack([places, np.zeros(len(places))])
    submaps, active = drive(X_MA)
    assert whole(submaps, merge) == {k: f"view {k}" for k in range(len(X_MA))}
    for k, views in enumerate(active):
        within = np.flatnonzero(np.hypot(*(X_MA[: k + 1, :2] - X_MA[k, :2]).T) <= REACH)
        assert np.isin(within, views).all()
    assert sorted(submaps.active) == submaps.views.tolist()
    for name, content in submaps.inactive.items():
        assert sorted(content) == np.flatnonzero(submaps.submap == name).tolist()
        assert name == min(content)


def test_what_is_active_stays_as_small_as_the_neighbourhood_and_is_activated_on_the_way_back():
    out = np.arange(0.0, 300.0, 2.0)
    submaps, active = drive(line(np.append(out, out[::-1])))
    most = (REACH + SLACK) / 2.0 + LEAST_VIEWS
    assert max(len(views) for views in active[: len(out)]) <= most + 1
    # On the way back there are twice as many within reach.
    assert max(len(views) for views in active) <= 2 * most + 2 * LEAST_VIEWS
    assert 0 in active[-1]
    assert len(submaps.inactive) > 5


def test_nothing_moves_to_and_fro_where_the_robot_stays():
    X_MA = line(np.append(np.arange(0.0, 100.0, 2.0), 100.0 + 3.0 * (np.arange(40) % 2)))
    _, active = drive(X_MA)
    later = [views[views < 50].tolist() for views in active[60:]]
    assert all(views == later[0] for views in later)


def test_a_loop_that_closes_activates_what_comes_near():
    X_MA = line(np.arange(0.0, 100.0, 2.0))
    submaps, _ = drive(X_MA)
    assert 0 not in submaps.views
    moved = X_MA.copy()
    moved[:5] += [100.0, 0.0, 0.0]
    active = to_activate(submaps.submap, moved, REACH)
    again = rearranged(submaps, active, split, merge)
    assert np.isin(np.arange(5), again.views).all()
    assert whole(again, merge) == whole(submaps, merge)
