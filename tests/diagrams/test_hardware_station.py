"""The station of a real robot, without one: its ports, what it passes on and when it stands."""

import functools
import logging
import time

import numpy as np
import pytest
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.analysis import Simulator

import tfg_drake
from tests.diagrams.rooms import room
from tests.hardware.fake_robot import FakeDevice, base_state
from tfg_drake.diagrams.hardware_station import MakeHardwareStation
from tfg_drake.diagrams.missions.real_robot import DevicesOf
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld, Scenario
from tfg_drake.diagrams.station import MakeTurtlebotStation
from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.emulation.emulator import Emulator
from tfg_drake.hardware.robot_devices import RobotDevices
from tfg_drake.hardware.watchdog import Limits
from tfg_drake.messages import Hazards, LaserScan, Odometry, TagDetections, replace
from tfg_drake.mission.sequence import NOT_ENABLED
from tfg_drake.safety.velocity_filter import PRESSED


def port_names(diagram):
    """Names and types of the ports, inputs and outputs."""
    inputs = [diagram.get_input_port(i) for i in range(diagram.num_input_ports())]
    outputs = [diagram.get_output_port(i) for i in range(diagram.num_output_ports())]
    return [[(port.get_name(), port.get_data_type(), port.size()) for port in ports] for ports in (inputs, outputs)]


class Station:
    """A hardware station of a fake device that runs as fast as it can."""

    def __init__(self, velocity=(0.2, 0.5), enable=1.0, *, tags=True):
        """tags: there is a source of them."""
        self.device = FakeDevice()
        devices = RobotDevices(self.device, self.device if tags else None, self.device, Limits(), [self.device])
        self.diagram = MakeHardwareStation(Scenario(), devices)
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()
        self.diagram.GetInputPort("base.velocity_commanded").FixValue(self.context, list(velocity))
        self.enable(enable)
        self.simulator.Initialize()

    def enable(self, value):
        if value is not None:
            self.diagram.GetInputPort("base.enable").FixValue(self.context, [value])

    def run(self, until):
        self.simulator.AdvanceTo(until)
        return self

    def read(self, name):
        return self.diagram.GetOutputPort(name).Eval(self.context)

    @property
    def enabled(self):
        return bool(self.read("base.enabled")[0])

    def sent(self, since=0.0):
        return [command[1:] for command in self.device.commands if command[0] >= since]


def still(sent):
    return bool(sent) and all(velocity == (0.0, 0.0) for velocity in sent)


def test_the_ports_are_the_simulated_ones_but_for_the_truth():
    simulated, real = port_names(MakeTurtlebotStation(Scenario())), port_names(Station().diagram)
    assert [port for port in simulated[0] if not port[0].startswith("truth.")] == real[0]
    truth = [port for port in simulated[1] if port[0].startswith("truth.")]
    assert len(truth) == 4
    assert [port for port in simulated[1] if port not in truth] == real[1]


def test_hardware_is_one_word_away():
    """The robot that the scenario names, here an emulated one, and nothing else in the scenario changes."""
    with Emulator(MakeWorld(LoadScenario("house").world)) as emulator:
        scenario = Scenario()
        scenario.hardware.port = emulator.device
        scenario.hardware.tags = scenario.hardware.scan = "socket:{}:{}".format(*emulator.sensors)
        station = MakeTurtlebotStation(scenario, hardware=True)
        assert port_names(station) == port_names(Station().diagram)
        simulator = Simulator(station)
        simulator.set_target_realtime_rate(1.0)
        simulator.AdvanceTo(1.0)
        context = simulator.get_context()
        assert len(station.GetOutputPort("tags.detections").Eval(context).ids) > 3
        assert station.GetOutputPort("scan.ranges").Eval(context).stamp == pytest.approx(0.9, abs=0.2)
        assert not station.GetOutputPort("base.enabled").Eval(context)[0]
        station.GetSubsystemByName("base").devices.close()


