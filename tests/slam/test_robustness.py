"""What a real robot does to an estimator: slips, kidnappings, moved tags, misread ids, lost and late messages."""

import copy
import dataclasses
import logging

import numpy as np
import pytest

from tests.slam.test_scan_lines import ANGLES, CONFIG
from tfg_drake.config import OdometryConfig, ScanConfig, TagSensorConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import Odometry, TagDetections, replace
from tfg_drake.simulation.laser_scanner import scan
from tfg_drake.slam.estimator import (
    _found_meanwhile,
    begin_turn,
    close_piece,
    end_turn,
    finished_map,
    pose_estimate,
    process_detections,
    process_odometry,
    process_scan,
)
from tfg_drake.slam.estimator_state import KIDNAPPED, initial_state, opened
from tfg_drake.slam.shared import by_data_sheet

TURN = 201
LEG = 150


class Tour:
    """A robot on a ring in a 20 x 20 m room of 80 tags, and its estimator; spoil: what happens to each frame."""

    def __init__(self, drive, seed, noise=1.0, period=0.0, spoil=lambda detections, rng: detections):
        self.rng = np.random.default_rng(500 + seed)
        points = np.random.default_rng(1000 + seed).uniform(-10.0, 10.0, (80, 2))
        self.robot = drive(points, seed, noise, start=(6.0, 0.0, 0.5 * np.pi))
        self.spoil = spoil
        self.state = process_odometry(initial_state(self.robot.config, period), self.robot.odometry())

    def move(self, speed, turn_rate, steps):
        for _ in range(steps):
            for message in self.robot.step(speed, turn_rate):
                if isinstance(message, Odometry):
                    self.state = process_odometry(self.state, message)
                else:
                    self.state = process_detections(self.state, self.spoil(message, self.rng))

    def turn_round(self, slip_at=None, slip=(0.0, 0.0, 0.0)):
        self.state = begin_turn(self.state, self.robot.time)
        for step in range(TURN):
            if step == slip_at:
                self.carry(slip)
            self.move(0.0, 1.0, 1)
        self.state = end_turn(self.state, self.robot.time)

    def leg(self, steps=LEG):
        self.move(0.5, 0.5 / 6.0, steps)

    def carry(self, slip):
        self.robot.X_WB = se2.compose(self.robot.X_WB, np.array(slip))

    def error(self):
        error = se2.between(self.robot.X_MB, pose_estimate(self.state).X_MB)
        return np.hypot(*error[:2]), abs(error[2])

    def map_rmse(self):
        estimate = self.state.map
        return np.sqrt(np.mean(np.sum((estimate.p_ML - self.robot.p_ML(estimate.ids)) ** 2, axis=1)))


@pytest.fixture(scope="module")
def after_three_turns(drive):
    """A tour after as many turns and legs; to be copied."""
    tour = Tour(drive, 1)
    for _ in range(3):
        tour.turn_round()
        tour.leg()
    return tour


# In a drive and in a turn one that is hardly noticed and one that cannot be missed; the others take long.
SLIPS = [
    (0.5, 0.0, 0.0),
    pytest.param((0.0, -0.5, 0.0), marks=pytest.mark.slow),
    pytest.param((0.1, 0.1, np.deg2rad(30.0)), marks=pytest.mark.slow),
    (-3.0, 2.0, 2.5),
]


@pytest.mark.parametrize("slip", SLIPS)
@pytest.mark.parametrize("when", ["driving", "turning"])
def test_a_robot_that_was_moved_finds_itself(after_three_turns, slip, when, caplog):
    tour = copy.deepcopy(after_three_turns)
    with caplog.at_level(logging.WARNING, "tfg_drake.slam"):
        if when == "driving":
            tour.carry(slip)
            tour.leg(64)
            tour.turn_round()
        else:
            tour.turn_round(slip_at=60, slip=slip)
    assert "from where its wheels have brought it" in caplog.text
    assert [one.note.kind for one in caplog.records if hasattr(one, "note")] == ["slip"]
    position, heading = tour.error()
    assert position < 0.1
    assert heading < 0.02
    tour.leg()
    caplog.clear()
    tour.turn_round()
    assert tour.error()[0] < 0.1
    assert tour.map_rmse() < 0.08
    assert "left out of the map" not in caplog.text


