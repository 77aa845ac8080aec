"""`crumple render CAR` draws a baked car as one picture. It shows what is solid, what is hollow, what is held, and where the front
is. It writes CAR.png into the folder:
  cuts           lengthwise through the middle, and across at the front axle and in the middle: tets, and the surface's outline
  surface        from the side, from above and from the front; colours show its parts
  tets           their boundary under the translucent surface, which is red where it lies far outside the tets
  regions        by colour, and the anchored nodes
"""

from __future__ import annotations

import os
import pathlib
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from PIL import Image, ImageDraw

from crumple._library import Error, ffi
from crumple.schema.Car import Car
from crumple.session import View
from crumple.trace import Array, Mesh, Scene, _corner_normals, _dot, _unit, framed
from crumple.types import Mesh as CarMesh
from crumple.types import Part, PartKind

matplotlib.use("Agg")
import matplotlib.colors  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.collections import LineCollection, PolyCollection  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.lines import Line2D  # noqa: E402
from matplotlib.patches import Patch  # noqa: E402

MOST_BYTES = 256 << 20  # a baked car, as in the server
FAR = 0.04  # m outside the tets: from here on the surface is red, and the bake names the part
SOLID, HELD, HOLLOW = "#0072B2", "#D55E00", "#FCE79A"
AIR = "#FFFFFF"
SURFACE, OUTSIDE = (0.62, 0.66, 0.70), (0.83, 0.0, 0.22)
# Okabe and Ito's colours, then others that differ from them: one for each of 16 regions.
REGIONS = ["#9AA5AE", "#56B4E9", "#009E73", "#F0E442", "#CC79A7", "#0072B2", "#7A5C00", "#8DD3A0", "#B39DDB", "#5D4037", "#00ACC1",
           "#C0CA33", "#FF8A80", "#37474F", "#FFCC80", "#827717"]
# Of parts that are not body or panel.
PARTS = {PartKind.glass: "#7FC4E8", PartKind.light: "#F0C419", PartKind.wheel: "#2B2B30", PartKind.interior: "#8A6D5A", PartKind.point: "#B0158C"}
TINT = 0.5  # opacity of glass
MOST_LABELS = 24
AXES = ("x, m (forward)", "y, m (left)", "z, m (up)")
PIXELS = 800  # along the car, in pictures of its surface
MOST_DOTS = 20_000
MOST_AROUND = 1000  # triangles around a vertex that are compared with each other
DPI = 110


@dataclass
class Baked:
    """What the picture shows of a baked car. Its bytes have been checked."""

    file: str
    name: str
    attribution: str
    node: Array  # n x 3, m
    region: Array  # n
    anchored: Array  # n, bool
    tet: Array  # t x 4
    vertex: Array  # v x 3, m
    triangle: Array  # f x 3
    distance: Array  # v, m, from the vertex to its tet; 0 of wheels
    regions: list[str]
    mass: float  # kg
    parts: tuple[Part, ...]
    kind: Array  # f, the PartKind of each triangle

    @property
    def size(self) -> Array:
        return np.asarray(np.ptp(self.vertex, axis=0))

    @property
    def held(self) -> Array:
        """The tets that cannot deform, because all their nodes are anchored."""
        return np.asarray(self.anchored[self.tet].all(1))


def is_baked_car(path: str | os.PathLike[str]) -> bool:
    with open(path, "rb") as file:
        return file.read(8)[4:] == b"CRMP"


