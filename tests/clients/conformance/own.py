"""The part of the conformance table about a mesh of the game's own and about parts. It bakes a small car with wheels, and says where
vertices, normals, tangents and parts must be after a dent: by the plainest computation, in double precision, that follows
crumple_client.h. make.py calls it."""

import json
import pathlib
import struct
import subprocess
import tempfile

import numpy as np
from crumple.schema.Car import Car

ROOT = pathlib.Path(__file__).resolve().parents[3]
SAME_PLACE, SAME_SIDE = 1e-4, 0.5  # m, cosine
REACH_OF_WHEEL, REACH_OF_OTHERS, LEAST_NODES, BEYOND_LAST = 1.5, 0.4, 12, 1.1
WHEEL = 4  # PartKind


def cylinder(hub, radius, width, segments=12):
    turn = 2 * np.pi * np.arange(segments) / segments
    ring = np.stack([radius * np.cos(turn), 0 * turn, radius * np.sin(turn)], 1)
    vertex = np.concatenate([ring + hub + [0, y, 0] for y in (-width / 2, width / 2)] + [[hub - [0, width / 2, 0], hub + [0, width / 2, 0]]])
    face = []
    for k in range(segments):
        a, b, c, d = k, (k + 1) % segments, segments + k, segments + (k + 1) % segments
        face += [(a, c, d), (a, d, b), (2 * segments, a, b), (2 * segments + 1, d, c)]
    return vertex, face


def box(low, high):
    vertex = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertex, [t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]


def to_file(position):
    """The file is in centimetres, -z forward, y up, and away from its origin."""
    x, y, z = position.T
    return 100 * np.stack([-y, z + 0.5, -x + 1], 1)


def bake(folder):
    """A body, a cabin of glass on it, and four wheels. Their triangles meet at edges, so normals of the game differ from ours."""
    meshes = [("body", *box((-2, -0.8, 0.2), (2, 0.8, 0.8))), ("glass", *box((-1, -0.7, 0.8), (0.6, 0.7, 1.3)))]
    meshes += [(f"wheel{i}", *cylinder(np.array([x, y, 0.3]), 0.3, 0.2)) for i, (x, y) in enumerate(((1.3, 0.95), (1.3, -0.95), (-1.3, 0.95), (-1.3, -0.95)))]
    lines, first = [], 1
    for name, vertex, face in meshes:
        lines += [f"o {name}"] + ["v {:.6f} {:.6f} {:.6f}".format(*v) for v in to_file(vertex)]
        lines += ["f {} {} {}".format(*(first + i for i in t)) for t in face]
        first += len(vertex)
    (folder / "box.obj").write_text("\n".join(lines) + "\n")
    parts = [{"name": "glass", "kind": "glass", "source": ["glass"]}]
    parts += [{"name": f"wheel {i}", "kind": "wheel", "source": [f"wheel{i}"]} for i in range(4)]
    parts += [{"name": "camera", "kind": "point", "position": {"x": 0.1, "y": 0.2, "z": 1.25}, "orientation": {"x": 0, "y": 0, "z": 0.6, "w": 0.8}}]
    (folder / "parts.json").write_text(json.dumps({"parts": parts}))
    subprocess.run([ROOT / "build/crumple", "bake", folder / "box.obj", "-o", folder / "box.car", "--mesher", "lattice", "--nodes", "100",
                    "--forward=-z", "--up=y", "--scale=0.01", "--parts", folder / "parts.json", "--attribution", "made by the tests"],
                   check=True, stdout=subprocess.DEVNULL)
    return (folder / "box.car").read_bytes()


