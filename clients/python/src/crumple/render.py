"""`crumple render` draws a baked car (crumple.car_sheet), or a recording: an animation, a contact sheet and charts. Of a recording
it writes into the folder:
  animation.webp      the crash in slow motion, again and again; below 1 MB if it is short
  contact_sheet.jpg   its moments, close together where the car gives way
  reactions.png       deceleration, energy absorbed, deepest dent and contacts over time
  frame_0001.png ...  with --frames

    python -m crumple.render FILE.mcap -o FOLDER
"""

from __future__ import annotations

import argparse
import copy
import dataclasses
import itertools
import multiprocessing
import os
import pathlib
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from crumple._library import Error
from crumple.car_sheet import is_baked_car, kinds_of, render_car
from crumple.model import NO_LOOK, Bound, Look, Model, bytes_of_cars, looks_of, source_of
from crumple.recording import Recording, _obstacle_of
from crumple.schema.Obstacles import Obstacles, ObstaclesT
from crumple.trace import Array, Camera, Mesh, Scene, framed
from crumple.session import View
from crumple.types import Mesh as CarMesh
from crumple.types import Obstacle, PartKind, Pose, Shape

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

# Okabe and Ito's colours, which nearly everybody can tell apart: PAINT in the light, INK on white.
PAINT = [(0.74, 0.24, 0.05), (0.06, 0.36, 0.62), (0.05, 0.50, 0.38), (0.80, 0.50, 0.10)]
INK = ["#D55E00", "#0072B2", "#009E73", "#B07700"]
# Of parts that have no material.
LOOKS = {PartKind.glass: Look((0.05, 0.07, 0.08), 1.0, glass=True), PartKind.light: Look((0.90, 0.86, 0.72), 1.0),
         PartKind.wheel: Look((0.045, 0.045, 0.05), 0.2), PartKind.interior: Look((0.13, 0.12, 0.12), 0.1)}
CONCRETE, STEEL = (0.62, 0.61, 0.58), (0.86, 0.72, 0.16)
BEFORE, AFTER = 0.25, 0.6  # s that a clip shows before and after its dents
GAP = 1.2  # s without a dent, after which another clip begins
MOST_CLIPS = 4
MOST_BYTES = 1_000_000
MOST_FRAMES = 1000  # because all are held in memory
STANDARD_GRAVITY = 9.80665  # m/s^2


@dataclass
class Clip:
    start: float  # s
    end: float
    first: float  # s, of the first contact, from which captions count
    last: float  # s, of the last dent
    cars: list[str]  # those that are hit, or all if none is; the clip draws no others


@dataclass
class Moment:
    """What one picture shows, in the frame of the world."""

    time: float
    vertex: dict[str, Array]  # by car
    dent: dict[str, Array]  # m, how far each vertex has moved
    obstacles: list[Obstacle]
    caption: str = ""


@dataclass
class Cloth:
    """Triangles of a car that look alike. look: None: the car's paint."""

    triangle: Array
    look: Look | None
    uv: Array | None = None  # of all vertices of the car


@dataclass
class Film:
    clip: Clip
    moments: list[Moment]
    dress: dict[str, list[Cloth]] = field(default_factory=dict)  # by car
    credits: list[str] = field(default_factory=list)


def matrix(q: Any) -> Array:
    x, y, z, w = q
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


# ---- what to show ----