@pytest.mark.parametrize("enable", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_real_robot_explores_from_python(enable, tmp_path, caplog):
    """An emulated one: in real time, within its limits, moving only where that was asked for, closed at the end."""
    scenario = room()
    with Emulator(MakeWorld(scenario.world)) as emulator:
        scenario.explorer.first_look = 0.0
        scenario.robot.max_speed = 4.0
        scenario.hardware.port = emulator.device
        scenario.hardware.tags = scenario.hardware.scan = "socket:{}:{}".format(*emulator.sensors)
        started, station = time.monotonic(), functools.partial(MakeTurtlebotStation, hardware=True)
        run = tfg_drake.explore(scenario, station=station, enable=enable, until=3.0, out=tmp_path / "run")
        assert time.monotonic() - started > 3.0
    assert run.scenario.robot.max_speed < 1.0
    assert run.outcome == "time_limit"
    turned = np.ptp(run.X_WB[1][:, 2])
    if enable:
        assert turned > 0.5
    else:
        assert turned < 0.05
        assert (run.status.phase, run.status.reason) == ("paused", NOT_ENABLED)
        assert "nothing moves before it is enabled: by enable=True" in caplog.text
    assert DevicesOf(run.station).base.locked


def test_the_station_alone_in_meshcat():
    meshcat = Meshcat(MeshcatParams(host="localhost"))
    station = MakeTurtlebotStation(LoadScenario("house"), meshcat)
    Simulator(station).AdvanceTo(0.5)
    assert meshcat.HasPath("/tfg/world/walls")
    assert meshcat.HasPath("/tfg/truth")


@pytest.mark.parametrize("enable", [None, 0.0])
def test_nothing_moves_before_it_is_enabled(enable):
    station = Station(enable=enable).run(2.0)
    assert not station.enabled
    assert station.device.enabled == 0
    assert still(station.sent())


def test_an_enabled_base_moves_within_the_limits():
    station = Station().run(2.0)
    assert station.enabled
    assert station.device.enabled == 1
    assert station.sent()[-1] == (0.2, 0.5)
    steps = np.diff([command[1] for command in station.device.commands])
    assert steps.max() <= 0.5 / 32.0 + 1e-12


def test_messages_appear_at_their_time_in_the_station_s_time():
    station = Station().run(1.99)
    assert station.read("base.odometry").stamp == pytest.approx(1.92)  # the last event was at 1.9375
    assert station.read("base.odometry").X_OB[0] == pytest.approx(0.96)
    assert station.read("tags.detections").stamp == pytest.approx(1.9)
    assert station.read("tags.detections").ids.tolist() == [19]
    assert station.read("scan.ranges").stamp == pytest.approx(1.9)
    assert station.read("base.hazards").stamp == pytest.approx(1.96)


def test_at_rest_holds_for_all_the_time_since_the_message_before():
    station = Station(enable=0.0)
    station.device.moving_at = (30,)  # at 0.6 s, taken with the one after it at 0.625
    assert station.run(0.60).read("base.odometry").at_rest
    moved = station.run(0.63).read("base.odometry")
    assert moved.stamp == pytest.approx(0.62)
    assert not moved.at_rest
    assert station.run(0.70).read("base.odometry").at_rest


def test_the_first_odometry_is_where_the_base_stands():
    station = Station()
    assert station.read("base.odometry").stamp == 0.0
    assert station.read("base.odometry").X_OB[0] == pytest.approx(0.07)


def test_scans_that_stand_while_the_odometry_drives_are_noted_once(caplog):
    """The fake robot's odometry drives by 0.5 m/s whatever it is told; its scans here are of a room that stands."""
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    ranges = 3.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    ranges[(angles > 1.0) & (angles < 1.3)] = 1.5
    with caplog.at_level(logging.WARNING, "tfg_drake"):
        station = Station()
        message = station.device.message

        def of_a_room(kind, number):
            said = message(kind, number)
            return replace(said, ranges=ranges, range_max=10.0) if kind is LaserScan else said

        station.device.message = of_a_room
        station.run(16.0)
    notes = [record.note for record in caplog.records if hasattr(record, "note")]
    assert [note.kind for note in notes] == ["contradiction"]
    assert 6.0 < notes[0].time_s < 12.0
    assert "see whether the wheels slip, the scanner is frozen" in notes[0].text


def test_a_stop_by_the_operator_locks_the_device():
    station = Station().run(1.0)
    station.enable(0.0)
    station.run(2.0)
    assert station.device.locked == "stopped by the operator"
    assert not station.enabled
    assert still(station.sent(since=1.05))
    station.enable(2.0)
    station.run(3.0)
    assert station.enabled
    assert station.device.enabled == 2


def test_a_device_that_locked_itself_is_not_enabled_by_the_same_number(caplog):
    station = Station().run(1.0)
    station.device.locked = "the clock of /odom has jumped"
    with caplog.at_level(logging.WARNING, "tfg_drake.hardware"):
        station.run(2.0)
    assert not station.enabled
    assert still(station.sent(since=1.05))
    assert "the base stands until it is enabled anew: the clock of /odom has jumped" in caplog.text
    station.enable(2.0)
    assert station.run(3.0).enabled


def test_a_device_that_refuses_is_asked_once(caplog):
    station = Station(enable=0.0).run(0.5)
    station.device.refuses = "no odometry for more than 0.5 s"
    station.enable(1.0)
    with caplog.at_level(logging.WARNING, "tfg_drake.hardware"):
        station.run(1.5)
    assert not station.enabled
    assert caplog.text.count("the robot is not enabled: no odometry for more than 0.5 s") == 1


@pytest.mark.parametrize(
    ("kind", "name", "patience"), [(LaserScan, "scan", 0.4), (TagDetections, "tags", 1.0), (Odometry, "odometry", 0.5)]
)
def test_it_stands_while_a_sensor_is_silent(kind, name, patience, caplog):
    station = Station(velocity=(0.0, 0.5)).run(2.0)
    station.device.silent.add(kind)
    with caplog.at_level(logging.INFO, "tfg_drake.hardware"):
        station.run(4.0)
        assert not station.enabled
        assert still(station.sent(since=2.1 + patience))
        station.device.silent.clear()
        station.run(6.0)
    assert station.enabled
    assert station.sent()[-1] == (0.0, 0.5)
    assert f"the base stands: no {name} for more than {patience:g} s" in caplog.text
    assert f"{name} again" in caplog.text


def test_without_a_source_of_tags_none_is_waited_for():
    station = Station(velocity=(0.0, 0.5), tags=False)
    assert port_names(station.diagram) == port_names(Station().diagram)
    station.run(70.0)
    assert station.enabled
    assert station.sent(since=69.0)[-1] == (0.0, 0.5)
    assert not len(station.read("tags.detections").ids)


def test_a_sensor_that_stays_silent_ends_the_run():
    station = Station().run(1.0)
    station.device.silent.add(LaserScan)
    with pytest.raises(DeviceError, match=r"^no scan for 60 s: its source is silent$"):
        station.run(70.0)


def test_a_dead_device_ends_the_run():
    station = Station().run(1.0)
    station.device.dead = True
    with pytest.raises(DeviceError, match="the robot's process has ended"):
        station.run(2.0)


def test_the_bumper_reaches_the_filter():
    station = Station(velocity=(0.2, 0.0)).run(1.0)
    station.device.bumper = 2
    station.run(1.5)
    assert station.read("base.hazards").bumper == 2
    assert station.sent()[-1][0] < 0.0


def test_the_operator_is_told_once_what_happens_to_the_base(caplog):
    station = Station().run(1.0)
    station.device.bumper = 4
    with caplog.at_level(logging.WARNING, "tfg_drake.hardware"):
        station.run(2.0)
        station.device.state = base_state(2.0, battery_level="low")
        station.run(3.0)
        station.device.remarks = ["tags of 127.0.0.1:5000: started again"]
        station.run(10.0)
    lines = [record.getMessage().partition(" s: ") for record in caplog.records]
    assert [line for _, _, line in lines] == [
        "bumper left: the robot backs away and looks for another way",
        "tags of 127.0.0.1:5000: started again",
        f"the base stands: {PRESSED}",
        "the battery is low, 13.8 V: the mission ends, at home if explorer.return_home is set",
    ]
    assert [float(time) for time, _, _ in lines] == pytest.approx([1.0, 3.0, 4.0, 7.0], abs=0.2)


def test_the_simulated_base_obeys_enable_too():
    station = MakeTurtlebotStation(Scenario())
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.GetInputPort("base.velocity_commanded").FixValue(context, [0.2, 0.0])
    enabled, truth = station.GetOutputPort("base.enabled"), station.GetOutputPort("truth.pose")
    assert enabled.Eval(context)[0] == 1.0
    simulator.AdvanceTo(1.0)
    assert truth.Eval(context)[3] == pytest.approx(0.2)
    station.GetInputPort("base.enable").FixValue(context, [0.0])
    simulator.AdvanceTo(2.0)
    assert enabled.Eval(context)[0] == 0.0
    assert truth.Eval(context)[3] == pytest.approx(0.0, abs=1e-6)
    station.GetInputPort("base.enable").FixValue(context, [2.0])
    simulator.AdvanceTo(3.0)
    assert enabled.Eval(context)[0] == 1.0
    assert truth.Eval(context)[3] == pytest.approx(0.2)
    assert isinstance(station.GetOutputPort("base.hazards").Eval(context), Hazards)
