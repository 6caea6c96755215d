"""The page in a browser: every button and every toggle is pressed, and does what it says."""

import base64
import itertools
import json
import time
import zlib

import cv2
import numpy as np
import pytest
import shapely
from PIL import Image, ImageSequence

from benchmarks.timelines import read_timeline
from tests.cockpit.conftest import ENDS, EXPLAINED, STAGES, SUMMARY, begin, drive, end, stage, write_mission
from tfg_drake.cockpit.browser import SEEK, wait_for_page, write_gif, write_mp4
from tfg_drake.cockpit.page import export_page
from tfg_drake.cockpit.server import Cockpit
from tfg_drake.diagrams.missions.run import viewer_script
from tfg_drake.diagrams.missions.summary_words import table_rows
from tfg_drake.pictures.rows import Table
from tfg_drake.storage.timeline import MAGIC, TimelineWriter, encoded, write_map_timeline

LAYERS = ["walls", "map", "uncertainty", "frontiers", "gains", "roadmap", "tour", "path", "trail", "scan", "camera"]
LAYERS += ["free", "wall_landmarks", "keep_out"]


class Page:
    """A page in the browser, and what can be done with it."""

    def __init__(self, driver, address):
        self.driver = driver
        driver.get_log("browser")
        driver.get("about:blank")  # An address that differs by its fragment alone would not be loaded anew.
        driver.get(address)
        wait_for_page(driver)

    def __call__(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def until(self, script, *arguments):
        limit = time.monotonic() + 60.0
        while not (found := self(script, *arguments)):
            assert time.monotonic() < limit, (script, self.driver.get_log("browser"))
            time.sleep(0.02)
        return found

    def click(self, name):
        self.driver.find_element("id", name).click()

    def text(self, name):
        return self("return document.getElementById(arguments[0]).innerText", name)

    def seek(self, seconds):
        """As a hand on the slider does; how long it took, s."""
        return self(SEEK, seconds)

    def picture(self, anew=False):
        """What is drawn, as a number that another picture would hardly have. Symbols keep their size while the scale
        changes little; anew: it is chosen for this picture, whatever was shown before."""
        return self(
            """if (arguments[0]) unit = 0;
            render();
            const context = viewer.renderer.getContext();
            const w = context.drawingBufferWidth, h = context.drawingBufferHeight;
            const pixels = new Uint8Array(4 * w * h);
            context.readPixels(0, 0, w, h, context.RGBA, context.UNSIGNED_BYTE, pixels);
            let sum = 0;
            for (const pixel of new Uint32Array(pixels.buffer)) sum = (Math.imul(sum, 31) + pixel) | 0;
            return sum;""",
            anew,
        )

    def complaints(self):
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]


@pytest.fixture(scope="module")
def exported(driver, mission, tmp_path_factory):
    out = tmp_path_factory.mktemp("page") / "mission.html"
    export_page(mission, out, "room", viewer_script())
    return out


@pytest.fixture(scope="module")
def page(driver, exported):
    """The page of a mission that has ended, from its file."""
    driver.get_log("performance")
    return Page(driver, exported.as_uri())


def test_the_file_asks_for_nothing_and_complains_of_nothing(page):
    page.seek(5.0)
    asked = [json.loads(entry["message"])["message"] for entry in page.driver.get_log("performance")]
    asked = [one["params"]["request"]["url"] for one in asked if one["method"] == "Network.requestWillBeSent"]
    assert [url[:5] for url in asked if not url.startswith("about:")] == ["file:"] * len(asked)
    assert page.complaints() == []


def test_it_begins_at_the_end_and_says_how_it_ended(page):
    page.seek(10.0)
    assert page.text("title") == "room, seed 3"
    assert page.text("phase") == "complete"
    card = page.text("card")
    for words in ("Mission complete", "Nothing is left <b>to see</b>.", "3 stages", "runs/room"):
        assert words in card
    page.driver.find_element("css selector", "#card button").click()
    assert not page.driver.find_element("id", "card").is_displayed()
    page.seek(0.0)


def test_the_end_has_the_numbers_of_the_terminal(page):
    """The same of each, rounded alike; the page's sum of the way is a little less than the summary's."""
    page.seek(9.75)
    numbers = page.text("numbers").splitlines()
    assert dict(zip(numbers[::2], numbers[1::2], strict=True))["driven"] == "3.9 m"
    page.seek(10.0)
    numbers, card = page.text("numbers").splitlines(), page.text("card").splitlines()
    shown = dict(zip(card[1:-1:2], card[2::2], strict=False))
    told = dict(
        table_rows({**dict.fromkeys(FIELDS), **SUMMARY, "position_error_moving_m": {"mean": 0.015, "max": 0.02}})
    )
    driven = dict(zip(numbers[::2], numbers[1::2], strict=True))["driven"]
    assert driven == shown["driven"] == told["driven"].split(",")[0]
    assert shown["time"].split(",")[0] == told["time"].split(",")[0] == page.text("clock")
    assert page.text("time").endswith(f"of {page.text('clock')}")
    assert f"{shown['tags']}, map error {shown['map error']}" == told["tags"]
    assert told["pose error"].startswith(shown["pose error"] + ",")
    assert (
        shown["coverage"].replace("\u00a0", " ")
        == told["coverage"]
        == "100.0 % of the area, 99.9 % of the surface within 5 cm"
    )
    assert page("return [0.29, 0.9994, 1 - 1e-9, 1].map(percent)") == [
        f"{shown}\u00a0%" for shown in ("29.0", "99.9", "99.9", "100.0")
    ]
    assert told["safety"] == f"contacts: {shown['contacts']}; least clearance -"
    assert shown["contacts"] == "0 by the robot, 1 by others"
    assert page("return [2.25, 2.75, -0.06].map((value) => number(value, 1))") == ["2.2", "2.8", f"{-0.06:.1f}"]


