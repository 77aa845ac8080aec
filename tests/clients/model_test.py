"""Tests that `crumple export --mesh` and `crumple render --mesh` show the model from which a car was baked, with its materials and
textures, as it dents.

    python tests/clients/model_test.py build/crumple [unittest's options]
"""

import io
import json
import pathlib
import struct
import subprocess
import sys
import tempfile
import unittest



import crumple
import numpy as np
from PIL import Image

PROGRAM = str(pathlib.Path(sys.argv[1]).resolve())
PAINT = (20, 200, 40)  # of the texture


def box(low, high, cells=6):
    """A closed box, whose sides have a grid of triangles, with normals of its sides and with places in a texture."""
    vertex, normal, uv, triangle = [], [], [], []
    low, high = np.array(low, float), np.array(high, float)
    for axis in range(3):
        for end in (0, 1):
            first, (u, v) = len(vertex), ((axis + 1) % 3, (axis + 2) % 3)
            for i in range(cells + 1):
                for j in range(cells + 1):
                    at = np.where(end, high, low)
                    at[u], at[v] = (low + (high - low) * i / cells)[u], (low + (high - low) * j / cells)[v]
                    vertex.append(at)
                    normal.append(np.eye(3)[axis] * (1 if end else -1))
                    uv.append((i / cells, j / cells))
            for i in range(cells):
                for j in range(cells):
                    a, b, c, d = (first + (i + x) * (cells + 1) + j + y for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))
                    triangle += [(a, b, c), (a, c, d)] if end else [(a, c, b), (a, d, c)]
    return [np.array(each, np.float32) for each in (vertex, normal, uv)] + [np.array(triangle, np.uint32)]


def wheel(radius=0.3, width=0.2, segments=16):
    turn = 2 * np.pi * np.arange(segments) / segments
    ring = np.stack([radius * np.cos(turn), 0 * turn, radius * np.sin(turn)], 1)
    vertex = np.concatenate([ring - [0, width / 2, 0], ring + [0, width / 2, 0], [[0, -width / 2, 0], [0, width / 2, 0]]])
    triangle = []
    for k in range(segments):
        a, b, c, d = k, (k + 1) % segments, segments + k, segments + (k + 1) % segments
        triangle += [(a, c, d), (a, d, b), (2 * segments, a, b), (2 * segments + 1, d, c)]
    return [vertex.astype(np.float32), None, None, np.array(triangle, np.uint32)]


def glb(meshes, nodes, materials, picture):
    """meshes: (arrays, material)."""
    blob, views, accessors = bytearray(), [], []

    def put(data):
        blob.extend(b"\0" * (-len(blob) % 4))
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        blob.extend(data)
        return len(views) - 1

    def array(rows):
        accessors.append({"bufferView": put(rows.tobytes()), "componentType": 5125 if rows.dtype == np.uint32 else 5126, "count": len(rows),
                          "type": {1: "SCALAR", 2: "VEC2", 3: "VEC3"}[1 if rows.ndim == 1 else rows.shape[1]]})
        if rows.ndim > 1 and rows.shape[1] == 3:
            accessors[-1] |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        return len(accessors) - 1

    listed = []
    for (vertex, normal, uv, triangle), material in meshes:
        attributes = {name: array(rows) for name, rows in (("POSITION", vertex), ("NORMAL", normal), ("TEXCOORD_0", uv)) if rows is not None}
        listed.append({"primitives": [{"attributes": attributes, "indices": array(triangle.ravel()), "material": material}]})
    image = {"bufferView": put(picture), "mimeType": "image/png"}
    blob.extend(b"\0" * (-len(blob) % 4))
    text = json.dumps({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes, "meshes": listed, "materials": materials,
                       "textures": [{"source": 0}], "images": [image], "bufferViews": views, "accessors": accessors,
                       "buffers": [{"byteLength": len(blob)}]}).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob)) + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob


