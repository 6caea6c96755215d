"""The parameters of every component, in SI units and radians, with the defaults of the `paper` scenario.

Plain mutable dataclasses of plain types, so that a scenario file can be read straight into them; the annotations say
which values are possible (constraints.py).
"""

import dataclasses
import math
from typing import Annotated, Any, ClassVar, TypeVar

from tfg_drake.constraints import (
    Angle,
    AtLeastOne,
    Bounds,
    KnownPose,
    NotNegative,
    OneOf,
    Point,
    Positive,
    Radians,
    Segment,
    Share,
    Signed,
    Whole,
)
from tfg_drake.typed_tree import document_fields

S = TypeVar("S")

# Clearance of a roadmap node beyond the robot's radius, m.
NODE_MARGIN = 0.05
# The formulas of the information gain, by name: the exact one, its limit for a wide prior of new landmarks, and those
# of the paper and of its authors' program.
GAINS = ("exact", "limit", "paper", "authors")
# The rules by which the next goal is picked, by name: most gain per expected time, most gain (the paper's), the first
# of a short tour, the frontier reached soonest, any place within reach.
GOAL_RULES = ("gain_per_time", "argmax", "tour", "nearest_frontier", "random")
# Solvers of the keyframe graph: nested dissection, or GTSAM.
SOLVERS = ("dissection", "gtsam")
# Landmarks of the map.
LANDMARKS = ("both", "tags", "walls")
# Real robots by the protocol of their base.
ROBOTS = ("kobuki", "ros2", "rosbridge")
# Sensors of a simulated robot: ideal ones, or a camera whose images are rendered.
EYES = ("ideal", "camera")
# The bound on the collision probability holds for each point of a path, or for the whole path.
RISKS = ("point", "path")
# Greatest plausible speed, m/s, and turn rate, rad/s; a greater one was probably meant in degrees.
FASTEST, FASTEST_TURN = 5.0, 15.0


@dataclasses.dataclass
class RobotConfig:
    """The differential-drive base."""

    # Radius of the round base, m.
    radius: Positive = 0.18
    # Speed limit, m/s.
    max_speed: Annotated[float, Bounds(0.0, FASTEST)] = 0.5
    # Turn-rate limit, rad/s.
    max_turn_rate: Annotated[float, Bounds(0.0, FASTEST_TURN)] = 1.5
    # Acceleration limit, m/s^2.
    max_acceleration: Positive = 0.5
    # Turn acceleration limit, rad/s^2.
    max_turn_acceleration: Positive = 3.5


@dataclasses.dataclass
class OdometryConfig:
    """Wheel encoders and gyro: their data sheet, which the estimator assumes."""

    # Random walk of the distance travelled, m per root metre.
    distance_noise: float = 0.02
    # Standard deviation of the constant relative scale error of distance, drawn once a run.
    distance_scale: float = 0.015
    # Random walk of the heading, rad per root second.
    gyro_noise: float = 0.005
    # Standard deviation of the constant gyro bias, rad/s, drawn once a run.
    gyro_bias: float = 0.001
    # Standard deviation of the constant relative scale error of the gyro, drawn once a run.
    gyro_scale: float = 0.01
    # Random walk of the position independent of the motion, m per root second, as wheels slip a little in turns in
    # place; it also keeps covariances regular.
    position_noise: float = 5e-4


