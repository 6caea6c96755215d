// The scene: the viewer that Drake ships, lights, and a group for each layer.

const viewer = new MeshCat.Viewer(element("scene"), false);
viewer.gui.domElement.remove();
for (const name of ["Background", "Grid", "Axes", "Lights"]) viewer.set_property([name], "visible", false);
// A colour is what it is named, also where one is mixed with another.
viewer.renderer.toneMapping = T.NoToneMapping;
viewer.renderer.outputColorSpace = T.LinearSRGBColorSpace;
T.ColorManagement.enabled = false;

const world = new T.Group(); // z up, whatever the viewer's scene is turned by
world.rotation.x = -Math.PI / 2 - viewer.scene.rotation.x;
viewer.scene.add(world);
const sky = new T.HemisphereLight(0xffffff, 0x8a8f99, 0.86 * Math.PI),
  sun = new T.DirectionalLight(0xffffff, 0.16 * Math.PI);
sky.position.set(0, 0, 1);
sun.position.set(4, -7, 10);
world.add(sky, sun);
const map = new T.Group();
world.add(map);

// Heights of what lies flat, so that nothing fights for the same pixel: those of LOOKS, and what only the page has
// between them.
const Z = {
  free: LOOKS.free_space.high,
  camera: LOOKS.free_space.high + 0.003,
  roadmap: LOOKS.free_space.high + 0.006,
  trail: LOOKS.trail.high,
  gains: LOOKS.gain_0.high,
  frontiers: LOOKS.frontier.high,
  tour: LOOKS.path.high - 0.003,
  path: LOOKS.path.high,
  uncertainty: LOOKS.landmark_3sigma.high,
  scan: LOOKS.scan.high,
};
const WALL_HEIGHT = LOOKS.wall.high,
  MAP_HEIGHT = LOOKS.edge.high;
// Few corners: without a graphics card every triangle is felt.
const MANY = 2000; // Of more than so many each is drawn with fewer still.
const PLATE = new T.PlaneGeometry(1, 1),
  UPRIGHT = new T.PlaneGeometry(1, 1).rotateX(Math.PI / 2);
const DISC = new T.CircleGeometry(1, 12),
  SQUARE = new T.PlaneGeometry(1.8, 1.8);
/** A box without its bottom. */
const BOX = new T.BoxGeometry(1, 1, 1);
BOX.setIndex([...BOX.index.array.slice(0, 30)]);
BOX.clearGroups();
const POST = new T.CylinderGeometry(1, 1, 1, 8).rotateX(Math.PI / 2);
const OVAL = new T.CircleGeometry(1, 20),
  RING = new T.RingGeometry(0.86, 1, 24, 1);

// name, words, swatch, shown at first, explanation.
const LAYERS = [
  ["walls", "walls", "wall", true, "The true walls, which the robot does not know (simulation only)"],
  [
    "map",
    "map",
    "landmark",
    true,
    "What the robot has mapped: tags, and walls. Dark: on a wall or between two tags; grey: past the last tag; orange: without a landmark",
  ],
  [
    "uncertainty",
    "uncertainty",
    "landmark",
    true,
    "Ellipses of three standard deviations round each tag and the robot",
  ],
  [
    "wall_landmarks",
    "wall landmarks",
    "wall_landmark",
    true,
    "Walls that are landmarks, as tags are, between two points of each; round them bands of three standard deviations",
  ],
  ["keep_out", "keep-out areas", "keep_out", true, "Areas that it must not enter (explorer.keep_out)"],
  ["frontiers", "frontiers", "frontier", true, "Where known free space ends at the unknown"],
  [
    "gains",
    "gains",
    "path",
    true,
    "Places that the robot could go to: the darker (on a dark page the brighter), the more information is to be gained",
  ],
  ["roadmap", "roadmap", "roadmap", false, "The ways that the robot knows it can drive"],
  [
    "tour",
    "tour, instead",
    "path",
    true,
    "1, 2, ... its goal first: the stops of the tour that it has planned. Grey a, b, c: where it could have gone instead",
  ],
  ["path", "path", "path", true, "The path that it drives, and its goal"],
  ["trail", "trail", "trail", true, "The way that it has driven, as it believes; beside it, grey, the true one"],
  ["scan", "scan", "scan", true, "What its laser scanner meets"],
  ["camera", "camera", "camera", true, "What its camera sees"],
  ["free", "free space", "free", true, "Floor that the robot has seen to be free"],
];
const groups = {};
for (const [name] of LAYERS) groups[name] = new T.Group();
for (const name of ["walls"]) world.add(groups[name]);
for (const name of ["map", "wall_landmarks", "uncertainty", "keep_out", "frontiers", "gains", "roadmap", "tour", "path", "free"]) map.add(groups[name]);
const trails = { pose: new T.Group(), truth: new T.Group() };
map.add(trails.pose, groups.scan, groups.camera);
world.add(trails.truth, groups.trail);
const people = new T.Group(),
  mine = new T.Group(); // the robot's own uncertainty
world.add(people);
groups.uncertainty.add(mine);