class Plain:
    """The car, and what it looks like with displaced nodes."""

    def __init__(self, data):
        car = Car.GetRootAs(data)

        def rows(first, count, kind, width):
            return np.frombuffer(data, kind, count * width, first._tab.Pos).reshape(count, width)

        skin = rows(car.Skin(0), car.SkinLength(), "<u4", 8)
        self.corner, self.weight = skin[:, :4].astype(int), skin[:, 4:].copy().view("<f4").astype(float)
        self.node = rows(car.Node(0), car.NodeLength(), "<f4", 3).astype(float)
        self.vertex = rows(car.Vertex(0), car.VertexLength(), "<f4", 3).astype(float)
        self.triangle = car.TriangleAsNumpy().reshape(-1, 3).astype(int)
        self.part_of = car.VertexPartAsNumpy()
        self.used = np.unique(self.corner[self.weight > 0])  # as in keyframes
        self.place = car.SourceToCarAsNumpy().reshape(3, 4)
        self.part = []
        for i in range(car.PartLength()):
            part = car.Part(i)
            at, turn = part.Position(), part.Orientation()
            self.part.append((part.Kind(), np.array([at.X(), at.Y(), at.Z()]), np.array([turn.X(), turn.Y(), turn.Z(), turn.W()]), part.Radius()))

    def motion(self, part, moved):
        """The rotation and the point that goes with it: the rigid motion nearest to that of the nodes around (Kabsch 1976)."""
        kind, at, _, radius = self.part[part]
        rest = self.node[self.used]
        away = np.linalg.norm(rest - at, axis=1)
        reach = max(REACH_OF_WHEEL * radius if kind == WHEEL else REACH_OF_OTHERS, BEYOND_LAST * np.sort(away)[min(LEAST_NODES, len(away)) - 1])
        weight = np.where(away < reach, (1 - (away / reach) ** 2) ** 2, 0)
        weight /= weight.sum()
        center, to = weight @ rest, weight @ (rest + moved)
        u, _, v = np.linalg.svd(((rest - center) * weight[:, None]).T @ (rest + moved - to))
        turn = v.T @ np.diag([1, 1, np.linalg.det(v.T @ u.T)]) @ u.T
        return turn, lambda p: to + (p - center) @ turn.T

    def now(self, moved):
        """Vertices with these displacements of the nodes that the skin uses."""
        all_moved = np.zeros_like(self.node)
        all_moved[self.used] = moved
        out = self.vertex + (self.weight[..., None] * all_moved[self.corner]).sum(1)
        for i, (kind, *_) in enumerate(self.part):
            if kind == WHEEL:
                out[self.part_of == i] = self.motion(i, moved)[1](self.vertex[self.part_of == i])
        return out

    def poses(self, moved):
        out = []
        for i, (_, at, turn, _) in enumerate(self.part):
            rotation, carry = self.motion(i, moved)
            out.append([*carry(at), *quaternion(rotation @ matrix(turn))])
        return out


def matrix(q):
    x, y, z, w = q
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def quaternion(m):
    """With w >= 0."""
    w = np.sqrt(max(1 + np.trace(m), 1e-12)) / 2
    return [(m[2, 1] - m[1, 2]) / (4 * w), (m[0, 2] - m[2, 0]) / (4 * w), (m[1, 0] - m[0, 1]) / (4 * w), w]


def nearest_on(p, a, b, c):
    """The weights of the nearest point of a triangle: of its inside, else of its edges."""
    edges = np.stack([b - a, c - a], 1)
    u, v = np.linalg.lstsq(edges, p - a, rcond=None)[0]
    if u >= 0 and v >= 0 and u + v <= 1:
        return np.array([1 - u - v, u, v])
    best = None
    for i, j in ((0, 1), (1, 2), (2, 0)):
        s, e = (a, b, c)[i], (a, b, c)[j]
        t = np.clip((p - s) @ (e - s) / ((e - s) @ (e - s)), 0, 1)
        weight = np.zeros(3)
        weight[i], weight[j] = 1 - t, t
        far = np.linalg.norm(s + t * (e - s) - p)
        if best is None or far < best[0]:
            best = far, weight
    return best[1]


def unit(v):
    return v / np.linalg.norm(v)