@dataclasses.dataclass
class TagSensorConfig:
    """An ideal feature sensor: range and bearing of coded landmarks. Range, field of view and rate are the paper's."""

    # Greatest range, m.
    range: Positive = 10.0
    # Horizontal field of view, rad (124 degrees).
    field_of_view: Annotated[float, Bounds(0.0, 2.0 * math.pi)] = 2.164208272472129
    # Greatest angle between the line of sight and the tag's normal, rad (75 degrees).
    max_incidence: Annotated[float, Bounds(0.0, 0.5 * math.pi)] = 1.3089969389957472
    # Frames per second, Hz.
    rate: Annotated[float, Bounds(0.0, 1000.0)] = 10.0
    # Range noise: sigma_r = range_noise + range_noise_per_metre * r, m.
    range_noise: Positive = 0.02
    range_noise_per_metre: float = 0.01
    # Bearing noise, rad.
    bearing_noise: Annotated[float, Bounds(0.0, 1.0)] = 0.01
    # Probability that a visible tag is detected in a frame.
    detection_probability: Annotated[float, Bounds(0.0, 1.0)] = 1.0
    # Probability that a detection is a gross error in range and bearing, or has another tag's id. The estimator does
    # not know it.
    outlier_probability: Share = 0.0
    wrong_id_probability: Share = 0.0
    # Ratio of measured to true range, 1 for no error. The estimator does not know it.
    range_scale: Positive = 1.0
    # Standard deviations of the camera's yaw, rad, and of its clock against the base's, s. Both are learnt with the
    # map; 0: exactly known.
    yaw_deviation: Annotated[float, NotNegative(), Radians()] = 0.0175
    clock_deviation: float = 0.05
    # The same of its place, ahead and to the side, m, and of the relative error of its ranges.
    mount_deviation: float = 0.005
    range_scale_deviation: Share = 0.01


@dataclasses.dataclass
class ScanConfig:
    """The planar laser scanner."""

    # Greatest and least range, m; a depth camera's least range is some 0.45 m.
    range: Positive = 10.0
    least_range: float = 0.0
    # Field of view, rad (124 degrees).
    field_of_view: Annotated[float, Bounds(0.0, 2.0 * math.pi)] = 2.164208272472129
    # Angle between rays, rad (0.5 degrees).
    resolution: Annotated[float, Bounds(1e-4, math.pi)] = 0.008726646259971648
    # Scans per second, Hz.
    rate: Annotated[float, Bounds(1.0, 1000.0)] = 10.0
    # Range noise, m.
    noise: float = 0.015
    # Standard deviations of its yaw, rad, of its place, ahead and to the side, m, of its clock against the base's, s,
    # and of the delay of its rays per angle, s/rad. All are learnt with the map.
    yaw_deviation: Annotated[float, NotNegative(), Radians()] = 0.01
    mount_deviation: float = 0.005
    clock_deviation: float = 0.02
    sweep_deviation: float = 0.02
    # Number of looks that a new wall needs; of a recording with few scans per metre one has to suffice.
    least_looks: int = 3


@dataclasses.dataclass
class StationConfig:
    """The parts of the simulated station."""

    # Its sensors, one of EYES. `camera` also sets the sections tags and scan to such a camera's data sheet; later
    # settings override it.
    eyes: Annotated[str, OneOf(EYES)] = "ideal"


@dataclasses.dataclass
class CameraConfig:
    """The camera that sees colour and depth, where `station.eyes` is one, and the building that it looks at.

    Its field of view, range and rate are in the sections tags (colour) and scan (depth).
    """

    # Pixels.
    width: Annotated[int, Whole(), Bounds(64.0, 4096.0)] = 640
    height: Annotated[int, Whole(), Bounds(64.0, 4096.0)] = 480
    # Height of the lens above the floor, m.
    mount_height: Positive = 0.3
    # Side of the tags' black squares, height of their centres above the floor, and height of the walls, m.
    tag_size: Positive = 0.16
    tag_height: Positive = 0.3
    wall_height: Positive = 2.5


@dataclasses.dataclass
class SafetyConfig:
    """The filter between any controller and the base."""

    # Greatest age of the scan, s, beyond which the base does not drive ahead.
    scan_timeout: Positive = 0.6
    # Least distance of scan points from the robot's outline in its direction of travel, m.
    stop_distance: float = 0.04
    # Duration, s, and speed, m/s, of backing away after a bumper hit.
    reflex_time: float = 1.0
    reflex_speed: float = 0.1
    # Turn rate of the reflex when only one side was hit, rad/s.
    reflex_turn_rate: float = 0.4
    # Width of the corridor that must be free ahead, beyond the base on either side, m.
    side_margin: float = 0.03


