"""`crumple export --mesh MODEL.glb` writes the model from which a car was baked as a film: with its own vertices, materials and
textures, which follow the dents of a recording. The file has all of the model, and beside it a morph target of each shape, a moving
node, and one animation of both.

    python -m crumple.export FILE.mcap FOLDER MODEL.glb FPS
"""

from __future__ import annotations

import copy
import json
import pathlib
import struct
import sys
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from crumple._library import Error
from crumple.model import BIN_CHUNK, GLB, JSON_CHUNK, Array, Bound, Model, bytes_of_cars, source_of
from crumple.recording import Recording
from crumple.types import Pose

# Converts X forward, Y left, Z up to glTF's Z forward, X left, Y up: a third of a turn about (1, 1, 1).
UPRIGHT = [-0.5, -0.5, -0.5, 0.5]
FLOAT, ARRAY_BUFFER = 5126, 34962


@dataclass
class Film:
    """A car as long as it keeps its asset. Shape 0 is rest."""

    bound: Bound
    start: float  # s
    attribution: str
    shapes: list[tuple[Array, Array]] = field(default_factory=list)  # displacements, and changes of normals, in the file's coordinates
    keys: list[tuple[float, Pose, int]] = field(default_factory=list)  # s from the start, pose, shape
    rest: Array | None = None  # normals
    last: Array | None = None  # positions


