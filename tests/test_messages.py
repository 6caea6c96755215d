import copy
import dataclasses
import inspect
import weakref

import numpy as np
import pytest

from tfg_drake import messages
from tfg_drake.messages import LaserScan, Odometry, Path, Roadmap
from tfg_drake.slam.keyframe_graph import empty_map

MESSAGES = [
    kind for _, kind in inspect.getmembers(messages, dataclasses.is_dataclass) if kind.__module__ == messages.__name__
]


def make(kind):
    """A message with an array in every field that holds one."""
    return kind(
        **{
            field.name: np.arange(6.0).reshape(3, 2) if field.type.endswith("Array") else 0
            for field in dataclasses.fields(kind)
        }
    )


def arrays(message):
    return [value for value in vars(message).values() if isinstance(value, np.ndarray)]


@pytest.mark.parametrize("kind", MESSAGES)
def test_a_message_is_frozen_and_its_copies_are_itself(kind):
    message = make(kind)
    for field in dataclasses.fields(kind):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(message, field.name, 0)
    assert copy.copy(message) is message
    assert copy.deepcopy({"state": [message]})["state"][0] is message
    assert message == message
    assert message != make(kind)
    assert hash(message) == hash(copy.copy(message))


@pytest.mark.parametrize("kind", MESSAGES)
def test_no_array_of_a_message_can_be_written(kind):
    for array in arrays(make(kind)):
        for view in (array, array[1:], array.T):
            with pytest.raises(ValueError, match="read-only"):
                view[...] = 1.0
            with pytest.raises(ValueError, match="WRITEABLE"):
                view.flags.writeable = True


def test_a_message_and_its_maker_do_not_share_memory():
    own = np.zeros((4, 3))
    whole, view, locked = own[:], own[1:3], own[:]
    locked.flags.writeable = False
    for points in (own, whole, view, locked):
        path = Path(id=1, stage=0, points=points)
        own[...] = 7.0
        np.testing.assert_array_equal(path.points, np.zeros_like(points))
        own[...] = 0.0
    assert own.flags.writeable
    assert view.flags.writeable


def test_an_array_that_becomes_read_only_later_was_copied_before():
    own = np.zeros(3)
    view = own[:]
    own.flags.writeable = False
    odometry = Odometry(0.0, own, np.zeros(2))
    view[0] = 1.0
    assert odometry.X_OB[0] == 0.0


def test_messages_share_what_a_message_holds_already():
    scan = LaserScan(0.0, np.linspace(-1.0, 1.0, 5), np.ones(5), 10.0, 0.01)
    assert dataclasses.replace(scan, stamp=1.0).angles is scan.angles


def test_what_was_worked_out_of_a_message_is_not_that_of_the_changed_one():
    estimate = empty_map()
    assert estimate.of_tags is estimate.of_tags
    assert messages.replace(estimate, stage=3).of_tags.stage == 3


def test_a_map_without_walls_is_let_go_at_once():
    estimate = messages.replace(empty_map(), stage=3)
    left = weakref.ref(estimate.of_tags)
    del estimate
    assert left() is None


@pytest.mark.parametrize(
    "array",
    [
        np.empty((0, 2)),
        np.empty(0, dtype=np.int64),
        np.array([[True, False], [False, True]]),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.arange(12.0).reshape(3, 4)[:, ::2],
        np.array(3.0),
    ],
)
def test_frozen_arrays_keep_shape_type_and_values_in_c_order(array):
    frozen = Path(id=0, stage=0, points=array).points
    assert frozen.dtype == array.dtype
    assert frozen.flags.c_contiguous
    np.testing.assert_array_equal(frozen, array, strict=True)


def test_a_roadmaps_nodes_keep_their_names():
    no, yes = np.zeros(3), np.array([True, True, False])
    entry = np.array([0, 1, -1])
    part = Roadmap(1, np.zeros((3, 2)), np.zeros((0, 2), dtype=int), yes, yes, entry, no, no, ids=np.array([4, 7, 9]))
    assert part.node_ids(np.array([2, 0])).tolist() == [9, 4]
    assert part.nodes(np.array([9, 4, 5, 100])).tolist() == [2, 0, -1, -1]
    assert part.reaches(np.array([4, 9, 8])).tolist() == [True, False, False]
    farther = dataclasses.replace(part, travel_length=np.array([2.0, 1.0, 1.0]))
    assert farther.reaches(np.array([4, 7, 9, 8]), 1.5).tolist() == [False, True, False, False]
    whole = dataclasses.replace(part, ids=np.zeros(0, dtype=np.int64))
    assert whole.node_ids(np.array([2, 0])).tolist() == [2, 0]
    assert whole.nodes(np.array([2, 3])).tolist() == [2, -1]
    nothing = dataclasses.replace(
        part, ids=part.ids[:0], points=np.zeros((0, 2)), reachable=yes[:0], travel_length=no[:0]
    )
    assert nothing.reaches(np.array([0])).tolist() == [False]


def test_a_map_given_what_its_views_share_is_as_uncertain_as_their_own_errors_make_it():
    rng = np.random.default_rng(5)
    roots, by_shared, sigma = rng.normal(size=(7, 7)), rng.normal(size=(7, 8)), rng.normal(size=(8, 8))
    own, shared = roots @ roots.T, sigma @ sigma.T
    told = dataclasses.replace(
        empty_map(),
        local=np.array([0, 2]),
        landmark_covariance=np.zeros((3, 2, 2)),
        covariance=own + by_shared @ shared @ by_shared.T,
        shared=np.zeros(8),
        with_shared=np.vstack([by_shared @ shared, shared]),
    )
    given = told.given_shared()
    np.testing.assert_allclose(given.covariance, own, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(given.landmark_covariance[2], own[2:4, 2:4], rtol=1e-6, atol=1e-6)
    # That is the map of an estimator that tells of no such parameters.
    assert given.given_shared() is given
