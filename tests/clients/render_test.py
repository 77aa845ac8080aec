"""Tests `crumple render` with the recordings of the repository, and with baked boxes: the pictures, and the errors.

    python tests/clients/render_test.py build/crumple [unittest's options]
"""

import argparse
import itertools
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

import numpy as np
from PIL import Image

from crumple import Obstacle, Pose, Recording, Shape, car_sheet
from crumple.render import BEFORE, Moment, Stage, find_clips, matrix, obstacle_mesh, read_film, sheet_moments
from crumple.trace import Scene

ROOT = pathlib.Path(__file__).resolve().parents[2]
POLE = ROOT / "recordings/built_in_pole.mcap"
PROGRAM = pathlib.Path(sys.argv[1]).resolve()
ITSELF = argparse.Namespace(recording="", cars=None, start=None, to=None)


def paint(pixels):
    """The first car's."""
    r, g, b = (pixels[..., k].astype(int) for k in range(3))
    return (r > 2 * g) & (g > b)


def steel(pixels):
    r, g, b = (pixels[..., k].astype(int) for k in range(3))
    return (r > 2 * b) & (r < 1.6 * g)


def told(pattern):
    """Returns a number that `crumple info` prints about the pole's recording."""
    text = subprocess.run([PROGRAM, "info", POLE], text=True, capture_output=True, check=True).stdout
    return float(re.search(pattern, text).group(1))


