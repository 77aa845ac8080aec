"""Tests `crumple render` with the recordings of the repository: the pictures, and the errors.

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

from crumple import Obstacle, Pose, Recording, Shape
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
