"""A saved map as a page in the browser, drawn by Meshcat without Drake; needs the `viewer` extra.

The page is whole: the PyPI package's viewer, the scene as its commands and a line of figures, so that it can be kept as
a file too. Seen from above; the mouse moves and zooms.
"""

from __future__ import annotations

import base64
import contextlib
import html
import json
import threading
from collections.abc import Iterator, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.bad_input import BadInput
from tfg_drake.geometry.se2 import compose, transform
from tfg_drake.mapfile.landmark_table import landmarks_in_world
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.pictures.caption import Colour
from tfg_drake.pictures.drawing import Mesh, discs, ellipses, outline_segments, ribbons
from tfg_drake.pictures.palette import BARE_SURFACE, EDGE, FRONTIER, LANDMARK, WALL_END

FREE: Colour = (0.94, 0.96, 0.92)
VIEW: Colour = (0.45, 0.25, 0.60)
LEGEND = (
    ("edge", EDGE),
    ("wall end", WALL_END),
    ("surface without tag", BARE_SURFACE),
    ("landmark, 3\u03c3", LANDMARK),
    ("frontier", FRONTIER),
    ("view", VIEW),
    ("free space", FREE),
)
# Where the server looks for a free port first.
PORT = 7000


class ViewerMissing(BadInput, ImportError):
    """The package meshcat is not installed; the message says how to get it."""


def scene_page(saved: SavedMap, title: str, figures: Sequence[tuple[str, str]]) -> str:
    """The page of a map, as HTML.

    Args:
        saved: the map, drawn in W.
        title: the first words above it.
        figures: (name, value) pairs that follow it.

    Raises:
        ViewerMissing: the package meshcat is not installed.
    """
    try:
        import meshcat
    except ImportError as error:
        raise ViewerMissing("the package meshcat is missing: pip install 'tfg-drake[viewer]'") from error
    script = Path(meshcat.viewer_assets_path()) / "dist" / "main.min.js"
    parts = {
        "TITLE": html.escape(title),
        "FIGURES": "".join(f"<span>{html.escape(n)} <b>{html.escape(v)}</b></span>" for n, v in figures),
        "LEGEND": "".join(f'<span><i style="background:{_css(c)}"></i>{html.escape(n)}</span>' for n, c in LEGEND),
        "VIEW": json.dumps([float(value) for value in _view(saved)]),
        "COMMANDS": json.dumps([base64.b64encode(command).decode() for command in _commands(saved)]),
        "SCRIPT": script.read_text(encoding="utf-8"),
    }
    page = _PAGE
    for name, part in parts.items():
        page = page.replace(f"{{{{{name}}}}}", part)
    return page


@contextlib.contextmanager
def serve(page: str) -> Iterator[str]:
    """Serves the page to this machine alone and yields its address."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            """The page, whatever is asked for but the browser's icon."""
            if self.path == "/favicon.ico":
                self.send_error(404)
                return
            body = page.encode()
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            with contextlib.suppress(ConnectionError):
                self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:
            """Says nothing."""

    server = _listen(Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://localhost:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def _listen(handler: type[BaseHTTPRequestHandler]) -> ThreadingHTTPServer:
    for port in range(PORT, PORT + 100):
        with contextlib.suppress(OSError):
            return ThreadingHTTPServer(("127.0.0.1", port), handler)
    return ThreadingHTTPServer(("127.0.0.1", 0), handler)


def _css(colour: Colour) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in colour)


def _view(saved: SavedMap) -> tuple[float, float, float, float]:
    """x_min, y_min, x_max, y_max in W, m, of all there is."""
    tfg = saved.tfg
    shown = [saved.p_ML, saved.X_MA[:, :2], tfg.segments.reshape(-1, 2), tfg.frontiers, tfg.star_vertices]
    points = transform(saved.X_WM, np.vstack(shown))
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.5 + 0.02 * float(np.max(high - low))
    return low[0] - margin, low[1] - margin, high[0] + margin, high[1] + margin