def read_baked(path: str | os.PathLike[str]) -> Baked:
    with open(path, "rb") as file:
        data = file.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise Error(f"{os.fspath(path)}: it is larger than 256 MiB; bake the car with fewer nodes")
    try:
        scene = ffi.new("char[]", b"car")
        with View(scene=scene) as view:
            mesh = view.mesh(view.add_asset(data))  # checks every size and index
    except Error as refused:
        raise Error(f"{os.fspath(path)}: {refused}") from None
    car = Car.GetRootAs(data)

    def rows(first: Any, count: int, kind: str, width: int) -> Array:
        return np.frombuffer(data, kind, count * width, first._tab.Pos).reshape(count, width)

    kind = kinds_of(mesh)
    wheel = np.zeros(car.VertexLength(), bool)
    wheel[mesh.triangle[kind == PartKind.wheel]] = True
    node = rows(car.Node(0), car.NodeLength(), "<f4", 3)
    vertex = rows(car.Vertex(0), car.VertexLength(), "<f4", 3)
    skin = rows(car.Skin(0), car.SkinLength(), "<u4", 8)[:, :4]
    size = np.ptp(vertex, axis=0)
    if size.min() < 1e-3 * size.max() or size.max() < 1e-2:
        raise Error(f"{os.fspath(path)}: its surface is flat or smaller than 10 mm; bake a car that has an inside")
    return Baked(
        shown(os.fsencode(pathlib.Path(path).name)), shown(car.Name()), shown(car.Attribution()), node, car.NodeRegionAsNumpy(), car.NodeAnchoredAsNumpy() == 1,
        rows(car.Tet(0), car.TetLength(), "<u4", 4), vertex, car.TriangleAsNumpy().reshape(-1, 3),
        np.where(wheel, 0.0, distance_to_tets(vertex, node[skin])), [shown(car.Region(i)) for i in range(car.RegionLength())], car.Mass(),
        mesh.parts, kind)


def kinds_of(mesh: CarMesh) -> Array:
    """Gives the kind of the part of each triangle."""
    if mesh.vertex_part is None:
        return np.zeros(len(mesh.triangle), np.uint8)
    return np.array([part.kind for part in mesh.parts], np.uint8)[mesh.vertex_part[mesh.triangle[:, 0]]]


def shown(text: bytes) -> str:
    """Names are other people's bytes: only letters that the font has, and not too many of them."""
    return "".join(c if c.isprintable() and ord(c) < 0x250 else "?" for c in text.decode("utf-8", "replace")[:200])


# ---- geometry ----


def distance_to_tets(point: Array, corner: Array) -> Array:
    """Gives for each point the distance to its own tet, whose corners are n x 4 x 3: 0 inside."""
    p, c = point.astype(np.float64), corner.astype(np.float64)
    edges = c[:, 1:] - c[:, :1]
    weight = np.linalg.solve(edges.transpose(0, 2, 1), (p - c[:, 0])[..., None])[..., 0]
    inside = (weight >= -1e-7).all(1) & (weight.sum(1) <= 1 + 1e-7)
    least = np.full(len(p), np.inf)
    for a, b, d in ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)):
        least = np.minimum(least, _distance_to_triangles(p, c[:, a], c[:, b], c[:, d]))
    return np.where(inside, 0.0, least)


