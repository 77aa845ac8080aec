"""Draws triangles by rays: Embree finds what each ray meets. Surfaces are two-sided paint, which reflects a simple sky. Light
comes from one sun, which stands behind the camera, and from the whole sky, each as far as nothing is in its way. Glass tints
what is behind it, mirrors, and gives no shade."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

Array = NDArray[Any]

BACKGROUND = np.array([0.90, 0.92, 0.94], np.float32)
GROUND = np.array([0.74, 0.74, 0.73], np.float32)
SKY_RAYS = 40
SUN_SIZE = 0.06  # radians, so that shadows on the ground have soft edges
GRID = 0.05  # m between the points at which the light on the ground is computed; it varies slowly
AROUND = 2.0  # m around everything: farther out nothing shades the ground
NEAR = 2e-3  # m from its surface at which a ray begins
VIEW = 20.0  # degrees from bottom to top
TINT = 0.45  # share of the light from behind that glass takes


@dataclass(frozen=True)
class Mesh:
    vertex: Array  # n x 3
    triangle: Array  # m x 3
    color: tuple[float, float, float]
    gloss: float = 0.0
    glass: bool = False
    uv: Array | None = None  # n x 2
    texture: Array | None = None  # height x width x 3 bytes, times `color`


class Camera:
    """Looks from `eye` to `target`, with z up. field: degrees from bottom to top. sun: radians by which the sun stands beside
    the eye, anticlockwise from above."""

    def __init__(self, eye: Array, target: Array, width: int, height: int, field: float, sun: float = -0.6) -> None:
        forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        self.eye, self.axes = np.asarray(eye, np.float32), np.stack([right, np.cross(right, forward), forward]).astype(np.float32)
        self.focal = height / 2 / np.tan(np.radians(field) / 2)
        self.width, self.height = width, height
        turn = np.arctan2(-forward[1], -forward[0]) + sun
        self.sun = _unit(np.array([np.cos(turn), np.sin(turn), 1.15], np.float32))

    def rays(self, x: Array, y: Array) -> Array:
        """Gives directions through points of the picture, which are in pixels from its upper left corner."""
        flat = np.stack([(x - self.width / 2) / self.focal, (self.height / 2 - y) / self.focal, np.ones_like(x)], 1)
        return _unit(flat.astype(np.float32) @ self.axes)


def framed(toward: Array, points: Array, width: int, height: int, sun: float) -> Camera:
    """Gives a camera in this direction from the points, as near as it can be and still see them all."""
    toward = toward / np.linalg.norm(toward)
    right = np.cross(-toward, [0, 0, 1])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, -toward)])
    target = points.mean(0)
    steep = 0.9 * np.tan(np.radians(VIEW) / 2) * np.array([width / height, 1])
    away = 0.0
    for _ in range(3):
        at, depth = (points - target) @ axes.T, (points - target) @ -toward
        away = float((np.abs(at) / steep - depth[:, None]).max())
        flat = at / (away + depth)[:, None]
        target = target + away * ((flat.max(0) + flat.min(0)) / 2) @ axes
    return Camera(target + away * toward, target, width, height, VIEW, sun)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b)[..., None])


def _spread(count: int) -> Array:
    """Spreads directions evenly over the upper half of the sphere."""
    i = np.arange(count) + 0.5
    z, turn = 1 - i / count * 0.95, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], 1).astype(np.float32)


def _corner_normals(vertex: Array, triangle: Array, crease: float = 0.75) -> Array:
    """Gives for each corner of each triangle the mean normal of those triangles around its vertex that meet it at less than the
    angle of `crease` (a cosine)."""
    edge = vertex[triangle]
    area = np.cross(edge[:, 1] - edge[:, 0], edge[:, 2] - edge[:, 0])
    unit = _unit(area)
    corner = triangle.ravel()
    order = np.argsort(corner, kind="stable")
    count = np.bincount(corner, minlength=len(vertex))
    first = np.concatenate([[0], np.cumsum(count)])
    of = np.repeat(np.arange(len(corner)), count[corner])  # each corner meets every triangle of its vertex
    within = np.arange(len(of)) - np.repeat(np.cumsum(count[corner]) - count[corner], count[corner])
    other = order[first[corner[of]] + within] // 3
    agrees = (_dot(unit[of // 3], unit[other]) > crease)[:, 0]
    total = np.zeros((len(corner), 3), np.float32)
    np.add.at(total, of[agrees], area[other[agrees]])
    return _unit(total).reshape(-1, 3, 3)


def _sky(direction: Array) -> Array:
    """What a mirror sees: a bright band above the horizon, a darker zenith, a dim ground."""
    z = direction[:, 2:3]
    above = np.clip(z, 0, 1)
    sky = np.array([0.55, 0.62, 0.72]) * (1 - above) ** 2 + np.array([0.95, 0.97, 1.0]) * above * (1 - above) * 3.2
    sky = sky + np.array([0.30, 0.36, 0.45]) * above**2
    return np.asarray(np.where(z > 0, sky, np.array([0.34, 0.34, 0.33]) * np.clip(1 + z, 0, 1)), np.float32)


class Scene:
    """Meshes on level ground."""

    def __init__(self, meshes: list[Mesh], ground: float = 0.0) -> None:
        meshes = sorted(meshes, key=lambda mesh: mesh.glass)
        offset = np.cumsum([0] + [len(mesh.vertex) for mesh in meshes])
        self.vertex = np.concatenate([mesh.vertex for mesh in meshes]).astype(np.float32)
        self.triangle = np.concatenate([mesh.triangle + o for mesh, o in zip(meshes, offset)]).astype(np.int32)
        self.owner = np.repeat(np.arange(len(meshes)), [len(mesh.triangle) for mesh in meshes])
        self.uv = np.concatenate([np.zeros((len(mesh.vertex), 2)) if mesh.uv is None else mesh.uv for mesh in meshes]).astype(np.float32)
        self.texture = [None if mesh.uv is None else mesh.texture for mesh in meshes]
        self.color = np.array([mesh.color for mesh in meshes], np.float32)
        self.gloss = np.array([mesh.gloss for mesh in meshes], np.float32)
        self.ground = ground
        self._embree = EmbreeScene()
        solid = sum(len(mesh.triangle) for mesh in meshes if not mesh.glass)
        self._first_pane = solid or len(self.triangle)
        TriangleMesh(self._embree, self.vertex, self.triangle[: self._first_pane])
        self._panes: Any = None
        if self._first_pane < len(self.triangle):
            self._panes = EmbreeScene()
            TriangleMesh(self._panes, self.vertex, self.triangle[self._first_pane :])

    def hits(self, origin: Array, direction: Array) -> dict[str, Array]:
        origin = np.ascontiguousarray(np.broadcast_to(origin, direction.shape), np.float32)
        found: dict[str, Array] = self._embree.run(origin, np.ascontiguousarray(direction, np.float32), output=True)
        return found

    def reached(self, origin: Array, direction: Array) -> Array:
        """Whether the rays meet nothing at any distance."""
        direction = np.ascontiguousarray(np.broadcast_to(direction, origin.shape), np.float32)
        return np.asarray(self._embree.run(np.ascontiguousarray(origin, np.float32), direction, query="OCCLUDED") == -1)

    def sky_light(self, point: Array, normal: Array) -> Array:
        """Gives for each point the light from the sky, as a share of an open plane's; the ground reflects a little."""
        light = np.zeros(len(point), np.float32)
        for direction in _spread(SKY_RAYS):
            toward = np.flatnonzero(normal @ direction > 0)
            light[toward] += (normal[toward] @ direction) * self.reached(point[toward] + NEAR * normal[toward], direction)
        bounced = 0.4 * (1 - normal[:, 2]) / 2 * np.sqrt(np.clip(light / (0.2625 * SKY_RAYS), 0, 1))
        return np.asarray(0.1 + 0.9 * light / (0.525 * SKY_RAYS) + bounced)

    def picture(self, camera: Camera) -> Array:
        """Gives height x width x 3 bytes. Where neighbouring pixels see different things, eight more rays smooth the edge."""
        self._light_ground(camera)
        self._normal = _corner_normals(self.vertex, self.triangle)
        self._sky = np.full((len(self.triangle), 3), -1, np.float32)
        y, x = (each.ravel() + np.float32(0.5) for each in np.mgrid[: camera.height, : camera.width])
        image, seen = self._look(camera, x, y)
        shape = (camera.height, camera.width)
        plane = seen.reshape(*shape, 4)
        edge = np.zeros(shape, bool)
        for axis in (0, 1):
            differs = (np.abs(np.diff(plane, axis=axis)) > [0.12, 0.12, 0.12, 0.5]).any(2)
            edge[tuple(slice(0, -1) if k == axis else slice(None) for k in (0, 1))] |= differs
            edge[tuple(slice(1, None) if k == axis else slice(None) for k in (0, 1))] |= differs
        where = np.flatnonzero(edge)
        step = (np.arange(8) + 0.5) / 8 - 0.5
        dx, dy = np.tile(step, len(where)), np.tile(step[[3, 6, 1, 4, 7, 2, 5, 0]], len(where))
        more, _ = self._look(camera, np.repeat(x[where], 8) + dx, np.repeat(y[where], 8) + dy)
        image[where] = np.clip(more, 0, 1).reshape(-1, 8, 3).mean(1)
        return (255 * np.clip(image, 0, 1) + 0.5).astype(np.uint8).reshape(*shape, 3)

    def _look(self, camera: Camera, x: Array, y: Array) -> tuple[Array, Array]:
        """Gives colours, and normal and owner, by which picture() finds edges."""
        ray = camera.rays(x, y)
        found = self.hits(camera.eye, ray)
        which = found["primID"]
        image = self._ground(camera, ray)
        seen = np.full((len(ray), 4), -1, np.float32)
        hit = np.flatnonzero(which >= 0)
        if len(hit):
            self._look_at_solids(camera, ray, found, hit, image, seen)
        if self._panes:
            self._look_through(camera, ray, np.where(which >= 0, found["tfar"], np.inf), image, seen)
        return image, seen

    def _look_through(self, camera: Camera, ray: Array, far: Array, image: Array, seen: Array) -> None:
        """Tints and mirrors where glass is nearer than `far`."""
        origin = np.ascontiguousarray(np.broadcast_to(camera.eye, ray.shape), np.float32)
        found: dict[str, Array] = self._panes.run(origin, np.ascontiguousarray(ray, np.float32), output=True)
        hit = np.flatnonzero((found["primID"] >= 0) & (found["tfar"] < far))
        which, ray = self._first_pane + found["primID"][hit], ray[hit]
        normal = _unit(found["Ng"][hit])
        normal *= -np.sign(_dot(normal, ray))
        facing = np.clip(-_dot(normal, ray), 0, 1)
        fresnel = 0.05 + 0.75 * (1 - facing) ** 5
        owner = self.owner[which]
        tinted = image[hit] * (1 - TINT) + TINT * self.color[owner]
        image[hit] = tinted * (1 - fresnel) + fresnel * _sky(ray + 2 * facing * normal)
        seen[hit, :3], seen[hit, 3] = normal, owner

    def _look_at_solids(self, camera: Camera, ray: Array, found: dict[str, Array], hit: Array, image: Array, seen: Array) -> None:
        which, ray = found["primID"][hit], ray[hit]
        u, v = found["u"][hit, None], found["v"][hit, None]
        weight = np.concatenate([1 - u - v, u, v], 1)
        flat = _unit(found["Ng"][hit])
        flat *= -np.sign(_dot(flat, ray))
        normal = _unit(np.einsum("ij,ijk->ik", weight, self._normal[which]))
        inner = _dot(normal, flat) < 0  # a panel seen from its back
        normal = np.where(inner, -normal, normal)
        point = camera.eye + ray * found["tfar"][hit, None]
        self._light_corners(np.unique(which), camera)
        fill = _dot(weight, self._sky[which])
        above = point + NEAR * flat
        key = np.clip(normal @ camera.sun, 0, 1)[:, None] * (self.reached(above, camera.sun) & (flat @ camera.sun > 0))[:, None]
        owner = self.owner[which]
        color = self._color(owner, which, weight) * np.where(inner, 0.6, 1)
        gloss = self.gloss[owner, None] * np.where(inner, 0.15, 1)
        facing = np.clip(-_dot(normal, ray), 0, 1)
        mirror = ray + 2 * facing * normal
        shine = np.clip(mirror @ camera.sun, 0, 1)[:, None] ** 60 * (key > 0)
        fresnel = gloss * (0.07 + 0.75 * (1 - facing) ** 5)
        body = color * (0.60 * key + 0.56 * fill)
        image[hit] = body * (1 - fresnel) + fresnel * _sky(mirror) * np.clip(0.2 + 0.8 * fill, 0, 1) + 0.35 * gloss * shine
        seen[hit, :3], seen[hit, 3] = flat, owner

    def _color(self, owner: Array, which: Array, weight: Array) -> Array:
        """Of the points with these weights of the corners of triangles."""
        color = self.color[owner]
        for i in np.unique(owner):
            texture = self.texture[i]
            if texture is None:
                continue
            mine = np.flatnonzero(owner == i)
            at = _dot(weight[mine][:, None], self.uv[self.triangle[which[mine]]].transpose(0, 2, 1))[..., 0] % 1
            row, column = ((at[:, k] * texture.shape[1 - k]).astype(int) % texture.shape[1 - k] for k in (1, 0))
            color[mine] *= texture[row, column] / np.float32(255)
        return np.asarray(color)

    def _light_corners(self, wanted: Array, camera: Camera) -> None:
        """Computes the light of the sky at the corners of the triangles that the camera sees, on the side that it sees. Between
        the corners the light varies evenly."""
        new = wanted[self._sky[wanted, 0] < 0]
        corner = self.vertex[self.triangle[new]]
        flat = _unit(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))
        toward = np.where(_dot(flat, camera.eye - corner[:, 0]) < 0, -1, 1)[:, None]
        normal = self._normal[new] * toward
        inward = 0.15 * (corner.mean(1, keepdims=True) - corner)  # away from the neighbours that it touches
        lit = self.sky_light((corner + inward + 4 * NEAR * flat[:, None] * toward).reshape(-1, 3), normal.reshape(-1, 3))
        self._sky[new] = lit.reshape(-1, 3)

    def _light_ground(self, camera: Camera) -> None:
        low, high = self.vertex.min(0)[:2] - AROUND, self.vertex.max(0)[:2] + AROUND
        count = np.minimum(np.ceil((high - low) / GRID).astype(int), 600)
        x, y = np.meshgrid(*(np.linspace(low[k], high[k], count[k]) for k in (0, 1)), indexing="ij")
        point = np.stack([x.ravel(), y.ravel(), np.full(x.size, self.ground + NEAR)], 1).astype(np.float32)
        right = _unit(np.cross(camera.sun, [0, 0, 1]))
        key = np.zeros(len(point), np.float32)
        turns = 2.4 * np.arange(8)
        for turn, r in zip(turns, SUN_SIZE * np.sqrt((np.arange(8) + 0.5) / 8)):
            key += self.reached(point, camera.sun + r * (np.cos(turn) * right + np.sin(turn) * np.cross(right, camera.sun))) / 8
        fill = self.sky_light(point, np.tile(np.array([0, 0, 1], np.float32), (len(point), 1)))
        fill = fill.reshape(x.shape)
        for axis in (0, 1, 0, 1):  # few rays give shadows hard edges, which this smooths away
            fill = (fill + np.roll(fill, 1, axis) + np.roll(fill, -1, axis)) / 3
        border = np.minimum.reduce([x - low[0], high[0] - x, y - low[1], high[1] - y]) / AROUND
        shade = 1 - 0.42 * key.reshape(x.shape) - 0.58 * np.minimum(fill, 1)
        self._grid, self._grid_low, self._grid_step = 1 - shade * np.clip(2 * border, 0, 1), low, (high - low) / (count - 1)

    def _ground(self, camera: Camera, ray: Array) -> Array:
        image = np.tile(BACKGROUND, (len(ray), 1))
        down = np.flatnonzero(ray[:, 2] < -1e-3)
        point = camera.eye + ray[down] * ((self.ground - camera.eye[2]) / ray[down, 2])[:, None]
        at = (point[:, :2] - self._grid_low) / self._grid_step
        inside = ((at >= 0) & (at < np.array(self._grid.shape) - 1)).all(1)
        i, f = at[inside].astype(int), at[inside] % 1
        light = np.ones(len(down), np.float32)
        light[inside] = sum(
            np.abs(1 - a - f[:, 0]) * np.abs(1 - b - f[:, 1]) * self._grid[i[:, 0] + a, i[:, 1] + b] for a in (0, 1) for b in (0, 1))
        middle = self._grid_low + self._grid_step * np.array(self._grid.shape) / 2
        far = np.clip(np.linalg.norm(point[:, :2] - middle, axis=1) / 18, 0, 1)[:, None] ** 1.5
        image[down] = GROUND * light[:, None] * (1 - far) + BACKGROUND * far
        return image
