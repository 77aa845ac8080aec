"""Reads a model that a game draws, a glTF file, with its materials and textures, and binds it to a baked car."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import pathlib
import struct
import urllib.parse
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from crumple._library import Error
from crumple.recording import Frame, Recording
from crumple.schema.Car import Car
from crumple.session import View
from crumple.types import Vertices

Array = NDArray[Any]

MOST_BYTES = 512 << 20  # of the file, as in `crumple bake`
MOST_NODES = 100_000  # a car has hundreds
TEXTURE = 512  # pixels: larger pictures are made smaller, since a car in a picture is no larger
KINDS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
GLB, JSON_CHUNK, BIN_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
CLEAR = 0.99  # less opaque is glass
NO_LOOK = 255
FAR, LEAST_ON_VERTICES = 0.3, 0.3  # m, share of the vertices: a model that is farther and has fewer is another car


@dataclass
class Look:
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)  # as in a picture, not linear light
    gloss: float = 0.5
    glass: bool = False
    texture: Array | None = None  # height x width x 3 bytes


@dataclass
class Piece:
    """A primitive of a mesh where a node puts it."""

    node: int
    primitive: int
    turn: Array  # 3 x 3, from its own coordinates to those of the file
    position: Array  # n x 3, in the file's coordinates
    normal: Array | None
    tangent: Array | None
    triangle: Array
    uv: Array | None
    look: Look


def srgb(linear: Array) -> Array:
    """Turns light from 0 to 1 into the numbers of a picture from 0 to 1."""
    return np.where(linear < 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def gloss_of(metallic: float, roughness: float) -> float:
    return float(max(1 - roughness, 0.5 * metallic))


class Model:
    """A glTF or GLB file. Raises Error with a sentence."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = pathlib.Path(path)
        self._buffers: dict[int, bytes] = {}
        self._pictures: dict[int, Array] = {}
        try:
            if self.path.stat().st_size > MOST_BYTES:
                self._refuse("it is larger than 512 MiB; export the car alone")
            self.json, self._bin = self._open()
            self.pieces = list(self._pieces())
        except (KeyError, IndexError, TypeError, ValueError, AttributeError, struct.error, RecursionError, OverflowError) as error:
            self._refuse(f"it is no sound glTF file ({type(error).__name__}: {error}); export it again as GLB")
        if not self.pieces:
            self._refuse("it has no triangles")

    def _refuse(self, fact: str) -> Any:
        raise Error(f"{self.path}: {fact}")

    def _open(self) -> tuple[dict[str, Any], bytes]:
        data = self.path.read_bytes()
        if data[:4] != b"glTF":
            return json.loads(data), b""
        length, kind = struct.unpack_from("<II", data, 12)
        if kind != JSON_CHUNK:
            raise ValueError("its first chunk is not JSON")
        at = 20 + length
        binary = b""
        if at + 8 <= len(data):
            size, kind = struct.unpack_from("<II", data, at)
            binary = data[at + 8 : at + 8 + size] if kind == BIN_CHUNK else b""
        return json.loads(data[20:at]), binary

    def buffer(self, index: int) -> bytes:
        buffer = self.json["buffers"][index]
        if index not in self._buffers:
            data = self._bin if "uri" not in buffer else self.fetch(buffer["uri"])
            if len(data) < buffer["byteLength"]:
                raise ValueError(f"buffer {index} is cut off")
            self._buffers[index] = data
        return self._buffers[index]

    def fetch(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        beside = (self.path.parent / urllib.parse.unquote(uri).replace("\\", "/")).resolve()
        if not beside.is_relative_to(self.path.parent.resolve()) or not beside.is_file():
            self._refuse(f"its file {uri[:80]!r} is not beside it; export it as one GLB file")
        return beside.read_bytes()

    def _view(self, index: int) -> tuple[bytes, int, int]:
        view = self.json["bufferViews"][index]
        data, at, size = self.buffer(view["buffer"]), view.get("byteOffset", 0), view["byteLength"]
        if at < 0 or size < 0 or at + size > len(data):
            raise ValueError(f"view {index} is outside its buffer")
        return data[at : at + size], size, view.get("byteStride", 0)

    def array(self, index: int) -> Array:
        accessor = self.json["accessors"][index]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise ValueError("an accessor is sparse")
        kind, width, count = np.dtype(KINDS[accessor["componentType"]]), WIDTHS[accessor["type"]], accessor["count"]
        data, size, stride = self._view(accessor["bufferView"])
        stride, at = stride or kind.itemsize * width, accessor.get("byteOffset", 0)
        if count < 1 or at < 0 or at + (count - 1) * stride + kind.itemsize * width > size:
            raise ValueError(f"accessor {index} is outside its view")
        rows = np.ndarray((count, width), kind, data, at, (stride, kind.itemsize))
        if accessor.get("normalized"):
            return (rows / np.iinfo(kind).max).astype(np.float32)
        return np.ascontiguousarray(rows)

    def _pieces(self) -> Iterator[Piece]:
        nodes = self.json.get("nodes", [])
        scenes = self.json.get("scenes") or [{"nodes": range(len(nodes))}]
        todo = [(index, np.eye(4)) for index in scenes[self.json.get("scene", 0)]["nodes"]]
        seen: set[int] = set()
        while todo:
            index, above = todo.pop()
            if index in seen or len(seen) > MOST_NODES:
                raise ValueError("a node hangs below two others")
            seen.add(index)
            node = nodes[index]
            place = above @ placed(node)
            todo += [(child, place) for child in node.get("children", [])]
            if "mesh" not in node:
                continue
            for k, primitive in enumerate(self.json["meshes"][node["mesh"]]["primitives"]):
                if primitive.get("mode", 4) == 4:
                    yield self._piece(index, k, primitive, place)

    def _piece(self, node: int, k: int, primitive: dict[str, Any], place: Array) -> Piece:
        if "KHR_draco_mesh_compression" in primitive.get("extensions", {}):
            self._refuse("its meshes are compressed by Draco; export it without compression")
        attributes = primitive["attributes"]
        own = self.array(attributes["POSITION"]).astype(np.float64)
        position = (own @ place[:3, :3].T + place[:3, 3]).astype(np.float32)
        if position.shape[1] != 3 or not np.isfinite(position).all():
            raise ValueError("a position is not three finite numbers")
        count = len(position)
        triangle = self.array(primitive["indices"])[:, 0].astype(np.int64) if "indices" in primitive else np.arange(count)
        triangle = triangle[: len(triangle) // 3 * 3].reshape(-1, 3)
        if len(triangle) and not 0 <= triangle.min() <= triangle.max() < count:
            raise ValueError("a triangle names a vertex that does not exist")

        def directions(name: str, turn: Array) -> Array | None:
            if name not in attributes:
                return None
            vectors = self.array(attributes[name])[:, :3].astype(np.float64) @ turn.T
            length = np.linalg.norm(vectors, axis=1, keepdims=True)
            return np.where(length > 1e-12, vectors / np.maximum(length, 1e-12), [0.0, 0.0, 1.0]).astype(np.float32)

        turn = place[:3, :3]
        normal = directions("NORMAL", np.linalg.inv(turn).T if abs(np.linalg.det(turn)) > 1e-30 else turn)
        look, coordinates = self._look(primitive.get("material"))
        uv = self.array(attributes[coordinates]) if look.texture is not None and coordinates in attributes else None
        return Piece(node, k, turn, position, normal, directions("TANGENT", turn), triangle, uv, look)

    def _look(self, index: int | None) -> tuple[Look, str]:
        if index is None:
            return Look(), ""
        material = self.json["materials"][index]
        paint = material.get("pbrMetallicRoughness", {})
        factor = np.array(paint.get("baseColorFactor", [1, 1, 1, 1]), float)
        blends = material.get("alphaMode") == "BLEND"
        glass = (blends and factor[3] < CLEAR) or material.get("extensions", {}).get("KHR_materials_transmission", {}).get("transmissionFactor", 0) > 0.5
        look = Look(tuple(srgb(np.clip(factor[:3], 0, 1)).tolist()), gloss_of(paint.get("metallicFactor", 1), paint.get("roughnessFactor", 1)), glass)
        texture = paint.get("baseColorTexture")
        if texture and not glass:
            look.texture = self._texture(texture["index"])
        return look, f"TEXCOORD_{texture.get('texCoord', 0)}" if texture else ""

    def _texture(self, index: int) -> Array | None:
        source = self.json["textures"][index].get("source")
        if source is None:  # it is only in a format of an extension
            return None
        if source not in self._pictures:
            image = self.json["images"][source]
            data = self._view(image["bufferView"])[0] if "bufferView" in image else self.fetch(image["uri"])
            with warnings.catch_warnings():
                warnings.simplefilter("error", Image.DecompressionBombWarning)
                try:
                    picture = Image.open(io.BytesIO(data))
                    picture.thumbnail((TEXTURE, TEXTURE))
                    self._pictures[source] = np.asarray(picture.convert("RGB"))
                except (OSError, SyntaxError, Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
                    raise ValueError(f"its picture {source} cannot be read: {error}") from None
        return self._pictures[source]


def placed(node: dict[str, Any]) -> Array:
    """The 4 x 4 matrix of a node."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    out = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), float)
    turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    out[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]), float)
    out[:3, 3] = node.get("translation", [0, 0, 0])
    return out


class Bound:
    """A model bound to a baked car: its vertices, piece after piece, follow the dents of the car in one View."""

    def __init__(self, model: Model, view: View, asset: str, source_to_car: Array) -> None:
        place = source_to_car.reshape(3, 4)
        self.model, self.turn, self.shift = model, place[:, :3], place[:, 3]
        self.first = np.cumsum([0] + [len(piece.position) for piece in model.pieces])
        self.rest = np.concatenate([piece.position for piece in model.pieces])
        self.rest_in_car = self.in_car(self.rest)
        up = np.array([[0, 0, 1]], np.float32)  # of vertices that have none

        def all_of(of: str) -> Array:
            lists = (getattr(piece, of) for piece in model.pieces)
            return np.concatenate([up.repeat(len(piece.position), 0) if each is None else each for piece, each in zip(model.pieces, lists)])

        self._own = view.map(asset, self.rest, all_of("normal"), all_of("tangent"), place)
        if self._own.farthest > FAR and self._own.on_vertices < LEAST_ON_VERTICES * len(self.rest):
            raise Error(f"{model.path}: its vertices are up to {self._own.farthest:.1f} m from the car, and {self._own.on_vertices} of "
                        f"{len(self.rest)} lie on a vertex of it; give the file from which the car was baked, or one in its coordinates")

    def vertices(self, view: View, car: str) -> Vertices | None:
        """In the file's coordinates."""
        return view.vertices(car, own=self._own)

    def in_car(self, position: Array) -> Array:
        return np.asarray(position @ self.turn.T + self.shift, np.float32)


def bytes_of_cars(recording: Recording) -> dict[str, bytes]:
    """The baked cars of a recording, by hash."""
    out = dict(recording.assets)
    with Frame(recording, 0) as frame:
        for data in recording.given:
            with contextlib.suppress(Error):  # the server refused this car too
                out[frame.add_asset(data)] = data
    return out


def source_of(car: bytes) -> Array | None:
    """The rows of the 3 x 4 matrix from the coordinates of the car's source to the car. None: the car does not know it."""
    matrix = Car.GetRootAs(car).SourceToCarAsNumpy()
    return None if isinstance(matrix, int) or len(matrix) != 12 else np.array(matrix, np.float64)


def looks_of(car: bytes) -> tuple[list[Look], Array]:
    """The looks in a baked car, and the number of the look of each triangle; NO_LOOK: none."""
    read = Car.GetRootAs(car)
    looks = []
    for i in range(read.LookLength()):
        look = read.Look(i)
        color = look.Color()
        light = np.array([color.Red(), color.Green(), color.Blue()])
        looks.append(Look(tuple(srgb(light).tolist()), gloss_of(look.Metallic(), look.Roughness()), color.Opacity() < CLEAR))
    return looks, read.TriangleLookAsNumpy() if looks else np.full(read.TriangleLength() // 3, NO_LOOK, np.uint8)
