// Trails: the way driven, as the robot believes, and truly.

// So far, m, no robot drives from one pose to the next: where it finds itself elsewhere it has not driven there.
const JUMP = 1.0;

/** The way driven, as a ribbon that grows; shown up to a time. */
class Trail {
  constructor(group, name, z) {
    Object.assign(this, { group, z, points: [], times: [], width: 0, mesh: null });
    this.look = material(name);
  }

  add(t, x, y) {
    const [a, b] = this.points.at(-1) ?? [Infinity, 0];
    if (Math.hypot(x - a, y - b) < 0.03) return;
    this.points.push([x, y]);
    this.times.push(t);
  }

  show(t) {
    const count = this.points.length;
    if (!this.mesh || this.built < count || this.width !== unit) this.build();
    if (this.mesh) this.mesh.geometry.setDrawRange(0, 6 * Math.max(before(this.times, t), 0));
  }

  build() {
    const count = this.points.length,
      capacity = Math.max(256, 2 ** Math.ceil(Math.log2(count + 1)));
    const anew = !this.mesh || this.capacity < count || this.width !== unit;
    if (anew) {
      this.capacity = capacity;
      const geometry = new T.BufferGeometry(),
        faces = new Uint32Array(6 * capacity);
      for (let i = 0; i < capacity; i++) faces.set([4 * i, 4 * i + 1, 4 * i + 2, 4 * i, 4 * i + 2, 4 * i + 3], 6 * i);
      geometry.setAttribute("position", new T.BufferAttribute(new Float32Array(12 * capacity), 3));
      geometry.setIndex(new T.BufferAttribute(faces, 1));
      this.mesh = new T.Mesh(geometry, this.look);
      this.mesh.frustumCulled = false;
      put(this.group, "trail", this.mesh);
      this.width = unit;
      this.built = 1;
    }
    const position = this.mesh.geometry.attributes.position,
      half = 0.35 * unit;
    for (let i = Math.max(this.built, 1); i < count; i++) {
      const [x1, y1] = this.points[i];
      let [x0, y0] = this.points[i - 1];
      if (Math.hypot(x1 - x0, y1 - y0) > JUMP) [x0, y0] = [x1, y1];
      const length = Math.hypot(x1 - x0, y1 - y0) || 1;
      const c = ((x1 - x0) / length) * half,
        s = ((y1 - y0) / length) * half;
      position.array.set(
        [
          x0 - c + s,
          y0 - s - c,
          this.z,
          x1 + c + s,
          y1 + s - c,
          this.z,
          x1 + c - s,
          y1 + s + c,
          this.z,
          x0 - c - s,
          y0 - s + c,
          this.z,
        ],
        12 * (i - 1),
      );
    }
    position.needsUpdate = true;
    this.built = count;
  }
}

const driven = new Trail(trails.pose, "trail", Z.trail),
  trueWay = new Trail(trails.truth, "truth", Z.trail - 0.004);