def _commands(saved: SavedMap) -> Iterator[bytes]:
    """What Meshcat draws: each layer has its own height, so that nothing fights for the same pixel."""
    tfg, X_WM = saved.tfg, saved.X_WM
    x_min, _, x_max, _ = _view(saved)
    # A symbol's size: visible when the whole map fills the window.
    unit = max(0.04, (x_max - x_min) / 420.0)
    yield from _mesh(
        "free", _stars(transform(X_WM, tfg.star_vertices), tfg.star_offsets, transform(X_WM, tfg.star_centers)), FREE
    )
    segments = np.hstack([transform(X_WM, tfg.segments[:, :2]), transform(X_WM, tfg.segments[:, 2:])])
    for kind, (name, colour) in enumerate((("edges", EDGE), ("ends", WALL_END), ("bare", BARE_SURFACE))):
        yield from _mesh(f"surfaces/{name}", ribbons(segments[tfg.segment_kind == kind], unit, 0.02), colour)
    views = compose(X_WM, saved.X_MA)
    tips = views[:, :2] + 4.0 * unit * np.stack([np.cos(views[:, 2]), np.sin(views[:, 2])], axis=1)
    rings = outline_segments(ellipses(views[:, :2], np.tile(np.eye(2), (len(views), 1, 1)), sigmas=2.0 * unit))
    arrows = np.vstack([rings, np.hstack([views[:, :2], tips])])
    yield from _mesh("views", ribbons(arrows, 0.5 * unit, 0.04), VIEW)
    yield from _mesh("frontiers", discs(transform(X_WM, tfg.frontiers), 1.1 * unit, 0.06), FRONTIER)
    p_WL, covariance = landmarks_in_world(saved)
    yield from _mesh("ellipses", ribbons(outline_segments(ellipses(p_WL, covariance)), 0.3 * unit, 0.08), LANDMARK)
    yield from _mesh("landmarks", discs(p_WL, 0.7 * unit, 0.1), LANDMARK)


def _stars(vertices: FloatArray, offsets: IntArray, centers: FloatArray) -> Mesh:
    """Packed star polygons as triangles round their centers, on the ground."""
    owner = np.repeat(np.arange(len(centers)), np.diff(offsets))
    following = np.arange(len(vertices)) + 1
    last = offsets[1:][np.diff(offsets) > 0] - 1
    following[last] = offsets[owner[last]]
    faces = np.stack([owner, len(centers) + np.arange(len(vertices)), len(centers) + following], axis=1)
    points = np.vstack([centers, vertices])
    return np.column_stack([points, np.zeros(len(points))]), faces


def _mesh(path: str, mesh: Mesh, colour: Colour) -> Iterator[bytes]:
    """The command that shows triangles in one flat colour; none where there are no triangles."""
    import umsgpack
    from meshcat.commands import SetObject
    from meshcat.geometry import MeshBasicMaterial, TriangularMeshGeometry
    from meshcat.path import Path as ScenePath

    vertices, faces = mesh
    if len(faces):
        geometry = TriangularMeshGeometry(vertices, faces)
        material = MeshBasicMaterial(color=int(_css(colour)[1:], 16))
        yield umsgpack.packb(SetObject(geometry, material, ScenePath(("map", *path.split("/")))).lower())


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>{{TITLE}}</title>
<style>
body { margin: 0; font: 15px sans-serif; color: #262a30; }
#scene { width: 100vw; height: 100vh; overflow: hidden; }
#caption { position: absolute; left: 16px; top: 12px; right: 280px; pointer-events: none; }
#caption span { margin-right: 1.4em; white-space: nowrap; color: #5a6068; }
#caption b { color: #262a30; }
#caption i { display: inline-block; width: 12px; height: 12px; margin-right: 6px; vertical-align: -1px; }
#caption div { margin-top: 6px; font-size: 13px; }
</style>
</head>
<body>
<div id="scene"></div>
<div id="caption"><b>{{TITLE}}</b> &emsp; {{FIGURES}}<div>{{LEGEND}}</div></div>
<script>{{SCRIPT}}</script>
<script>
const viewer = new MeshCat.Viewer(document.getElementById("scene"));
for (const command of {{COMMANDS}})
  viewer.handle_command_bytearray(Uint8Array.from(atob(command), c => c.charCodeAt(0)));
for (const name of ["Background", "Grid", "Axes"]) viewer.set_property([name], "visible", false);

// Straight down, a hair from the south: the controls keep z up, and so north stays up. The viewer's own axes have y up.
const [x_min, y_min, x_max, y_max] = {{VIEW}}, x = (x_min + x_max) / 2, y = (y_min + y_max) / 2;
const camera = new MeshCat.THREE.OrthographicCamera(-1, 1, 1, -1, 0.1, 200);
viewer.set_camera(camera);
viewer.set_object(["Cameras", "default", "rotated"], camera);
camera.position.set(x, 50, -y + 0.001);
viewer.controls.target.set(x, 0, -y);
viewer.controls.update();

// The whole map fills the window, below the caption.
function fit() {
  const top = 70 / window.innerHeight;
  const height = Math.max((y_max - y_min) / (1 - top), (x_max - x_min) * window.innerHeight / window.innerWidth);
  const width = height * window.innerWidth / window.innerHeight;
  camera.left = -width / 2;
  camera.right = width / 2;
  camera.top = height * (1 + top) / 2;
  camera.bottom = -height * (1 - top) / 2;
  camera.updateProjectionMatrix();
  viewer.set_dirty();
}
requestAnimationFrame(fit);
window.addEventListener("resize", fit);
</script>
</body>
</html>
"""