def a_car():
    """x forward, y left, z up in centimetres, below a root that turns and shrinks it to glTF's axes and metres."""
    texture = io.BytesIO()
    Image.new("RGB", (8, 8), PAINT).save(texture, "PNG")
    materials = [{"name": "paint", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0}},
                 {"name": "glass", "alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.1, 0.1, 0.3]}},
                 {"name": "tyre", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.0, 0.0, 1], "metallicFactor": 0.25, "roughnessFactor": 0.75}}]
    scaled = [[100 * part if k == 0 else part for k, part in enumerate(mesh)] for mesh in
              (box((-2, -0.8, 0.25), (2, 0.8, 0.8)), box((-1, -0.7, 0.8), (0.6, 0.7, 1.3)), wheel())]
    wheels = [(f"wheel {i}", [100 * x, 100 * y, 30]) for i, (x, y) in enumerate(((1.3, 0.95), (1.3, -0.95), (-1.3, 0.95), (-1.3, -0.95)))]
    nodes = [{"name": "root", "rotation": [-0.5, -0.5, -0.5, 0.5], "scale": [0.01] * 3, "children": [1, 2, 3, 4, 5, 6]},
             {"name": "body", "mesh": 0}, {"name": "cabin", "mesh": 1}] + [{"name": name, "mesh": 2, "translation": at} for name, at in wheels]
    return glb(list(zip(scaled, range(3))), nodes, materials, texture.getvalue())