class Writer:
    """Appends accessors to a glTF file."""

    def __init__(self, model: Model) -> None:
        self.json: dict[str, Any] = copy.deepcopy(model.json)
        self.blob = bytearray()
        start = []
        for i in range(len(self.json["buffers"])):
            start.append(self._append(model.buffer(i)))
        for view in self.json["bufferViews"]:
            view["byteOffset"] = view.get("byteOffset", 0) + start[view["buffer"]]
            view["buffer"] = 0
        for image in self.json.get("images", []):  # a picture beside the file comes into it
            uri = image.get("uri", "data:")
            if not uri.startswith("data:"):
                image["bufferView"] = self._view(model.fetch(uri))
                image.setdefault("mimeType", "image/png" if uri.lower().endswith("png") else "image/jpeg")
                del image["uri"]

    def _append(self, data: bytes) -> int:
        self.blob += b"\0" * (-len(self.blob) % 4)
        at = len(self.blob)
        self.blob += data
        return at

    def _view(self, data: bytes, **more: Any) -> int:
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": self._append(data), "byteLength": len(data), **more})
        return len(self.json["bufferViews"]) - 1

    def accessor(self, rows: Array, bounds: bool = False, **of_view: Any) -> int:
        rows = np.ascontiguousarray(rows, "<f4")
        width = 1 if rows.ndim == 1 else rows.shape[1]
        entry = {"bufferView": self._view(rows.tobytes(), **of_view), "componentType": FLOAT, "count": len(rows), "type": "SCALAR" if width == 1 else f"VEC{width}"}
        if bounds:
            entry["min"], entry["max"] = (np.atleast_1d(each).tolist() for each in (rows.min(0), rows.max(0)))
        self.json["accessors"].append(entry)
        return len(self.json["accessors"]) - 1

    def node(self, **entry: Any) -> int:
        self.json["nodes"].append(entry)
        return len(self.json["nodes"]) - 1

    def save(self, path: pathlib.Path) -> None:
        self.json["buffers"] = [{"byteLength": len(self.blob)}]
        text = json.dumps(self.json, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        self.blob += b"\0" * (-len(self.blob) % 4)
        size = 28 + len(text) + len(self.blob)
        if size >= 1 << 32:
            raise Error(f"{path}: the file would have over 4 GiB, the most that GLB allows: lower --fps")
        path.write_bytes(struct.pack("<III", GLB, 2, size) + struct.pack("<II", len(text), JSON_CHUNK) + text
                         + struct.pack("<II", len(self.blob), BIN_CHUNK) + self.blob)


def write(path: pathlib.Path, name: str, film: Film) -> None:
    model, out = film.bound.model, Writer(film.bound.model)
    meshes = out.json["meshes"]
    of_node: dict[int, int] = {}
    for i, piece in enumerate(model.pieces):
        node = out.json["nodes"][piece.node]
        if piece.node not in of_node:  # nodes that share a mesh get one each, because they bend in different ways
            meshes.append(copy.deepcopy(model.json["meshes"][node["mesh"]]))
            of_node[piece.node] = node["mesh"] = len(meshes) - 1
            for primitive in meshes[-1]["primitives"]:
                primitive.pop("targets", None)
            meshes[-1].pop("weights", None)
        mine = slice(film.bound.first[i], film.bound.first[i + 1])
        back = np.linalg.inv(piece.turn)
        targets = []
        for moved, turned in film.shapes:
            target = {"POSITION": out.accessor(moved[mine] @ back.T, True, target=ARRAY_BUFFER)}
            if piece.normal is not None:
                target["NORMAL"] = out.accessor(turned[mine] @ piece.turn / np.linalg.norm(piece.turn, 2), target=ARRAY_BUFFER)
            targets.append(target)
        if targets:
            meshes[-1]["primitives"][piece.primitive]["targets"] = targets
            meshes[-1]["weights"] = [0.0] * len(targets)
    scene = out.json.get("scene", 0)
    roots = out.json["scenes"][scene]["nodes"] if out.json.get("scenes") else sorted(
        set(range(len(model.json["nodes"]))) - {child for node in model.json["nodes"] for child in node.get("children", [])})
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = film.bound.turn, film.bound.shift
    source = out.node(name="source", matrix=place.T.ravel().tolist(), children=list(roots))
    body = out.node(name=name, children=[source])
    out.json["scenes"], out.json["scene"] = [{"nodes": [out.node(name="world", rotation=UPRIGHT, children=[body])]}], 0

    times = out.accessor(np.array([key[0] for key in film.keys], np.float32), True)
    weights = np.zeros((len(film.keys), len(film.shapes)), np.float32)
    for row, (_, _, shape) in zip(weights, film.keys):
        row[shape - 1 : shape] = 1  # none for shape 0
    animation: dict[str, Any] = {"samplers": [], "channels": []}

    def animate(nodes: list[int], path: str, values: Array) -> None:
        animation["samplers"].append({"input": times, "output": out.accessor(values)})
        animation["channels"] += [{"sampler": len(animation["samplers"]) - 1, "target": {"node": each, "path": path}} for each in nodes]

    animate([body], "translation", np.array([key[1].position for key in film.keys]))
    animate([body], "rotation", np.array([key[1].orientation for key in film.keys]))
    if film.shapes:
        animate(list(of_node), "weights", weights.ravel())
    out.json["animations"] = [animation]
    out.json.pop("skins", None)
    for node in out.json["nodes"]:
        node.pop("skin", None)
    out.json["asset"]["copyright"] = film.attribution
    out.save(path)


def films_of(recording: Recording, model: Model, fps: float) -> dict[str, Film]:
    """By the name of the file. As in export.cpp: a frame is the state after the first tick in its time, or after a tick in which a car
    appears; frames in which nothing changed are left out."""
    cars, films = bytes_of_cars(recording), dict[str, Film]()
    poses = {car: (sorted(known), known) for car, known in recording.poses().items()}
    bound: dict[str, Bound | None] = {}
    names: dict[str, list[str]] = {}  # of each car: its assets
    step, before = -1.0, 0.0
    for frame in recording.frames():
        now = np.floor(frame.time * fps)
        here = {car: surface for car in frame.cars() if (surface := frame.surface(car))}
        if now <= step and all(surface.asset in names.get(car, ()) for car, surface in here.items()):
            continue
        step = now
        for car, surface in here.items():
            if surface.asset not in bound:
                source = source_of(cars[surface.asset])
                try:
                    bound[surface.asset] = None if source is None else Bound(model, frame, surface.asset, source)
                except Error:
                    bound[surface.asset] = None
            assets = names.setdefault(car, [])
            assets += [] if surface.asset in assets else [surface.asset]
            own = bound[surface.asset]
            ticks, known = poses.get(car, ([], {}))
            last = int(np.searchsorted(ticks, frame.tick, side="right")) - 1
            seen = own.vertices(frame, car) if own and last >= 0 else None
            if not own or not seen:
                continue
            at = assets.index(surface.asset)
            name = car if at == 0 else f"{car}-{at + 1}"
            mesh = frame.mesh(surface.asset)
            film = films.setdefault(name, Film(own, frame.time, mesh.attribution))
            if film.rest is None:
                film.rest = np.concatenate([np.zeros((len(piece.position), 3), np.float32) if piece.normal is None else piece.normal for piece in model.pieces])
            shape = film.keys[-1][2] if film.keys else 0
            if surface.quanta.any() and (film.last is None or (seen.position != film.last).any()):
                film.last = seen.position
                film.shapes.append((seen.position - own.rest, seen.normal - film.rest))
                shape = len(film.shapes)
            elif not surface.quanta.any():
                shape = 0
            pose = known[ticks[last]]
            if film.keys and film.keys[-1][1:] == (pose, shape):
                continue
            if film.keys and before - film.start > film.keys[-1][0]:  # it stood still until the frame before
                film.keys.append((before - film.start, *film.keys[-1][1:]))
            film.keys.append((frame.time - film.start, pose, shape))
        before = frame.time
    if not films:
        raise Error(f"{model.path}: none of the cars was baked from it, or the cars do not say where their source's coordinates are; bake them again")
    return films


def main() -> None:
    file, folder, mesh, fps = sys.argv[1:]
    try:
        model = Model(mesh)
        with Recording(file) as recording:
            for name, film in films_of(recording, model, float(fps)).items():
                write(pathlib.Path(folder) / f"{name}.glb", name, film)
                print(f"{pathlib.Path(folder) / name}.glb: {len(film.bound.rest)} vertices of {mesh}, {len(film.shapes)} shapes")
    except OSError as error:
        sys.exit(f"{error.filename or mesh}: {error.strerror}; give another file or -o FOLDER")
    except Error as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
