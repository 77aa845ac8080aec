"""Triangles in, a picture out: a z-buffer in numpy. Surfaces are two-sided paint that reflects a simple sky; light comes from
one sun and from all of the sky, each shadowed by a depth map of its own, so that a dent is seen by its shade."""

import numpy as np

SUN = np.array([0.35, 0.55, 0.75]) / np.linalg.norm([0.35, 0.55, 0.75])
SKY_LIGHTS = 28
MAP = 384  # pixels of a shadow map's side
FAR, GRID = 4.0, 0.02  # m: extent and spacing of the ground's shadows


def corner_normals(vertex, triangle, crease=0.75):
    """Per corner of each triangle: the mean normal of the triangles around its vertex whose own is within `crease` (cosine)."""
    edge = vertex[triangle]
    area = np.cross(edge[:, 1] - edge[:, 0], edge[:, 2] - edge[:, 0])
    unit = area / np.maximum(np.linalg.norm(area, axis=1, keepdims=True), 1e-12)
    corner = triangle.ravel()
    order = np.argsort(corner, kind="stable")
    count = np.bincount(corner, minlength=len(vertex))
    first = np.concatenate([[0], np.cumsum(count)])
    of = np.repeat(np.arange(len(corner)), count[corner])  # each corner meets every triangle of its vertex
    within = np.arange(len(of)) - np.repeat(np.cumsum(count[corner]) - count[corner], count[corner])
    other = order[first[corner[of]] + within] // 3
    agrees = np.einsum("ij,ij->i", unit[of // 3], unit[other]) > crease
    total = np.zeros((len(corner), 3))
    np.add.at(total, of[agrees], area[other[agrees]])
    return (total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)).reshape(-1, 3, 3)


def rasterise(corner, width, height):
    """corner: (t, 3, 3) pixel x, pixel y, depth (smaller is nearer). Gives per pixel the depth (inf: nothing), the triangle
    (-1) and the weights of its first two corners."""
    depth = np.full(width * height, np.inf)
    which = np.full(width * height, -1)
    weight = np.zeros((width * height, 2))
    low = np.clip(np.floor(corner[:, :, :2].min(1)), 0, [width - 1, height - 1]).astype(int)
    high = np.clip(np.ceil(corner[:, :, :2].max(1)), 0, [width - 1, height - 1]).astype(int)
    side = (high - low).max(1) + 1
    a, b, c = corner[:, 0, :2], corner[:, 1, :2], corner[:, 2, :2]
    twice_area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    seen = (np.abs(twice_area) > 1e-9) & (corner[:, :, 2].min(1) > 0)
    found = []
    size = 4
    while size // 2 < max(width, height):  # triangles of about the same extent together
        group = np.flatnonzero(seen & (side <= size) & ((side > size // 2) | (size == 4)))
        step = max(1, 2_000_000 // size**2)
        for start in range(0, len(group), step):
            found.append(_cover(corner, twice_area, low, group[start : start + step], size, width, height))
        size *= 2
    if not found:
        return depth.reshape(height, width), which.reshape(height, width), weight.reshape(height, width, 2)
    pixel, z, triangle, u, v = (np.concatenate(part) for part in zip(*found))
    np.minimum.at(depth, pixel, z)
    front = z == depth[pixel]
    which[pixel[front]] = triangle[front]
    weight[pixel[front]] = np.stack([u[front], v[front]], 1)
    return depth.reshape(height, width), which.reshape(height, width), weight.reshape(height, width, 2)


def _cover(corner, twice_area, low, group, size, width, height):
    grid = np.arange(size)
    x = low[group, 0][:, None, None] + grid[None, None, :] + 0 * grid[None, :, None]
    y = low[group, 1][:, None, None] + grid[None, :, None] + 0 * grid[None, None, :]
    (ax, ay), (bx, by), (cx, cy) = (corner[group, k, :2].T[:, :, None, None] for k in range(3))
    area = twice_area[group][:, None, None]
    u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
    v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
    w = 1 - u - v
    inside = (u >= -1e-9) & (v >= -1e-9) & (w >= -1e-9) & (x < width) & (y < height)
    za, zb, zc = (corner[group, k, 2][:, None, None] for k in range(3))
    z = u * za + v * zb + w * zc
    triangle = np.broadcast_to(group[:, None, None], x.shape)
    return (y * width + x)[inside], z[inside], triangle[inside], u[inside], v[inside]


class Light:
    """Parallel light from a direction, and what of the scene it reaches."""

    def __init__(self, direction, points, triangle, size):
        up = [0, 0, 1] if abs(direction[2]) < 0.9 else [1, 0, 0]
        right = np.cross(up, direction)
        right /= np.linalg.norm(right)
        self.axes = np.stack([right, np.cross(direction, right), -np.asarray(direction)]).astype(np.float32)
        flat = points @ self.axes.T
        self.low = (flat.min(0) - 0.05).astype(np.float32)
        self.scale = np.float32((size - 1) / (flat[:, :2].max(0) + 0.05 - self.low[:2]).max())
        self.size = size
        self.depth = rasterise(self._map(points)[triangle], size, size)[0]

    def _map(self, points):
        flat = points.astype(np.float32) @ self.axes.T - self.low
        flat[:, :2] *= self.scale
        return flat

    def reaches(self, points, bias):
        at = self._map(points)
        pixel = np.round(at[:, :2]).astype(int)
        inside = ((pixel >= 0) & (pixel < self.size)).all(1)
        pixel = np.clip(pixel, 0, self.size - 1)
        return ~inside | (at[:, 2] - bias < self.depth[pixel[:, 1], pixel[:, 0]])


def _sky(direction):
    """What a mirror sees: a bright band above the horizon, a darker zenith, a dim ground."""
    z = direction[:, 2:3]
    above = np.clip(z, 0, 1)
    sky = np.array([0.55, 0.62, 0.72]) * (1 - above) ** 2 + np.array([0.95, 0.97, 1.0]) * above * (1 - above) * 3.2
    sky = sky + np.array([0.30, 0.36, 0.45]) * above**2
    ground = np.array([0.23, 0.22, 0.21]) * np.clip(1 + z, 0, 1)
    return np.where(z > 0, sky, ground)


class Camera:
    def __init__(self, eye, target, width, height, field=28):
        forward = np.subtract(target, eye)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        self.eye, self.axes = np.asarray(eye, float), np.stack([right, np.cross(right, forward), forward])
        self.focal = height / 2 / np.tan(np.radians(field) / 2)
        self.width, self.height = width, height

    def project(self, points):
        """Pixels and 1/z are linear over a triangle on the screen; the third is -1/z + a constant: smaller is nearer."""
        at = (points - self.eye) @ self.axes.T
        z = np.maximum(at[:, 2], 0.05)
        scale = self.focal / z
        return np.stack([self.width / 2 + scale * at[:, 0], self.height / 2 - scale * at[:, 1], 30 - 1 / z], 1)

    def rays(self):
        x, y = np.meshgrid(np.arange(self.width), np.arange(self.height))
        flat = np.stack([(x - self.width / 2) / self.focal, (self.height / 2 - y) / self.focal, np.ones_like(x)], -1)
        rays = flat.reshape(-1, 3) @ self.axes
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)


class Mesh:
    def __init__(self, vertex, triangle, color, gloss=0.0, alpha=1.0):
        self.vertex, self.triangle = np.asarray(vertex, float), np.asarray(triangle)
        self.color, self.gloss, self.alpha = np.asarray(color, float), gloss, alpha


def _lit(points, normal, sun, sky, bias):
    """How much of the sun, and what share of the sky, reaches each point."""
    points, normal = points.astype(np.float32), normal.astype(np.float32)
    key = np.clip(normal @ SUN, 0, 1) * sun.reaches(points + normal * bias, bias)
    fill = np.zeros(len(points))
    for direction, light in sky:
        fill += np.clip(normal @ direction, 0, 1) * light.reaches(points + normal * bias, bias)
    return key[:, None], (fill / (0.525 * len(sky)))[:, None]  # of an open plane: 1


def _hemisphere(count):
    """Directions spread evenly over the upper half of the sphere."""
    i = np.arange(count) + 0.5
    z, turn = 1 - i / count * 0.95, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], 1)


def _join(meshes):
    offset = np.cumsum([0] + [len(mesh.vertex) for mesh in meshes])
    vertex = np.concatenate([mesh.vertex for mesh in meshes])
    triangle = np.concatenate([mesh.triangle + o for mesh, o in zip(meshes, offset)])
    return vertex, triangle, np.repeat(np.arange(len(meshes)), [len(mesh.triangle) for mesh in meshes])


class Scene:
    """Opaque and translucent meshes on the ground z = 0, and the light on them; for any number of pictures."""

    def __init__(self, meshes):
        self.meshes = meshes
        self.solid = [mesh for mesh in meshes if mesh.alpha == 1]
        self.vertex, self.triangle, self.owner = _join(self.solid)
        self.normal = corner_normals(self.vertex, self.triangle)
        floor = np.array([[x, y, 0.0] for x in (-4, 4) for y in (-3, 3)])  # so that the maps hold the shadow on the ground
        around = np.concatenate([self.vertex, floor])
        self.sun = Light(SUN, around, self.triangle, 4 * MAP)
        self.sky = [(d, Light(d, around, self.triangle, MAP)) for d in _hemisphere(SKY_LIGHTS)]
        self.ground = self._light_ground()

    def _light_ground(self):
        """The ground's brightness on a grid of GRID metres: it varies slowly, and far fewer points than pixels are lit."""
        x, y = np.meshgrid(np.arange(-FAR, FAR, GRID), np.arange(-FAR, FAR, GRID), indexing="ij")
        points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
        key, fill = _lit(points, np.tile([0.0, 0, 1], (len(points), 1)), self.sun, self.sky, 0.01)
        return (0.45 * key / SUN[2] + 0.62 * fill).reshape(x.shape)

    def ground_at(self, points):
        at = (points[:, :2] + FAR) / GRID
        inside = ((at >= 0) & (at < len(self.ground) - 1)).all(1)
        at = np.where(inside[:, None], at, 0)
        i, f = at.astype(int), at % 1
        lit = 0
        for di in (0, 1):
            for dj in (0, 1):
                weight = (f[:, 0] if di else 1 - f[:, 0]) * (f[:, 1] if dj else 1 - f[:, 1])
                lit = lit + weight * self.ground[i[:, 0] + di, i[:, 1] + dj]
        return np.where(inside, lit, 0.45 + 0.62)[:, None]


def render(scene, camera, background=(0.90, 0.92, 0.94)):
    """An image: (height, width, 3) floats in [0, 1]."""
    solid, vertex, triangle, owner, sun, sky = scene.solid, scene.vertex, scene.triangle, scene.owner, scene.sun, scene.sky
    screen = camera.project(vertex)
    depth, which, weight = rasterise(screen[triangle], camera.width, camera.height)
    depth, which, weight = depth.ravel(), which.ravel(), weight.reshape(-1, 2)
    rays = camera.rays()
    image = np.tile(np.asarray(background, float), (len(rays), 1))

    # the ground
    down = rays[:, 2] < -1e-3
    reach = np.where(down, camera.eye[2] / np.where(down, -rays[:, 2], 1), np.inf)
    bare = down & (which < 0) & (reach < 60)
    points = camera.eye + rays[bare] * reach[bare, None]
    far = np.clip(np.linalg.norm(points[:, :2], axis=1) / 14, 0, 1)[:, None] ** 2
    ground = np.array([0.74, 0.74, 0.73]) * scene.ground_at(points)
    image[bare] = ground * (1 - far) + image[bare] * far

    # the meshes
    hit = np.flatnonzero(which >= 0)
    corners, u = triangle[which[hit]], np.concatenate([weight[hit], 1 - weight[hit].sum(1, keepdims=True)], 1)
    inverse = 1 / np.maximum(((vertex - camera.eye) @ camera.axes[2]), 0.05)
    u = u * inverse[corners]
    u /= u.sum(1, keepdims=True)
    points = np.einsum("ij,ijk->ik", u, vertex[corners])
    normal = np.einsum("ij,ijk->ik", u, scene.normal[which[hit]])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    inner = np.einsum("ij,ij->i", normal, rays[hit]) > 0
    normal[inner] *= -1
    color = np.array([mesh.color for mesh in solid])[owner[which[hit]]]
    gloss = np.array([mesh.gloss for mesh in solid])[owner[which[hit]]][:, None] * np.where(inner, 0.15, 1)[:, None]
    color = color * np.where(inner, 0.45, 1)[:, None]  # the bare inside of a panel
    key, fill = _lit(points, normal, sun, sky, 0.02)
    facing = np.clip(-np.einsum("ij,ij->i", normal, rays[hit]), 0, 1)[:, None]
    mirror = rays[hit] + 2 * facing * normal
    shine = np.clip(mirror @ SUN, 0, 1)[:, None] ** 60 * (key > 0)
    fresnel = gloss * (0.10 + 0.90 * (1 - facing) ** 5)
    body = color * (0.85 * key + 0.70 * fill)
    image[hit] = body * (1 - fresnel) + fresnel * _sky(mirror) * (0.35 + 0.65 * np.clip(fill, 0, 1)) + 0.5 * gloss * shine

    for mesh in scene.meshes:
        if mesh.alpha < 1:
            _overlay(mesh, camera, depth, image)
    return np.clip(image, 0, 1).reshape(camera.height, camera.width, 3)


def _overlay(mesh, camera, depth, image):
    front, which, _ = rasterise(camera.project(mesh.vertex)[mesh.triangle], camera.width, camera.height)
    seen = (which.ravel() >= 0) & (front.ravel() < depth)
    edge = mesh.vertex[mesh.triangle]
    normal = np.cross(edge[:, 1] - edge[:, 0], edge[:, 2] - edge[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    shade = 0.7 + 0.3 * np.abs(normal @ SUN)
    image[seen] = image[seen] * (1 - mesh.alpha) + mesh.alpha * mesh.color * shade[which.ravel()[seen], None]
