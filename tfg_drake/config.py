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
    """Wheel encoders and gyro, and what the estimator believes of them."""

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
    # Random walk of the position whatever the motion, m per root second: wheels slip a little when turning on the spot,
    # and no covariance becomes singular.
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
    # Probability that a detection is a gross error in range and bearing, or bears another tag's id. Not told either.
    outlier_probability: Share = 0.0
    wrong_id_probability: Share = 0.0
    # Ratio of measured to true range, 1 for no error. The estimator is not told.
    range_scale: Positive = 1.0
    # How far the camera may look aside, rad, and its clock be off the base's, s, as standard deviations. Both are
    # learnt with the map; 0 where they are known.
    yaw_deviation: Annotated[float, NotNegative(), Radians()] = 0.0175
    clock_deviation: float = 0.05
    # How far from its place it may sit, ahead and to the side, m, and its ranges be too long, as a share. Likewise.
    mount_deviation: float = 0.005
    range_scale_deviation: Share = 0.01


@dataclasses.dataclass
class ScanConfig:
    """The planar laser scanner."""

    # Greatest range, m, and the least: nearer it sees nothing, as a depth camera within some 0.45 m.
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
    # How far it may look aside, rad, sit from its place, ahead and to the side, m, its clock be off the base's, s, and
    # its rays be taken one after the other, s/rad, as standard deviations. All are learnt with the map.
    yaw_deviation: Annotated[float, NotNegative(), Radians()] = 0.01
    mount_deviation: float = 0.005
    clock_deviation: float = 0.02
    sweep_deviation: float = 0.02
    # Looks that a new wall needs; of a recording with few scans a metre one may have to do.
    least_looks: int = 3


@dataclasses.dataclass
class StationConfig:
    """The parts of the simulated station."""

    # What it sees with, one of EYES. Saying `camera` also sets in the sections tags and scan what such a camera's data
    # sheet says; what is set after that holds.
    eyes: Annotated[str, OneOf(EYES)] = "ideal"


@dataclasses.dataclass
class CameraConfig:
    """The camera that sees colour and depth, where `station.eyes` is one, and the building that it looks at.

    How much of the surroundings it sees, how far and how often, say the sections tags (colour) and scan (depth).
    """

    # Pixels.
    width: Annotated[int, Whole(), Bounds(64.0, 4096.0)] = 640
    height: Annotated[int, Whole(), Bounds(64.0, 4096.0)] = 480
    # The lens above the floor, m.
    mount_height: Positive = 0.3
    # Sides of the tags' black squares, their centres above the floor, and the walls' height, m.
    tag_size: Positive = 0.16
    tag_height: Positive = 0.3
    wall_height: Positive = 2.5


@dataclasses.dataclass
class SafetyConfig:
    """The filter between any controller and the base."""

    # Without a scan younger than this there is no forward speed, s.
    scan_timeout: Positive = 0.6
    # Nothing nearer to the robot's outline than this in its direction of travel, m, by the scan.
    stop_distance: float = 0.04
    # How long the base backs away after a bumper hit, s, and how fast, m/s.
    reflex_time: float = 1.0
    reflex_speed: float = 0.1
    # Turn rate of the reflex when only one side was hit, rad/s.
    reflex_turn_rate: float = 0.4
    # The corridor kept free ahead is this much wider than the base on either side, m.
    side_margin: float = 0.03


@dataclasses.dataclass
class RobotCameraConfig:
    """The camera of `--tags camera:`, where it sits on the robot, and the tags that it looks for."""

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
    # How old an image is when it arrives, s, where neither camera nor stream says when it was taken.
    latency: float = 0.0
    # Tags are looked for in an image so many times smaller; 1 sees smaller ones in four times the time.
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
    # What its rays span, rad, where its messages do not say; 0: as they say.
    field_of_view: float = 0.0
    # How far its clock is ahead of the odometry's, s.
    clock_offset: float = 0.0
    # A depth camera's scan is of what stands in this band of heights above the floor, m.
    low: float = 0.05
    high: Positive = 0.5


