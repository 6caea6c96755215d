// Cameras: from above, in space, and what fits into the window.

let flat = true,
  following = false,
  framed = true; // framed: the window follows what is known
const above = new T.OrthographicCamera(-1, 1, 1, -1, 0.1, 400),
  inSpace = new T.PerspectiveCamera(40, 1, 0.1, 2000);
const size = () => [element("scene").clientWidth || 1, element("scene").clientHeight || 1];
/** What panels leave free of the window: left, top, right, bottom, pixels. */
function margins() {
  const [w, h] = size(),
    side = element("side").getBoundingClientRect(),
    wide = w > 760;
  if (!side.width) return [20, 20, 20, 20];
  const layers = element("layers").getBoundingClientRect();
  return wide
    ? [
        element("layers").open ? layers.right + 16 : 30,
        56,
        w - side.left + element("scene").getBoundingClientRect().left + 20,
        30,
      ]
    : [12, 50, 12, h - (side.top - element("scene").getBoundingClientRect().top) + 12];
}

function useCamera() {
  const camera = flat ? above : inSpace;
  if (viewer.controls) viewer.controls.dispose();
  viewer.set_camera(camera);
  const controls = viewer.controls;
  controls.enableRotate = !flat;
  controls.screenSpacePanning = flat;
  controls.maxPolarAngle = flat ? Math.PI : 0.49 * Math.PI;
  controls.zoomToCursor = true;
  if (flat) controls.mouseButtons = { LEFT: T.MOUSE.PAN, MIDDLE: T.MOUSE.DOLLY, RIGHT: T.MOUSE.PAN };
  controls.addEventListener("start", () => {
    framed = false;
  });
  controls.addEventListener("change", () => {
    dirty = true;
  });
  fit();
}

function fit() {
  const [w, h] = size(),
    [left, top, right, bottom] = margins();
  const box = following ? followBox() : boundsAt(time);
  if (!(box[2] >= box[0])) return;
  const pad = 0.3,
    x = (box[0] + box[2]) / 2,
    y = (box[1] + box[3]) / 2;
  const width = Math.max(box[2] - box[0] + 2 * pad, 2),
    height = Math.max(box[3] - box[1] + 2 * pad, 2);
  const freeWidth = Math.max(w - left - right, 60),
    freeHeight = Math.max(h - top - bottom, 60);
  if (flat) {
    const scale = Math.max(width / freeWidth, height / freeHeight); // m a pixel
    const cx = x + ((right - left) / 2) * scale,
      cy = y + ((top - bottom) / 2) * scale;
    above.left = (-w / 2) * scale;
    above.right = (w / 2) * scale;
    above.top = (h / 2) * scale;
    above.bottom = (-h / 2) * scale;
    above.zoom = 1;
    above.position.set(cx, 100, -cy + 1e-3);
    viewer.controls.target.set(cx, 0, -cy);
  } else {
    inSpace.aspect = w / h;
    inSpace.setViewOffset(w, h, (right - left) / 2, (bottom - top) / 2, w, h);
    const tilt = (52 * Math.PI) / 180,
      tan = Math.tan((inSpace.fov * Math.PI) / 360);
    // Far enough that the near edge fits, too.
    const across = (width / 2 / tan) * (h / freeWidth),
      along = (((height / 2) * Math.sin(tilt) * 1.12) / tan) * (h / freeHeight);
    const distance = Math.max(across + (height / 2) * Math.cos(tilt), along + (height / 2) * Math.cos(tilt) * 0.6);
    viewer.controls.target.set(x, 0, -y);
    inSpace.position.set(x, distance * Math.sin(tilt), -y + distance * Math.cos(tilt));
  }
  resize();
  viewer.controls.update();
}

function followBox() {
  const p = robotPlace();
  return [p[0] - 5, p[1] - 4, p[0] + 5, p[1] + 4];
}

function robotPlace() {
  const place = new T.Vector3();
  robot.getWorldPosition(place);
  return [place.x, -place.z];
}

function resize() {
  const [w, h] = size(),
    camera = viewer.camera;
  if (camera === above) {
    const middle = (above.top + above.bottom) / 2,
      scale = (above.top - above.bottom) / 2 / (h / 2);
    above.top = middle + (h / 2) * scale;
    above.bottom = middle - (h / 2) * scale;
    above.left = (-w / 2) * scale;
    above.right = (w / 2) * scale;
  } else {
    camera.aspect = w / h;
  }
  camera.updateProjectionMatrix();
  viewer.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
  viewer.renderer.setSize(w, h);
  dirty = true;
}
viewer.set_3d_pane_size = () => resize();

/** A bar of a round length, from above. */
function showScale() {
  const metres = metresPerPixel(),
    ten = 10 ** Math.floor(Math.log10(120 * metres)),
    length = [5, 2, 1].map((k) => k * ten).find((one) => one <= 120 * metres);
  element("scale").hidden = !flat;
  element("scale").style.width = `${length / metres}px`;
  element("scale").textContent = `${length} m`;
}

function metresPerPixel() {
  const [, h] = size();
  if (flat) return (above.top - above.bottom) / above.zoom / h;
  const distance = inSpace.position.distanceTo(viewer.controls.target);
  return (2 * distance * Math.tan((inSpace.fov * Math.PI) / 360)) / h;
}