class ThePictures(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        with Recording(POLE) as recording:
            cls.clip, = find_clips(recording, recording.reactions(), ITSELF)
            cls.film = read_film(recording, cls.clip, 1 / 60)
        cls.stage = Stage(cls.film, {"car": (0.74, 0.24, 0.05)}, 320, 180)

    def test_the_clip_goes_from_before_the_first_contact_to_rest(self):
        self.assertAlmostEqual(self.clip.first, told(r"car car  at ([0-9.]+) s"), 2)
        self.assertLess(self.clip.start, self.clip.first - 0.8 * BEFORE)
        self.assertGreater(self.clip.end, self.clip.last + 0.3)
        self.assertLess(self.clip.end - self.clip.start, 1.2)
        moments = self.film.moments
        self.assertEqual(len(moments), round(60 * (moments[-1].time - moments[0].time)) + 1, "a tick is missing")

    def test_what_dents_changes_in_the_picture_and_nothing_else(self):
        first, last = self.film.moments[0], self.film.moments[-1]
        vertex, dent = last.vertex["car"], last.dent["car"]
        still = dent < 1e-3
        a, b = first.vertex["car"][still], vertex[still]
        u, _, v = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
        turn = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
        whole = Moment(last.time, {"car": (first.vertex["car"] - a.mean(0)) @ turn + b.mean(0)}, last.dent, last.obstacles)
        pictures = [self.stage.scene(moment).picture(self.stage.camera).astype(int) for moment in (whole, last)]
        differs = np.abs(pictures[0] - pictures[1]).sum(2) > 30
        camera = self.stage.camera

        def places(points):
            at = (points - camera.eye) @ camera.axes.T
            x, y = camera.width / 2 + camera.focal * at[:, 0] / at[:, 2], camera.height / 2 - camera.focal * at[:, 1] / at[:, 2]
            return tuple(np.stack([y, x]).astype(int))

        dented, rear = (places(vertex[which]) for which in (dent > 0.2, vertex[:, 0] < vertex[:, 0].min() + 1.0))
        self.assertGreater(differs[dented].mean(), 0.3)
        self.assertLess(differs[rear].mean(), 0.03)
        self.assertGreater(paint(pictures[1]).mean(), 0.05)

    def test_the_camera_sees_what_dented_past_the_obstacle(self):
        with Recording(ROOT / "recordings/m130_wall.mcap") as recording:
            clip, = find_clips(recording, recording.reactions(), ITSELF)
            film = read_film(recording, clip, 1 / 60)
        stage = Stage(film, {"car": (0.74, 0.24, 0.05)}, 320, 180)
        for moment in (max(film.moments, key=lambda moment: moment.dent["car"].max()), film.moments[-1]):
            dented = moment.vertex["car"][film.moments[-1].dent["car"] > 0.1]
            toward = stage.camera.eye - dented
            toward /= np.linalg.norm(toward, axis=1, keepdims=True)
            self.assertGreater(stage.scene(moment).reached(dented + 0.02 * toward, toward).mean(), 0.2)

    def test_things_throw_shadows_on_the_ground(self):
        moment = self.film.moments[-1]
        image = self.stage.scene(moment).picture(self.stage.camera).astype(int)
        grey = image[np.ptp(image, axis=2) < 14].mean(1)
        self.assertLess(np.quantile(grey, 0.02), 0.6 * np.median(grey))
        self.assertGreater(np.median(grey), 150)

    def test_obstacles_are_closed_and_where_they_are(self):
        rng = np.random.default_rng(1)
        corners = tuple(map(tuple, rng.uniform(-1, 1, (60, 3)).tolist())) + tuple(itertools.product((-1, 1), (-1, 1), (-1, 1)))
        turned = Pose((4, 5, 6), (0.0, 0.6, 0.0, 0.8))
        far = np.full(3, 50.0)
        direction = rng.normal(size=(500, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        for obstacle in (Obstacle(1, Shape.box, (1, 2, 3), turned), Obstacle(2, Shape.sphere, (1, 0, 0), turned),
                         Obstacle(3, Shape.capsule, (0.5, 2, 0), turned), Obstacle(4, Shape.hull, pose=turned, points=corners)):
            scene = Scene([obstacle_mesh(obstacle, -far, far)])
            self.assertFalse(scene.reached(np.tile(turned.position, (500, 1)), direction).any(), obstacle.shape)
            most = {Shape.box: 14**0.5, Shape.sphere: 1, Shape.capsule: 2.5, Shape.hull: 3**0.5}[obstacle.shape]
            self.assertAlmostEqual(np.linalg.norm(scene.vertex - turned.position, axis=1).max(), most, 3)
            self.assertIsNone(obstacle_mesh(obstacle, far, far + 1))
        cut = obstacle_mesh(Obstacle(1, Shape.box, (1, 20, 20)), np.full(3, -2.0), np.full(3, 2.0))
        self.assertEqual(np.abs(cut.vertex).max(0).tolist(), [1, 2, 2])

    def test_a_time_without_contact_is_shown_as_well(self):
        with Recording(POLE) as recording:
            clip, = find_clips(recording, recording.reactions(0, 0.5), ITSELF)
            self.assertEqual((clip.start, clip.end, clip.cars), (recording.start, recording.end, ["car"]))
            film = read_film(recording, clip, 0.5)
            stage = Stage(film, {"car": (0.74, 0.24, 0.05)}, 128, 96)
            image = stage.scene(film.moments[-1]).picture(stage.camera)
        self.assertGreater(paint(image).mean(), 0.003)

    def test_moments_of_the_sheet_lie_close_where_the_car_gives_way(self):
        chosen = sheet_moments(self.film, 9)
        times = np.array([self.film.moments[i].time - self.clip.first for i in chosen])
        self.assertEqual((len(set(chosen)), chosen[-1]), (9, len(self.film.moments) - 1))
        self.assertGreaterEqual(((times >= 0) & (times < 0.1)).sum(), 3)
        self.assertLess(times[0], -0.1)

    def test_cars_stand_where_the_reactions_say(self):
        with Recording(POLE) as recording:
            rows, mesh = recording.reactions(), recording.at(1.0).mesh(recording.lives[0].asset)
            self.assertGreater(recording.lives[0].mass or mesh.mass, 500)
        for moment in self.film.moments:
            row = rows[np.abs(rows["time"] - moment.time) < 1e-3]
            if len(row):
                still = moment.dent["car"] < 1e-3
                expected = mesh.vertex[still] @ matrix(row["orientation"][0]).T + row["position"][0]
                self.assertLess(np.abs(moment.vertex["car"][still] - expected).max(), 2e-3)


def box_in_cells(hollow):
    """A box of 4.5 x 1.8 x 1.5 m in cells of 0.25 x 0.15 x 0.15 m with six tets each; if it is hollow, in the outermost cells
    only. Gives OBJ and Medit files, of a surface with an aerial on its roof."""
    count, size = np.array([18, 12, 10]), np.array([0.25, 0.15, 0.15])
    axes = [np.arange(n + 1) * d for n, d in zip(count, size)]
    node = np.stack(np.meshgrid(*axes, indexing="ij"), 3).reshape(-1, 3)
    stride = np.array([(count[1] + 1) * (count[2] + 1), count[2] + 1, 1])
    tets = []
    for cell in np.ndindex(*count):
        if hollow and all(0 < c < n - 1 for c, n in zip(cell, count)):
            continue
        for order in itertools.permutations(range(3)):
            steps = np.cumsum([stride[k] for k in order])
            tets.append([int(np.dot(cell, stride))] + [int(np.dot(cell, stride) + step) for step in steps])
    used = np.unique(tets)
    lines = [f"{x:.4f} {y:.4f} {z:.4f} 0" for x, y, z in node[used]]
    tets = [" ".join(map(str, row)) + " 0" for row in np.searchsorted(used, tets) + 1]
    medit = ["MeshVersionFormatted 2", "Dimension 3", "Vertices", str(len(lines)), *lines, "Tetrahedra", str(len(tets)), *tets, "End"]
    corner = np.array([*np.ndindex(2, 2, 2)]) * count * size
    aerial = np.array([[2.0, 0.8, 1.5], [2.1, 0.8, 1.5], [2.05, 0.85, 1.5], [2.05, 0.82, 1.9]])
    side = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    faces = [*side, (9, 11, 10), (9, 10, 12), (10, 11, 12), (11, 9, 12)]
    surface = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in np.concatenate([corner, aerial])]
    return "\n".join(surface + [f"f {' '.join(map(str, face))}" for face in faces]) + "\n", "\n".join(medit) + "\n"


REGIONS = """{ "regions": [
  { "name": "cell $x$", "anchored": true, "box": { "center": {"x": -1.2, "y": 0, "z": 0.1}, "half": {"x": 0.6, "y": 1, "z": 0.4} } },
  { "name": "nose", "box": { "center": {"x": 2.2, "y": 0, "z": 0.8}, "half": {"x": 0.8, "y": 1, "z": 0.8} } } ] }"""


class ThePictureOfACar(unittest.TestCase):
    """The pixels of the PNG, at places that the panels' axes give."""

    @classmethod
    def setUpClass(cls):
        cls.folder = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory()))
        cls.pixels, cls.cars = {}, {}
        (cls.folder / "regions.json").write_text(REGIONS)
        for name in ("solid", "hollow"):
            surface, tets = box_in_cells(name == "hollow")
            (cls.folder / f"{name}.obj").write_text(surface)
            (cls.folder / f"{name}.mesh").write_text(tets)
            subprocess.run([PROGRAM, "bake", f"{name}.obj", "--tets", f"{name}.mesh", "-o", f"{name}.car", "--mass", "1234",
                            "--regions", "regions.json", "--pictures", "out"], cwd=cls.folder, check=True, stdout=subprocess.DEVNULL)
            cls.pixels[name] = np.array(Image.open(cls.folder / "out" / f"{name}.png").convert("RGB"))
            cls.cars[name] = car_sheet.read_baked(cls.folder / f"{name}.car")
        _, cls.panels = car_sheet.draw_sheet(cls.cars["solid"])  # they have the same surface, and so the same places

    def share(self, name, panel, place, color, reach=6):
        """Of the pixels around a place of a panel, the share that has this colour."""
        x, y = self.panels[panel].transData.transform(place)
        row, column = round(self.pixels[name].shape[0] - y), round(x)
        part = self.pixels[name][row - reach : row + reach + 1, column - reach : column + reach + 1].astype(int)
        return (np.abs(part - 255 * car_sheet.to_rgb(color)).max(2) < 30).mean()

    def test_a_cut_shows_what_is_solid_and_what_is_hollow(self):
        for panel, place in (("lengthwise", (0.1, 0.8)), ("across", (0.1, 0.8)), ("axle", (-0.1, 0.8))):
            self.assertGreater(self.share("solid", panel, place, car_sheet.SOLID), 0.5, panel)
            self.assertEqual(self.share("solid", panel, place, car_sheet.HOLLOW), 0, panel)
            self.assertGreater(self.share("hollow", panel, place, car_sheet.HOLLOW), 0.95, panel)
            self.assertEqual(self.share("hollow", panel, place, car_sheet.SOLID), 0, panel)
        self.assertGreater(self.share("hollow", "lengthwise", (0.6, 0.07), car_sheet.SOLID, 3), 0.6, "the floor is solid")
        for name in self.pixels:
            self.assertGreater(self.share(name, "lengthwise", (0, 1.58), "white"), 0.9, "above the roof is air")

    def test_tets_that_are_held_have_their_own_colour(self):
        self.assertGreater(self.share("solid", "lengthwise", (-1.2, 0.2), car_sheet.HELD), 0.8)
        self.assertEqual(self.share("solid", "lengthwise", (1.2, 0.2), car_sheet.HELD), 0)
        anchored = self.cars["solid"].node[self.cars["solid"].anchored]
        for panel, flat in (("regions side", [0, 2]), ("regions above", [0, 1])):
            ringed = [self.share("solid", panel, node[flat], car_sheet.HELD, 4) for node in anchored[::7]]
            self.assertGreater(min(ringed), 0.05, panel)
            self.assertEqual(self.share("solid", panel, (0.5, 0.4), car_sheet.HELD, 10), 0, panel)

    def test_regions_have_their_colours(self):
        nose = car_sheet.REGIONS[self.cars["solid"].regions.index("nose")]
        self.assertGreater(self.share("solid", "regions side", (1.8, 0.8), nose, 20), 0.005)
        self.assertEqual(self.share("solid", "regions side", (0.5, 0.8), nose, 20), 0)

    def test_the_arrow_points_from_the_front(self):
        for panel, height in (("side", 0.95), ("above", 0), ("lengthwise", 0.95), ("regions side", 0.95), ("regions above", 0)):
            self.assertGreater(self.share("solid", panel, (2.6, height), "black", 10), 0.1, panel)
            self.assertEqual(self.share("solid", panel, (-2.4, height), "black", 5), 0, panel)

    def test_a_part_far_outside_the_tets_is_red(self):
        def red(panel):
            low, high = (self.panels[panel].transAxes.transform(corner).astype(int) for corner in ((0, 0), (1, 1)))
            rows = self.pixels["solid"].shape[0]
            r, g, b = np.moveaxis(self.pixels["solid"][rows - high[1] : rows - low[1], low[0] : high[0]].astype(int), 2, 0)
            return np.argwhere((r > 2 * g) & (r > 2 * b) & (g < 60)), np.array([high[1] - low[1], high[0] - low[0]])

        for panel in ("side", "front", "tets"):
            self.assertGreater(len(red(panel)[0]), 20, panel)
        where, shape = red("side")
        self.assertLess(where[:, 0].max() / shape[0], 0.35, "it is red below the aerial too")

    def test_the_caption_has_the_numbers_of_the_car(self):
        car = self.cars["solid"]
        self.assertEqual((len(car.node), len(car.tet)), (19 * 13 * 11, 18 * 12 * 10 * 6))
        size, surface, credits = car_sheet.captions(car)
        self.assertIn("4.50 x 1.80 x 1.90 m (length x width x height)    1234 kg    2,717 nodes    12,960 tets", size)
        self.assertIn(f"smallest dihedral angle {car_sheet.smallest_dihedral(car.node, car.tet):.1f}", size)
        self.assertAlmostEqual(car_sheet.smallest_dihedral(car.node, car.tet), np.degrees(np.arctan2(0.15, 0.25)), 1)
        self.assertIn("mean 33.3 mm, largest 400 mm; 1 farther than 40 mm", surface)
        self.assertEqual(credits, "Car: not stated")

    def test_a_car_that_is_none_is_told_in_one_sentence(self):
        data = (self.folder / "solid.car").read_bytes()
        (self.folder / "cut.car").write_bytes(data[:5000])
        (self.folder / "forged.car").write_bytes(data[:64] + bytes([255] * 64) + data[128:])
        (self.folder / "taken").write_text("")
        for part, *arguments in (("cut.car: ", "cut.car"), ("forged.car: ", "forged.car"), ("taken", "solid.car", "-o", "taken"),
                                 ("solid.car: is a baked car, of which only -o applies", "solid.car", "--speed", "0.1")):
            done = subprocess.run([PROGRAM, "render", *arguments], cwd=self.folder, text=True, capture_output=True)
            self.assertEqual((done.returncode, done.stderr.count("\n")), (1, 1), done)
            self.assertIn(part, done.stderr)
        done = subprocess.run([PROGRAM, "bake", "solid.car", "-o", "again.car", "--pictures", "taken"], cwd=self.folder, text=True,
                              capture_output=True)
        self.assertEqual(done.returncode, 1, done)
        self.assertIn("again.car: the car is baked, but not its picture: taken", done.stderr)
        self.assertTrue((self.folder / "again.car").exists())

    def test_the_verb_draws_a_car_as_the_bake_does(self):
        done = subprocess.run([PROGRAM, "render", "hollow.car", "-o", "again"], cwd=self.folder, text=True, capture_output=True)
        self.assertEqual((done.returncode, done.stderr), (0, ""), done)
        self.assertEqual([each.name for each in (self.folder / "again").iterdir()], ["hollow.png"])
        with Image.open(self.folder / "again/hollow.png") as picture:
            self.assertTrue((np.array(picture.convert("RGB")) == self.pixels["hollow"]).all())