@dataclasses.dataclass
class HardwareConfig:
    """The real robot, where the station is one."""

    # How the base is reached, one of ROBOTS.
    robot: Annotated[str, OneOf(ROBOTS)] = "kobuki"
    # Speed limit of a real robot, m/s, if no other is lower.
    max_speed: Annotated[float, Bounds(0.0, FASTEST)] = 0.3
    # kobuki: the serial port.
    port: str = "/dev/kobuki"
    # A shipped preset or a YAML file that says what the robot's topics are and where its sensors sit; empty: that of a
    # turtlebot2 for a kobuki, else of a turtlebot4.
    preset: str = ""
    # rosbridge: HOST:PORT of the server.
    bridge: str = "localhost:9090"
    # Where tags and scans come from: ros2:/TOPIC, rosbridge:HOST:PORT/TOPIC, socket:HOST:PORT, or empty for the topics
    # of the preset; a kobuki has none of its own. Tags also from camera:SOURCE, or several of them with commas between,
    # or none; scans from rplidar:DEVICE or realsense:[SERIAL].
    tags: str = ""
    scan: str = ""
    # What a preset says of sensors on ROS, of those of our own.
    camera: RobotCameraConfig = dataclasses.field(default_factory=RobotCameraConfig)
    # Of the second camera and those after it, where tags come from several: camera:SOURCE,camera:SOURCE.
    more_cameras: list[RobotCameraConfig] = dataclasses.field(default_factory=list)
    scanner: RobotScannerConfig = dataclasses.field(default_factory=RobotScannerConfig)


@dataclasses.dataclass
class DisturbanceConfig:
    """The base is moved while its wheels notice nothing: they slip, or somebody pushes it."""

    # When it begins and how long it takes, s.
    time: float = 0.0
    duration: Positive = 1.0
    # How far the base is moved in all, ahead and to its left, m, and how far it is turned, rad.
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

    # When, s; what would come right beside the robot waits until that has gone, and all later changes with it.
    time: float = 0.0
    # Surfaces that come and surfaces that go, [x0, y0, x1, y1] in W, m; what goes may be a piece of a wall.
    walls: list[Segment] = dataclasses.field(default_factory=list)
    opened: list[Segment] = dataclasses.field(default_factory=list)
    # Tags that are moved, where they are then, and ids of tags that fall off.
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
    # From so far, m, half of the tags that are looked at straight are detected, from half as far again none, and from
    # half of it all; what is looked at aslant counts as that much farther off as it seems narrower. 0: as the data
    # sheet says.
    detection_range: float = 0.0
    # Range and bearing noise of a tag from one frame to the next fall to 1/e of their correlation in this time, s; 0:
    # white.
    correlation_time: float = 0.0
    # Standard deviations of each tag's constant error in range, m, and bearing, rad: it is printed, measured or hung
    # otherwise than believed.
    tag_range_error: float = 0.0
    tag_bearing_error: float = 0.0
    # The camera's clock less the base's, s: a frame's stamp is so much too late.
    clock_offset: Signed = 0.0
    # Standard deviation of a stamp's own error, s, and probability that a frame is lost.
    clock_jitter: float = 0.0
    frame_loss_probability: Share = 0.0
    # The camera's heading in the body frame, rad, and where it sits, ahead and to the left of the body's origin, m; it
    # is believed to sit there and to look ahead.
    yaw: Angle = 0.0
    ahead: Signed = 0.0
    left: Signed = 0.0
    # No tag is detected while the robot turns faster than this, rad/s: the image is blurred; 0: never.
    blurring_turn_rate: float = 0.0


@dataclasses.dataclass
class OdometryRealityConfig:
    """Wheels and gyro of the simulated base where they differ from OdometryConfig; None: as that says."""

    distance_noise: float | None = None
    distance_scale: float | None = None
    gyro_noise: float | None = None
    gyro_bias: float | None = None
    gyro_scale: float | None = None
    # The encoders count so many ticks a metre; 0: any number.
    ticks_per_metre: float = 0.0
    # Wheels slip in turns: they roll farther than the base moves by this share per rad/s that it turns, s.
    slip_per_turn_rate: float = 0.0


