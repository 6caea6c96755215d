"""The simulated station: its ports, its noise, its reproducibility, and that it keeps off walls."""

import logging

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import InitializeParams, Simulator
from pydrake.systems.framework import LeafSystem

from tfg_drake.config import ChangeConfig, TagConfig
from tfg_drake.diagrams.mission_diagram import MakeMissionDiagram
from tfg_drake.diagrams.robots import Robot
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld, Scenario, WorldConfig
from tfg_drake.diagrams.station import MakeTurtlebotStation
from tfg_drake.geometry.se2 import between, compose, transform
from tfg_drake.messages import Hazards
from tfg_drake.simulation.people import RADIUS, places_at
from tfg_drake.systems.differential_drive_plant import DifferentialDrivePlant
from tfg_drake.systems.ports import declare_message_output

OUTPUTS = [
    "base.odometry",
    "base.hazards",
    "base.enabled",
    "tags.detections",
    "scan.ranges",
    "truth.pose",
    "truth.contacts",
    "truth.clearance",
    "truth.contacts_received",
]
WORLD = WorldConfig(
    walls=[[-3, -3, 3, -3], [3, -3, 3, 3], [3, 3, -3, 3], [-3, 3, -3, -3]],
    tags=[TagConfig(id=5, position=[3.0, 0.5], facing=np.pi), TagConfig(id=3, position=[0.0, 3.0], facing=-np.pi / 2)],
    start=[0.5, -0.5, 0.3],
)


def make_scenario(noise=True):
    scenario = Scenario(world=WORLD)
    if not noise:
        for name in ("distance_noise", "distance_scale", "gyro_noise", "gyro_bias", "gyro_scale"):
            setattr(scenario.odometry, name, 0.0)
        scenario.tags.range_noise = scenario.tags.range_noise_per_metre = scenario.tags.bearing_noise = 0.0
        scenario.scan.noise = 0.0
    return scenario


@pytest.fixture(scope="module")
def station():
    return MakeTurtlebotStation(make_scenario())


@pytest.fixture(scope="module")
def noiseless_station():
    return MakeTurtlebotStation(make_scenario(noise=False))


def start(station, seed=0, command=(0.2, 0.5)):
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.SetRandomContext(context, RandomGenerator(seed))
    station.GetInputPort("base.velocity_commanded").FixValue(context, list(command))
    simulator.Initialize()
    return simulator


def read(station, context, name):
    return station.GetOutputPort(name).Eval(context)


def everything(station, context):
    """All that the station says, as one list of numbers."""
    numbers = []
    for name in OUTPUTS:
        value = read(station, context, name)
        for part in vars(value).values() if hasattr(value, "__dict__") else [value]:
            numbers += np.ravel(part).tolist()
    return numbers


class Dropping(DifferentialDrivePlant):
    """A hazard from 1 s to 2 s: a dropped wheel or a cliff."""

    drop, cliff = 0, 0

    def _Hazards(self, context):
        hangs = 1.0 <= context.get_time() < 2.0
        return Hazards(context.get_time(), 0, self.cliff * hangs, self.drop * hangs)


def dropping(drop, cliff):
    """A station whose base hangs or stands at a cliff, driving; its Simulator and the speed at times, s."""
    scenario = make_scenario()
    plant = Dropping(MakeWorld(scenario.world), scenario.robot)
    plant.drop, plant.cliff = drop, cliff
    station = MakeTurtlebotStation(scenario, plant=lambda _: plant)
    simulator = start(station, command=(0.2, 0.0))

    def speed(time):
        simulator.AdvanceTo(time)
        return read(station, simulator.get_context(), "truth.pose")[3]

    return station, simulator, speed


@pytest.mark.parametrize(("drop", "cliff"), [(1, 0), (0, 2)])
def test_after_a_wheel_drop_or_a_cliff_a_base_that_can_be_enabled_must_be(drop, cliff, caplog):
    station, simulator, speed = dropping(drop, cliff)
    context = simulator.get_mutable_context()
    enable = station.GetInputPort("base.enable")
    enable.FixValue(context, [1.0])
    with caplog.at_level(logging.WARNING, "tfg_drake.hardware"):
        assert speed(0.9) == pytest.approx(0.2)
        assert read(station, context, "base.enabled")[0] == 1.0
        assert speed(1.7) == pytest.approx(0.0, abs=1e-6)
        assert read(station, context, "base.enabled")[0] == 0.0
        # Too soon: who enables it now would be surprised when the wheel is down.
        enable.FixValue(context, [2.0])
        assert speed(4.0) == pytest.approx(0.0, abs=1e-6)
        assert read(station, context, "base.enabled")[0] == 0.0
    enable.FixValue(context, [3.0])
    assert speed(5.0) == pytest.approx(0.2)
    assert read(station, context, "base.enabled")[0] == 1.0
    what = "a wheel hangs: put the robot on its wheels" if drop else "a cliff: carry the robot away from it"
    lines = [record.getMessage().partition(" s: ")[2] for record in caplog.records]
    assert lines == [f"the base stands until it is enabled anew: {what}, then enable it"] * 2