def read(path):
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    file, blob = json.loads(data[20 : 20 + length]), data[28 + length :]

    def array(index):
        accessor = file["accessors"][index]
        view = file["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        return np.frombuffer(blob, "<f4", accessor["count"] * width, view.get("byteOffset", 0)).reshape(accessor["count"], width)

    return file, array


class AModel(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="crumple_test_")))
        cls.model = cls.folder / "model.glb"
        cls.model.write_bytes(a_car())
        cls.run_program("bake", cls.model, "-o", cls.folder / "model.car", "--nodes", "400", "--attribution", "made by the tests")
        cls.recording = cls.folder / "model.mcap"
        server = subprocess.Popen([PROGRAM, "serve", "--car", cls.folder / "model.car", "--listen", "tcp/127.0.0.1:0", "--record", cls.recording], stdout=subprocess.PIPE, text=True)
        endpoint = server.stdout.readline().split("tcp/")[1].split()[0].rstrip(",;.")
        with crumple.Session(f"tcp/{endpoint}", host="test", timeout=60) as host:
            asset = host.add_asset(str(cls.folder / "model.car"))
            host.spawn("a", asset)
            host.publish_obstacles([crumple.Obstacle(7, crumple.Shape.box, (1.0, 0.4, 5.0), crumple.Pose((3.7, 0.6, 0.0)))])
            host.publish_poses(0.0, [crumple.CarPose("a", crumple.Pose(), velocity=(15.0, 0.0, 0.0))])
            touched = []
            host.until(lambda: touched.extend(each.contacts for each in host.reactions()) or (any(touched) and touched[-1] == 0), 60)
            until = host.health().tick + 30 if host.health() else 0
            host.until(lambda: host.health() and host.health().tick > until, 60)
        server.terminate()
        server.wait(60)
        server.stdout.close()

    @classmethod
    def run_program(cls, *arguments):
        done = subprocess.run([PROGRAM, *map(str, arguments)], text=True, capture_output=True)
        if done.returncode:
            raise RuntimeError(done.stderr)
        return done.stdout

    def refusal(self, *arguments):
        done = subprocess.run([PROGRAM, *map(str, arguments)], text=True, capture_output=True)
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertNotIn("Traceback", done.stderr)
        return done.stderr

    def test_the_film_has_the_vertices_materials_and_textures_of_the_model_and_the_dents_of_the_recording(self):
        self.run_program("export", self.recording, "-o", self.folder / "film", "--mesh", self.model)
        file, array = read(self.folder / "film/a.glb")
        self.assertEqual([each["name"] for each in file["materials"]], ["paint", "glass", "tyre"])
        self.assertEqual(len(file["images"]), 1)
        weights = next(each for each in file["animations"][0]["channels"] if each["target"]["path"] == "weights")
        shapes = len(file["meshes"][file["nodes"][weights["target"]["node"]]["mesh"]]["weights"])
        last = array(file["animations"][0]["samplers"][weights["sampler"]]["output"]).reshape(-1, shapes)[-1]
        with crumple.Recording(self.recording) as recording, recording.at(recording.end) as frame:
            baked = frame.vertices("a")
            mesh = frame.mesh(frame.surface("a").asset)
        self.assertGreater(np.linalg.norm(baked.displacement, axis=1).max(), 0.1)
        compared, wheels = 0, 0
        for node in file["nodes"]:
            if "mesh" not in node:
                continue
            primitive = file["meshes"][node["mesh"]]["primitives"][0]
            rest = array(primitive["attributes"]["POSITION"])
            now = rest + sum(share * array(target["POSITION"]) for share, target in zip(last, primitive["targets"]))
            to_car = lambda p: 0.01 * (p + node.get("translation", [0, 0, 0]))  # the model lies as the car does
            for a, b in zip(to_car(rest), to_car(now)):
                at = np.flatnonzero(np.linalg.norm(mesh.vertex - a, axis=1) < 1e-4)
                if len(at) == 0:
                    continue
                apart = np.linalg.norm(baked.position[at] - b, axis=1).min()
                self.assertLess(apart, 1e-4, node["name"])
                compared += 1
                wheels += node["name"].startswith("wheel")
        self.assertGreater(compared, 500)
        self.assertEqual(wheels, 4 * 34, "four nodes share a mesh, and each bends in its own way")

    def test_a_baked_car_keeps_the_looks_of_materials_without_a_texture(self):
        self.run_program("export", self.recording, "-o", self.folder / "bare")
        file, _ = read(self.folder / "bare/a.glb")
        looks = {each["name"]: each["pbrMetallicRoughness"] for each in file["materials"]}
        self.assertEqual(looks["tyre"], {"baseColorFactor": [0.5, 0, 0, 1], "metallicFactor": 0.25, "roughnessFactor": 0.75})
        self.assertAlmostEqual(looks["glass"]["baseColorFactor"][3], 0.3, 6)
        self.assertEqual(set(looks), {"paint", "glass", "tyre"}, "the body's paint is the viewer's, since its material has a texture")
        self.assertNotIn("images", file)

    def test_pictures_have_its_texture(self):
        def green(*options):
            self.run_program("render", self.recording, "-o", self.folder / "pictures", "--sheet", "--size", "320x180", *options)
            pixels = np.asarray(Image.open(self.folder / "pictures/contact_sheet.jpg")).astype(int)
            return int(((pixels[..., 1] > 1.8 * pixels[..., 0]) & (pixels[..., 1] > 1.5 * pixels[..., 2])).sum())

        self.assertGreater(green("--mesh", self.model), 2000)
        self.assertLess(green(), 50)

    def test_another_model_and_a_broken_one_are_refused_in_a_sentence(self):
        def told(name, data):
            path = self.folder / name
            path.write_bytes(data)
            return self.refusal("export", self.recording, "-o", self.folder / "none", "--mesh", path)

        good = a_car()
        length = struct.unpack_from("<I", good, 12)[0]
        text, rest = good[20 : 20 + length], good[20 + length :]

        def changed(change):
            file = json.loads(text)
            change(file)
            new = json.dumps(file).encode()
            new += b" " * (-len(new) % 4)
            return struct.pack("<4sII", b"glTF", 2, 20 + len(new) + len(rest)) + struct.pack("<I4s", len(new), b"JSON") + new + rest

        self.assertIn("none of the cars was baked from it", told("other.glb", changed(lambda file: file["nodes"][0].update(scale=[0.02] * 3))))
        bomb = io.BytesIO()
        Image.new("1", (20000, 20000)).save(bomb, "PNG")
        for name, data in {"empty": b"", "text": b"hello", "half": good[: len(good) // 2], "no json": good[:20],
                           "circle": changed(lambda file: file["nodes"][1].update(children=[0])),
                           "no node": changed(lambda file: file["nodes"][0].update(children=[99])),
                           "accessor beyond": changed(lambda file: file["accessors"][0].update(count=10**9)),
                           "view beyond": changed(lambda file: file["bufferViews"][0].update(byteLength=10**9)),
                           "negative": changed(lambda file: file["bufferViews"][1].update(byteOffset=-4)),
                           "corner beyond": changed(lambda file: file["meshes"][0]["primitives"][0].update(indices=0)),
                           "no buffer": changed(lambda file: file.update(buffers=[])),
                           "elsewhere": changed(lambda file: file["buffers"][0].update(uri="../../etc/passwd")),
                           "bomb": glb([(wheel(), 0)], [{"mesh": 0}], [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}], bomb.getvalue())}.items():
            with self.subTest(name):
                self.assertIn("model", told(f"{name} model.glb", data))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1] + sys.argv[2:], verbosity=2)
