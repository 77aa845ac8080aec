"""A picture from a recording: each car before, after, and after from above, with what it hit.

    python clients/python/picture.py FILE.mcap -o PICTURE.png [--cars ID ...] [--width 1800]

Reads nothing but the recording: the car is its attachment, the dent its keyframes and deltas, the obstacles its host's list.
"""

import argparse
import pathlib
import sys
import time

import numpy as np
from mcap.reader import make_reader
from PIL import Image, ImageDraw, ImageFont

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import schema  # noqa: E402,F401  makes crumple.schema
from crumple.schema.Car import Car  # noqa: E402
from crumple.schema.Command import Command  # noqa: E402
from crumple.schema.Delta import Delta  # noqa: E402
from crumple.schema.Keyframe import Keyframe  # noqa: E402
from crumple.schema.Obstacles import ObstaclesT, Obstacles  # noqa: E402
from crumple.schema.Order import Order  # noqa: E402
from crumple.schema.Reactions import Reactions, ReactionsT  # noqa: E402
from crumple.schema.Shape import Shape  # noqa: E402
from crumple.schema.Spawn import Spawn  # noqa: E402
from render import Camera, Mesh, Scene, render  # noqa: E402

PAINT = [(0.62, 0.07, 0.06), (0.08, 0.20, 0.42), (0.10, 0.33, 0.22)]
CONCRETE = (0.62, 0.60, 0.56)
STEEL = (0.80, 0.66, 0.12)


def struct_array(data, first, count, kind, width):
    """A vector of FlatBuffers structs as a numpy view."""
    return np.frombuffer(data, kind, count * width, first._tab.Pos).reshape(count, width)