@dataclasses.dataclass
class ScanRealityConfig:
    """The simulated scanner where it differs from its data sheet, ScanConfig; None: as that says."""

    noise: float | None = None
    # Errors of two rays fall to 1/e of their correlation over this angle between them, rad; 0: white.
    correlation_angle: float = 0.0
    # Probability that a ray meets nothing (glass, black walls), and that it tells a range between the surface that it
    # passes the edge of and the one behind.
    dropout_probability: Share = 0.0
    mixed_probability: Share = 0.0
    # The scanner's heading in the body frame, rad, and where it sits, ahead and to the left of the body's origin, m; it
    # is believed to sit there and to look ahead.
    yaw: Angle = 0.0
    ahead: Signed = 0.0
    left: Signed = 0.0
    # Whether it is mounted upside down; it is believed not to be.
    flip: bool = False
    # From the first ray to the last, s, while the robot moves on; a scan is stamped with the first. 0: all at once.
    sweep_time: float = 0.0
    # The scanner's clock less the base's, s.
    clock_offset: Signed = 0.0


@dataclasses.dataclass
class CameraRealityConfig:
    """The faults of a rendered camera."""

    # How long a frame is exposed, s: meanwhile the robot turns, and the image is blurred by so much.
    exposure_time: float = 0.0
    # Grey levels are so many times those of a good exposure: below 1 it is dark, above 1 there is glare.
    brightness: Positive = 1.0
    # Standard deviation of a pixel's white noise, grey levels.
    noise: float = 2.0
    # Standard deviation of depth at 1 m, m; it grows with the square of the depth. Stereo with a baseline of 5.5 cm and
    # 500 pixels of focal length that matches to 0.08 pixels (docs/compare.md) has 0.08 / (500 * 0.055).
    depth_noise: float = 0.003


@dataclasses.dataclass
class RealityConfig:
    """What the simulated world does otherwise than the sections `tags`, `odometry` and `scan` say, which are what the
    explorer believes. None of it is told."""

    tags: TagRealityConfig = dataclasses.field(default_factory=TagRealityConfig)
    odometry: OdometryRealityConfig = dataclasses.field(default_factory=OdometryRealityConfig)
    scan: ScanRealityConfig = dataclasses.field(default_factory=ScanRealityConfig)
    camera: CameraRealityConfig = dataclasses.field(default_factory=CameraRealityConfig)
    # How many people walk about in the building.
    people: int = 0
    # How long it takes, s, to choose a goal, and to plan a path, until they are known to the others.
    planning_time: float = 0.0
    # What changes in the building while the robot is in it, one after the other.
    changes: list[ChangeConfig] = dataclasses.field(default_factory=list)


def as_it_is(belief: S, reality: Any) -> S:
    """A sensor's data sheet with what a section of RealityConfig says instead."""
    names = {field.name for field in dataclasses.fields(belief)}  # type: ignore[arg-type]
    given = {name: value for name, value in vars(reality).items() if name in names and value is not None}
    return dataclasses.replace(belief, **given)  # type: ignore[type-var]


@dataclasses.dataclass
class PartsConfig:
    """Parts of one's own: each the dotted name of a function of the scenario that makes one, or of a class that is made
    with the scenario, such as my_module.MyEstimator; "" for the usual one."""

    estimator: str = ""
    goal_selector: str = ""
    planner: str = ""
    follower: str = ""