@dataclasses.dataclass
class RobotCameraConfig:
    """The camera of `--tags camera:`, its mount, and the tags that it detects."""

    # The calibration's file, OpenCV's YAML or ROS's camera_info.
    calibration: str = ""
    # Side of the tags' black square, m, and their family.
    tag_size: Annotated[float, Bounds(0.0, 10.0)] = 0.16
    family: str = "tag36h11"
    # Where it sits in the body frame, m and rad; pitch is downward, roll clockwise as it looks.
    x: Signed = 0.0
    y: Signed = 0.0
    yaw: Angle = 0.0
    pitch: Angle = 0.0
    roll: Angle = 0.0
    # Age of an image on arrival, s, if neither camera nor stream stamps it.
    latency: float = 0.0
    # Factor by which an image is reduced before detection; 1 detects smaller tags than 2 and takes four times as long.
    decimation: Annotated[float, Bounds(1.0, 100.0)] = 2.0
    # Threads of the detector.
    threads: Annotated[int, Whole(), Bounds(1.0, 100.0)] = 1


@dataclasses.dataclass
class RobotScannerConfig:
    """The scanner of `--scan rplidar:` or the depth camera of `--scan realsense:`."""

    # Where it sits in the body frame, m and rad: x ahead, z above the floor; pitch is downward.
    x: Signed = 0.0
    y: Signed = 0.0
    z: float = 0.3
    yaw: Angle = 0.0
    pitch: Angle = 0.0
    # Whether it is mounted upside down: what it has on its left is on the robot's right.
    flip: bool = False
    # Whether it counts its rays clockwise as seen from above it.
    clockwise: bool = False
    # Field of view, rad, if its messages do not state it; 0: as they state.
    field_of_view: float = 0.0
    # Lead of its clock over the odometry's, s.
    clock_offset: float = 0.0
    # Band of heights above the floor, m, from which a depth camera's scan is made.
    low: float = 0.05
    high: Positive = 0.5


@dataclasses.dataclass
class HardwareConfig:
    """The real robot, where the station is one."""

    # The protocol of the base, one of ROBOTS.
    robot: Annotated[str, OneOf(ROBOTS)] = "kobuki"
    # Speed limit of a real robot, m/s, if no other is lower.
    max_speed: Annotated[float, Bounds(0.0, FASTEST)] = 0.3
    # kobuki: the serial port.
    port: str = "/dev/kobuki"
    # A shipped preset or a YAML file with the robot's topics and mounts; empty: turtlebot2 for a kobuki, otherwise
    # turtlebot4.
    preset: str = ""
    # rosbridge: HOST:PORT of the server.
    bridge: str = "localhost:9090"
    # Sources of tags and scans: ros2:/TOPIC, rosbridge:HOST:PORT/TOPIC, socket:HOST:PORT, or empty for the topics of
    # the preset; a kobuki has none of its own. Tags also from camera:SOURCE, or several of them separated by commas, or
    # none; scans from rplidar:DEVICE or realsense:[SERIAL].
    tags: str = ""
    scan: str = ""
    # Calibration and mount of sensors that are not on ROS; those on ROS are in the preset.
    camera: RobotCameraConfig = dataclasses.field(default_factory=RobotCameraConfig)
    # The same for the second and further cameras, if tags come from several: camera:SOURCE,camera:SOURCE.
    more_cameras: list[RobotCameraConfig] = dataclasses.field(default_factory=list)
    scanner: RobotScannerConfig = dataclasses.field(default_factory=RobotScannerConfig)


@dataclasses.dataclass
class DisturbanceConfig:
    """The base is moved unnoticed by its wheels: they slip, or somebody pushes it."""

    # Start and duration, s.
    time: float = 0.0
    duration: Positive = 1.0
    # Total displacement of the base, ahead and to its left, m, and turn, rad.
    ahead: Signed = 0.0
    left: Signed = 0.0
    turn: Angle = 0.0
    # Whether the gyro feels that turn.
    gyro_feels: bool = True