@pytest.mark.parametrize(("drop", "cliff"), [(1, 0), (0, 2)])
def test_a_simulated_base_that_nobody_enables_goes_on_by_itself(drop, cliff):
    station, simulator, speed = dropping(drop, cliff)
    assert speed(0.9) == pytest.approx(0.2)
    assert speed(1.7) == pytest.approx(0.0, abs=1e-6)
    assert speed(3.0) == pytest.approx(0.2)
    assert read(station, simulator.get_context(), "base.enabled")[0] == 1.0


def test_a_mission_is_paused_after_a_wheel_drop_until_it_is_enabled_anew():
    scenario = make_scenario()
    world = MakeWorld(scenario.world)

    def MakeStation(scenario):
        plant = Dropping(world, scenario.robot)
        plant.drop = 4
        return MakeTurtlebotStation(scenario, plant=lambda _: plant)

    requests = []
    diagram, *_ = MakeMissionDiagram(
        scenario, world, robot=Robot("odd", MakeStation, world_known=True), operated=[lambda: requests]
    )
    simulator = Simulator(diagram)
    explorer = diagram.GetSubsystemByName("explorer")

    def phase(time):
        simulator.AdvanceTo(time)
        return explorer.GetOutputPort("mission").Eval(explorer.GetMyContextFromRoot(simulator.get_context())).phase

    assert [phase(time) for time in (0.9, 1.5, 3.0)] == ["observe", "paused", "paused"]
    requests.append("enable")
    simulator.AdvanceTo(3.1)
    requests.clear()
    assert phase(3.5) == "observe"


class TwoWheels(LeafSystem):
    """A plant with none but the ports that every scenario needs."""

    def __init__(self, _scenario):
        super().__init__()
        self.DeclareVectorInputPort("velocity_commanded", 2)
        self.DeclareVectorOutputPort("pose", 5, lambda context, output: None)
        declare_message_output(self, "hazards", lambda _context: Hazards(0.0, 0, 0, 0), {self.nothing_ticket()})


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("corridor_push", "pushes, which disturbances needs; add it or empty disturbances"),
        ("house_real", "people, which reality.people needs; add it or empty reality.people"),
    ],
)
def test_a_plant_that_what_happens_cannot_reach_is_refused(name, line):
    with pytest.raises(TypeError) as caught:
        MakeTurtlebotStation(LoadScenario(name), plant=TwoWheels)
    assert str(caught.value) == f"plant TwoWheels: lacks the input port {line}"


def test_a_plant_of_ones_own_has_its_name():
    own = MakeTurtlebotStation(make_scenario(), plant=TwoWheels)
    assert type(own.GetSubsystemByName("TwoWheels")) is TwoWheels


def test_ports_and_names(station):
    inputs = [station.get_input_port(i).get_name() for i in range(station.num_input_ports())]
    outputs = [station.get_output_port(i).get_name() for i in range(station.num_output_ports())]
    assert station.get_name() == "station"
    assert inputs == ["base.velocity_commanded", "base.enable", "base.pose", "truth.pushes"]
    assert outputs == OUTPUTS
    assert [system.get_name() for system in station.GetSystems()] == [
        "safety_filter",
        "differential_drive_plant",
        "odometry",
        "tag_sensor",
        "laser_scanner",
        "odometry_noise",
        "odometry_run_errors",
        "tag_noise",
        "scan_noise",
    ]
    assert not station.HasAnyDirectFeedthrough()


def test_without_noise_the_sensors_agree_with_the_truth_at_their_stamps(noiseless_station):
    simulator = start(noiseless_station)
    X_WS = np.array(WORLD.start)
    positions = {tag.id: np.array(tag.position) for tag in WORLD.tags}
    truth = {}
    seen = set()
    for k in range(1, 321):
        # Scans and tags come at multiples of 0.1 s, between the plant's steps.
        simulator.AdvanceTo(k / 80)
        context = simulator.get_context()
        truth[k / 80] = read(noiseless_station, context, "truth.pose")[:3]
        odometry = read(noiseless_station, context, "base.odometry")
        if odometry.stamp in truth:
            assert pytest.approx(between(X_WS, truth[odometry.stamp]), abs=1e-9) == odometry.X_OB
        frame = read(noiseless_station, context, "tags.detections")
        at = [t for t in truth if abs(t - frame.stamp) < 1e-9]
        for X_WB in (truth[t] for t in at):
            for tag, r, b in zip(frame.ids.tolist(), frame.range, frame.bearing, strict=True):
                point = compose(X_WB, np.array([r * np.cos(b), r * np.sin(b), 0.0]))[:2]
                assert point == pytest.approx(positions[tag], abs=1e-9)
                seen.add(tag)
            message = read(noiseless_station, context, "scan.ranges")
            hits = compose(
                X_WB,
                np.stack([message.ranges * np.cos(message.angles), message.ranges * np.sin(message.angles)], -1)[
                    :, [0, 1, 1]
                ],
            )[:, :2]
            assert np.abs(hits).max(axis=1) == pytest.approx(np.full(len(hits), 3.0), abs=1e-9)
    assert seen == {3, 5}