def find_clips(recording: Recording, rows: Array, options: argparse.Namespace) -> list[Clip]:
    everybody = [car for car in recording.cars if not options.cars or car in options.cars]
    touched = rows[rows["contacts"] > 0]
    if options.start is not None or options.to is not None or not len(touched):
        start = recording.start if options.start is None else max(options.start, recording.start)
        end = recording.end if options.to is None else min(options.to, recording.end)
        if end <= start:
            raise Error(f"{options.recording}: it lasts from {recording.start:.2f} to {recording.end:.2f} s; give --from and --to within this time")
        inside = touched[(touched["time"] >= start) & (touched["time"] <= end)]
        first = float(inside["time"][0]) if len(inside) else start
        return [Clip(start, end, first, end, hit(inside) or everybody)]
    denting = []  # (time, J) of the ticks in which a car took enough to be seen
    for car in hit(touched):
        mine = rows[rows["car"] == car]
        taken = np.maximum(np.diff(mine["energy_absorbed"], prepend=0.0), 0)
        much = taken > max(0.02 * taken.sum(), 1e-9)
        denting += list(zip(mine["time"][much].tolist(), taken[much].tolist())) or [(float(mine["time"][0]), 0.0)]
    denting.sort()
    groups = [[denting[0]]]
    for each in denting[1:]:
        groups.append([]) if each[0] - groups[-1][-1][0] > GAP else None
        groups[-1].append(each)
    if len(groups) > MOST_CLIPS:
        print(f"{len(groups)} crashes: the {MOST_CLIPS} strongest are shown; choose others by --from, --to or --cars")
        groups = sorted(sorted(groups, key=lambda group: -sum(taken for _, taken in group))[:MOST_CLIPS])
    clips = []
    for group in groups:
        start, end = max(group[0][0] - BEFORE, recording.start), min(group[-1][0] + AFTER, recording.end)
        inside = touched[(touched["time"] >= start) & (touched["time"] <= end)]
        clips.append(Clip(start, end, float(inside["time"][0]), group[-1][0], hit(inside)))
    return clips


def hit(rows: Array) -> list[str]:
    return list(dict.fromkeys(rows["car"].tolist()))


def read_film(recording: Recording, clip: Clip, step: float, model: Model | None = None) -> Film:
    """model: draws the cars that were baked from it."""
    film, cars, bound = Film(clip, []), bytes_of_cars(recording), dict[str, Bound | None]()
    poses = {car: (sorted(known), known) for car, known in recording.poses(clip.start - 5, clip.end).items()}
    lists = [(tick, key, [_obstacle_of(each) for each in ObstaclesT.InitFromObj(Obstacles.GetRootAs(data)).obstacles])
             for tick, key, data in recording.messages() if key.endswith("/obstacles")]
    wanted = {int(t * recording.rate + 1e-6) for t in np.arange(clip.start, clip.end + 1e-9, step)}
    for frame in recording.frames(clip.start, clip.end):
        if frame.tick not in wanted:
            continue
        def pose(car: str, now: int = frame.tick) -> Pose | None:
            ticks, known = poses.get(car, ([], {}))
            at = int(np.searchsorted(ticks, now, side="right")) - 1
            return known[ticks[at]] if at >= 0 else None

        moment = Moment(frame.time, {}, {}, [])
        for car in clip.cars:
            stands = pose(car)
            if not stands:
                continue
            surface, seen = frame.surface(car), frame.vertices(car)
            if not surface or not seen:
                continue
            mesh, position, dent = frame.mesh(surface.asset), seen.position, seen.displacement
            if model and surface.asset not in bound:
                bound[surface.asset] = bind(model, frame, surface.asset, cars[surface.asset])
            if own := bound.get(surface.asset):
                seen = own.vertices(frame, car)
                if not seen:
                    continue
                position = own.in_car(seen.position)
                dent = position - own.rest_in_car
            film.dress[car] = dress_of_model(own.model, own.first) if own else dress_of(cars[surface.asset], mesh)
            moment.vertex[car] = (position @ matrix(stands.orientation).T + stands.position).astype(np.float32)
            moment.dent[car] = np.linalg.norm(dent, axis=1)
            if mesh.attribution not in film.credits:
                film.credits.append(mesh.attribution)
        latest = {key: (tick, told) for tick, key, told in lists if tick <= frame.tick}
        moment.obstacles = [moved(each, (frame.tick - tick) / recording.rate) for tick, told in latest.values() for each in told]
        if moment.vertex:
            film.moments.append(moment)
    if model and not any(bound.values()):
        raise Error(f"{model.path}: none of the cars was baked from it")
    return film