@pytest.mark.parametrize("push", [0.0, 0.35, -0.35])
def test_a_robot_pushed_in_a_corridor_knows_how_little_it_knows(push, caplog):
    """Two walls do not tell where along them it is: the deviation of its position grows, and a note says so."""
    corridor = np.array([[-2.0, -1.0, 60.0, -1.0], [60.0, 1.0, -2.0, 1.0], [-2.0, 1.0, -2.0, -1.0]])
    sheet, rng = by_data_sheet(OdometryConfig(), TagSensorConfig(), ScanConfig()), np.random.default_rng(3)
    X_WB, X_OB, stamp = np.zeros(3), np.zeros(3), 0.0
    state = process_odometry(initial_state(OdometryConfig(), 5.0, sheet), Odometry(0.0, X_OB, np.zeros(2)))
    looks = 3 * [(0.6, 0.0, 6.0, False), (0.0, 0.3, 1.0, True), (0.0, -0.3, 1.0, True)]
    for k, (speed, rate, seconds, is_turn) in enumerate([(0.0, 0.6, 10.5, True), (0.0, -0.6, 10.5, True), *looks]):
        state = begin_turn(state, stamp) if is_turn else state
        for i in range(round(seconds / 0.05)):
            stamp, moved = round(stamp + 0.05, 6), np.array([0.05 * speed, 0.0, 0.05 * rate])
            pushed = np.array([-0.2, push, 0.0]) * (push != 0.0 and k == 5 and i == 100)
            X_WB, X_OB = se2.compose(se2.compose(X_WB, moved), pushed), se2.compose(X_OB, moved)
            state = process_scan(state, scan(corridor, X_WB, stamp, ANGLES, rng.normal(size=len(ANGLES)), CONFIG))
            state = process_odometry(state, Odometry(stamp, X_OB, np.array([speed, rate])))
        state = end_turn(state, stamp) if is_turn else state
    told = pose_estimate(state)
    assert np.hypot(*(X_WB - told.X_MB)[:2]) < 2.0 * np.sqrt(np.trace(told.covariance[:2, :2]))
    assert ("do not tell another one" in caplog.text) == (push != 0.0)


def test_a_clean_drive_raises_no_alarm(drive, caplog):
    with caplog.at_level(logging.WARNING, "tfg_drake.slam"):
        for seed in range(2):
            tour = Tour(drive, seed)
            for _ in range(3):
                tour.turn_round()
                tour.leg()
    assert caplog.text == ""


def outliers(detections, rng):
    """3 % gross errors and 2 % misread ids."""
    r, b, ids = detections.range.copy(), detections.bearing.copy(), detections.ids.copy()
    bad = rng.random(len(r)) < 0.03
    r[bad] = rng.uniform(0.3, 10.0, bad.sum())
    b[bad] += rng.normal(0.0, 0.3, bad.sum())
    wrong = rng.random(len(r)) < 0.02
    ids[wrong] = 100 + rng.integers(0, 80, wrong.sum())
    return dataclasses.replace(detections, range=r, bearing=b, ids=ids)


@pytest.mark.parametrize(
    ("period", "seeds", "legs"),
    [
        pytest.param(0.0, 3, 4, marks=pytest.mark.slow),
        pytest.param(1.0, 3, 4, marks=pytest.mark.slow),
        (1.0, 1, 2),
    ],
)
def test_outliers_and_misread_ids_hardly_matter(drive, period, seeds, legs):
    clean, spoilt = [], []
    for seed in range(seeds):
        for spoil, results in ((lambda detections, rng: detections, clean), (outliers, spoilt)):
            tour = Tour(drive, seed, period=period, spoil=spoil)
            for _ in range(legs):
                tour.turn_round()
                tour.leg()
            tour.turn_round()
            results.append(tour.map_rmse())
    assert np.mean(spoilt) < 1.2 * np.mean(clean) + 0.003