def unpack(message):
    """The numbers of a keyframe's or delta's part, modulo 2^16; schema/message.fbs says how they are packed."""
    words, count, at = message.PackedAsNumpy(), message.Count(), 0
    steps = np.zeros((-(-count // 16) * 16, 3), np.uint16)
    bits = np.arange(16)
    for first in range(0, count, 16):
        head, at = int(words[at]), at + 1
        for axis in range(3):
            width = head >> 5 * axis & 31
            stream = (words[at : at + width, None] >> bits & 1).reshape(16, width)
            steps[first : first + 16, axis] = stream @ (1 << bits[:width])
            at += width
    steps = steps[:count]
    return np.cumsum((steps >> 1) ^ (0 - (steps & 1)), axis=0, dtype=np.uint16).astype(np.int16).ravel()


class Crash:
    """One car of the recording: its mesh, its dent at the end, and where it was when it last touched something."""

    def __init__(self, host):
        self.host = host
        self.asset = None
        self.quantum = 0.0
        self.key = self.now = None
        self.key_tick = 0
        self.contact = None  # ReactionT at the deepest point
        self.obstacles = []
        self.impulse = 0.0

    def take_keyframe(self, message):
        self.asset, self.quantum = message.Asset().decode(), message.Quantum()
        if self.key_tick != message.Tick() or self.key is None:
            self.key = np.zeros(3 * message.NodeCount(), np.int16)
            self.key_tick = message.Tick()
        self.key[3 * message.First() : 3 * (message.First() + message.Count())] = unpack(message)
        self.now = self.key.copy()

    def take_delta(self, message):
        if message.Keyframe() != self.key_tick or self.key is None:
            return
        part = slice(3 * message.First(), 3 * (message.First() + message.Count()))
        self.now[part] = self.key[part] + unpack(message)

    def displacement(self, car):
        """Of the vertices, m: each moves with four nodes of the skin."""
        data, first = car._tab.Bytes, car.Skin(0)
        skin = np.frombuffer(data, [("node", "<u4", 4), ("weight", "<f4", 4)], car.SkinLength(), first._tab.Pos)
        used = np.unique(skin["node"][skin["weight"] > 0])
        at = np.minimum(np.searchsorted(used, skin["node"]), len(used) - 1)
        nodes = self.now.reshape(-1, 3) * self.quantum
        return np.einsum("vk,vkx->vx", skin["weight"], nodes[at])


def read(path):
    """The cars of a recording by id, and its baked cars by hash."""
    crashes, obstacles, assets = {}, {}, {}
    with open(path, "rb") as file:
        reader = make_reader(file)
        for attachment in reader.iter_attachments():
            assets[attachment.name] = (Car.GetRootAs(attachment.data), attachment.data)
        for _, channel, message in reader.iter_messages(log_time_order=False):
            key = channel.topic.split("/", 3)[-1].split("/")
            if key[0] == "car":
                take_car(key, message.data, crashes)
            elif key[0] == "host" and key[-1] == "obstacles":
                obstacles[key[1]] = ObstaclesT.InitFromObj(Obstacles.GetRootAs(message.data)).obstacles
            elif key[0] == "host" and key[-1] == "reactions":
                take_reactions(ReactionsT.InitFromObj(Reactions.GetRootAs(message.data)), obstacles, crashes)
    return crashes, assets


def take_car(key, data, crashes):
    if len(key) == 2:
        command = Command.GetRootAs(data)
        if command.OrderType() == Order.Spawn:
            spawn = Spawn()
            spawn.Init(command.Order().Bytes, command.Order().Pos)
            crashes[key[1]] = Crash(spawn.Host().decode())
    elif key[1] in crashes and key[2:] == ["key", "0"]:
        crashes[key[1]].take_keyframe(Keyframe.GetRootAs(data))
    elif key[1] in crashes and key[2:] == ["delta", "0"]:
        crashes[key[1]].take_delta(Delta.GetRootAs(data))


def take_reactions(reactions, obstacles, crashes):
    for reaction in reactions.cars:
        crash = crashes.get(reaction.car.decode())
        size = np.linalg.norm([reaction.impulse.x, reaction.impulse.y, reaction.impulse.z])
        if crash and size > crash.impulse:  # the tick that changed its motion most
            crash.impulse, crash.contact = size, reaction
            crash.obstacles = obstacles.get(crash.host, [])


def rotation(q):
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def box(half):
    corner = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    side = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corner, np.array([t for a, b, c, d in side for t in ((a, b, c), (a, c, d))])


def capsule(radius, half):
    turns, rings = 48, [(-half, 0.0)] + [(half * s + radius * np.sin(a), radius * np.cos(a)) for s, angles in
                                         ((-1, np.linspace(-1.5, 0, 8)), (1, np.linspace(0, 1.5, 8))) for a in angles]
    angle = np.linspace(0, 2 * np.pi, turns, endpoint=False)
    vertex = np.array([[r * np.cos(a), r * np.sin(a), z] for z, r in rings[1:] for a in angle])
    i, j = np.meshgrid(np.arange(len(rings) - 2), np.arange(turns), indexing="ij")
    a, b = (i * turns + j).ravel(), (i * turns + (j + 1) % turns).ravel()
    return vertex, np.concatenate([np.stack([a, b, b + turns], 1), np.stack([a, b + turns, a + turns], 1)])


def obstacle_mesh(obstacle, crash, extent):
    """In the frame of the car when it was hit hardest. Cut to the neighbourhood of the car; walls are seen through."""
    size, wide = obstacle.size, obstacle.shape == Shape.box
    if obstacle.shape == Shape.box:
        vertex, triangle = box([size.x, size.y, size.z])
    elif obstacle.shape == Shape.capsule:
        vertex, triangle = capsule(size.x, size.y)
    elif obstacle.shape == Shape.sphere:
        vertex, triangle = capsule(size.x, 0.0)
    else:
        return None
    place, car = obstacle.pose, crash.contact.pose
    world = vertex @ rotation(place.orientation).T + [place.position.x, place.position.y, place.position.z]
    local = (world - [car.position.x, car.position.y, car.position.z]) @ rotation(car.orientation)
    low, high = extent
    local = np.clip(local, low - [0.35, 0.35, 0], high + [0.35, 0.35, 0.9 if not wide else 0.25])
    return Mesh(local, triangle, CONCRETE if wide else STEEL, gloss=0.15, alpha=0.28 if wide else 1.0)


def draw_car(crash, asset, paint, width):
    """Three images side by side, and what to write under them."""
    car, data = asset
    rest = struct_array(data, car.Vertex(0), car.VertexLength(), "<f4", 3).astype(float)
    triangle = car.TriangleAsNumpy().reshape(-1, 3)
    after = rest + crash.displacement(car)
    moved = np.linalg.norm(crash.displacement(car), axis=1)
    extent = (rest.min(0), rest.max(0))
    center = (extent[0] + extent[1]) / 2
    # Seen from where it was hit, a little to the side and from above.
    hardest = moved >= np.quantile(moved, 0.97)
    push = crash.displacement(car)[hardest].mean(0) if moved.max() > 0 else np.array([-1.0, 0, 0])
    bearing = np.arctan2(-push[1], -push[0]) if np.hypot(push[0], push[1]) > abs(push[2]) else 0.6
    away = 11.5 * np.array([np.cos(bearing + 0.62), np.sin(bearing + 0.62), 0.42])
    height = width * 10 // 16
    front = Camera(center + away, center + [0, 0, -0.1], width, height, field=16.5)
    over = 1.2 * np.array([np.cos(bearing), np.sin(bearing), 12])
    above = Camera(center + over, center, width, height, field=19)
    things = [mesh for mesh in (obstacle_mesh(o, crash, extent) for o in crash.obstacles) if mesh] if crash.contact else []
    body = lambda vertex: Mesh(vertex, triangle, paint, gloss=1.0)  # noqa: E731
    before, dented = Scene([body(rest)]), Scene([body(after)] + things)
    images = [render(before, front), render(dented, front), render(dented, above)]
    return images, f"deepest dent {1e3 * moved.max():.0f} mm", car.Attribution().decode()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording")
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--cars", nargs="*", help="ids; default: all that were hit, at most three")
    parser.add_argument("--width", type=int, default=1800, help="pixels")
    options = parser.parse_args()
    started = time.monotonic()
    crashes, assets = read(options.recording)
    chosen = options.cars or [car for car, crash in crashes.items() if crash.contact][:3]
    if not chosen or any(car not in crashes for car in chosen):
        sys.exit(f"picture: {options.recording} has no such car that was hit; it has: {', '.join(crashes) or 'none'}")
    fine = 2 * (options.width // 3)  # two samples a pixel and axis
    rows = []
    for i, car in enumerate(chosen):
        rows.append((car, *draw_car(crashes[car], assets[crashes[car].asset], PAINT[i % len(PAINT)], fine)))
    compose(rows, options.output, options.width // 3)
    print(f"{options.output}: {len(rows)} cars in {time.monotonic() - started:.1f} s")


def compose(rows, output, width):
    height, line = width * 10 // 16, 34
    picture = Image.new("RGB", (3 * width, len(rows) * (height + line) + line), (237, 240, 242))
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(size=17)
    for i, (car, images, caption, credit) in enumerate(rows):
        top = i * (height + line)
        for k, image in enumerate(images):
            tile = Image.fromarray((255 * image).astype(np.uint8)).resize((width, height), Image.Resampling.BOX)
            picture.paste(tile, (k * width, top))
        labels = (f"{car}: before", f"after: {caption}", "after, from above")
        for k, label in enumerate(labels):
            draw.text((k * width + 14, top + height + 6), label, fill=(40, 44, 48), font=font)
    credits = sorted({credit for *_, credit in rows})
    draw.text((14, picture.height - 28), "Car: " + "; ".join(credits), fill=(110, 114, 118), font=font)
    picture.save(output)


if __name__ == "__main__":
    main()