@dataclasses.dataclass
class TagConfig:
    """One tag on a wall."""

    # How one is written.
    example: ClassVar[str] = "a tag as {id: 7, position: [x, y], facing: 0.0}, m and rad"

    # The tag's code, unique in the world.
    id: int
    # Centre (x, y) in W, on the wall's surface, m.
    position: Point
    # Heading of the outward normal, rad.
    facing: Angle


@dataclasses.dataclass
class ChangeConfig:
    """Somebody shuts or opens a door, moves a chair or a tag."""

    # Time, s; a change right beside the robot waits until the robot has gone, as do all later changes.
    time: float = 0.0
    # Surfaces that appear and surfaces that disappear, [x0, y0, x1, y1] in W, m; the latter may be pieces of walls.
    walls: list[Segment] = dataclasses.field(default_factory=list)
    opened: list[Segment] = dataclasses.field(default_factory=list)
    # Tags that are moved, at their new places, and ids of tags that fall off.
    tags: list[TagConfig] = dataclasses.field(default_factory=list)
    fallen: list[int] = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class TagRealityConfig:
    """The simulated tag sensor where it differs from its data sheet, TagSensorConfig; None: as that says."""

    range: Positive | None = None
    max_incidence: Annotated[float, Bounds(0.0, 0.5 * math.pi)] | None = None
    range_noise: float | None = None
    range_noise_per_metre: float | None = None
    bearing_noise: float | None = None
    detection_probability: Annotated[float, Bounds(0.0, 1.0)] | None = None
    outlier_probability: Share | None = None
    wrong_id_probability: Share | None = None
    range_scale: Positive | None = None
    # Range, m, at which half of the tags seen head-on are detected; at 1.5 times it none, at half of it all. The range
    # of a tag seen obliquely counts divided by the cosine of the incidence. 0: as in the data sheet.
    detection_range: float = 0.0
    # Correlation time of a tag's range and bearing noise, s, after which the correlation has fallen to 1/e; 0: white.
    correlation_time: float = 0.0
    # Standard deviations of each tag's constant error in range, m, and bearing, rad, from print, measurement or
    # mounting.
    tag_range_error: float = 0.0
    tag_bearing_error: float = 0.0
    # The camera's clock minus the base's, s, by which the stamp of a frame is too late.
    clock_offset: Signed = 0.0
    # Standard deviation of a stamp's own error, s, and probability that a frame is lost.
    clock_jitter: float = 0.0
    frame_loss_probability: Share = 0.0
    # The camera's true yaw in the body frame, rad, and place, ahead and to the left of the body's origin, m; all are
    # assumed to be zero.
    yaw: Angle = 0.0
    ahead: Signed = 0.0
    left: Signed = 0.0
    # Turn rate above which blur prevents any detection, rad/s; 0: none.
    blurring_turn_rate: float = 0.0


@dataclasses.dataclass
class OdometryRealityConfig:
    """Wheels and gyro of the simulated base where they differ from OdometryConfig; None: as that says."""

    distance_noise: float | None = None
    distance_scale: float | None = None
    gyro_noise: float | None = None
    gyro_bias: float | None = None
    gyro_scale: float | None = None
    # Resolution of the encoders, ticks per metre; 0: infinite.
    ticks_per_metre: float = 0.0
    # Slip of the wheels in turns: the share by which they roll farther than the base moves, per turn rate, s.
    slip_per_turn_rate: float = 0.0


