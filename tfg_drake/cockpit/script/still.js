// What stands still is drawn once and kept; a picture is what is kept, and over it what moves.

const STILL = 0,
  MOVING = 1; // three.js draws of a scene what is in its camera's layer.

/** Makes an object, with all its parts, one that every picture draws anew. */
function moves(object) {
  object.traverse((part) => part.layers.set(MOVING));
  return object;
}

const kept = {
  target: new T.WebGLRenderTarget(1, 1, { samples: 4, depthTexture: new T.DepthTexture(1, 1) }),
  key: "",

  /** All that a picture of what stands still depends on. */
  keyNow(camera) {
    const parts = [shapes, painted, ...camera.matrixWorld.elements, ...camera.projectionMatrix.elements];
    parts.push(...map.matrix.elements);
    for (const group of Object.values(groups)) parts.push(group.visible, ...group.children.map((one) => one.visible));
    return parts.join();
  },

  draw() {
    const { renderer, scene, camera } = viewer;
    const size = renderer.getDrawingBufferSize(new T.Vector2());
    scene.updateMatrixWorld();
    camera.updateMatrixWorld();
    const key = this.keyNow(camera) + size.toArray();
    if (key !== this.key) {
      this.key = key;
      // Edges are smoothed where that is seen, and does not take twice the time of all the rest.
      const many = drawn.map && drawn.map.count > MANY,
        samples = many || devicePixelRatio >= 2 ? 0 : 4;
      if (samples !== this.target.samples) {
        this.target.samples = samples;
        this.target.dispose();
      }
      this.target.setSize(size.x, size.y);
      camera.layers.set(STILL);
      renderer.setRenderTarget(this.target);
      renderer.render(scene, camera);
      renderer.setRenderTarget(null);
    }
    camera.layers.set(MOVING);
    renderer.render(scene, camera);
  },
};

/** Shows what is kept, before anything else, and how far away it is: what moves may be behind it. */
const screen = moves(
  new T.Mesh(
    new T.PlaneGeometry(2, 2),
    new T.ShaderMaterial({
      uniforms: { colours: { value: kept.target.texture }, depths: { value: kept.target.depthTexture } },
      vertexShader: "void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }",
      fragmentShader: `uniform sampler2D colours, depths;
        void main() {
          gl_FragColor = texelFetch(colours, ivec2(gl_FragCoord.xy), 0);
          gl_FragDepth = texelFetch(depths, ivec2(gl_FragCoord.xy), 0).r;
        }`,
      depthFunc: T.AlwaysDepth,
    }),
  ),
);
screen.frustumCulled = false;
screen.renderOrder = -1000;
viewer.scene.add(screen);
for (const light of [sky, sun]) light.layers.enableAll();
for (const group of [robot, ghost, groups.camera, groups.scan, people, mine, trails.pose, trails.truth]) moves(group);