def _distance_to_triangles(p: Array, a: Array, b: Array, c: Array) -> Array:
    normal = np.cross(b - a, c - a)
    over = np.ones(len(p), bool)
    least = np.full(len(p), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        along = np.clip(_dot(p - start, edge) / np.maximum(_dot(edge, edge), 1e-30), 0, 1)
        least = np.minimum(least, np.linalg.norm(p - start - along * edge, axis=1))
        over &= _dot(np.cross(edge, p - start), normal)[:, 0] >= 0
    flat = np.abs(_dot(p - a, _unit(normal)))[:, 0]
    return np.where(over, np.minimum(flat, least), least)


def smallest_dihedral(node: Array, tet: Array) -> float:
    """Degrees, between two faces of a tet."""
    corner = node[tet].astype(np.float64)
    out = []
    for i, j, k, m in ((0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 0, 2), (2, 3, 0, 1)):
        edge = _unit(corner[:, j] - corner[:, i])
        sides = [side - _dot(side, edge) * edge for side in (corner[:, k] - corner[:, i], corner[:, m] - corner[:, i])]
        out.append(np.arccos(np.clip(_dot(_unit(sides[0]), _unit(sides[1])), -1, 1)).min())
    return float(np.degrees(min(out)))


def boundary(tet: Array) -> tuple[Array, Array]:
    """Gives the faces of only one tet, and the tet of each."""
    faces = np.concatenate([tet[:, [1, 2, 3]], tet[:, [0, 3, 2]], tet[:, [0, 1, 3]], tet[:, [0, 2, 1]]])
    _, first, count = np.unique(np.sort(faces, 1), axis=0, return_index=True, return_counts=True)
    alone = np.sort(first[count == 1])
    return faces[alone], alone % len(tet)


def cut_tets(node: Array, tet: Array, axis: int, at: float) -> tuple[list[Array], Array]:
    """Gives the polygons in which a plane across this axis cuts the tets, as points of the two other axes, and the tet of each."""
    flat = [k for k in range(3) if k != axis]
    side = node[:, axis].astype(np.float64) - at
    above = (side > 0)[tet]
    polygons: list[Array] = []
    owner = []
    for few in (1, 3, 2):
        which = np.flatnonzero(above.sum(1) == few)
        order = np.argsort(above[which] if few == 3 else ~above[which], axis=1, kind="stable")
        corner = np.take_along_axis(tet[which], order, 1)  # those of the smaller group first
        pairs = ((0, 2), (0, 3), (1, 3), (1, 2)) if few == 2 else ((0, 1), (0, 2), (0, 3))
        points = []
        for i, j in pairs:
            a, b = corner[:, i], corner[:, j]
            share = (side[a] / (side[a] - side[b]))[:, None]
            points.append(node[a][:, flat] * (1 - share) + node[b][:, flat] * share)
        polygons += list(np.stack(points, 1)) if len(which) else []
        owner.append(which)
    return polygons, np.concatenate(owner)


def cut_triangles(vertex: Array, triangle: Array, axis: int, at: float) -> Array:
    """Gives the lines, n x 2 x 2, in which a plane across this axis cuts the surface."""
    flat = [k for k in range(3) if k != axis]
    side = vertex[:, axis].astype(np.float64) - at
    above = (side > 0)[triangle]
    which = np.flatnonzero((above.sum(1) > 0) & (above.sum(1) < 3))
    lone = above[which] == (above[which].sum(1) == 1)[:, None]
    first = lone.argmax(1)
    corner = np.take_along_axis(triangle[which], (first[:, None] + np.arange(3)) % 3, 1)
    ends = []
    for k in (1, 2):
        a, b = corner[:, 0], corner[:, k]
        share = (side[a] / (side[a] - side[b]))[:, None]
        ends.append(vertex[a][:, flat] * (1 - share) + vertex[b][:, flat] * share)
    return np.stack(ends, 1)


def front_axle(car: Baked) -> float:
    """Finds where the front wheels touch the ground: what is lowest in the front half. Without wheels a quarter of the length."""
    low, length = car.vertex.min(0), float(car.size[0])
    middle = low[0] + length / 2
    lowest = car.vertex[(car.vertex[:, 2] < low[2] + 0.05 * car.size[2]) & (car.vertex[:, 0] > middle), 0]
    if len(lowest) >= 3:
        at = float((lowest.min() + lowest.max()) / 2)
        if np.ptp(lowest) < 0.2 * length and 0.15 * length < at - middle < 0.45 * length:
            return at
    return float(middle + length / 4)


# ---- the panels ----


@dataclass
class Cut:
    axis: int
    at: float
    polygons: list[Array]
    held: Array  # of each polygon
    outline: Array
    hollow: Array  # a bool of each point of a grid
    extent: tuple[float, float, float, float]
    areas: tuple[float, float]  # m^2, solid and hollow


def make_cut(car: Baked, scene: Scene, axis: int, at: float) -> Cut:
    """A point without tets is hollow if it is shut in: if in the plane of the cut three of four directions meet the surface or
    tets."""
    at += 1e-4 * float(car.size.max())  # beside the nodes and seams that often lie in the middle
    polygons, owner = cut_tets(car.node, car.tet, axis, at)
    flat = [k for k in range(3) if k != axis]
    low, high = car.vertex.min(0)[flat], car.vertex.max(0)[flat]
    step = float(car.size.max()) / 500
    count = np.maximum(np.ceil((high - low) / step).astype(int), 2)
    u, v = (low[k] + (np.arange(count[k]) + 0.5) * (high[k] - low[k]) / count[k] for k in (0, 1))
    point = np.zeros((count[1], count[0], 3), np.float32)
    point[..., axis], point[..., flat[0]], point[..., flat[1]] = at, u[None, :], v[:, None]
    point = point.reshape(-1, 3)
    filled = _filled(polygons, low, high, count)
    empty = np.flatnonzero(~filled.ravel())
    shut = np.zeros(len(empty))
    for turn in (np.arange(24) + 0.5) * np.pi / 12:
        direction = np.zeros(3, np.float32)
        direction[flat[0]], direction[flat[1]] = np.cos(turn), np.sin(turn)
        shut += ~scene.reached(point[empty], direction) / 24
    hollow = np.zeros(count[0] * count[1], bool)
    hollow[empty] = smooth(shut, empty, count)[empty] >= 0.75
    cell = float(np.prod((high - low) / count))
    extent = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
    return Cut(axis, at, polygons, car.held[owner], cut_triangles(car.vertex, car.triangle, axis, at),
               hollow.reshape(count[1], count[0]), extent, (cell * float(filled.sum()), cell * float(hollow.sum())))


def smooth(value: Array, where: Array, count: Array) -> Array:
    """Gives the mean of the values around each point of a grid: rays that just miss an edge leave single points."""
    total, known = np.zeros(count[0] * count[1]), np.zeros(count[0] * count[1])
    total[where], known[where] = value, 1
    total, known = total.reshape(count[1], count[0]), known.reshape(count[1], count[0])
    for axis in (0, 1):
        total, known = (np.sum([np.roll(each, k, axis) for k in range(-4, 5)], axis=0) for each in (total, known))
    return np.asarray(total / np.maximum(known, 1)).ravel()


def _filled(polygons: list[Array], low: Array, high: Array, count: Array) -> Array:
    """Which points of a grid lie in a polygon; rows are the second axis."""
    image = Image.new("1", (int(count[0]), int(count[1])))
    pen = ImageDraw.Draw(image)
    for polygon in polygons:
        pen.polygon([tuple(p) for p in ((polygon - low) / (high - low) * count - 0.5).tolist()], fill=1)
    return np.array(image)


def flat_axes(axis: int) -> tuple[int, int]:
    """Gives the car's axes that go right and up in a picture along this axis."""
    return ((1, 2), (0, 2), (0, 1))[axis]


def look_along(car: Baked, mesh: tuple[Array, Array], color: Array, axis: int, far: Array | None = None,
               glass: Array | None = None) -> Array:
    """Draws triangles as they are seen from far away: from the front (0), from the car's right (1) or from above (2). glass:
    whether a triangle is translucent. Gives an image with alpha."""
    right, up = flat_axes(axis)
    sign = -1 if axis == 1 else 1
    low, high = car.vertex.min(0), car.vertex.max(0)
    step = float(car.size.max()) / PIXELS
    w, h = (max(2, int(np.ceil((high[k] - low[k]) / step))) for k in (right, up))
    origin = np.zeros((2 * h, 2 * w, 3), np.float32)
    origin[..., right] = low[right] + (np.arange(2 * w) + 0.5) / (2 * w) * (high[right] - low[right])
    origin[..., up] = (high[up] - (np.arange(2 * h) + 0.5) / (2 * h) * (high[up] - low[up]))[:, None]
    origin[..., axis] = (high if sign > 0 else low)[axis] + sign
    toward = np.zeros(3, np.float32)
    toward[axis] = -sign
    vertex, triangle = mesh
    solid = np.ones(len(triangle), bool) if glass is None or glass.all() else ~glass
    image, depth, _ = shade(Scene([Mesh(vertex, triangle[solid], (0, 0, 0))]), origin.reshape(-1, 3), toward, color[solid], far)
    if not solid.all():
        panes, near, red = shade(Scene([Mesh(vertex, triangle[~solid], (0, 0, 0))]), origin.reshape(-1, 3), toward, color[~solid], far)
        share = np.where(near < depth, np.where(red, 1, TINT), 0)[:, None] * panes[:, 3:]
        alpha = share + image[:, 3:] * (1 - share)
        image[:, :3] = (panes[:, :3] * share + image[:, :3] * image[:, 3:] * (1 - share)) / np.maximum(alpha, 1e-6)
        image[:, 3:] = alpha
    return halved(image, 2 * w, 2 * h)


def halved(image: Array, width: int, height: int) -> Array:
    """Makes one pixel of four, so that edges are smooth."""
    pixels = image.reshape(height // 2, 2, width // 2, 2, 4)
    alpha = pixels[..., 3:].mean((1, 3))
    color = (pixels[..., :3] * pixels[..., 3:]).mean((1, 3)) / np.maximum(alpha, 1e-6)
    return np.concatenate([color, alpha], 2)


def shade(scene: Scene, origin: Array, direction: Array, color: Array, distance: Array | None = None,
          edge: float = 0.0) -> tuple[Array, Array, Array]:
    """Gives red, green, blue and alpha of each ray, how far it went, and whether it met something red. color: of each triangle.
    distance: of each vertex from the tets; red where it is far. edge: m, half the width of the pale lines between triangles,
    which are flat then."""
    rays = np.ascontiguousarray(np.broadcast_to(direction, origin.shape), np.float32)
    found = scene.hits(origin, rays)
    which = found["primID"]
    hit = np.flatnonzero(which >= 0)
    image = np.zeros((len(rays), 4), np.float32)
    which, rays = which[hit], rays[hit]
    weight = np.stack([1 - found["u"][hit] - found["v"][hit], found["u"][hit], found["v"][hit]], 1)
    normal = _unit(found["Ng"][hit])
    if not edge and np.bincount(scene.triangle.ravel()).max() < MOST_AROUND:
        corners = _corner_normals(scene.vertex, scene.triangle)
        normal = _unit(np.einsum("ij,ijk->ik", weight, corners[which]))
    normal *= -np.sign(_dot(normal, rays))
    sun = _unit(np.array([0.4, -0.3, 0.85]))
    light = (0.7 if edge else 0.45) + 0.35 * np.clip(-_dot(normal, rays), 0, 1) + 0.25 * np.clip(_dot(normal, sun), 0, 1)
    red = np.zeros(len(hit), bool)
    if distance is not None:
        red = (weight * distance[scene.triangle[which]]).sum(1) > FAR
    image[hit, :3] = np.clip(np.where(red[:, None], OUTSIDE, color[which]) * light, 0, 1)
    image[hit, 3] = 1
    if edge:
        corner = scene.vertex[scene.triangle[which]]
        opposite = np.linalg.norm(corner[:, [2, 0, 1]] - corner[:, [1, 2, 0]], axis=2)
        twice = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
        line = (weight * twice[:, None] / np.maximum(opposite, 1e-9)).min(1) < edge
        image[hit[line], :3] = 0.5 + 0.5 * image[hit[line], :3]
    is_red = np.zeros(len(image), bool)
    is_red[hit] = red
    return image, np.where(found["primID"] >= 0, found["tfar"], np.inf), is_red


def draw_tets(axes: Axes, car: Baked, width: int, height: int) -> None:
    """Draws the boundary of the tets, and over it the translucent surface."""
    faces, owner = boundary(car.tet)
    points = car.vertex[:: max(1, len(car.vertex) // 5000)]
    camera = framed(np.array([0.8, -1.0, 0.55]), points, 2 * width, 2 * height, 0.0)
    y, x = (each.ravel() + np.float32(0.5) for each in np.mgrid[: camera.height, : camera.width])
    rays = camera.rays(x, y)
    origin = np.broadcast_to(camera.eye, rays.shape)
    pixel = float(np.linalg.norm(camera.eye - points.mean(0))) / camera.focal  # m
    color = np.where(car.held[owner][:, None], to_rgb(HELD), to_rgb(SOLID))
    tets, tets_far, _ = shade(Scene([Mesh(car.node, faces, (0, 0, 0))]), origin, rays, color, edge=0.8 * pixel)
    pale = np.full((len(car.triangle), 3), 0.95)
    surface, surface_far, red = shade(Scene([Mesh(car.vertex, car.triangle, (0, 0, 0))]), origin, rays, pale, car.distance)
    share = np.where(surface_far < tets_far, np.where(red, 1, 0.3), 0)[:, None]
    bare = tets[:, :3] * tets[:, 3:] + 1 - tets[:, 3:]
    image = np.concatenate([bare * (1 - share) + surface[:, :3] * share, np.ones((len(rays), 1))], 1)
    axes.imshow(halved(image, camera.width, camera.height), extent=(0, width, 0, height), interpolation="antialiased")
    axes.set_xlim(0, width)
    axes.set_ylim(0, height)
    axes.axis("off")
    low, high = car.vertex.min(0), car.vertex.max(0)
    middle = (low[1] + high[1]) / 2
    ends = np.array([[high[0] + share * car.size[0], middle, low[2]] for share in (0.02, 0.16)])
    at = (ends - camera.eye) @ camera.axes.T
    across = (camera.width / 2 + camera.focal * at[:, 0] / at[:, 2]) / 2
    upward = (camera.height / 2 + camera.focal * at[:, 1] / at[:, 2]) / 2
    draw_front(axes, (float(across[0]), float(upward[0])), (float(across[1]), float(upward[1])))


def draw_front(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    axes.annotate("", end, start, annotation_clip=False,
                  arrowprops={"arrowstyle": "-|>,head_width=0.5,head_length=0.8", "linewidth": 3, "color": "black", "shrinkA": 0, "shrinkB": 0})
    axes.annotate("FRONT", ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2), (0, 9), textcoords="offset points", fontsize=11,
                  fontweight="bold", ha="center", va="bottom", annotation_clip=False)


def set_up(axes: Axes, car: Baked, axis: int) -> None:
    """Axes in metres, the ground, a scale bar, and an arrow to the front."""
    right, up = flat_axes(axis)
    low, high = car.vertex.min(0), car.vertex.max(0)
    x, y = limits(car, axis)
    axes.set_xlim(*x)
    axes.set_ylim(*y)
    axes.set_aspect("equal")
    axes.set_xlabel(AXES[right], fontsize=8, labelpad=1)
    axes.set_ylabel(AXES[up], fontsize=8, labelpad=1)
    axes.tick_params(labelsize=7, length=2)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, linewidth=0.5)
    axes.set_axisbelow(True)
    if up == 2:
        axes.axhline(low[2], color="#777777", linewidth=0.8, zorder=1)
    bar = next(b for b in (5.0, 1.0, 0.5, 0.1, 0.05) if b <= 0.7 * min(car.size[:2]) or b == 0.05)
    at = y[0] + 0.07 * (y[1] - y[0])
    axes.plot([low[right], low[right] + bar], [at, at], color="black", linewidth=3, solid_capstyle="butt", zorder=5)
    axes.annotate(f"{bar:g} m", (low[right] + bar, at), (4, 0), textcoords="offset points", fontsize=8, va="center")
    if right == 0:
        middle = (low[up] + high[up]) / 2
        draw_front(axes, (high[0] + 0.02 * car.size[0], middle), (high[0] + 0.13 * car.size[0], middle))
    else:
        axes.text(0.985, 0.97, "seen from the FRONT", fontsize=8, fontweight="bold", ha="right", va="top", transform=axes.transAxes)


def limits(car: Baked, axis: int) -> tuple[tuple[float, float], tuple[float, float]]:
    right, up = flat_axes(axis)
    low, high, size = car.vertex.min(0).astype(float), car.vertex.max(0).astype(float), car.size.astype(float)
    room = 0.16 * size[0] if right == 0 else 0.08 * size[right]
    return ((low[right] - 0.06 * size[right], high[right] + room), (low[up] - 0.17 * size[up], high[up] + 0.12 * size[up]))


def draw_cut(axes: Axes, car: Baked, cut: Cut) -> None:
    set_up(axes, car, cut.axis)
    shown = np.zeros((*cut.hollow.shape, 4))
    shown[cut.hollow] = (*to_rgb(HOLLOW), 1)
    axes.imshow(shown, extent=cut.extent, origin="lower", interpolation="nearest", zorder=2)
    colors = np.where(cut.held, HELD, SOLID)
    axes.add_collection(PolyCollection(cut.polygons, facecolors=colors, edgecolors="white", zorder=3,
                                       linewidths=0.35 if len(cut.polygons) < 2000 else 0.12))
    axes.add_collection(LineCollection(list(cut.outline), colors="black", linewidths=1.3, zorder=4, capstyle="round"))


def draw_surface(axes: Axes, car: Baked, axis: int) -> None:
    set_up(axes, car, axis)
    palette = np.array([to_rgb(PARTS[kind]) if kind in PARTS else SURFACE for kind in PartKind])
    glass = car.kind == PartKind.glass
    put_image(axes, car, look_along(car, (car.vertex, car.triangle), palette[car.kind], axis, car.distance, glass), axis)
    right, up = flat_axes(axis)
    placed = [part for part in car.parts if part.kind in (PartKind.wheel, PartKind.point)][:MOST_LABELS]
    for part in placed:
        at = part.pose.position[right], part.pose.position[up]
        axes.plot(*at, "+", color="white" if part.kind == PartKind.wheel else PARTS[part.kind], markersize=8, zorder=6)
        if part.kind == PartKind.point:
            axes.annotate(part.name[:40], at, (5, 4), textcoords="offset points", fontsize=7, zorder=6, parse_math=False)


def put_image(axes: Axes, car: Baked, image: Array, axis: int, alpha: float = 1.0) -> None:
    right, up = flat_axes(axis)
    low, high = car.vertex.min(0), car.vertex.max(0)
    axes.imshow(image, extent=(low[right], high[right], low[up], high[up]), interpolation="antialiased", alpha=alpha, zorder=2)


def draw_regions(axes: Axes, car: Baked, axis: int) -> None:
    """Draws the boundary of the tets in the colours of their regions, and over it the nodes of painted regions and the anchored
    nodes, also those that lie inside."""
    set_up(axes, car, axis)
    faces, owner = boundary(car.tet)
    palette = np.array([to_rgb(color) for color in REGIONS])
    votes = car.region[faces]
    color = palette[np.where(votes[:, 1] == votes[:, 2], votes[:, 1], votes[:, 0]) % len(palette)]
    put_image(axes, car, look_along(car, (car.node, faces), color, axis), axis, 0.55)
    right, up = flat_axes(axis)
    for which, size, line in ((car.region > 0, 5, 0.0), (car.anchored, 14, 0.7)):
        nodes = np.flatnonzero(which)
        nodes = nodes[:: max(1, len(nodes) // MOST_DOTS)]
        axes.scatter(car.node[nodes, right], car.node[nodes, up], s=size, c=palette[car.region[nodes] % len(palette)], zorder=3,
                     linewidths=line, edgecolors=HELD)


def part_legend(car: Baked) -> list[Any]:
    kinds = [part.kind for part in car.parts]
    names = {PartKind.glass: "glass", PartKind.light: "lights", PartKind.interior: "interior",
             PartKind.wheel: f"wheels: {kinds.count(PartKind.wheel)}", PartKind.point: f"points: {kinds.count(PartKind.point)}"}
    return [Patch(color=PARTS[kind], label=name) for kind, name in names.items() if kind in kinds]


def region_legend(car: Baked) -> list[Any]:
    count = np.bincount(car.region, minlength=len(car.regions))
    handles: list[Any] = [Patch(color=REGIONS[i % len(REGIONS)], label=f"{name[:40]}: {count[i]:,} nodes")
                          for i, name in enumerate(car.regions)]
    ring = Line2D([], [], linestyle="", marker="o", markersize=4, markerfacecolor=REGIONS[0], markeredgecolor=HELD,
                  label=f"anchored (the safety cell): {int(car.anchored.sum()):,} nodes")
    return [*handles, ring]


def captions(car: Baked) -> list[str]:
    length, width, height = car.size
    far = int((car.distance > FAR).sum())
    return [
        f"{length:.2f} x {width:.2f} x {height:.2f} m (length x width x height)    {car.mass:.0f} kg    {len(car.node):,} nodes    "
        f"{len(car.tet):,} tets    smallest dihedral angle {smallest_dihedral(car.node, car.tet):.1f} degrees",
        f"surface: {len(car.vertex):,} vertices, {len(car.triangle):,} triangles; from a vertex to the nearest tet: mean "
        f"{1000 * car.distance.mean():.1f} mm, largest {1000 * car.distance.max():.0f} mm; {far:,} farther than {1000 * FAR:.0f} mm (red)",
        f"Car: {car.attribution}",
    ]


def draw_sheet(car: Baked) -> tuple[Figure, dict[str, Axes]]:
    """Gives the figure, and its panels by name."""
    body = car.triangle[car.kind != PartKind.wheel] if (car.kind != PartKind.wheel).any() else car.triangle
    surface = Scene([Mesh(car.vertex, body, (0, 0, 0)), Mesh(car.node, boundary(car.tet)[0], (0, 0, 0))])
    low = car.vertex.min(0)
    middle = float(low[0] + car.size[0] / 2)
    cuts = {"lengthwise": make_cut(car, surface, 1, float(low[1] + car.size[1] / 2)),
            "axle": make_cut(car, surface, 0, front_axle(car)), "across": make_cut(car, surface, 0, middle)}

    def areas(name: str) -> str:
        solid, hollow = cuts[name].areas
        return f"solid {solid:.2f} m², hollow {hollow:.2f} m²"

    rows: list[list[tuple[str, int | None, str]]] = [
        [("lengthwise", 1, f"CUT lengthwise in the middle: {areas('lengthwise')}"),
         ("axle", 0, f"CUT across at x = {cuts['axle'].at:.2f} m"), ("across", 0, f"CUT across at x = {cuts['across'].at:.2f} m")],
        [("side", 1, "SURFACE from the side"), ("above", 2, "SURFACE from above"), ("front", 0, "SURFACE from the front")],
        [("tets", None, "TETS under the surface"), ("regions side", 1, "REGIONS and anchored nodes, from the side"),
         ("regions above", 2, "REGIONS and anchored nodes, from above")],
    ]
    wide, gap, label, head, foot = 18.0, 0.7, 0.85, 1.15, 0.95  # inches
    spans: list[list[Array]] = []
    heights: list[float] = []
    for row in rows:
        boxes = [np.ptp(limits(car, 1 if axis is None else axis), axis=1) for _, axis, _ in row]
        scale = min((wide - 0.3 - gap * len(row)) / sum(box[0] for box in boxes), 4.5 / max(box[1] for box in boxes))
        spans.append([scale * box for box in boxes])
        heights.append(max(float(scale * box[1]) for box in boxes))
    handles = region_legend(car)
    columns = 1 if len(handles) < 6 else 3
    heights[2] = max(heights[2], float(spans[2][1][1]) + 0.45 + 0.2 * -(-len(handles) // columns))
    tall = head + sum(heights) + label * len(rows) + foot
    figure = Figure((wide, tall), dpi=DPI, facecolor="white")
    panels: dict[str, Axes] = {}
    top = head
    for row, sizes, height in zip(rows, spans, heights):
        left = gap
        for (name, axis, title), (w, h) in zip(row, sizes):
            h = height if axis is None else h
            axes = figure.add_axes((left / wide, 1 - (top + label / 2 + h) / tall, w / wide, h / tall), label=name)
            axes.set_title(title, loc="left", fontsize=10, fontweight="bold", pad=5)
            panels[name] = axes
            left += w + gap
            if axis is None:
                draw_tets(axes, car, int(w * DPI), int(h * DPI))
            elif name in cuts:
                draw_cut(axes, car, cuts[name])
            elif name.startswith("regions"):
                draw_regions(axes, car, axis)
            else:
                draw_surface(axes, car, axis)
        top += height + label

    def write(x: float, y: float, text: str, **look: Any) -> None:
        figure.text(x / wide, 1 - y / tall, text, parse_math=False, **look)

    write(0.3, 0.42, f"{car.name}  ({car.file})", fontsize=17, fontweight="bold", va="center")
    colors = [Patch(color=SOLID, label="solid: tets that deform"), Patch(color=HELD, label="solid: tets that are held (anchored)"),
               Patch(facecolor=HOLLOW, edgecolor="#B0A060", label="hollow: enclosed, but without tets"),
               Line2D([], [], color="black", label="the surface's outline"),
               Patch(color=OUTSIDE, label=f"surface farther than {1000 * FAR:.0f} mm outside the tets")]
    figure.legend(handles=colors, loc="center left", bbox_to_anchor=(0.3 / wide, 1 - 0.85 / tall), ncols=len(colors), fontsize=10,
                  frameon=False, borderpad=0)
    if parts := part_legend(car):
        figure.legend(handles=parts, loc="center right", bbox_to_anchor=(1 - 0.3 / wide, 1 - 0.42 / tall), ncols=len(parts), fontsize=10,
                      frameon=False, borderpad=0, title="parts", title_fontsize=10)
    legend = panels["regions side"].legend(handles=handles, loc="upper left", borderaxespad=0, fontsize=8, frameon=False, ncols=columns,
                                           bbox_to_anchor=(0, -0.42 / float(spans[2][1][1])))
    for text in legend.get_texts():
        text.set_parse_math(False)
    for i, line in enumerate(captions(car)):
        write(0.3, tall - foot + 0.2 + 0.28 * i, line, fontsize=10.5, va="center")
    return figure, panels


def to_rgb(color: str) -> Array:
    return np.array(matplotlib.colors.to_rgb(color))


def render_car(path: str | os.PathLike[str], folder: str | os.PathLike[str]) -> pathlib.Path:
    """Writes the picture of a baked car into a folder, and gives its path."""
    figure, _ = draw_sheet(read_baked(path))
    written = pathlib.Path(folder) / f"{pathlib.Path(path).stem}.png"
    written.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(written, dpi=DPI)
    return written