@dataclasses.dataclass
class ScanRealityConfig:
    """The simulated scanner where it differs from its data sheet, ScanConfig; None: as that says."""

    noise: float | None = None
    # Angle between two rays at which the correlation of their errors has fallen to 1/e, rad; 0: white.
    correlation_angle: float = 0.0
    # Probability that a ray has no return (glass, black walls), and that a ray past an edge has a range between the
    # surfaces in front and behind.
    dropout_probability: Share = 0.0
    mixed_probability: Share = 0.0
    # The scanner's true yaw in the body frame, rad, and place, ahead and to the left of the body's origin, m; all are
    # assumed to be zero.
    yaw: Angle = 0.0
    ahead: Signed = 0.0
    left: Signed = 0.0
    # Whether it is mounted upside down, which is not assumed.
    flip: bool = False
    # Time from the first ray to the last, s, during which the robot moves; the stamp is that of the first. 0: all at
    # once.
    sweep_time: float = 0.0
    # The scanner's clock minus the base's, s.
    clock_offset: Signed = 0.0


@dataclasses.dataclass
class CameraRealityConfig:
    """The faults of a rendered camera."""

    # Exposure time of a frame, s, during which the robot's turn blurs the image.
    exposure_time: float = 0.0
    # Factor on the grey levels of a good exposure: below 1 too dark, above 1 glare.
    brightness: Positive = 1.0
    # Standard deviation of a pixel's white noise, grey levels.
    noise: float = 2.0
    # Standard deviation of depth at 1 m, m; it grows with the square of the depth. Stereo with a baseline of 5.5 cm and
    # 500 pixels of focal length that matches to 0.08 pixels (docs/compare.md) has 0.08 / (500 * 0.055).
    depth_noise: float = 0.003


@dataclasses.dataclass
class RealityConfig:
    """Deviations of the simulated world from the sections `tags`, `odometry` and `scan`, which the explorer assumes. It
    does not know them."""

    tags: TagRealityConfig = dataclasses.field(default_factory=TagRealityConfig)
    odometry: OdometryRealityConfig = dataclasses.field(default_factory=OdometryRealityConfig)
    scan: ScanRealityConfig = dataclasses.field(default_factory=ScanRealityConfig)
    camera: CameraRealityConfig = dataclasses.field(default_factory=CameraRealityConfig)
    # Number of people who walk about in the building.
    people: int = 0
    # Simulated computing time, s, of a choice of a goal and of a path, after which they are output.
    planning_time: float = 0.0
    # Changes of the building during the mission, in their order.
    changes: list[ChangeConfig] = dataclasses.field(default_factory=list)


def as_it_is(belief: S, reality: Any) -> S:
    """A sensor's data sheet with what a section of RealityConfig says instead."""
    names = {field.name for field in dataclasses.fields(belief)}  # type: ignore[arg-type]
    given = {name: value for name, value in vars(reality).items() if name in names and value is not None}
    return dataclasses.replace(belief, **given)  # type: ignore[type-var]


@dataclasses.dataclass
class PartsConfig:
    """Your own parts: the dotted name of a function or class that takes the scenario and returns the part, such as
    my_module.MyEstimator; "" for the default."""

    estimator: str = ""
    goal_selector: str = ""
    planner: str = ""
    follower: str = ""