def bind(model: Model, frame: View, asset: str, car: bytes) -> Bound | None:
    """None: the car was baked from another file."""
    source = source_of(car)
    try:
        return None if source is None else Bound(model, frame, asset, source)
    except Error:
        return None


def dress_of(car: bytes, mesh: CarMesh) -> list[Cloth]:
    """Of a baked car: by its looks, and elsewhere by the kinds of parts."""
    looks, look = looks_of(car)
    of: list[Look | None] = [None, *LOOKS.values(), *looks]
    kinds = [None, *LOOKS]
    by_kind = np.array([kinds.index(kind) if kind in kinds else 0 for kind in PartKind])[kinds_of(mesh)]
    which = np.where(look == NO_LOOK, by_kind, len(kinds) + look.astype(int))
    return [Cloth(mesh.triangle[which == i], of[i]) for i in np.unique(which).tolist()]


def dress_of_model(model: Model, first: Array) -> list[Cloth]:
    blank = np.zeros((int(first[-1]), 2), np.float32)
    out = []
    for piece, start in zip(model.pieces, first.tolist()):
        uv = None
        if piece.uv is not None:
            uv = blank.copy()
            uv[start : start + len(piece.uv)] = piece.uv
        out.append(Cloth(piece.triangle + start, piece.look, uv))
    return [cloth for cloth in out if len(cloth.triangle)]


def car_meshes(vertex: Array, dress: list[Cloth], paint: tuple[float, float, float]) -> list[Mesh]:
    out = []
    for cloth in dress:
        look = cloth.look or Look(paint, 1.0)
        used, triangle = np.unique(cloth.triangle, return_inverse=True)
        uv = None if cloth.uv is None else cloth.uv[used]
        out.append(Mesh(vertex[used], triangle.reshape(-1, 3), look.color, look.gloss, look.glass, uv, look.texture))
    return out


def moved(obstacle: Obstacle, seconds: float) -> Obstacle:
    at = [x + seconds * v for x, v in zip(obstacle.pose.position, obstacle.velocity)]
    return Obstacle(obstacle.id, obstacle.shape, obstacle.size, Pose(at, obstacle.pose.orientation), points=obstacle.points)


# ---- how it looks ----


def box(low: Array, high: Array) -> tuple[Array, Array]:
    corner = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    side = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corner, np.array([t for a, b, c, d in side for t in ((a, b, c), (a, c, d))])


def capsule(radius: float, low: float, high: float) -> tuple[Array, Array]:
    angle = np.linspace(0, np.pi / 2, 9)
    rings = [(low - radius * np.cos(a), radius * np.sin(a)) for a in angle] + [
        (high + radius * np.sin(a), radius * np.cos(a)) for a in angle]
    turns = 48
    turn = np.linspace(0, 2 * np.pi, turns, endpoint=False)
    vertex = np.array([[r * np.cos(a), r * np.sin(a), z] for z, r in rings for a in turn])
    i, j = np.meshgrid(np.arange(len(rings) - 1), np.arange(turns), indexing="ij")
    a, b = (i * turns + j).ravel(), (i * turns + (j + 1) % turns).ravel()
    return vertex, np.concatenate([np.stack([a, b, b + turns], 1), np.stack([a, b + turns, a + turns], 1)])


