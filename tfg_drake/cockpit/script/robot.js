// A TurtleBot: a base, three plates on poles, a camera that looks ahead. Radius 1.
function turtlebot(name) {
  const robot = new T.Group(),
    lit = material(name, { lit: true });
  const part = (geometry, x, y, z, look = lit) => {
    const mesh = new T.Mesh(geometry, look);
    mesh.position.set(x, y, z);
    robot.add(mesh);
    return mesh;
  };
  const plate = (radius, height) => new T.CylinderGeometry(radius, radius, height, 40).rotateX(Math.PI / 2);
  part(plate(1, 0.5), 0, 0, 0.3);
  for (const height of [0.85, 1.3, 2.0]) part(plate(0.92, 0.07), 0, 0, height);
  for (const [x, y] of [
    [0.6, 0.6],
    [-0.6, 0.6],
    [0.6, -0.6],
    [-0.6, -0.6],
  ])
    part(plate(0.05, 1.5), x, y, 1.25, material("truth", { lit: true }));
  part(new T.BoxGeometry(0.25, 0.9, 0.3), 0.35, 0, 2.2, material("edge", { lit: true }));
  // Ahead, seen from above.
  const arrow = new T.Shape([new T.Vector2(0.85, 0), new T.Vector2(-0.15, 0.5), new T.Vector2(-0.15, -0.5)]);
  part(new T.ShapeGeometry(arrow), 0, 0, 2.38, material("camera"));
  return robot;
}

const robot = turtlebot("robot"),
  ghost = new T.Group();
map.add(robot);
world.add(ghost);
ghost.add(new T.Mesh(new T.RingGeometry(1.12, 1.3, 40), material("truth")));
ghost.add(new T.Mesh(new T.PlaneGeometry(1.2, 0.16).translate(0.6, 0, 0), material("truth")));
ghost.position.z = 0.03;