def test_a_moved_tag_is_mapped_anew(drive, caplog):
    tour = Tour(drive, 2)
    tour.turn_round()
    tour.leg()
    tour.turn_round()
    tag = int(tour.state.map.ids[np.argmin(np.hypot(*tour.robot.tags[tour.state.map.ids - 100].T))])
    tour.robot.tags[tag - 100] += [1.0, 0.5]
    with caplog.at_level(logging.WARNING, "tfg_drake.slam"):
        tour.leg()
        tour.turn_round()
        assert f"left out of the map, for they contradict it: tags {tag}" in caplog.text
        caplog.clear()
        tour.leg()
        tour.turn_round()
    assert f"mapped anew, for more was seen of them elsewhere: tags {tag}" in caplog.text
    assert "left out of the map" not in caplog.text
    estimate = tour.state.map
    np.testing.assert_allclose(estimate.p_ML[estimate.ids == tag][0], tour.robot.p_ML(np.array([tag]))[0], atol=0.1)
    assert tour.map_rmse() < 0.05


def test_what_the_whole_map_contradicts_is_taken_back_at_the_end(drive, caplog):
    """The newest keyframe has the farthest tag that four have seen 1.1 m from where it is."""
    tour = Tour(drive, 4)
    for _ in range(4):
        tour.turn_round()
        tour.leg(60)
    state, newest = tour.state, tour.state.graph.keyframes[-1]
    seen = [one.ids for one in state.graph.keyframes]
    often = [sum(tag in ids for ids in seen) > 3 for tag in newest.ids]
    tag = int(newest.ids[np.argmax(often * np.hypot(*newest.y_AL.T))])
    y_AL = newest.y_AL + 0.8 * (newest.ids == tag)[:, None]
    spoilt = replace(state.graph, keyframes=(*state.graph.keyframes[:-1], replace(newest, y_AL=y_AL)))
    with caplog.at_level(logging.WARNING, "tfg_drake.slam"):
        tour.state = finished_map(replace(state, graph=spoilt))
    assert f"taken back, for the map contradicts it: a sighting of tag {tag}" in caplog.text
    assert tag not in tour.state.graph.keyframes[-1].ids
    np.testing.assert_array_equal(tour.state.map.doubtful, [tag])
    assert tour.map_rmse() < 0.05


def test_a_tag_that_frames_fail_to_show_is_doubtful_after_the_next_view(drive, caplog):
    tour = Tour(drive, 3)
    tour.turn_round()
    tag, watch = int(tour.state.map.ids[5]), tour.state.watch
    failed = np.where(watch.ids == tag, 1000, 0)
    tour.state = replace(tour.state, watch=replace(watch, failed=failed, all_expected=1000, all_seen=990))
    tour.leg()
    with caplog.at_level(logging.WARNING, "tfg_drake.slam"):
        tour.turn_round()
    assert f"not seen where the map has them: tags {tag}" in caplog.text
    assert tag in tour.state.map.doubtful
    assert not tour.state.watch.failed.any()


@pytest.mark.parametrize("frames", [pytest.param(1, marks=pytest.mark.slow), 2, 6])
def test_an_id_misread_before_its_tag_is_seen_puts_it_nowhere_wrong(drive, caplog, frames):
    """In two frames it is not believed; in six it is, until the tag itself has been seen."""
    misread = []

    def spoil(detections, rng):
        unseen = [tag for tag in range(100, 180) if tag not in seen]
        seen.update(detections.ids.tolist())
        if detections.stamp < 8.0 or len(misread) >= frames or not len(detections.ids):
            return detections
        tag = misread[0] if misread else unseen[0]
        misread.append(tag)
        # The same tag of the room, so that the misread frames agree.
        ids = detections.ids.copy()
        ids[np.argmin(np.abs(detections.bearing))] = tag
        return dataclasses.replace(detections, ids=ids)

    seen = set()
    tour = Tour(drive, 7, period=2.0, spoil=spoil)
    tour.turn_round()
    tour.leg(64)
    tour.turn_round()
    tag = misread[0]
    assert (tag in tour.state.map.ids) == (frames >= 3)
    with caplog.at_level(logging.WARNING, "tfg_drake.slam"):
        for _ in range(3):
            tour.leg()
            tour.turn_round()
    estimate = tour.state.map
    np.testing.assert_allclose(estimate.p_ML[estimate.ids == tag][0], tour.robot.p_ML(np.array([tag]))[0], atol=0.15)
    assert len(estimate.doubtful) == 0
    assert (f"more was seen of them elsewhere: tags {tag}" in caplog.text) == (frames >= 3)
    assert tour.map_rmse() < 0.08