def hull(points: Array) -> tuple[Array, Array]:
    """Makes triangles of every three points that have all others on one side. Of many points it takes those that are outermost
    in one of 200 directions."""
    i = np.arange(200)
    z, turn = 1 - (2 * i + 1) / 200, 2.4 * i
    toward = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
    points = points[np.unique((points @ toward).argmax(0))]
    three = np.array(list(itertools.combinations(range(len(points)), 3)))
    a, b, c = (points[three[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    side = normal @ points.T - (normal * a).sum(1)[:, None]
    slack = 1e-6 * max(float(np.abs(side).max()), 1e-12)
    return points, three[(side.max(1) <= slack) | (side.min(1) >= -slack)]


def obstacle_mesh(obstacle: Obstacle, low: Array, high: Array) -> Mesh | None:
    """Cuts the obstacle to this box in the world, as far as its own axes allow: a wall of twenty metres would hide more than it
    shows."""
    turn, place = matrix(obstacle.pose.orientation), np.array(obstacle.pose.position)
    corner = (box(low, high)[0] - place) @ turn
    low, high = corner.min(0), corner.max(0)
    size = np.array(obstacle.size)
    if obstacle.shape == Shape.box:
        if (low > size).any() or (high < -size).any():
            return None
        vertex, triangle = box(np.maximum(low, -size), np.minimum(high, size))
    elif obstacle.shape in (Shape.sphere, Shape.capsule):
        half = size[1] if obstacle.shape == Shape.capsule else 0.0
        if (low > [size[0], size[0], half + size[0]]).any() or (high < [-size[0], -size[0], -half - size[0]]).any():
            return None
        vertex, triangle = capsule(size[0], min(max(low[2], -half), half), max(min(high[2], half), -half))
    elif obstacle.shape == Shape.hull:
        vertex, triangle = hull(np.array(obstacle.points))
        if (vertex.min(0) > high).any() or (vertex.max(0) < low).any():
            return None
    elif turn[2, 2] < 0.999:  # a half space that is not level; a level one is the ground
        vertex, triangle = box(np.append(low[:2], -0.1), np.append(high[:2], 0.0))
    else:
        return None
    color = STEEL if obstacle.shape in (Shape.sphere, Shape.capsule) else CONCRETE
    return Mesh(vertex @ turn.T + place, triangle, color, gloss=0.1)


class Stage:
    """Makes the scene of a clip at any moment, and has the camera that sees it."""

    def __init__(self, film: Film, paint: dict[str, tuple[float, float, float]], width: int, height: int) -> None:
        self.film, self.paint = film, paint
        clip, moments = film.clip, film.moments
        every = max(1, len(moments) // 12)
        seen = [m for m in moments[::-every] if m.time > clip.first - 0.1] or moments[-1:]
        points = np.concatenate([vertex[::7] for m in seen for vertex in m.vertex.values()])
        level = [o.pose.position[2] for m in moments for o in m.obstacles
                 if o.shape == Shape.half_space and matrix(o.pose.orientation)[2, 2] >= 0.999]
        self.ground = float(max(level)) if level else float(min(v[:, 2].min() for m in moments for v in m.vertex.values()))
        deepest = max(moments, key=lambda m: max(float(dent.max()) for dent in m.dent.values()))
        self.low = np.append(points.min(0)[:2] - 0.25, self.ground)
        self.high = points.max(0) + [0.25, 0.25, 0.45]
        self.camera = self._best_camera([deepest, moments[-1]], points, width, height)

    def scene(self, moment: Moment, clear: bool = True) -> Scene:
        """clear: one can see through glass."""
        cars = [mesh for car, vertex in moment.vertex.items()
                for mesh in car_meshes(vertex, self.film.dress[car], self.paint[car])]
        found = [mesh for each in moment.obstacles if (mesh := obstacle_mesh(each, self.low, self.high))]
        return Scene([mesh if clear else dataclasses.replace(mesh, glass=False) for mesh in cars + found], self.ground)

    def bare(self) -> Stage:
        """Gives a stage without moments: another process needs no more."""
        stage = copy.copy(self)
        stage.film = Film(self.film.clip, [], self.film.dress)
        return stage

    def _best_camera(self, moments: list[Moment], points: Array, width: int, height: int) -> Camera:
        """Chooses the camera, of many around the scene, that sees most of the dents, and sees them large, when they are deepest
        and at the end."""
        judged = []
        for moment in moments:
            vertex = np.concatenate(list(moment.vertex.values()))
            dent = np.concatenate([self.film.moments[-1].dent.get(car, dent) for car, dent in moment.dent.items()])
            judged.append((self.scene(moment, clear=False), vertex[::3], dent[::3] ** 2 + 0.02 * max(float(dent.max()), 1e-3) ** 2))
        best, found = -1.0, None
        for turn in np.arange(24) * np.pi / 12 + 0.2:
            for rise, sun in itertools.product((0.15, 0.28, 0.5), (-0.6, 0.6)):
                camera = framed(np.array([np.cos(turn), np.sin(turn), rise]), points, width, height, sun)
                shares = []
                for scene, vertex, worth in judged:
                    toward = camera.eye - vertex
                    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
                    seen = np.flatnonzero(scene.reached(vertex + 0.02 * toward, toward))
                    lit = scene.reached(vertex[seen] + 0.02 * camera.sun, camera.sun)
                    shares.append(float((worth[seen] * (0.7 + 0.3 * lit)).sum() / worth.sum()))
                away = float(np.linalg.norm(camera.eye - points.mean(0)))
                share = (2 * min(shares) + sum(shares)) * (0.9 if rise < 0.2 else 1.0) / away**0.5  # low only if much is won
                if share > best:
                    best, found = share, camera
        assert found
        return found


def draw(task: tuple[Stage, Moment]) -> Array:
    stage, moment = task
    return stage.scene(moment).picture(stage.camera)


def captions(film: Film, rows: Array, masses: dict[str, float], rate: float, named: bool) -> None:
    """Writes to each moment the time since the first contact, the deceleration in its tick and the deepest dent."""
    for moment in film.moments:
        now = rows[np.abs(rows["time"] - moment.time) < 0.5 / rate]
        cars = list(moment.vertex)
        load = max((float(g) for car in cars for g in gees(now[now["car"] == car], masses.get(car, 0.0), rate)), default=0.0)
        dent = max(float(moment.dent[car].max()) for car in cars)
        moment.caption = f"{1000 * (moment.time - film.clip.first):+.0f} ms    {load:.0f} g    dent {1000 * dent:.0f} mm"
        if named:
            moment.caption = f"{', '.join(cars[:3])}    {moment.caption}"


def gees(rows: Array, mass: float, rate: float) -> Array:
    return np.linalg.norm(rows["impulse"], axis=1) * rate / STANDARD_GRAVITY / mass if mass > 0 else np.zeros(len(rows))


# ---- files ----


def write_on(picture: Image.Image, place: tuple[float, float], text: str, size: float, most: float, anchor: str = "la") -> None:
    """Writes as large as `size`, or smaller if the text would be wider than `most`."""
    pen = ImageDraw.Draw(picture)
    font = ImageFont.load_default(size)
    font = ImageFont.load_default(size * min(1.0, most / max(pen.textlength(text, font), 1.0)))
    pen.text(place, text, fill=(38, 42, 46), font=font, anchor=anchor)


def credit(films: list[Film]) -> str:
    return "Car: " + "; ".join(dict.fromkeys(each for film in films for each in film.credits))


def labelled(image: Array, caption: str, credits: str) -> Image.Image:
    picture = Image.fromarray(image)
    w, h = picture.size
    write_on(picture, (0.025 * w, 0.03 * h), caption, h / 21, 0.95 * w)
    write_on(picture, (0.98 * w, 0.975 * h), credits, h / 36, 0.95 * w, "rs")
    return picture


def write_animation(path: pathlib.Path, pictures: list[Image.Image], fps: float, ends: set[int]) -> None:
    """Each clip stays for a second at its end. Every frame is coded whole (kmax=1): if only the changes from one frame to the
    next are coded, blocks stay on the ground, and the file gets smaller by a fifth at most."""
    at = np.round(1000 / fps * np.arange(len(pictures) + 1)).astype(int)
    lasts = [int(b - a) + (1000 if i in ends else 0) for i, (a, b) in enumerate(zip(at, at[1:]))]
    for quality in (75, 60, 45, 30):
        pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=lasts, loop=0, quality=quality, method=4, kmin=0, kmax=1)
        if path.stat().st_size < MOST_BYTES:
            break


def sheet_moments(film: Film, count: int) -> list[int]:
    """Chooses moments half by time and half by how the dent grows, so that they are close together while the car gives way."""
    times = np.array([m.time for m in film.moments])
    dents = np.array([max((float(d.max()) for d in m.dent.values()), default=0.0) for m in film.moments])
    def share(values: Array) -> Array:
        way = np.cumsum(np.abs(np.diff(values, prepend=values[0])))
        return np.asarray(way / max(float(way[-1]), 1e-12))

    way = 0.45 * share(times) + 0.55 * share(dents)
    chosen: list[int] = []
    for goal in np.linspace(0, way[-1], min(count, len(way))):
        chosen.append(max(int(np.abs(way - goal).argmin()), chosen[-1] + 1 if chosen else 0))
    last = len(way) - 1
    return [min(each, last - k) for k, each in zip(range(len(chosen) - 1, -1, -1), chosen)]


def moments_each(films: list[Film]) -> int:
    return 9 if len(films) == 1 else max(3, 12 // len(films) // 3 * 3)


def write_sheet(path: pathlib.Path, images: list[Array], films: list[Film]) -> None:
    h, w = (side // 2 for side in images[0].shape[:2])
    line, tiles = max(18, h // 10), []
    offset = 0
    for film in films:
        chosen = sheet_moments(film, moments_each(films))
        tiles += [(images[offset + i], film.moments[i].caption) for i in chosen] + [None] * (-len(chosen) % 3)
        offset += len(film.moments)
    sheet = Image.new("RGB", (3 * w, len(tiles) // 3 * (h + line) + line), (237, 240, 242))
    for i, tile in enumerate(tiles):
        if tile:
            x, y = i % 3 * w, i // 3 * (h + line)
            sheet.paste(Image.fromarray(tile[0]).resize((w, h), Image.Resampling.BOX), (x, y))
            write_on(sheet, (x + 0.03 * w, y + h + line / 2), tile[1], 0.66 * line, 0.95 * w, "lm")
    write_on(sheet, (sheet.width - 0.03 * w, sheet.height - line / 2), credit(films), 0.6 * line, 0.95 * sheet.width, "rm")
    sheet.save(path, quality=88)


def write_chart(path: pathlib.Path, recording: Recording, films: list[Film], rows: Array, masses: dict[str, float]) -> None:
    names = ("deceleration, g", "energy absorbed, kJ", "deepest dent, mm", "contacts")
    figure, axes = plt.subplots(4, len(films), sharex="col", sharey="row", squeeze=False, figsize=(max(7.0, 3.4 * len(films)), 8))
    for column, film in zip(axes.T, films):
        clip = film.clip
        for i, car in enumerate(clip.cars[: len(INK)]):
            mine = rows[(rows["car"] == car) & (rows["time"] >= clip.start) & (rows["time"] <= clip.end)]
            look = {"color": INK[i], "linestyle": ("-", "--", "-.", ":")[i], "linewidth": 1.8, "label": car}
            ms = 1000 * (mine["time"] - clip.first)
            shown = [m for m in film.moments if car in m.dent]
            data = [(ms, gees(mine, masses.get(car, 0.0), recording.rate)), (ms, mine["energy_absorbed"] / 1000),
                    ([1000 * (m.time - clip.first) for m in shown], [1000 * float(m.dent[car].max()) for m in shown]),
                    (ms, mine["contacts"])]
            for k, (axis, (x, y)) in enumerate(zip(column, data)):
                if k in (0, 3) and len(x):  # the value of a tick holds from the tick before
                    x, y = np.insert(x, 0, x[0] - 1000 / recording.rate), np.insert(y, 0, 0)
                axis.plot(x, y, drawstyle="steps-pre" if k in (0, 3) else "default", **look)
        for axis in column:
            axis.grid(alpha=0.3)
            axis.spines[["top", "right"]].set_visible(False)
            axis.set_xlim(-50, 1000 * min(clip.last - clip.first + 0.15, clip.end - clip.first))
        column[-1].set_xlabel(f"ms after the first contact, at {clip.first:.2f} s")
        column[0].legend(frameon=False, loc="upper right") if clip.cars else None
    for axis, name in zip(axes[:, 0], names):
        axis.set_ylabel(name)
        axis.set_ylim(bottom=0)  # after all plots, because it ends automatic scaling
    figure.suptitle(pathlib.Path(recording._file.name).name, x=0.02, ha="left", fontsize=11)
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    plt.close(figure)


# ---- the verb ----


class Progress:
    """Prints a line now and then that begins with three dots. In a terminal `crumple render` shows the last of them."""

    def __init__(self) -> None:
        self.told = time.monotonic()

    def __call__(self, text: str) -> None:
        if time.monotonic() - self.told > 0.5:
            self.told = time.monotonic()
            print(f"... {text}", flush=True)


def images_of(stages: list[Stage], progress: Progress) -> Iterator[Array]:
    tasks = [(stage.bare(), moment) for stage in stages for moment in stage.film.moments]
    count = min(len(os.sched_getaffinity(0)), len(tasks), 16)
    if len(tasks) < 8 or count == 1:
        yield from map(draw, tasks)
        return
    with ProcessPoolExecutor(count, multiprocessing.get_context("spawn")) as pool:
        for i, image in enumerate(pool.map(draw, tasks)):
            progress(f"frame {i + 1} of {len(tasks)}")
            yield image


def size_of(text: str) -> tuple[int, int]:
    try:
        w, h = (int(part) for part in text.split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is not WIDTHxHEIGHT, such as 960x540") from None
    if not (64 <= w <= 4096 and 64 <= h <= 4096):
        raise argparse.ArgumentTypeError(f"{text} is not from 64x64 to 4096x4096")
    return w, h


def number(low: float, high: float) -> Callable[[str], float]:
    def read(text: str) -> float:
        if not low <= float(text) <= high:
            raise argparse.ArgumentTypeError(f"{text} is not from {low:g} to {high:g}")
        return float(text)

    read.__name__ = "number"  # argparse prints this name
    return read


def render(options: argparse.Namespace) -> None:
    begun, progress = time.monotonic(), Progress()
    folder = pathlib.Path(options.output or pathlib.Path(options.recording).stem)
    if is_baked_car(options.recording):
        if options.of_recordings:
            raise Error(f"{options.recording}: this is a baked car, so only -o applies; leave out the other options, or give a recording")
        progress("drawing the car")
        print(f"{render_car(options.recording, folder)}: what is solid, hollow and held, drawn in {time.monotonic() - begun:.0f} s")
        return
    model = Model(options.mesh) if options.mesh else None
    with Recording(options.recording) as recording:
        unknown = [car for car in options.cars or () if car not in recording.cars]
        if unknown or not recording.cars:
            raise Error(f"{options.recording}: it has no car {', '.join(unknown)}; its cars are: {', '.join(recording.cars) or 'none'}")
        rows = recording.reactions()
        rows = rows[np.isin(rows["car"], options.cars)] if options.cars else rows
        films, clips = [], find_clips(recording, rows, options)
        frames_most = sum((clip.end - clip.start) * min(options.fps / options.speed, recording.rate) for clip in clips)
        if frames_most > MOST_FRAMES:
            raise Error(f"{options.recording}: {frames_most:.0f} frames are more than {MOST_FRAMES}; give a shorter time by --from and "
                        "--to, a higher --speed or fewer --fps")
        for clip in clips:
            progress(f"reading {clip.start:.1f} to {clip.end:.1f} s")
            film = read_film(recording, clip, options.speed / options.fps, model)
            films += [film] if film.moments else []
        if not films:
            raise Error(f"{options.recording}: no car has a pose in that time; choose another time by --from and --to")
        masses = {life.car: life.mass or _mesh_mass(recording, life.asset) for life in recording.lives}
        cars = list(dict.fromkeys(car for film in films for car in film.clip.cars))
        paint = {car: PAINT[i % len(PAINT)] for i, car in enumerate(cars)}
        for film in films:
            captions(film, rows, masses, recording.rate, named=len(films) > 1)
        progress("looking for the best view")
        stages = [Stage(film, paint, *options.size) for film in films]
        folder.mkdir(parents=True, exist_ok=True)
        written = ["reactions.png", "contact_sheet.jpg"]
        write_chart(folder / written[0], recording, films, rows, masses)
        if options.sheet:
            for film in films:
                film.moments = [film.moments[i] for i in sheet_moments(film, moments_each(films))]
        images = list(images_of(stages, progress))
        progress("writing")
        write_sheet(folder / written[1], images, films)
    moments = [moment for film in films for moment in film.moments]
    pictures = [labelled(image, moment.caption, credit(films)) for image, moment in zip(images, moments)]
    if not options.sheet:
        written.append("animation.webp")
        ends = set((np.cumsum([len(film.moments) for film in films]) - 1).tolist())
        write_animation(folder / written[-1], pictures, options.fps, ends)
    for i, picture in enumerate(pictures if options.frames else ()):
        written.append(f"frame_{i + 1:04}.png")
        picture.save(folder / written[-1])
    frames = f" to {written[-1]}" if options.frames else ""
    print(f"{folder}: {len(pictures)} pictures in {time.monotonic() - begun:.0f} s; {', '.join(written[: 4 - options.sheet])}{frames}")


def _mesh_mass(recording: Recording, asset: str) -> float:
    with recording.at(recording.start) as frame:
        mesh = frame._mesh(asset)
    return mesh.mass if mesh else 0.0


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="crumple render", formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        description="Draws a recording as an animation in slow motion, a contact sheet and charts. Draws a baked car as one picture: "
        "an arrow points to its front, and cuts show what is solid, hollow and anchored.",
        epilog="Examples: crumple render today.mcap -o pictures --speed 0.1; crumple render car.car -o pictures")
    none: dict[str, Any] = {"default": argparse.SUPPRESS}
    parser.set_defaults(output="", start=None, to=None, cars=None, mesh=None)
    parser.add_argument("recording", metavar="FILE", help="a recording or a baked car; for a baked car -o is the only option")
    parser.add_argument("-o", "--output", metavar="FOLDER",
                        help="folder for the pictures (default: the name of FILE without its ending)", **none)
    parser.add_argument("--from", metavar="S", dest="start", type=float,
                        help="start of the animation, s (default: shortly before each crash)", **none)
    parser.add_argument("--to", metavar="S", type=float, help="end of the animation, s (default: shortly after each crash)", **none)
    parser.add_argument("--speed", metavar="TIMES", type=number(0.001, 100), default=0.25,
                        help="speed of the animation, as a multiple of the real speed")
    parser.add_argument("--fps", metavar="N", type=number(1, 60), default=15, help="frames a second of the animation")
    parser.add_argument("--cars", metavar="ID", nargs="+", help="cars to draw (default: all cars that are hit)", **none)
    parser.add_argument("--mesh", metavar="MODEL.glb", help="the glTF file from which the cars were baked; the pictures show "
                        "the cars with its materials and textures", **none)
    parser.add_argument("--size", metavar="WxH", type=size_of, default="960x540", help="size of the animation, pixels")
    parser.add_argument("--sheet", action="store_true", help="leave out the animation, to save time")
    parser.add_argument("--frames", action="store_true", help="write every frame as a PNG too")
    options, bare = parser.parse_args(), parser.parse_args(["FILE"])
    options.of_recordings = any(vars(options)[name] != value for name, value in vars(bare).items() if name not in ("recording", "output"))
    try:
        render(options)
    except OSError as error:
        sys.exit(f"{error.filename or options.recording}: {error.strerror}; give another FILE or -o FOLDER")
    except Error as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