def test_any_time_is_shown(page):
    page.seek(0.0)
    assert page("return groups.map.children.length") == 0
    assert "stage\n0" in page.text("numbers")
    for number, time_s in enumerate(STAGES, start=1):
        page.seek(time_s + 0.1)
        assert f"stage\n{number}" in page.text("numbers")
        assert page("return arrays(drawn.map).points.length / 2") == number
    # Between two recorded poses the robot is between them.
    page.seek(5.125)
    np.testing.assert_allclose(page("return robot.position.toArray()"), [2.05, 0.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(page("return ghost.position.toArray().slice(0, 2)"), [3.07, 2.0], atol=1e-3)
    page.seek(1.0)
    known = "return groups.map.children.map((object) => object.name)"
    assert page(known) == ["sighted"]  # It forgets what it did not know then.
    assert page.text("phase") == "observe: first look"
    assert page.text("wheels") == "wheels enabled"


def test_what_is_told_of_the_very_time_that_is_shown_is_shown(page):
    """A page that follows a mission has written its panels just before the wheels are stopped."""
    page.seek(10.0)
    stopped = """setLive(true); tell();
        timeline.layers.get("enabled").times.push(10);
        timeline.layers.get("enabled").records.push({ told: { enabled: false }, time: 10 });
        fed = true; picture(performance.now());"""
    page(stopped)
    try:
        page.until("return element('wheels').innerText === 'wheels stopped'")
    finally:
        page("for (const name of ['times', 'records']) timeline.layers.get('enabled')[name].pop(); setLive(false)")


def test_a_table_is_put_together_at_any_time_from_what_has_changed(page, tmp_path):
    """As Python reads it."""
    rng = np.random.default_rng(0)
    path, ids = tmp_path / "timeline.tfg", np.zeros(0, dtype=int)
    with TimelineWriter(path) as writer:
        for time in range(40):
            ids = np.union1d(rng.choice(ids, len(ids) // 2, replace=False), rng.integers(0, 10 ** (2 + time // 10), 20))
            points = rng.normal(0.0, 1.0, (len(ids), 2))
            table = Table({"points": points, "ids": ids, "kind": (ids % 3).astype(np.uint8)}, points, ids)
            writer.write_rows("map", float(time), table)
            writer.write("scan", float(time), {"points": points})
    told = page(
        """const bytes = Uint8Array.from(atob(arguments[0]), (c) => c.charCodeAt(0)), read = new Timeline();
        return read.feed(bytes).then(() => ["map", "scan"].map((name) => [39, 7, 8, 22].map((t) => {
            const record = read.at(name, t), now = arrays(record);
            return [record.count ?? null, ...["points", "ids", "kind"].map((array) => [...(now[array] ?? [])])];
        })));""",
        base64.b64encode(path.read_bytes()).decode(),
    )
    for name, shown in zip(("map", "scan"), told, strict=True):
        records = [record for record in read_timeline(path) if record.layer == name]
        for time, (count, points, *numbers) in zip((39, 7, 8, 22), shown, strict=True):
            now = records[time].arrays
            np.testing.assert_allclose(points, now["points"].ravel(), atol=1e-5)
            if name == "map":
                assert [count, *numbers] == [len(now["ids"]), now["ids"].tolist(), now["kind"].tolist()]


@pytest.mark.parametrize("blocks", [1, 50])
def test_a_small_timeline_is_not_unpacked_without_end(page, blocks):
    """One block of zeros that stands for 150 MB, and many that each stand for 3 MB, of a record that is small."""
    record = encoded("scan", 0.0, {}, {"word": " " * (150_000_000 // blocks)})
    block = zlib.compress(record, 9)
    data = MAGIC + blocks * (len(block).to_bytes(4, "little") + block)
    told = page(
        """const other = new Timeline(), bytes = Uint8Array.from(atob(arguments[0]), (c) => c.charCodeAt(0));
        return other.feed(bytes).then(() => ["read"], (error) => ["refused", other.unpacked]);""",
        base64.b64encode(data).decode(),
    )
    assert told[0] == "refused"
    assert told[1] <= 2**26


def test_what_stands_still_is_drawn_once(page):
    page.seek(6.0)
    key, before = page("return kept.key"), page.picture()
    page.seek(6.2)
    assert page("return kept.key") == key
    assert page.picture() != before  # The robot has moved.
    for change in (lambda: page.click("layer-frontiers"), lambda: page.seek(8.1), lambda: page.click("mode")):
        before = page("return kept.key")
        change()
        page("render()")
        assert page("return kept.key") != before
    page.click("layer-frontiers")
    page.click("mode")


def test_numbers_and_the_goal_are_explained(page):
    page.seek(6.0)
    numbers = page.text("numbers").splitlines()
    figures = dict(zip(numbers[::2], numbers[1::2], strict=True))
    assert figures["tags mapped"] == "2"
    assert figures["map entropy"] == "-10 nats"
    assert figures["true error"] == "2.0 cm"
    assert figures["stated uncertainty"] == "12.2 cm"  # the root of the mean variance
    choice = page.text("choice")
    assert "chosen 1 2.0 3.5 0.5 5.5 4.0 1.4" in " ".join(choice.split())
    assert [f"instead {i}" in " ".join(choice.split()) for i in "abcd"] == [True, True, True, False]
    assert page.text("most") == "0\n31 nats"  # the scale of the gains
    swatch = "return getComputedStyle(document.querySelector('label i[data-layer=' + arguments[0] + ']'))"
    assert "gradient" in page(f"{swatch}.backgroundImage", "gains")
    looks = [page(f"{swatch}.borderStyle + {swatch[7:]}.backgroundImage", name) for name in ("map", "uncertainty")]
    assert looks[0] != looks[1]


def test_the_tour_is_drawn_as_numbered_stops(page):
    badges = "return groups.tour.getObjectByName(arguments[0]).children.map((badge) => badge.position.toArray())"
    number_ = """const canvas = groups.tour.getObjectByName("stops").children[arguments[0]].material.map.image;
        return canvas.getContext("2d").getImageData(0, 0, 64, 64).data.join();"""
    page.seek(2.1)
    stops = np.array([[3.5, 1.2], [2.0, -1.0], [0.0, 1.0]])
    np.testing.assert_allclose(np.array(page(badges, "stops"))[:, :2], stops, atol=1e-3)
    assert len({page(number_, k) for k in range(3)}) == 3
    assert len(page(badges, "instead")) == 3
    # Lines from each to the next, by the roadmap.
    legs = page("return [...groups.tour.getObjectByName('legs').geometry.attributes.position.array]")
    legs = np.array(legs).reshape(4, 4, 3)[..., :2]
    np.testing.assert_allclose(legs.mean(axis=1), [[2.75, 1.1], [2, 0], [2, 0], [1, 1]], atol=1e-3)
    assert "A tour of 3 stops, 21 s in all" in page.text("choice")
    page.seek(5.1)
    assert len(page(badges, "stops")) == 1
    assert "A tour of one stop, 6 s" in page.text("choice")
    page.seek(8.1)  # Of another rule: no stops, only what was not taken, and why.
    assert page(badges, "stops") == []
    assert len(page(badges, "instead")) == 3
    assert "It looks round once more." in page.text("choice")
    assert "chosen 1" not in " ".join(page.text("choice").split())
    page.seek(10.0)
    assert not any(page("return groups.tour.children.map((child) => child.visible)"))


def test_the_first_look_shows_what_is_seen(page):
    page.seek(1.0)
    seen = page("return [sightedTags(time), groups.map.getObjectByName('sighted') !== undefined]")
    np.testing.assert_allclose(np.reshape(seen[0], (3, 2)), [[1.5, 0.4], [2.0, 1.15], [2.0, 1.4]], atol=1e-3)
    assert seen[1] is True
    numbers = page.text("numbers").splitlines()
    figures = dict(zip(numbers[::2], numbers[1::2], strict=True))
    assert figures["tags mapped"] == "0, 3 seen"
    assert page("return groups.free.getObjectByName('first look') !== undefined")
    # The scan's triangles, from the two rays to the right of a gap to the last: shapely's area, but for cells.
    places = [np.array([0.4 * t, 0.0]) for t in np.arange(0.0, 1.1, 0.25)]
    area = shapely.union_all([shapely.Polygon([place, *(ENDS + place)]) for place in places]).area
    assert float(figures["floor seen"].split()[0]) == pytest.approx(area, abs=1.0)
    assert "The robot's first look" in page.text("choice")
    assert "The robot's first look" in page("return element('phase').title")
    page.seek(2.1)
    assert page("return [groups.free.getObjectByName('first look') ?? null, sightedTags(time)]")[0] is None
    assert "first look" not in page.text("choice")


def test_the_camera_sees_no_farther_than_the_scan(page):
    page.seek(6.0)
    corners = np.array(page("return [...groups.camera.getObjectByName('cone').geometry.attributes.position.array]"))
    corners = corners.reshape(-1, 3)[2:, :2]
    reach, bearing = np.hypot(*corners.T), np.arctan2(corners[:, 1], corners[:, 0])
    ahead = (bearing > -0.1) & (bearing < 0.46)  # where the wall is
    assert ahead.sum() >= 3
    assert np.all(corners[ahead, 0] <= 1.0 + 1e-3)
    assert reach.max() == pytest.approx(2.0, abs=1e-3)  # its range, where nothing is in the way
    assert np.abs(bearing).max() <= 1.0 + 1e-6


def test_who_moved_the_robot_is_marked_in_the_time_line(page):
    marks = "return [...element('marks').children].map((mark) => [mark.title, parseFloat(mark.style.left)])"
    page.seek(9.0)
    scripted, pushed = page(marks)  # The scenario's second is after the end.
    assert scripted == ["7.0 s: Slip or push of the scenario: 0.00 m ahead, -0.20 m to its left, turned by 30°", 70]
    assert pushed == ["4.0 s: Somebody has pushed the robot: 0.00 m ahead, 0.50 m to its left, turned by 30°", 40]
    page.driver.find_element("css selector", "#marks i:last-child").click()
    assert page("return time") == 4


def test_there_is_a_scale_from_above(page):
    page.seek(6.0)
    bar = "return [parseFloat(element('scale').style.width) * metresPerPixel(), element('scale').textContent]"
    length, text = page(bar)
    assert f"{length:.3g} m" == text
    page.click("mode")
    page.until("return element('scale').hidden")  # by the next picture
    page.click("mode")


@pytest.mark.parametrize("flat", [True, False])
def test_every_layer_can_be_shown_and_hidden(page, flat):
    page.seek(6.0)
    if not flat:
        page.click("mode")
    before = page.picture(anew=True)
    for name in LAYERS if flat else ("walls", "map", "camera"):
        shown = page("return document.getElementById(arguments[0]).checked", f"layer-{name}")
        page.click(f"layer-{name}")
        assert page("return groups[arguments[0]].visible", name) is not shown
        assert page.picture(anew=True) != before, name
        page.click(f"layer-{name}")
        assert page.picture(anew=True) == before, name
    if not flat:
        page.click("mode")


def test_chart_and_numbers_count_walls_where_there_are_no_tags(page):
    """The series of tags, then of walls too, emptied for a moment."""
    without = """
        const kept = [series.tags.values, series.walls.values], walls = arguments[0];
        series.tags.values = kept[0].map(() => 0);
        if (!walls) series.walls.values = kept[1].map(() => 0);
        tell();
        const said = [document.querySelector("#plots span").textContent, document.getElementById("numbers").innerText];
        [series.tags.values, series.walls.values] = kept;
        tell();
        return said;
    """
    page.seek(9.0)
    assert page("return document.querySelector('#plots span').textContent") == "tags mapped"
    for walls, name, number in ((True, "walls mapped", "2"), (False, "landmarks mapped", "0")):
        chart, numbers = page.driver.execute_script(without, walls)
        assert chart == name
        assert f"{name}\n{number}\n" in numbers
        assert "tags" not in numbers


def test_walls_that_are_landmarks_are_bands_of_three_deviations(page):
    band = "return [...groups.wall_landmarks.getObjectByName('spread').geometry.attributes.position.array]"
    named = "return groups.wall_landmarks.children.map((object) => object.name).sort()"
    page.seek(3.0)
    assert page(named) == []
    page.seek(9.0)
    assert page(named) == ["lines", "spread"]
    # Of the second one the line is wider.
    corners = np.reshape(page(band), (-1, 3))[1:, :2]
    np.testing.assert_allclose(corners, [[-0.9, -2.3], [1.5, -2.9], [1.5, -1.1], [-0.9, -1.7]], atol=1e-3)
    assert page("return document.getElementById('layer-wall_landmarks').parentElement.hidden") is False


def test_from_above_and_in_space(page):
    page.seek(6.0)
    before = page.picture(anew=True)
    page.click("mode")
    assert page("return viewer.camera.isPerspectiveCamera") is True
    assert page.text("mode") == "2D"
    assert page.picture(anew=True) != before
    page.click("mode")
    assert page("return viewer.camera.isOrthographicCamera") is True
    assert page.picture(anew=True) == before


def test_the_whole_building_is_in_any_window(page):
    corners = """return WALLS.map(([x, y]) => {
        const p = world.localToWorld(new T.Vector3(x, y, 0)).project(viewer.camera);
        const box = element("scene").getBoundingClientRect();
        return [box.left + (p.x + 1) / 2 * box.width, box.top + (1 - p.y) / 2 * box.height];
    })""".replace("WALLS", "[[0, 0], [6, 0], [6, 4], [0, 4]]")
    try:
        for size in ((1200, 500), (640, 800), (820, 560)):
            page.driver.set_window_size(*size)
            page.until("return Math.abs(innerWidth - arguments[0]) < 3 && shownBounds !== ''", size[0])
            for _ in range(2):
                page("dirty = true; render()")
                places = np.array(page(corners))
                side = page("const r = element('side').getBoundingClientRect(); return [r.left, r.top]")
                bar = page("return element('bar').getBoundingClientRect().bottom")
                assert places[:, 1].min() > bar
                assert places[:, 0].min() > 0
                assert places[:, 0].max() < side[0] or places[:, 1].max() < side[1]
                page.click("mode")
    finally:
        page.driver.set_window_size(820, 560)


def test_follow_and_fit(page):
    page.seek(6.0)
    page.click("follow")
    assert page("return following") is True
    page("time = 8; render()")
    target, robot = page("return viewer.controls.target.toArray()"), page("return robotPlace()")
    offset = page("return offset()")
    np.testing.assert_allclose([target[0] - offset[0], target[2] - offset[1]], [robot[0], -robot[1]], atol=1e-3)
    page.click("fit")
    assert page("return [following, framed]") == [False, True]
    # Whoever moves the camera keeps it, until he asks for the whole again.
    page("viewer.controls.dispatchEvent({ type: 'start' })")
    assert page("return framed") is False
    page.click("fit")
    assert page("return framed") is True


def test_play_hold_and_the_keys(page):
    page.seek(0.0)
    page.click("play")
    page.until("return time > 0.5")
    page.click("play")
    assert page("return playing") is False
    page("element('rate').value = '64'")
    page.click("play")
    page.until("return time >= timeline.end && !playing")
    send = "document.dispatchEvent(new KeyboardEvent('keydown', { key: arguments[0] })); return time"
    page.seek(0.0)
    assert [page(send, "ArrowRight") for _ in range(4)] == [2, 5, 8, 10]
    assert [page(send, "ArrowLeft") for _ in range(4)] == [8, 5, 2, 0]
    for key, state in (("v", "!flat"), ("v", "flat"), ("f", "following"), ("0", "!following")):
        page(send, key)
        assert page(f"return {state}") is True, key


def test_dark_and_light(page):
    page.seek(6.0)

    def background(scheme):
        feature = {"name": "prefers-color-scheme", "value": scheme}
        page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
        page.until("return dark.matches === arguments[0]", scheme == "dark")
        page.until(
            "return [...materials.values()].every((m) => `#${m.color.getHexString()}` === colour(m.userData.name))"
        )
        return page.picture(), page("return getComputedStyle(document.body).backgroundColor")

    light, night = background("light"), background("dark")
    assert light[0] != night[0]
    assert light[1] != night[1]
    assert background("light") == light


def test_what_the_text_counts_is_what_is_numbered(page):
    """A goal that is planned anew while the gains stay as they are."""
    page.seek(8.1)
    try:
        page("""const { times, records } = timeline.layers.get("goal"), one = records[0];
            times.push(8.2);
            records.push({ ...one, time: 8.2, arrays: { ...arrays(one), tour: new Float32Array([1, 1, 2, 1]) } });""")
        page.seek(8.3)
        assert page("return groups.tour.getObjectByName('stops').children.length") == 2
        assert "A tour of 2 stops" in page.text("choice")
    finally:
        page("for (const name of ['times', 'records']) timeline.layers.get('goal')[name].pop()")


def test_an_area_to_keep_out_of_is_drawn_by_clicks_and_told_as_a_setting(page):
    from selenium.webdriver import ActionChains

    page.seek(6.0)
    scene = page.driver.find_element("id", "scene")
    corners = np.array([[1.0, -1.0], [2.0, -1.0], [2.0, 0.0]])  # in M, which lies at (1, 2)

    def click(corner):
        x, y = page(
            """render();
            const p = map.localToWorld(new T.Vector3(...arguments, 0)).project(viewer.camera);
            return [p.x * element("scene").clientWidth / 2, -p.y * element("scene").clientHeight / 2];""",
            *corner.tolist(),
        )
        ActionChains(page.driver).move_to_element_with_offset(scene, round(x), round(y)).click().perform()

    page.click("keep")
    for corner in [*corners, corners[0]]:
        click(corner)
    text = page("return document.querySelector('#areas code').textContent")
    (area,) = json.loads(text.removeprefix("--set explorer.keep_out='").removesuffix("'"))
    np.testing.assert_allclose(area, corners + np.array([1.0, 2.0]), atol=0.05)  # A pixel is a centimetre or two.
    assert page("return areas.drawn.children.map((one) => one.name)") == ["edges"]
    page("[...document.querySelectorAll('#areas button')].find((one) => one.textContent === 'Undo').click()")
    page.click("keep")
    assert page("return [element('areas').hidden, areas.drawn.children.length, armed]") == [True, 0, ""]


def test_on_a_telephone_nothing_is_cut(driver, live):
    live.begin()
    page = Page(driver, live.cockpit.address)
    page.until("return element('request-end') !== null && timeline.at('mission', time) !== null")
    size = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": False}
    try:
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        page.until("return innerWidth === 390")
        cut = page("""const shown = [...document.querySelectorAll("header *, footer *, #view button")];
            return shown.filter((one) => one.offsetParent).filter((one) => {
              const { left, right } = one.getBoundingClientRect(),
                inside = one.clientWidth && one.scrollWidth > one.clientWidth + 1;
              return left < 0 || right > 390 || inside;
            }).map((one) => one.id || one.tagName);""")
        assert cut == []
        assert page("return element('slider').clientWidth") > 300
    finally:
        driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_of_a_recording_neither_camera_nor_wheels_are_shown(driver, tmp_path):
    with TimelineWriter(tmp_path / "timeline.tfg") as writer:
        writer.write("world", 0.0, {}, title="log", radius=0.18, rule="", simulated=True, camera=None, wheels=False)
        writer.write("enabled", 0.0, {}, enabled=True)
        drive(writer, 1.0)
    export_page(tmp_path / "timeline.tfg", tmp_path / "log.html", "log", viewer_script())
    page = Page(driver, (tmp_path / "log.html").as_uri())
    assert page("return robot.visible") is True
    assert page.text("wheels") == ""
    assert page("return [groups.camera.children.length, element('layer-camera').parentElement.hidden]") == [0, True]


def test_a_recording_that_is_mapped_has_its_clock_and_its_end_to_ask_for_and_no_wheels(driver, tmp_path):
    live = Live(tmp_path)
    with live.cockpit, live.writer:
        live.writer.write(
            "world", 0.0, {}, title="log", radius=0.18, rule="", simulated=True, camera=None, wheels=False
        )
        drive(live.writer, 1.0)
        live.writer.flush()
        live.cockpit.follow(live.path)
        page = Page(driver, live.cockpit.address)
        page.until("return element('clock-rate') !== null")
        shown = page("return [...document.querySelectorAll('header button:not([hidden])')].map((one) => one.id)")
        assert shown == [f"request-{what}" for what in ("hold", "resume", "step", "end")]
        assert page("return element('keep').hidden")
        page("for (const key of ' a') document.dispatchEvent(new KeyboardEvent('keydown', { key }))")
        page.click("request-end")
        assert (live.asked(), page("return armed")) == (["end"], "")


def test_the_floor_of_a_grid_is_its_free_cells(driver, tmp_path):
    with TimelineWriter(tmp_path / "timeline.tfg") as writer:
        begin(writer)
        for time, last in ((1.0, 0.05), (3.0, 1.95)):
            drive(writer, time)
            runs = {
                "free": np.array([[0.05, 0.05, last, 0.05], [0.05, 0.15, 1.95, 0.15]]),
                "occupied": np.zeros((0, 4)),
            }
            writer.write("grid", time, runs, resolution=0.1, stage=1)
    export_page(tmp_path / "timeline.tfg", tmp_path / "room.html", "room", viewer_script())
    page = Page(driver, (tmp_path / "room.html").as_uri())
    np.testing.assert_allclose(page("return [value(area, 1.5), value(area, 3.0)]"), [0.21, 0.4], atol=1e-6)


def test_where_a_session_is_in_its_map_is_told_until_it_is_found(driver, tmp_path):
    with TimelineWriter(tmp_path / "timeline.tfg") as writer:
        begin(writer)
        for time, places in ((0.0, 0), (1.0, 3), (2.0, 1), (3.0, -1)):
            drive(writer, time)
            writer.write("places", time, {}, places=places)
        writer.write("pose", 2.75, {"pose": np.array([2.75, 2.0, 0.0, 1e4, 0.0, 1e4, 1e2], dtype=np.float32)})
        writer.write("pose", 3.125, {"pose": np.array([7.5, 2.0, 0.0, 1e-2, 0.0, 2e-2, 1e-3], dtype=np.float32)})
    export_page(tmp_path / "timeline.tfg", tmp_path / "room.html", "room", viewer_script())
    page = Page(driver, (tmp_path / "room.html").as_uri())
    told = []
    for at in (0.5, 1.5, 2.75, 3.125):
        page.seek(at)
        numbers = page.text("numbers").splitlines()
        shown = dict(zip(numbers[::2], numbers[1::2], strict=True))
        told.append((shown.get("place in its map"), shown["stated uncertainty"]))
    assert told == [
        ("not found yet", "12.2 cm"),
        ("one of 3", "12.2 cm"),
        ("not found yet", "not known yet"),
        (None, "12.2 cm"),
    ]
    assert shown["driven"] == "1.2 m"  # The jump to its place is no way.


@pytest.mark.parametrize("flat", [True, False])
def test_a_place_that_is_clicked_is_found_on_the_floor(page, flat):
    page.seek(6.0)
    if not flat:
        page.click("mode")
    place = page(
        """render();
        const p = map.localToWorld(new T.Vector3(2, -1, 0)).project(viewer.camera);
        const box = viewer.renderer.domElement.getBoundingClientRect();
        const found = placeAt({
          clientX: box.left + (p.x + 1) / 2 * box.width,
          clientY: box.top + (1 - p.y) / 2 * box.height,
        });
        return [found.x, found.y];"""
    )
    np.testing.assert_allclose(place, [2.0, -1.0], atol=1e-3)
    if not flat:
        page.click("mode")


@pytest.mark.slow
@pytest.mark.parametrize("write", [write_gif, write_mp4])
def test_a_film_shows_the_mission_to_its_end(driver, exported, tmp_path, write):
    said, out = [], tmp_path / f"film.{write.__name__[-3:]}"
    write(exported, out, said.append, 3)
    assert said[-1] == "filming the mission, picture 3 of 3"
    if write is write_gif:
        frames = [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(Image.open(out))]
    else:
        film = cv2.VideoCapture(str(out))
        frames = [film.read()[1] for _ in range(3)]
        assert not film.read()[0]
    assert len(frames) == 3
    assert all(np.any(one != other) for one, other in itertools.pairwise(frames))


# What a browser would run, were it read as HTML.
SCRIPT = "<img src=x onerror='window.ran = 1'><script>window.ran = 1</script>"


def hostile(told, numbers, name=""):
    """The contents of a record with a script in every string, or in place of every number that is shown."""
    if isinstance(told, dict):
        return {key: hostile(value, numbers, key) for key, value in told.items()}
    if isinstance(told, list) and name != "at":
        return [hostile(one, numbers, name) for one in told]
    if isinstance(told, str):
        return told if numbers else SCRIPT + told
    return SCRIPT if numbers and isinstance(told, int | float) and name in SHOWN else told


# Of the summary what the end's card does not show.
FIELDS = [
    "heading_error_rad",
    "real_time_factor",
    "landmarks_doubtful",
    "min_clearance_m",
    "walls_mapped",
    "least_known",
    "changes",
]
# The page's own.
SCRIPTS = 3
SHOWN = [*SUMMARY, "mean", "stage", "entropy", "views", *EXPLAINED[0]]


def written_hostile(path, monkeypatch, numbers):
    """A mission's file whose words or numbers are script."""
    write = TimelineWriter.write
    with monkeypatch.context() as patch:
        patch.setattr(TimelineWriter, "write", lambda *given, **told: write(*given, **hostile(told, numbers)))
        write_mission(path)
    return path


@pytest.mark.parametrize("numbers", [False, True], ids=["words", "numbers"])
def test_script_in_a_runs_file_is_text(driver, tmp_path, monkeypatch, numbers):
    path, out = written_hostile(tmp_path / "timeline.tfg", monkeypatch, numbers), tmp_path / "mission.html"
    export_page(path, out, f"{SCRIPT}{{{{DATA}}}}", viewer_script())
    page = Page(driver, out.as_uri())
    for seconds in (0.0, *(time_s + 0.1 for time_s in STAGES), 10.0):
        page.seek(seconds)
        assert page("return document.querySelectorAll('img, body script:not([id])').length") == SCRIPTS
        assert page("return window.ran") is None
    shown = page("return document.body.innerText")
    assert shown.count(SCRIPT) >= (2 if numbers else 4), shown
    assert page.complaints() == []
    # Were anything read as HTML all the same, the browser would not run it.
    page("document.getElementById('card').innerHTML = arguments[0]", SCRIPT)
    page.until("return document.querySelector('#card img').complete")
    assert any("Content Security Policy" in one for one in page.complaints())
    assert page("return window.ran") is None


class Live:
    """A mission under way that this test drives."""

    def __init__(self, folder, *, simulated=True):
        self.path = folder / "timeline.tfg"
        rate = 4.0 if simulated else None
        self.cockpit = Cockpit(viewer_script(), "room", rate=rate)
        self.writer = TimelineWriter(self.path, lambda: self.cockpit.watched)
        self.simulated = simulated

    def begin(self):
        begin(self.writer, simulated=self.simulated)
        self.writer.flush()
        self.cockpit.follow(self.path)

    def drive(self, time, number=None):
        drive(self.writer, time)
        if number is not None:
            stage(self.writer, number, time)
        self.writer.flush()

    def until(self, condition):
        limit = time.monotonic() + 60.0
        while not (found := condition()):
            assert time.monotonic() < limit
            time.sleep(0.01)
        return found

    def asked(self):
        return self.until(lambda: list(self.cockpit.requests()))


@pytest.fixture(params=[True, False], ids=["simulated", "robot"])
def live(request, tmp_path):
    live = Live(tmp_path, simulated=request.param)
    with live.cockpit, live.writer:
        yield live


def test_a_recorded_mission_is_played_until_the_live_one_begins(driver, mission, tmp_path):
    path = tmp_path / "timeline.tfg"
    with Cockpit(viewer_script(), "room", recorded=mission, rate=8.0) as cockpit, TimelineWriter(path) as writer:
        cockpit.word = "compiling kernels, about 2 min left"
        page = Page(driver, cockpit.address)
        told = "A recorded mission; yours begins by itself. Compiling kernels, about 2 min left"
        page.until("return element('notice').innerText === arguments[0]", told)
        page.until("return playing && time > 9")
        page.until("return playing && time < 2")  # from the beginning once more
        assert not any(page.driver.find_element("id", name).is_displayed() for name in ("live", "send", "drive"))
        begin(writer)
        writer.flush()
        cockpit.follow(path)
        page.until("return typeof SOURCE !== 'undefined' && SOURCE.live && timeline.layers.has('pose')")
        page.until("return element('notice').hidden && element('stop').checkVisibility()")
        assert page.complaints() == []


@pytest.mark.slow
def test_a_mission_under_way(driver, live):
    live.cockpit.word = "compiling kernels, 3 of 133"
    page = Page(driver, live.cockpit.address)
    page.until("return element('notice').innerText === arguments[0]", live.cockpit.word)
    live.begin()
    page.until("return element('notice').hidden")
    simulated = live.simulated
    page.until("return element('wheels').innerText === 'wheels enabled'")
    for name in ("stop", "live", "request-hold", "request-step", "request-recall", "request-end", "request-enable"):
        assert page.driver.find_element("id", name).is_displayed(), name
    assert page.text("request-enable") == ("Enable wheels" if simulated else "Start")

    # What happens is shown, whatever was looked at before.
    live.drive(2.0, 1)
    page.until("return time > 1.99 && stageTimes.length === 1")
    page.seek(0.0)
    assert page("return live") is False
    live.drive(3.0)
    page.until("return timeline.end === 3")
    assert page("return time") == 0
    page.click("live")
    page.until("return time > 2.99")

    page.click("stop")
    assert live.asked() == ["stop"]
    live.writer.write("enabled", 3.0, {}, enabled=False)
    live.writer.flush()
    page.until("return element('wheels').innerText === 'wheels stopped'")
    page.click("request-enable")
    assert live.asked() == ["enable"]
    page.click("request-recall")
    assert live.asked() == ["recall"]
    if simulated:
        page.click("request-push")
        assert live.asked() == ["push"]
        page.click("request-hold")
        page.until("return element('clock').dataset.held === 'true'")
        assert live.cockpit.clock.held
        page.until("return element('request-hold').disabled && !element('request-resume').disabled")
        page.click("request-resume")
        page.until("return element('clock').dataset.held === 'false'")
        live.cockpit.at_stage(1)
        page.click("request-step")
        live.until(lambda: live.cockpit.clock.stepping)
        live.cockpit.at_stage(2)
        page.until("return element('clock').dataset.held === 'true'")
        page("element('clock-rate').value = '8'; element('clock-rate').dispatchEvent(new Event('change'))")
        live.until(lambda: live.cockpit.clock.rate == 8.0)
        page.until("return element('clock-rate').value === '8'")
    else:
        idle = "return ['hold', 'resume', 'enable'].map((what) => element(`request-${what}`).disabled).join()"
        page.until(f"{idle} === 'false,true,false'")
        page.click("request-hold")
        assert live.asked() == ["hold"]
        live.writer.write("mission", 3.0, {}, phase="paused", stage=1, outcome="", reason="", drives=False)
        live.writer.flush()
        page.until(f"{idle} === 'true,true,false'")  # It waits for the wheels.
        live.writer.write("enabled", 3.0, {}, enabled=True)
        live.writer.flush()
        page.until(f"{idle} === 'true,false,true'")
        for what in ("resume", "step"):
            page.click(f"request-{what}")
            assert live.asked() == ["resume"]
    assert simulated or not page("return element('numbers').innerText.includes('speed')")
    page("document.dispatchEvent(new KeyboardEvent('keydown', { key: ' ' }))")
    assert live.asked() == ["stop"]
    page.click("request-end")
    assert live.asked() == ["end"]

    live.drive(9.0, 2)
    end(live.writer)
    page.until("return !element('card').hidden && element('stop').hidden")
    assert "Mission complete" in page.text("card")
    assert page.text("controls") == "The mission is over."
    assert page("return document.querySelectorAll('header button:not([hidden]), header select').length") == 0
    assert page.complaints() == []


def test_whatever_the_status_says_nothing_moves(driver, live):
    """The words give way: all of them are in the title."""
    words = "waits for the wheels to be enabled, and for somebody who reads all of this"
    places = """PHASES.observe = arguments[0]; timeline.at("mission", time).told.phase = arguments[0];
        timeline.at("mission", time).told.stage = 1; tell();
        return ["bar", "stop", "request-hold", "request-end", "clock-rate", "scene", "wheels"].map((name) => {
          const { left, right, top, bottom } = element(name)?.getBoundingClientRect() ?? {};
          return [left, right, top, bottom];
        });"""
    if not live.simulated:
        pytest.skip("the robot's bar has fewer buttons")
    live.begin()
    try:
        page = Page(driver, live.cockpit.address)
        page.until("return element('clock-rate') !== null && timeline.at('mission', time) !== null")
        for width in (1024, 1100, 1200, 1366, 1600):
            driver.set_window_size(width, 600)
            page.until("return Math.abs(innerWidth - arguments[0]) < 3", width)
            short, long = page(places, "map"), page(places, words)
            assert long == short, width
            assert len({top for _, _, top, _ in short[:1]}) == 1
            assert short[0][3] < 50, width  # It is one line,
            assert all(right <= width for _, right, _, _ in short), width  # and all of it is in the window.
            assert page("const { scrollWidth, clientWidth } = element('clock-rate'); return scrollWidth <= clientWidth")
            assert words in page("return element('phase').title")
            assert page("return element('phase').scrollWidth > element('phase').clientWidth")
    finally:
        driver.set_window_size(820, 560)


@pytest.mark.slow
def test_the_robot_is_sent_and_driven(driver, tmp_path):
    from selenium.webdriver import ActionChains

    live = Live(tmp_path)
    with live.cockpit, live.writer:
        live.begin()
        live.drive(2.0, 1)
        page = Page(driver, live.cockpit.address)
        page.until("return stageTimes.length === 1")
        assert not page.driver.find_element("id", "send").is_displayed()
        live.cockpit.sends = live.cockpit.drives = True
        page.until("return !element('send').hidden && !element('drive').hidden")

        scene = page.driver.find_element("id", "scene")

        def click():
            x, y = page("""render();
                const p = map.localToWorld(new T.Vector3(2, -1, 0)).project(viewer.camera);
                return [p.x * element("scene").clientWidth / 2, -p.y * element("scene").clientHeight / 2];""")
            ActionChains(driver).move_to_element_with_offset(scene, round(x), round(y)).click().perform()

        click()
        assert list(live.cockpit.requests()) == []  # Who has not asked for it only looks.
        page.click("send")
        click()
        (place,) = live.asked()
        np.testing.assert_allclose(place, [2.0, -1.0], atol=0.05)  # A pixel is a centimetre or two.
        assert page("return asked.children.length") == 1
        live.drive(3.0, 2)
        page.until("return asked.children.length === 0")

        page.click("drive")
        assert page("return [element('send'), element('drive')].map((b) => b.getAttribute('aria-pressed'))") == [
            "false",
            "true",
        ]
        page("document.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowUp' }))")
        assert live.until(lambda: list(live.cockpit.keys())) == ["forward"]
        pad = "{ axes: [0, arguments[0], 0, 0], buttons: [{ pressed: arguments[1] }, { pressed: false }] }"
        page(f"const pad = {pad}; navigator.getGamepads = () => [null, pad];", -0.5, False)
        assert "stick 0.50 0.00" in live.until(lambda: list(live.cockpit.keys()))
        page(f"const pad = {pad}; navigator.getGamepads = () => [pad];", 0.05, True)
        pressed = []
        live.until(lambda: pressed.extend(live.cockpit.keys()) or {"stick 0.00 0.00", "look"} <= set(pressed))
        page("document.dispatchEvent(new KeyboardEvent('keydown', { key: 'Escape' }))")
        assert "halt" in live.until(lambda: list(live.cockpit.keys()))
        assert page.complaints() == []


class Futures:
    """A fork that this test drives."""

    def __init__(self, timeline):
        self.timeline, self.is_running, self.rows, self.asked = timeline, False, [], []

    def start(self, stage, goal):
        self.asked.append((stage, goal))
        self.is_running = True
        return True

    def state(self):
        said = {"folder": f"runs/fork{SCRIPT}", "line": f"5 s  stage 1{SCRIPT}", "failure": ""}
        told = {"stage": 2, "rows": self.rows, **said}
        return {"number": len(self.asked), "running": self.is_running, **told}


@pytest.mark.slow
def test_a_run_is_forked_on_its_page(driver, mission, tmp_path):
    forks = Futures(tmp_path / "fork.tfg")
    with (
        Cockpit(viewer_script(), "room", timeline=mission, live=False, controls=False, forks=forks) as cockpit,
        TimelineWriter(forks.timeline) as writer,
    ):
        page = Page(driver, cockpit.address)
        page.seek(5.2)
        assert "Click another candidate of stage 2" in page.text("fork")
        page("document.querySelectorAll('tr[data-row]')[1].click()")
        page.click("request-fork")
        page.until("return forks.number === 1")
        assert forks.asked == [(2, (2.0, 3.0))]  # (1, 1) in M
        page.until("return element('fork').textContent.includes('5 s  stage 1')")
        begin(writer)
        for time_s in np.arange(0.25, 12.01, 0.25):
            drive(writer, time_s)
        writer.flush()
        page.until("return Number(element('slider').max) === 12")
        page.seek(12.0)
        np.testing.assert_allclose(page("return forkRobot.position.toArray().slice(0, 2)"), [4.8, 0.0], atol=1e-5)
        assert page("return robot.position.x") == pytest.approx(4.0)  # The run itself was over by then.
        rows = [["", "run", f"fork{SCRIPT}", "difference"], [f"time{SCRIPT}", "10 s", "12 s", "+2 s"]]
        forks.rows, forks.is_running = rows, False
        page.until("return element('fork').innerText.includes('+2 s')")
        assert page.text("fork").count("<img") == 3
        assert "runs/fork" in page.text("fork")
        assert page.complaints() == []


@pytest.mark.slow
def test_two_pages_one_reloaded_and_one_closed_in_the_middle(driver, tmp_path):
    live = Live(tmp_path)
    with live.cockpit, live.writer:
        live.begin()
        # Without the token a page can stop and nothing else.
        first = Page(driver, live.cockpit.address.partition("#")[0])
        first.until("return timeline.layers.has('pose')")
        first.click("request-hold")
        first.until("return !element('notice').hidden")
        assert "Only who has the whole address" in first.text("notice")
        assert not live.cockpit.clock.held
        window = driver.current_window_handle
        driver.switch_to.new_window("tab")
        second = Page(driver, live.cockpit.address)
        live.drive(2.0, 1)
        second.until("return stageTimes.length === 1")
        driver.refresh()
        live.drive(5.0, 2)
        second.until("return document.body.dataset.ready === 'true' && stageTimes.length === 2")
        driver.close()
        driver.switch_to.window(window)
        live.drive(8.0, 3)
        first.until("return stageTimes.length === 3")
        first.click("stop")
        assert live.asked() == ["stop"]


def test_a_page_that_cannot_draw_stops_the_robot_all_the_same(driver):
    with Cockpit("/* no viewer */", "room") as cockpit:
        driver.get("about:blank")
        driver.get(cockpit.address)
        limit = time.monotonic() + 60.0
        while "This page has failed" not in driver.find_element("id", "notice").text:
            assert time.monotonic() < limit
            time.sleep(0.02)
        driver.find_element("id", "stop").click()
        while not (requests := list(cockpit.requests())):
            assert time.monotonic() < limit
            time.sleep(0.01)
        assert requests == ["stop"]


@pytest.mark.slow
def test_where_no_wall_is_a_landmark_no_layer_is_named(driver, small_map, tmp_path):
    write_map_timeline(small_map, tmp_path / "timeline.tfg", "tags")
    export_page(tmp_path / "timeline.tfg", tmp_path / "map.html", "tags", viewer_script())
    page = Page(driver, (tmp_path / "map.html").as_uri())
    assert page("return document.getElementById('layer-map').parentElement.hidden") is False
    assert page("return document.getElementById('layer-wall_landmarks').parentElement.hidden") is True