def test_the_world_may_be_otherwise_than_believed():
    scenario = make_scenario(noise=False)
    tags, scan = scenario.reality.tags, scenario.reality.scan
    tags.clock_offset, tags.yaw, tags.tag_range_error, tags.frame_loss_probability = 0.02, 0.1, 0.05, 0.5
    scan.clock_offset, scan.yaw, scan.dropout_probability = -0.03, -0.1, 0.3
    real, believed = MakeTurtlebotStation(scenario), MakeTurtlebotStation(make_scenario(noise=False))
    shown, stamps = [], set()
    for station in (believed, real):
        simulator = start(station, command=(0.0, 0.0))
        for k in range(1, 20):
            simulator.AdvanceTo(0.1 * k)
            stamps.add(read(station, simulator.get_context(), "tags.detections").stamp)
        shown.append([read(station, simulator.get_context(), name) for name in ("tags.detections", "scan.ranges")])
    (frame, ranges), (other_frame, other_ranges) = shown
    assert other_frame.ids.tolist() == frame.ids.tolist()
    assert other_frame.bearing == pytest.approx(frame.bearing - 0.1)
    errors = other_frame.range - frame.range
    assert (errors != 0.0).all()
    assert np.abs(errors).max() < 0.25
    late = [stamp for stamp in stamps if round(1e3 * stamp) % 100 == 20]
    assert 3 < len(late) < 16
    assert other_ranges.stamp == pytest.approx(ranges.stamp - 0.03)
    assert np.isinf(other_ranges.ranges).mean() == pytest.approx(0.3, abs=0.1)


def test_the_image_of_a_robot_that_turns_fast_is_blurred():
    scenario = make_scenario(noise=False)
    scenario.reality.tags.blurring_turn_rate = 0.4
    station = MakeTurtlebotStation(scenario)
    seen = []
    for turn_rate in (0.0, 0.5):
        simulator = start(station, command=(0.0, turn_rate))
        simulator.AdvanceTo(1.05)
        frame = read(station, simulator.get_context(), "tags.detections")
        assert frame.stamp == pytest.approx(1.0)
        seen.append(len(frame.ids))
    assert seen == [1, 0]


def test_the_seed_decides_the_run(station):
    runs = {}
    for key, seed in (("first", 1), ("again", 1), ("other", 2)):
        simulator = start(station, seed)
        simulator.AdvanceTo(1.0)
        runs[key] = everything(station, simulator.get_context())
    assert runs["first"] == runs["again"]
    assert runs["first"] != runs["other"]


@pytest.mark.parametrize("t", [0.5, 0.7003])
def test_a_cloned_context_continues_bit_for_bit(station, t):
    simulator = start(station, 3)
    simulator.AdvanceTo(t)
    clone = simulator.get_context().Clone()
    simulator.AdvanceTo(2.0)
    resumed = Simulator(station, clone)
    resumed.Initialize(InitializeParams(suppress_initialization_events=True))
    resumed.AdvanceTo(2.0)
    assert everything(station, clone) == everything(station, simulator.get_context())


def test_run_errors_stay_constant(station):
    simulator = start(station, 4)
    port = station.GetSubsystemByName("odometry_run_errors").get_output_port()
    values = set()
    for t in (0.03125, 1.0, 3.0):
        simulator.AdvanceTo(t)
        context = station.GetSubsystemByName("odometry_run_errors").GetMyContextFromRoot(simulator.get_context())
        values.add(tuple(port.Eval(context)))
    assert len(values) == 1


def test_full_speed_ahead_ends_before_the_wall(station):
    simulator = start(station, 5, (0.5, 0.0))
    simulator.AdvanceTo(15.0)
    context = simulator.get_context()
    assert read(station, context, "truth.contacts").tolist() == [0.0]
    assert read(station, context, "truth.pose")[3] == pytest.approx(0.0, abs=0.02)
    assert 0.0 < read(station, context, "truth.clearance")[0] < 0.15


def test_backwards_the_base_stands_where_it_has_neither_seen_nor_been(station):
    """No sensor looks back, and the bumper does not either."""
    simulator = start(station, 6, (-0.5, 0.0))
    simulator.AdvanceTo(12.0)
    context = simulator.get_context()
    assert read(station, context, "truth.contacts").tolist() == [0.0]
    assert read(station, context, "truth.pose")[3] == 0.0


