"""A picture from a recording: each car before, after, and after from above, with what it hit.

    python clients/python/picture.py FILE.mcap -o PICTURE.png [--cars ID ...] [--width 1800]

Reads nothing but the recording: the car is its attachment, the dent its keyframes and deltas, the obstacles its host's list.
"""

import argparse
import sys
import time

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from crumple import Recording, Shape
from render import Camera, Mesh, Scene, render

PAINT = [(0.62, 0.07, 0.06), (0.08, 0.20, 0.42), (0.10, 0.33, 0.22)]
CONCRETE = (0.62, 0.60, 0.56)
STEEL = (0.80, 0.66, 0.12)


class Crash:
    """One car of the recording: its mesh, its dent at the end, and where it was when it was hit hardest."""

    def __init__(self, recording, life):
        last = recording.end if life.despawned is None else (life.despawned - 1) / recording.rate
        with recording.at(last) as frame:
            self.mesh, self.displacement = frame.mesh(life.asset), frame.vertices(life.car).displacement.astype(float)
        mine = recording.reactions(life.spawned / recording.rate, last)
        mine = mine[mine["car"] == life.car]
        impulse = np.linalg.norm(mine["impulse"], axis=1)
        self.contact = mine[impulse.argmax()] if impulse.any() else None  # the tick that changed its motion most
        self.obstacles = recording.obstacles(self.contact["time"]).get(life.host, []) if impulse.any() else []


def rotation(q):
    x, y, z, w = q
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


def obstacle_mesh(obstacle, contact, extent):
    """In the frame of the car when it was hit hardest. Cut to the neighbourhood of the car; walls are seen through."""
    size, wide = obstacle.size, obstacle.shape == Shape.box
    if obstacle.shape == Shape.box:
        vertex, triangle = box(size)
    elif obstacle.shape == Shape.capsule:
        vertex, triangle = capsule(size[0], size[1])
    elif obstacle.shape == Shape.sphere:
        vertex, triangle = capsule(size[0], 0.0)
    else:
        return None
    world = vertex @ rotation(obstacle.pose.orientation).T + obstacle.pose.position
    local = (world - contact["position"]) @ rotation(contact["orientation"])
    low, high = extent
    local = np.clip(local, low - [0.35, 0.35, 0], high + [0.35, 0.35, 0.9 if not wide else 0.25])
    return Mesh(local, triangle, CONCRETE if wide else STEEL, gloss=0.15, alpha=0.28 if wide else 1.0)


def draw_car(crash, paint, width):
    """Three images side by side, and what to write under them."""
    rest, triangle = crash.mesh.vertex.astype(float), crash.mesh.triangle
    after = rest + crash.displacement
    moved = np.linalg.norm(crash.displacement, axis=1)
    extent = (rest.min(0), rest.max(0))
    center = (extent[0] + extent[1]) / 2
    # Seen from where it was hit, a little to the side and from above.
    hardest = moved >= np.quantile(moved, 0.97)
    push = crash.displacement[hardest].mean(0) if moved.max() > 0 else np.array([-1.0, 0, 0])
    bearing = np.arctan2(-push[1], -push[0]) if np.hypot(push[0], push[1]) > abs(push[2]) else 0.6
    away = 11.5 * np.array([np.cos(bearing + 0.62), np.sin(bearing + 0.62), 0.42])
    height = width * 10 // 16
    front = Camera(center + away, center + [0, 0, -0.1], width, height, field=16.5)
    over = 1.2 * np.array([np.cos(bearing), np.sin(bearing), 12])
    above = Camera(center + over, center, width, height, field=19)
    things = [mesh for mesh in (obstacle_mesh(o, crash.contact, extent) for o in crash.obstacles) if mesh]
    body = lambda vertex: Mesh(vertex, triangle, paint, gloss=1.0)  # noqa: E731
    before, dented = Scene([body(rest)]), Scene([body(after)] + things)
    images = [render(before, front), render(dented, front), render(dented, above)]
    return images, f"deepest dent {1e3 * moved.max():.0f} mm", crash.mesh.attribution


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording")
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--cars", nargs="*", help="ids; default: all that were hit, at most three")
    parser.add_argument("--width", type=int, default=1800, help="pixels")
    options = parser.parse_args()
    started = time.monotonic()
    with Recording(options.recording) as recording:
        lives, reactions = {life.car: life for life in recording.lives}, recording.reactions()
        hit = set(reactions["car"][reactions["impulse"].any(axis=1)])
        chosen = options.cars or [car for car in lives if car in hit][:3]
        if not chosen or any(car not in lives for car in chosen):
            sys.exit(f"picture: {options.recording} has no such car that was hit; it has: {', '.join(lives) or 'none'}")
        crashes = {car: Crash(recording, lives[car]) for car in chosen}
    fine = 2 * (options.width // 3)  # two samples a pixel and axis
    rows = []
    for i, car in enumerate(chosen):
        rows.append((car, *draw_car(crashes[car], PAINT[i % len(PAINT)], fine)))
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