class Own:
    """Vertices of the game, bound to the car as crumple_map says. rows: position, normal, tangent in the file's coordinates."""

    def __init__(self, car, rows):
        self.car, self.rows = car, rows.astype(float)
        linear = car.place[:, :3]
        self.linear, self.turn = linear, linear / np.linalg.norm(linear, 2)  # the source only turns and scales
        crosses = self.crosses(car.vertex)
        self.bound = []
        self.on_vertices, self.farthest = 0, 0.0
        for row in self.rows:
            p, normal = linear @ row[:3] + car.place[:, 3], self.turn @ row[3:6]
            away = np.linalg.norm(car.vertex - p, axis=1)
            weights = [nearest_on(p, *car.vertex[t]) for t in car.triangle]
            far = np.array([np.linalg.norm(w @ car.vertex[t] - p) for w, t in zip(weights, car.triangle)])
            on = away.min() <= SAME_PLACE
            if on:
                assert np.count_nonzero(away <= SAME_PLACE) == 1, "which of two vertices in one place counts is not told"
                near, weight, corners = {int(away.argmin())}, np.ones(1), [int(away.argmin())]
                far = away.min()
            else:
                t = int(far.argmin())
                weight, corners, far = weights[t], car.triangle[t], far.min()
                near = {int(v) for v, w in zip(corners, weight) if w > 1e-9}
            around = [t for t in range(len(car.triangle)) if near & set(car.triangle[t].tolist())]
            sides = [(t, unit(crosses[t]) @ normal) for t in around]
            turning = [(t, np.sign(side)) for t, side in sides if abs(side) > SAME_SIDE] or [(t, 1) for t in around]
            assert all(abs(abs(side) - SAME_SIDE) > 1e-3 for _, side in sides)
            part = int(car.part_of[corners[0]])
            self.bound.append((corners, weight, turning, part if car.part[part][0] == WHEEL else None))
            self.on_vertices, self.farthest = self.on_vertices + on, max(self.farthest, float(far))

    def crosses(self, vertex):
        a, b, c = (vertex[self.car.triangle[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    def now(self, moved):
        """9 numbers each: position, normal, tangent. moved: of the nodes that the skin uses."""
        vertex = self.car.now(moved)
        rest, crosses = self.crosses(self.car.vertex), self.crosses(vertex)
        out = []
        for row, (corners, weight, turning, wheel) in zip(self.rows, self.bound):
            away = weight @ (vertex - self.car.vertex)[corners]
            facing = unit(sum(sign * rest[t] for t, sign in turning))
            now = unit(sum(sign * crosses[t] for t, sign in turning))
            axis, cosine = np.cross(facing, now), facing @ now
            rotate = lambda v: cosine * v + np.cross(axis, v) + axis * (axis @ v) / (1 + cosine)
            if wheel is not None:
                rigid = self.car.motion(wheel, moved)[0]
                rotate = lambda v: rigid @ v
            out.append([*(row[:3] + np.linalg.solve(self.linear, away)), *(unit(self.turn.T @ rotate(self.turn @ row[k : k + 3])) for k in (3, 6))])
        return [[float(x) for x in np.hstack(row)] for row in out]


def make():
    """Gives the bytes of the car and of the mesh, and the two objects."""
    with tempfile.TemporaryDirectory() as folder:
        data = bake(pathlib.Path(folder))
    car = Plain(data)
    # Vertices of the body, the glass and a wheel with hard normals, and some between the vertices and beside the surface.
    rows, points = [], [((2, 0.8, 0.8), (1, 0, 0), (0, 1, 0)), ((2, 0.8, 0.8), (0, 0, 1), (1, 0, 0)), ((2, -0.8, 0.2), (0.6, -0.8, 0), (0, 0, 1)),
                        ((2, 0.31, 0.47), (1, 0, 0), (0, 1, 0)), ((2.02, 0.31, 0.47), (1, 0, 0), (0, 1, 0)), ((1.1, 0.33, 0.8), (0, 0, 1), (1, 0, 0)),
                        ((1.1, 0.33, 0.81), (0, 0, -1), (1, 0, 0)), ((-1, 0.7, 1.3), (-0.8, 0.6, 0), (0, 0, 1)), ((0.6, -0.1, 1.07), (1, 0, 0), (0, 1, 0)),
                        ((1.6, 1.05, 0.3), (1, 0, 0), (0, 0, 1)), ((1.3, 1.05, 0.3), (0, 1, 0), (0, 0, 1)), ((-1.3, -1.05, 0.3), (0, -1, 0), (1, 0, 0))]
    x, y = car.vertex[:, 0], car.vertex[:, 2]
    shift = np.array([(x.max() + x.min()) / 2, 0, y.min()])
    for position, normal, tangent in points:
        at = to_file(np.array([position], float))[0]
        turned = [to_file(np.array([v], float))[0] - to_file(np.zeros((1, 3)))[0] for v in (normal, tangent)]
        rows.append([*at, *(unit(v) for v in turned)])
    rows = np.array([np.hstack(row) for row in rows], "<f4")
    assert abs(shift).max() < 1e-3
    return data, struct.pack("<I", len(rows)) + rows.tobytes(), car, Own(car, rows)