class TheVerb(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))

    def render(self, *arguments):
        return subprocess.run([PROGRAM, "render", *map(str, arguments)], cwd=self.folder, text=True, capture_output=True)

    def test_writes_an_animation_of_this_speed_a_sheet_and_charts_and_nothing_else(self):
        done = self.render(POLE, *"-o out --from 0.7 --to 1.3 --speed 0.5 --fps 10 --size 240x136 --frames".split())
        self.assertEqual((done.returncode, done.stderr), (0, ""), done)
        self.assertEqual([each.name for each in self.folder.iterdir()], ["out"])
        frames = [f"frame_{i:04}.png" for i in range(1, 14)]  # one frame per 0.05 s
        self.assertEqual(sorted(each.name for each in (self.folder / "out").iterdir()),
                         ["animation.webp", "contact_sheet.jpg", *frames, "reactions.png"])
        with Image.open(self.folder / "out/animation.webp") as animation:
            lasts = []
            for i in range(animation.n_frames):
                animation.seek(i)
                animation.load()
                lasts.append(animation.info["duration"])
            self.assertEqual((animation.size, animation.n_frames, sum(lasts), animation.info["loop"]), ((240, 136), 13, 2300, 0))
        for each in frames:
            pixels = np.array(Image.open(self.folder / "out" / each))
            self.assertGreater(steel(pixels).mean(), 0.01, "no pole")
            self.assertGreater(paint(pixels[:, 10:-10]).mean(), 0.02, "no car")
        with Image.open(self.folder / "out/contact_sheet.jpg") as sheet:
            self.assertEqual(sheet.size[0], 3 * 120)

    def test_what_goes_wrong_is_told_in_one_sentence(self):
        cut = self.folder / "cut.mcap"
        cut.write_bytes(POLE.read_bytes()[:400_000])
        for code, part, *arguments in ((1, "cut.mcap: this is not a whole recording of crumple; if it was cut off, run crumple recover", cut),
                                       (1, "no.mcap: No such file", "no.mcap"), (1, "it has no car x; its cars are: car", POLE, "--cars", "x"),
                                       (1, f"it lasts from 0.02 to {told('([0-9]+) ticks') / 60:.2f} s", POLE, "--from", "9"), (2, "--size", POLE, "--size", "9"),
                                       (1, "cut.mcap", POLE, "-o", cut, "--size", "64x64", "--sheet")):
            done = self.render(*arguments)
            self.assertEqual(done.returncode, code, done)
            self.assertIn(part, done.stderr)
            self.assertEqual(done.stderr.count("\n"), 1 if code == 1 else done.stderr.count("\n"), done.stderr)
        without = subprocess.run([PROGRAM, "render", POLE], cwd=self.folder, text=True, capture_output=True,
                                 env={"CRUMPLE_PYTHON": sys.base_prefix + "/bin/python3", "PATH": "/usr/bin"})
        self.assertEqual(without.returncode, 1)
        self.assertIn("server/setup", without.stderr)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1] + sys.argv[2:], verbosity=2)
