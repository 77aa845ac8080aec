"""Tests the installed Python package and its client library against a real server.

    python tests/clients/python_package_test.py build/crumple CAR build/clients/libcrumple_client.so [unittest's options]
"""

import dataclasses
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

import flatbuffers
import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

import crumple
from crumple.schema.Answer import AnswerT
from crumple.schema.Command import CommandT
from crumple.schema.Delta import Delta
from crumple.schema.Keyframe import Keyframe
from crumple.schema.Order import Order
from crumple.schema.Pose import PoseT
from crumple.schema.Quat import QuatT
from crumple.schema.Spawn import SpawnT
from crumple.schema.Vec3d import Vec3dT
from live_server import CAR, LIBRARY, PATIENCE, PROGRAM, ROOT, WithServer


def output(*command, **options):
    return subprocess.run([*map(str, command)], check=True, text=True, stdout=subprocess.PIPE, **options).stdout


def packed(thing, **fields):
    for field, value in fields.items():
        setattr(thing, field, value)
    builder = flatbuffers.Builder()
    builder.Finish(thing.Pack(builder))
    return bytes(builder.Output())


class TheLibrary(unittest.TestCase):
    def test_shows_its_header_and_nothing_else(self):
        declared = set(re.findall(r"\b(crumple_\w+)\(", (ROOT / "clients/cpp/include/crumple_client.h").read_text()))
        shown = {line.split()[-1] for line in output("nm", "-D", "--defined-only", LIBRARY).splitlines()}
        self.assertEqual(shown, declared)

    def test_needs_no_library_that_not_every_linux_has(self):
        needed = set(re.findall(r"NEEDED.*\[(.*)\]", output("readelf", "-d", LIBRARY)))
        self.assertIn("libc.so.6", needed)
        self.assertLessEqual(needed, {"libc.so.6", "libm.so.6", "libgcc_s.so.1", "ld-linux-x86-64.so.2", "ld-linux-aarch64.so.1"})


class TheReader(unittest.TestCase):
    def test_pairs_commands_of_one_tick_with_their_answers(self):
        """A stranger may send a command that is none, for the car that a host spawns in the same tick."""
        position, turn = Vec3dT(), QuatT()
        position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w = 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0
        spawn = SpawnT()
        spawn.pose, spawn.asset, spawn.host = PoseT(), "asset", "game"
        spawn.pose.position, spawn.pose.orientation = position, turn
        command = packed(CommandT(), orderType=Order.Spawn, order=spawn)
        path = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory())) / "commands.mcap"
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start("crumple", "test")
            writer.add_metadata("crumple", {"scene": "main", "rate": "60", "program": "test"})
            schema = writer.register_schema("S", "", b"")
            channels = {key: writer.register_channel(f"crumple/1/main/{key}", "", schema)
                        for key in ("car/a", "car/a/answer", "tick")}
            for key, data in (("car/a", command), ("car/a", b"no command"), ("car/a/answer", packed(AnswerT(), ok=True)),
                              ("car/a/answer", packed(AnswerT(), ok=False, error="none")), ("tick", b"")):
                writer.add_message(channels[key], 0, data, 0, sequence=7)
            writer.finish()
        with crumple.Recording(path) as recording:
            life, = recording.lives
            self.assertEqual((life.car, life.host, life.asset), ("a", "game", "asset"))

    def test_unpacks_no_chunk_that_fills_the_memory(self):
        def write(size, compression, byte):
            path = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory())) / "bomb.mcap"
            with path.open("wb") as file:
                writer = Writer(file, chunk_size=size + 1000, compression=compression)
                writer.start("crumple", "test")
                writer.add_metadata("crumple", {"scene": "main", "rate": "60", "program": "test"})
                channel = writer.register_channel("crumple/1/main/tick", "", writer.register_schema("S", "", b""))
                writer.add_message(channel, 0, byte(size), 0)
                writer.finish()
            return path

        def refused(path):
            with crumple.Recording(path) as recording, self.assertRaisesRegex(crumple.Error, "a chunk claims to hold"):
                list(recording.messages())

        noise, zeros = np.random.default_rng(1).bytes, bytes
        for size, compression, byte in ((1 << 20, CompressionType.ZSTD, zeros), (70 << 20, CompressionType.ZSTD, noise),
                                        (70 << 20, CompressionType.LZ4, noise), (70 << 20, CompressionType.NONE, noise)):
            path = write(size, compression, byte)
            refused(path)
            if compression is CompressionType.NONE:
                continue
            claims = bytearray(path.read_bytes())
            with path.open("rb") as file:
                chunk, = make_reader(file).get_summary().chunk_indexes
            at = chunk.chunk_start_offset + 9 + 16  # two times precede it
            claims[at:at + 8] = (1000).to_bytes(8, "little")
            path.write_bytes(claims)
            refused(path)
        for compression in CompressionType.ZSTD, CompressionType.LZ4:
            with crumple.Recording(write(1 << 20, compression, noise)) as recording:
                self.assertEqual(len(list(recording.messages())), 1)