@dataclasses.dataclass
class ExplorerConfig:
    """The method's own parameters. None is read from the world."""

    # The rule that chooses the next goal, one of GOAL_RULES.
    goal: Annotated[str, OneOf(GOAL_RULES)] = "tour"
    # Limits of the mission's time, s, and way, m, 0: none; and whether the robot returns to its start at the end.
    budget_time: float = 0.0
    budget_distance: float = 0.0
    return_home: bool = False
    # Whether the robot, after exploration, looks again where the landmarks' error falls by a larger share than the
    # mission's duration grows (tour only).
    revisit: bool = True
    # Prior number of landmarks per metre of unexplored surface, until the building has shown its own.
    density: Positive = 1.0
    # Standard deviation of an unknown landmark's position, each axis, m.
    prior_sigma: Positive = 10.0
    # Roadmap nodes whose information gain is evaluated each stage.
    samples: AtLeastOne = 400
    # The mission is complete when no candidate sees enough frontier or promises more than this, nats.
    stop_gain: float = 20.0
    # Number of attempts at a frontier point before it is given up.
    frontier_attempts: AtLeastOne = 3
    # Turn rate while observing at a goal, rad/s.
    turn_rate: Annotated[float, Bounds(0.0, FASTEST_TURN)] = 1.2
    # Time for which the robot stands and observes before it moves, s, and number of turns that follow, half of them
    # back. The map's heading is that of the start pose, which only frames taken there determine, as the gyro drifts
    # with every turn; the turns determine its place among the landmarks.
    first_look: float = 5.0
    first_turns: AtLeastOne = 1
    # Areas that the robot must not enter, each a polygon of corners [x, y] in W, m; W is the frame of the start pose in
    # an unknown building.
    keep_out: list[list[Point]] = dataclasses.field(default_factory=list)

    # Ablations, by which parts and alternatives are evaluated. Missions are best with the defaults.

    # The formula of the information gain, one of GAINS.
    gain: Annotated[str, OneOf(GAINS)] = "exact"
    # Whether the gain is reduced by a price for an uncertain arrival pose (of a tour, once no frontier is left), and
    # number of known tags that a goal should have in view.
    pose_price: bool = True
    least_tags: int = 0
    # Period at which the robot maps what is ahead on its way to a goal, and chooses again, s; 0: only at goals.
    glance_period: float = 2.0
    # The way between views is mapped in pieces of this length, s; 0: path sightings localise only, as in the paper.
    path_keyframe_period: float = 5.0
    # The solver of the keyframe graph, one of SOLVERS. GTSAM is slower and does not estimate constant errors of tags.
    solver: Annotated[str, OneOf(SOLVERS)] = "dissection"
    # The landmarks, one of LANDMARKS: tags, walls seen by the scanner, or both.
    landmarks: Annotated[str, OneOf(LANDMARKS)] = "both"
    # The map file, or the folder of a run, with which the mission begins; "": none.
    known_map: str = ""
    # Prior of the start pose in W: x, y (m), yaw (rad), and the deviations of the position (m) and of the yaw (rad),
    # against which observations prevail. Empty: anywhere in that map.
    known_at: KnownPose = dataclasses.field(default_factory=list)
    parts: PartsConfig = dataclasses.field(default_factory=PartsConfig)


@dataclasses.dataclass
class PlannerConfig:
    """The roadmap's chance constraint (the paper's Sec. III-E)."""

    # Largest probability of a collision.
    collision_probability: Annotated[float, Bounds(0.0, 0.5)] = 0.01
    # What this bounds, one of RISKS: the collision probability of each point of a path, or of the whole path.
    risk: Annotated[str, OneOf(RISKS)] = "point"


@dataclasses.dataclass
class GridConfig:
    """The grid baseline: GMapping and the choice of frontiers on its map."""

    # Side of a cell, m.
    resolution: Annotated[float, Bounds(0.01)] = 0.05
    # Number of particles of the filter, each with its own map.
    particles: AtLeastOne = 100
    # Time (s), way (m) or turn (rad), whichever comes first, after which a scan is added to the map.
    update_period: Positive = 3.0
    update_distance: Positive = 1.0
    update_angle: Annotated[float, Bounds(0.0, 2.0 * math.pi)] = 0.5
    # Weights of the paper's eq. 1: per nat of the grid's entropy, of which a square metre of unknown cells has
    # log(2) / resolution^2, and per nat of the pose's.
    weight_map: float = 0.01
    weight_pose: float = 1.0

    # Ablations, by which parts and alternatives are evaluated. Missions are best with the defaults.

    # Whether the weighted sum is divided by the expected time. If not, the largest sum is the goal at any distance, as
    # in the printed eq. 1.
    per_time: bool = True
    # Whether a goal whose frontier was seen on the way is abandoned at once. If not, the robot drives there and looks
    # around, as Yamauchi's did.
    eager: bool = True


document_fields(globals())