def test_an_unconnected_command_and_an_empty_world():
    empty = MakeTurtlebotStation(Scenario())
    simulator = Simulator(empty)
    simulator.AdvanceTo(0.5)
    context = simulator.get_context()
    assert read(empty, context, "truth.pose").tolist() == [0.0] * 5
    assert read(empty, context, "truth.clearance").tolist() == [np.inf]
    assert read(empty, context, "tags.detections").ids.size == 0
    assert np.isinf(read(empty, context, "scan.ranges").ranges).all()


def among_people(count, **reality):
    scenario = make_scenario()
    scenario.reality.people = count
    for name, value in reality.items():
        setattr(scenario.reality.scan, name, value)
    return MakeTurtlebotStation(scenario)


def test_people_walk_about_and_are_seen():
    station = among_people(4)
    assert [system.get_name() for system in station.GetSystems()][-2:] == ["people", "people_numbers"]
    simulator = start(station, 1, command=(0.0, 0.8))
    places, seen, X_WB = [], 0, np.array(WORLD.start)
    for k in range(1, 81):
        simulator.AdvanceTo(0.1 * k)
        context = simulator.get_context()
        # Taken where the robot was a scan's period ago.
        message = read(station, context, "scan.ranges")
        p_WP = places_at(read(station, context, "truth.people"), message.stamp)
        places.append(p_WP)
        rays = np.stack([np.cos(message.angles), np.sin(message.angles)], axis=1)
        points = transform(X_WB, message.ranges[:, None] * rays)
        off = np.abs(np.hypot(*(points[:, None] - p_WP).transpose(2, 0, 1)) - RADIUS).min(axis=1)
        wall = np.abs(np.abs(points).max(axis=1) - 3.0)
        # They have stepped on meanwhile.
        assert (np.minimum(off, wall) < 0.2).all()
        seen += np.count_nonzero(wall > 0.3)
        X_WB = read(station, context, "truth.pose")[:3]
    assert seen > 100
    assert (np.ptp(places, axis=0) > 0.5).any()
    assert np.abs(places).max() <= 3.0 - RADIUS


def test_people_leave_all_other_numbers_as_they_are():
    readings = []
    for count in (0, 3):
        # What only some scenarios have comes behind what every one has, and people last.
        station = among_people(count, dropout_probability=0.1)
        simulator = start(station, 2, command=(0.0, 0.3))
        simulator.AdvanceTo(0.05)
        readings.append([*everything_but_contacts(station, simulator.get_context())])
    assert readings[0] == readings[1]


def everything_but_contacts(station, context):
    for name in ("base.odometry", "tags.detections", "scan.ranges"):
        for part in vars(read(station, context, name)).values():
            yield np.ravel(part).tolist()


def test_the_seed_decides_the_walk():
    walks = []
    for seed in (1, 1, 2):
        station = among_people(2)
        simulator = start(station, seed)
        simulator.AdvanceTo(6.0)
        walks.append(read(station, simulator.get_context(), "truth.people").p_WP.tolist())
    assert walks[0] == walks[1]
    assert walks[0] != walks[2]


def test_the_world_changes_for_sensors_and_wheels_and_waits_until_the_robot_is_clear():
    scenario = make_scenario(noise=False)
    tag, other = scenario.world.tags[:2]
    moved = TagConfig(id=tag.id, position=[tag.position[0], tag.position[1] + 0.5], facing=tag.facing)
    scenario.reality.changes = [
        ChangeConfig(time=0.25, walls=[[2.0, -2.0, 2.0, 2.0]], tags=[moved], fallen=[other.id]),
        ChangeConfig(time=0.5, walls=[[0.3, -0.5, 0.3, 0.5]]),
    ]
    station = MakeTurtlebotStation(scenario)
    simulator = start(station, command=(0.0, 0.0))
    for time, wall, shown, count in ((0.2, 3.0, [5], 0), (0.45, 2.0, [], 1), (2.0, 2.0, [], 1)):
        simulator.AdvanceTo(time)
        context = simulator.get_context()
        scan, now = read(station, context, "scan.ranges"), read(station, context, "truth.world")
        assert scan.ranges[len(scan.ranges) // 2] == pytest.approx((wall - 0.5) / np.cos(0.3))
        assert read(station, context, "tags.detections").ids.tolist() == shown
        assert now.count == count
    assert now.world.tag_ids.tolist() == [tag.id]
    assert now.world.p_WT.tolist() == [moved.position]
    # The wheels feel the wall that is there.
    simulator = start(station, command=(0.5, 0.0))
    simulator.AdvanceTo(8.0)
    assert read(station, simulator.get_context(), "truth.pose")[0] < 2.0