def test_impossible_sightings_are_named_and_ignored(drive, caplog):
    def spoil(detections, rng):
        r = detections.range.copy()
        r[: len(r) // 4] = np.nan
        return dataclasses.replace(detections, range=r)

    tour = Tour(drive, 3, spoil=spoil)
    with caplog.at_level(logging.WARNING, "tfg_drake.slam"):
        tour.turn_round()
        tour.leg()
        tour.turn_round()
    assert "impossible or ambiguous sightings ignored" in caplog.text
    assert tour.map_rmse() < 0.05


def test_gaps_in_odometry_and_frames_of_the_past_are_survived(drive):
    tour = Tour(drive, 4)
    tour.turn_round()
    tour.leg(40)
    state = tour.state
    for _ in range(32):
        tour.robot.step(0.5, 0.5 / 6.0)
    late = TagDetections(0.5, np.array([100]), np.ones(1), np.zeros(1), np.ones(1), np.ones(1))
    assert process_detections(state, late) is state
    tour.leg(60)
    tour.turn_round()
    assert tour.error()[0] < 0.1
    assert tour.map_rmse() < 0.08


@pytest.mark.slow
def test_mapping_the_way_sharpens_the_map(drive):
    rmse = {0.0: [], 1.0: []}
    for period, values in rmse.items():
        for seed in range(4):
            tour = Tour(drive, seed, period=period)
            for _ in range(5):
                tour.turn_round()
                tour.leg()
            tour.turn_round()
            values.append(tour.map_rmse())
            assert tour.state.map.stage == 6
    assert np.mean(rmse[1.0]) < np.mean(rmse[0.0])


def test_a_drive_without_turns_is_mapped_piece_by_piece(drive):
    tour = Tour(drive, 5, noise=0.0, period=np.inf)
    for _ in range(6):
        tour.leg(64)
        tour.state = close_piece(tour.state, tour.robot.time)
    assert tour.state.map.stage == 6
    assert tour.map_rmse() < 1e-5
    assert tour.error()[0] < 1e-5


def test_no_piece_can_be_closed_where_none_is_open(drive):
    tour = Tour(drive, 5)
    with pytest.raises(ValueError, match="No piece of the way is open"):
        close_piece(tour.state, 1.0)


def test_a_piece_that_began_nobody_knows_where_begins_where_the_robot_has_found_itself_since(drive):
    """As long as it is not lost, and that tells more."""
    tour = Tour(drive, 5, period=np.inf)
    for _ in range(4):
        tour.leg(64)
        tour.state = close_piece(tour.state, tour.robot.time)
    began, begun = tour.robot.X_MB, opened(tour.state)
    guess = replace(begun, X_MB=begun.X_MB + np.array([4.0, -3.0, 1.0]), sigma=KIDNAPPED)
    tour.leg(64)
    found = _found_meanwhile(tour.state, guess)
    off = se2.between(began, found.X_MB)
    assert np.abs(off).max() < 0.1
    assert (found.sigma < 0.2).all()
    assert found.begin is guess.begin
    assert _found_meanwhile(replace(tour.state, contradictions=np.inf), guess) is guess
    surer = replace(guess, sigma=np.full(3, 1e-4))
    assert _found_meanwhile(tour.state, surer) is surer