@dataclasses.dataclass
class ExplorerConfig:
    """The method's own parameters. None is read from the world."""

    # The rule by which the next goal is picked, one of GOAL_RULES.
    goal: Annotated[str, OneOf(GOAL_RULES)] = "tour"
    # Seconds and metres that the mission may take, 0: as many as it needs; and whether the robot comes home at the end.
    budget_time: float = 0.0
    budget_distance: float = 0.0
    return_home: bool = False
    # Whether the robot, when all is explored, looks again where the landmarks' error falls by a larger share than the
    # mission grows longer (tour only).
    revisit: bool = True
    # Landmarks expected per metre of unexplored surface, until the building has shown how many there are.
    density: Positive = 1.0
    # Standard deviation of an unknown landmark's position, each axis, m.
    prior_sigma: Positive = 10.0
    # Roadmap nodes whose information gain is evaluated each stage.
    samples: AtLeastOne = 400
    # The mission is complete when no candidate sees enough frontier or promises more than this, nats.
    stop_gain: float = 20.0
    # Attempts at one frontier point before it is given up.
    frontier_attempts: AtLeastOne = 3
    # Turn rate while observing at a goal, rad/s.
    turn_rate: Annotated[float, Bounds(0.0, FASTEST_TURN)] = 1.2
    # The robot stands and looks this long before it first moves, s, and then turns round so many times, half of them
    # back. The map's heading is that of the start pose: only frames taken there tell it, as the gyro wanders with every
    # turn; the turns tell where among the landmarks the robot stood.
    first_look: float = 5.0
    first_turns: AtLeastOne = 1
    # Areas that the robot must not enter, each the corners [x, y] of a polygon in W, m: of a robot in a building that
    # is not known in the frame of its start.
    keep_out: list[list[Point]] = dataclasses.field(default_factory=list)

    # Ablations: what a part is worth, and what others do instead. Missions are best with the defaults.

    # The formula of the information gain, one of GAINS.
    gain: Annotated[str, OneOf(GAINS)] = "exact"
    # Whether goals are preferred by their gain less the price of arriving with an uncertain pose (of a tour, where no
    # frontier is left), and how many known tags a goal should have in view.
    pose_price: bool = True
    least_tags: int = 0
    # On its way to a goal the robot maps what it has ahead once in this time, s, and chooses anew; 0: only at goals.
    glance_period: float = 2.0
    # The way between views is mapped in pieces of this length, s; 0: path sightings localise only, as in the paper.
    path_keyframe_period: float = 5.0
    # What solves the estimator's keyframe graph, one of SOLVERS. GTSAM is slower and knows no constant errors of tags.
    solver: Annotated[str, OneOf(SOLVERS)] = "dissection"
    # What the map is made of, one of LANDMARKS: tags, walls as the scan sees them, or both.
    landmarks: Annotated[str, OneOf(LANDMARKS)] = "both"
    # The file of a map of the building, or the folder of a run, that the mission begins with; "": none.
    known_map: str = ""
    # Where in W the robot is thought to be at the beginning, x, y (m), yaw (rad), and the deviations of the place (m)
    # and of the yaw (rad): what it sees counts for more. Empty: anywhere in that map.
    known_at: KnownPose = dataclasses.field(default_factory=list)
    parts: PartsConfig = dataclasses.field(default_factory=PartsConfig)


@dataclasses.dataclass
class PlannerConfig:
    """The roadmap's chance constraint (the paper's Sec. III-E)."""

    # Largest probability of a collision.
    collision_probability: Annotated[float, Bounds(0.0, 0.5)] = 0.01
    # What it is the probability of: of any point of a path by itself, or of the whole path; one of RISKS.
    risk: Annotated[str, OneOf(RISKS)] = "point"


@dataclasses.dataclass
class GridConfig:
    """The grid baseline: GMapping and the choice of frontiers on its map."""

    # Side of a cell, m.
    resolution: Annotated[float, Bounds(0.01)] = 0.05
    # Particles of the filter, each with a map of its own.
    particles: AtLeastOne = 100
    # A scan goes into the map after this much time (s), way (m) or turn (rad), whatever comes first.
    update_period: Positive = 3.0
    update_distance: Positive = 1.0
    update_angle: Annotated[float, Bounds(0.0, 2.0 * math.pi)] = 0.5
    # Weights of the weighted sum (the paper's eq. 1): per nat of the grid's entropy, of which a square metre of unknown
    # cells has log(2) / resolution^2, and per nat of the pose's.
    weight_map: float = 0.01
    weight_pose: float = 1.0

    # Ablations: what a part is worth, and what others do instead. Missions are best with the defaults.

    # Whether the weighted sum is taken per expected second. If not, the largest sum is the goal, however far, as eq. 1
    # is printed.
    per_time: bool = True
    # Whether a goal whose frontier was seen on the way is left for the next at once. If not, the robot drives there and
    # looks round, as Yamauchi's did.
    eager: bool = True


document_fields(globals())