class ThePackage(WithServer):
    def setUp(self):
        super().setUp()
        shutil.copy(CAR, self.folder / "car.car")

    def session(self, host=None):
        return self.enterContext(crumple.Session(self.endpoint, host=host, timeout=PATIENCE))

    @staticmethod
    def held(session):
        surface = session.surface("car1")
        return surface.hash if surface else None

    def test_a_host_and_a_viewer_end_with_the_surface_of_the_server(self):
        host, viewer = self.session("script"), self.session()
        self.asset = host.add_asset(CAR)
        self.assertGreater(host.spawn("car1", self.asset), 0)
        host.follow("car1")
        viewer.follow()
        reactions = self.crash(host)
        self.assertGreater(reactions[-1].energy_absorbed, 10e3)
        self.assertLess(reactions[-1].velocity[0], 5.0)
        dent = host.until(lambda: host.surface("car1"), PATIENCE)
        viewer.until(lambda: viewer.cars() == ["car1"] and self.held(viewer) == dent.hash, PATIENCE)
        late = self.session()
        late.follow("car1")
        self.assertEqual(late.until(lambda: self.held(late), PATIENCE), dent.hash)
        self.assertTrue(dent.quanta.flags.owndata, "what the library shows is gone with the next poll")
        watched = output(PROGRAM, "watch", "--connect", self.endpoint, "--once")
        self.assertIn(f"hash {dent.hash:016x}", watched, "the program's own viewer differs")

        # Positions and normals, in the caller's memory; the mesh came from the server.
        mesh = viewer.mesh(dent.asset)
        self.assertEqual(mesh.mass, host.mesh(self.asset).mass)
        self.assertIn("built-in", mesh.name)
        buffer = np.full(len(mesh.vertex), 7, [("position", "f4", 3), ("normal", "f4", 3), ("moved", "f4", 3), ("uv", "f4", 2)])
        given = crumple.Vertices(buffer["position"], buffer["moved"], buffer["normal"])
        self.assertEqual(viewer.vertices("car1", given).changed, slice(0, len(mesh.vertex)))
        self.assertTrue((buffer["uv"] == 7).all())
        np.testing.assert_array_equal(buffer["position"], mesh.vertex + buffer["moved"])
        deepest = np.abs(buffer["moved"]).max()
        self.assertAlmostEqual(deepest, np.abs(dent.quanta).max() * dent.quantum, delta=0.02)
        self.assertGreater(deepest, 0.1)
        np.testing.assert_allclose(np.linalg.norm(buffer["normal"], axis=1), 1, atol=1e-5)
        self.assertFalse(viewer.surface("car1").dirty)
        with self.assertRaisesRegex(ValueError, "float32"):
            viewer.vertices("car1", crumple.Vertices(*[np.zeros((len(mesh.vertex), 3))] * 3))

        # A mesh of the caller's, in centimetres and another order, moves with it.
        order = np.random.default_rng(1).permutation(len(mesh.vertex))
        to_car = np.array([[0.01, 0, 0, 0], [0, 0.01, 0, 0.5], [0, 0, 0.01, 0]])
        own = viewer.map(dent.asset, (mesh.vertex[order] - [0, 0.5, 0]) * 100, normal=buffer["normal"][order], to_car=to_car)
        self.assertEqual((own.on_vertices, own.count), (len(order), len(order)))
        placed = viewer.vertices("car1", own=own)
        np.testing.assert_allclose(placed.position / 100 + [0, 0.5, 0], buffer["position"][order], atol=1e-5)
        np.testing.assert_allclose(placed.displacement / 100, buffer["moved"][order], atol=1e-6)
        self.assertIsNone(placed.tangent)
        with self.assertRaisesRegex(ValueError, "float32"):
            viewer.vertices("car1", crumple.Vertices(*[np.zeros((3, 3), np.float32)] * 3), own=own)
        with self.assertRaisesRegex(ValueError, "3 x 4"):
            viewer.map(dent.asset, mesh.vertex, to_car=np.eye(4))
        with self.assertRaisesRegex(crumple.Error, "finite"):
            viewer.map(dent.asset, np.full((1, 3), np.nan), to_car=to_car)

        # The earlier surface is the same as long as nothing moves.
        past = viewer.vertices("car1", time=viewer.time - 0.1)
        np.testing.assert_array_equal(past.displacement, buffer["moved"])
        self.assertGreaterEqual(viewer.time, dent.tick / 60)

        state = host.save("car1")
        host.repair("car1")
        viewer.until(lambda: self.held(viewer) not in (None, dent.hash), PATIENCE)
        self.assertFalse(viewer.surface("car1").quanta.any(), "repaired, but not as new")
        host.load("car1", state)
        viewer.until(lambda: self.held(viewer) == dent.hash, PATIENCE)
        self.assertGreater(viewer.until(viewer.health, PATIENCE).tick, dent.tick)
        self.assertGreater(viewer.statistics().surface, 3)
        host.despawn("car1")
        viewer.until(lambda: self.held(viewer) and not viewer.surface("car1").alive, PATIENCE)
        viewer.close()
        with self.assertRaisesRegex(crumple.Error, "closed"):
            viewer.cars()
        self.stop()
        self.check_recording(reactions, dent)

    def check_recording(self, reactions, dent):
        with crumple.Recording(self.recording) as recording:
            told = {tick: message.GetRootAs(data).Hash() for name, message in (("key", Keyframe), ("delta", Delta))
                    for tick, _, data in recording.messages(f"car/car1/{name}/0")}
            self.assertEqual(told[dent.tick], dent.hash, "the server told another hash")
            life, = recording.lives
            self.assertEqual((life.car, life.host, life.asset), ("car1", "script", self.asset))
            self.assertEqual(recording.obstacles(), {"script": [self.wall]})
            rows = recording.reactions(end=reactions[-1].time)
            by_tick = {int(row["tick"]): row for row in rows}
            for each in reactions:
                row = by_tick[each.tick]
                self.assertEqual((row["car"], tuple(row["impulse"]), tuple(row["position"]), row["energy_absorbed"]),
                                 (each.car, each.impulse, each.pose.position, each.energy_absorbed))
            table = crumple.columns(rows)
            self.assertTrue(all(column.shape == (len(rows),) for column in table.values()))
            np.testing.assert_array_equal(table["impulse_x"], rows["impulse"][:, 0])

            with recording.at(dent.tick / recording.rate) as frame:
                np.testing.assert_array_equal(frame.surface("car1").quanta, dent.quanta)
                moved = frame.vertices("car1")
                np.testing.assert_array_equal(moved.position, frame.mesh(self.asset).vertex + moved.displacement)
            self.assertEqual(recording.at(recording.end).cars(), [], "it was despawned")
            walked, told_while = {}, []
            for frame in recording.frames():
                walked[frame.tick] = frame.surface("car1")
                told_while += frame.reactions()
            self.assertEqual([each.tick for each in told_while], recording.reactions()["tick"].tolist())
            before = [tick for tick in walked if tick < life.spawned]
            self.assertTrue(all(walked[tick] is None for tick in before))
            self.assertTrue(all(recording.at(tick / recording.rate).cars() == [] for tick in before[:3]))
            for tick in range(life.spawned, life.despawned, 5):  # seeking gives the same as playing up to there
                sought = recording.at(tick / recording.rate).surface("car1")
                self.assertEqual((sought.tick, sought.hash), (walked[tick].tick, walked[tick].hash))
                self.assertEqual(told[sought.tick], sought.hash)

    def test_a_reaction_names_the_car_that_touched_this_one_and_what_it_gave(self):
        given = {}
        with crumple.Recording(ROOT / "recordings/m130_head_on.mcap") as recording:
            for frame in recording.frames():
                for each in frame.reactions():
                    for partner in each.partners:
                        given[each.tick, each.car] = partner
        cars = {"head_on_left": "head_on_right", "head_on_right": "head_on_left"}
        self.assertEqual({car for _, car in given}, set(cars))
        for (tick, car), partner in given.items():
            self.assertEqual((partner.car, partner.host), (cars[car], cars[car]))
            np.testing.assert_array_equal(partner.impulse, -np.array(given[tick, partner.car].impulse))
        self.assertGreater(max(partner.contacts for partner in given.values()), 5)

    def test_a_recording_that_another_program_wrote_anew_is_as_good(self):
        source = ROOT / "recordings/built_in_pole.mcap"
        for compression in (CompressionType.ZSTD, CompressionType.NONE):
            with open(source, "rb") as file, open(self.folder / "anew.mcap", "wb") as out:
                reader, writer = make_reader(file), Writer(out, compression=compression)
                writer.start("crumple", "another")
                channels = {}
                for schema, channel, message in reader.iter_messages(log_time_order=False):
                    if channel.id not in channels:
                        number = writer.register_schema(schema.name, schema.encoding, schema.data)
                        channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
                    writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
                for each in reader.iter_attachments():
                    writer.add_attachment(each.create_time, each.log_time, each.name, each.media_type, each.data)
                for each in reader.iter_metadata():
                    writer.add_metadata(each.name, each.metadata)
                writer.finish()
            self.assertIn("every tick identical", output(PROGRAM, "replay", self.folder / "anew.mcap", "--verify"))
            self.assertIn("crashes\n  car car", output(PROGRAM, "info", self.folder / "anew.mcap"))
            with crumple.Recording(self.folder / "anew.mcap") as anew, crumple.Recording(source) as before:
                np.testing.assert_array_equal(anew.reactions(), before.reactions())
                car = before.cars[0]
                self.assertEqual(anew.at(2.0).surface(car).hash, before.at(2.0).surface(car).hash)

    def test_what_is_no_whole_recording_is_told_with_the_remedy(self):
        whole = (ROOT / "recordings/m130_wall.mcap").read_bytes()
        for other in (b"", b"no recording at all, but long enough to be one", whole[:-3000], whole[:9]):
            (self.folder / "other.mcap").write_bytes(other)
            with self.assertRaisesRegex(crumple.Error, "other.mcap.*crumple recover"):
                crumple.Recording(self.folder / "other.mcap")

    def test_what_the_server_refuses_is_raised_with_its_sentence(self):
        host = self.session("script")
        asset = host.add_asset(CAR)
        with self.assertRaisesRegex(crumple.Refused, "car1"):
            host.repair("car1")
        host.spawn("car1", asset)
        with self.assertRaisesRegex(crumple.Refused, "yield_strain"):
            host.set_parameters("car1", crumple.Parameters(yield_strain=-1.0))
        self.assertGreater(host.set_parameters("car1", crumple.Parameters(solver=crumple.Solver.classic, iterations=5)), 0)
        with self.assertRaisesRegex(crumple.Refused, "."):
            host.load("car1", b"nothing that was saved")
        with self.assertRaisesRegex(crumple.Error, "unit quaternion"):
            host.publish_poses(0.0, [crumple.CarPose("car1", crumple.Pose(orientation=(0, 0, 0, 2)))])
        with self.assertRaisesRegex(ValueError, "position has 2 numbers"):
            host.publish_poses(0.0, [crumple.CarPose("car1", crumple.Pose((0, 0)))])
        with self.assertRaisesRegex(crumple.Error, "host"):
            self.session().publish_obstacles([])
        with self.assertRaisesRegex(crumple.Error, "crumple_follow"):
            host.surface("car2")
        with self.assertRaisesRegex(crumple.Error, "no server of scene other"):
            crumple.Session(self.endpoint, scene="other", timeout=0.2)
        with self.assertRaises(TimeoutError):
            host.until(lambda: False, 0.2)

    def test_the_example_of_the_readme_tells_what_was_recorded(self):
        text = (ROOT / "clients/python/README.md").read_text()
        example = re.match(r"# [^\n]*\n\n```python\n(.*?)```", text, re.DOTALL).group(1)
        self.assertLess(example.count("\n"), 60)
        self.assertEqual(example.count("tcp/127.0.0.1:7447"), 1)
        printed = output(sys.executable, "-c", example.replace("tcp/127.0.0.1:7447", self.endpoint), cwd=self.folder)
        self.stop()
        self.assertGreater(float(re.search(r"(\d+) kJ absorbed", printed).group(1)), 50)
        self.assertGreater(float(re.search(r"dent (\d+) mm", printed).group(1)), 100)
        tick, surface = re.search(r"tick (\d+), hash (\w+)", printed).groups()
        with crumple.Recording(self.recording) as recording:
            self.assertEqual(f"{recording.at(int(tick) / recording.rate).surface('car1').hash:016x}", surface)

    def test_a_scene_that_a_script_wrote_is_driven(self):
        pole = crumple.Scene.read(ROOT / "clients/scenes/pole.json")
        hit = dataclasses.replace(pole.hits[0], position=(8.0, 0.0, 0.0), speed_kmh=36.0, seconds=0.8)
        parameters = (crumple.Parameters(yield_strain=0.006, solver=crumple.Solver.nodal),)
        written = dataclasses.replace(pole, hits=(hit,), mass=1100.0, parameters=parameters)
        written.write(self.folder / "pole36.json")
        self.assertEqual(crumple.Scene.read(self.folder / "pole36.json"), written)
        output(PROGRAM, "drive", self.folder / "pole36.json", "--car", CAR, "--connect", self.endpoint, "--id", "car1")
        self.stop()
        with crumple.Recording(self.recording) as recording:
            rows = recording.reactions()
            self.assertTrue(rows["contacts"].any() and rows["velocity"][:, 0].max() < 10.1, "36 km/h, into the pole")
            obstacle, = recording.obstacles()["drive"]
            self.assertEqual((obstacle.shape, obstacle.pose.position), (crumple.Shape.capsule, (12.15, 0.0, 2.0)))


class TheTypes(unittest.TestCase):
    def test_are_those_that_a_strict_checker_finds(self):
        folder = ROOT / "clients/python"
        command = [sys.executable, "-m", "mypy", "--cache-dir", pathlib.Path(PROGRAM).resolve().parent / "mypy"]
        checked = subprocess.run([*command, "src/crumple", "hatch_build.py"], cwd=folder, text=True, stdout=subprocess.PIPE)
        self.assertEqual(checked.returncode, 0, checked.stdout)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1] + sys.argv[4:], verbosity=2)
