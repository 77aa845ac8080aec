"""Bakes freely available cars and measures the bakes: bench/cars runs it, and explains its options.

A car is a name, a file in its package, and flags of the bake: the axes and the unit that the file does not state.
"""

import argparse
import hashlib
import io
import json
import os
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile
import zipfile

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from PIL import Image

from crumple import car_sheet
from crumple.trace import Mesh, Scene, framed
from tables import table

here = pathlib.Path(__file__).parent
work = here.parent / "build/cars"
crumple = here.parent / "build/crumple"
NODES, LEVELS, LEVELS_OF = 5000, (300, 1000, 5000, 15000, 50000), "m130"
BARS = {"seconds": ("CPU, best of 3", "s", "<= 10 s", 0, 10), "mib": ("peak memory", "MiB", "<= 1 GB", 0, 1000e6 / 2**20),
        "deviation": ("nodes, deviation from 5,000", "%", "± 5 %", -5, 5), "dihedral": ("smallest dihedral angle", "degrees", ">= 16", 16, 180),
        "mean": ("mean distance of the skin", "mm", "<= 8 mm", 0, 8), "max": ("largest distance of the skin", "mm", "<= 80 mm", 0, 80)}
LEVELS_BAR = 60  # s, CPU of all levels together

METADRIVE, SMARTS = "metadrive/assets/models/vehicle", "smarts/assets/vehicles/visual_model"
SUMO, PYBULLET = "sumo/data/3D/car", "pybullet_data"
TORCS, FLIGHTGEAR = "usr/share/games/torcs/cars", "usr/share/games/flightgear/Models"
RALLY = "usr/share/games/trigger-rally/data.zip!vehicles"
SOURCES = [  # registry, package, version, licence, cars
    ("PyPI", "metadrive-simulator", "0.2.6.0", "Apache-2.0", [
        ("m130", f"{METADRIVE}/130/vehicle.gltf", "--forward=-z --up=y"),
        ("beetle", f"{METADRIVE}/beetle/vehicle.gltf", "--forward=-z --up=y"),
        ("ferra", f"{METADRIVE}/ferra/vehicle.gltf", "--forward=-z --up=y"),
        ("lada", f"{METADRIVE}/lada/vehicle.gltf", "--forward=-z --up=y"),
        ("metadrive truck", f"{METADRIVE}/truck/vehicle.gltf", "--forward=-z --up=y")]),
    ("PyPI", "smarts", "2.0.1", "MIT", [
        (name.replace("_", " "), f"{SMARTS}/{name}.glb", "--forward=-z --up=y")
        for name in ("simple_car", "muscle_car", "moving_truck", "truck", "bus", "coach")]),
    ("PyPI", "eclipse-sumo", "1.28.0", "EPL-2.0", [
        (f"citrus {name}", f"{SUMO}-{name}-citrus.obj", "--up=y --forward=z --scale=2.3")
        for name in ("normal", "minibus", "microcargo")]),
    ("PyPI", "pybullet", "3.2.7", "zlib", [
        ("racecar", f"{PYBULLET}/racecar/meshes/chassis.STL", "--scale=10"),
        ("husky", f"{PYBULLET}/husky/meshes/base_link.stl", "--scale=4")]),
    ("Debian", "torcs-data", "1.3.7+dfsg-5", "Free Art License", [
        (name, f"{TORCS}/{name}/{name}.acc", "--up=y --forward=x")
        for name in ("acura-nsx-sz", "baja-bug", "car1-ow1", "car1-stock1", "car1-trb1", "car3-trb1", "155-DTM", "buggy", "p406")]),
    ("Debian", "flightgear-data-models", "1:2020.3.16+dfsg-1", "GPL-2+", [
        ("110 bus", f"{FLIGHTGEAR}/Transport/110Bus.ac", "--up=y --forward=-x"),
        ("fire engine", f"{FLIGHTGEAR}/Airport/Vehicle/hoskosh-ti-1500.ac", "--up=y --forward=-x")]),
    ("Debian", "trigger-rally-data", "0.6.6.1-3", "GPL-2+", [
        ("evo", f"{RALLY}/evo_wrc/evo_wrc.obj", "--up=z --forward=y --scale=0.011"),
        ("cordo", f"{RALLY}/cordo_wrc/cordo_wrc.obj", "--up=z --forward=y --scale=0.011"),
        ("fox", f"{RALLY}/fox_wrc/fox_wrc.obj", "--up=z --forward=y --scale=0.5")]),
    ("Debian", "morse-simulator-data", "1.4-8", "BSD-3-Clause", [
        ("hummer", "usr/share/morse/data/robots/hummer.blend", "")]),
]
LICENCES = {"m130": "CC-BY-4.0", "155-DTM": "GPL-2+", "buggy": "GPL-2+", "p406": "GPL-2+"}  # where not the package's
LEFT_OUT = [("duckietown-world-daffy 6.4.3 (PyPI)", "the package names no licence"),
            ("@hytopia.com/assets 0.4.11 (npm)", "its licence allows the models only in games on one platform")]


def run(command, folder=None):
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError((done.stderr.strip() or f"{command[0]} failed").splitlines()[-1])
    return done.stdout


def fetch(registry, package, version, cars):
    """Puts the files of the cars into build/cars. Raises RuntimeError with one sentence."""
    paths = {name: work / f"{package}-{version}".replace(":", "-") / f"{name}{pathlib.Path(member).suffix}" for name, member, _ in cars}
    if all(path.exists() for path in paths.values()):
        return paths
    print(f"fetching {package} {version} from {registry} ...", flush=True)
    work.mkdir(parents=True, exist_ok=True)
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps", "--only-binary", ":all:"]
    apt = ["apt-get", "download", "-q", "-o", "APT::Sandbox::User=root"]
    with tempfile.TemporaryDirectory(dir=work) as folder:
        try:
            run([*pip, f"{package}=={version}"] if registry == "PyPI" else [*apt, f"{package}={version}"], folder)
            file = next(each for each in pathlib.Path(folder).iterdir() if each.suffix in (".whl", ".deb"))
            if file.suffix == ".deb":
                run(["dpkg-deb", "-x", file, "x"], folder)
            for name, member, _ in cars:
                outer, _, inner = member.partition("!")
                data = zipfile.ZipFile(file).read(outer) if file.suffix == ".whl" else (pathlib.Path(folder) / "x" / outer).read_bytes()
                paths[name].parent.mkdir(exist_ok=True)
                paths[name].write_bytes(zipfile.ZipFile(io.BytesIO(data)).read(inner) if inner else data)
        except (KeyError, OSError, StopIteration, zipfile.BadZipFile) as error:
            raise RuntimeError(f"a file or a program is missing: {error}") from None
    return paths


# A process of its own, because a child's peak memory includes that of the process that starts it.
MEASURE = """import json, resource, subprocess, sys
done = subprocess.run(sys.argv[1:], capture_output=True, text=True)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([done.returncode, done.stdout + done.stderr, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024]))"""


def bake(path, flags, out, nodes, pinned=False):
    """Gives the report, CPU seconds and MiB of one bake. Raises RuntimeError with the bake's own sentence."""
    command = [crumple, "bake", path, "-o", out, "--mesher", "lattice", "--nodes", str(nodes), *flags.split()]
    if pinned:
        command = ["taskset", "-c", str(min(os.sched_getaffinity(0))), *command]
    done = subprocess.run([sys.executable, "-I", "-S", "-c", MEASURE, *command], capture_output=True, text=True, check=True)
    code, said, seconds, mib = json.loads(done.stdout)
    if code:
        raise RuntimeError(said.strip().splitlines()[-1].split(f"{path}: ")[-1].removeprefix("crumple bake: "))
    return said, seconds, mib


def bodies(tet):
    """The number of bodies whose tets hang together by faces."""
    faces = np.sort(np.concatenate([tet[:, list(k)] for k in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))]), 1)
    order = np.lexsort(faces.T)
    same = (faces[order[1:]] == faces[order[:-1]]).all(1)
    a, b = order[:-1][same] % len(tet), order[1:][same] % len(tet)
    label, before = np.arange(len(tet)), None
    while before is None or (label != before).any():
        before = label.copy()
        np.minimum.at(label, a, label[b])
        np.minimum.at(label, b, label[a])
        label = label[label]
    return len(np.unique(label))


def number_in(pattern, text):
    found = re.search(pattern, text)
    return float(found[1]) if found else 0.0


def measure(path, flags, out):
    runs, hashes = [], set()
    for i in range(3):
        runs.append(bake(path, flags, out, NODES, pinned=i == 2))
        hashes.add(hashlib.sha256(out.read_bytes()).hexdigest())
    said, car = runs[0][0], car_sheet.read_baked(out)
    mapped = re.search(r"(\d+) vertices; (\d+) lie on a vertex", run([crumple, "map", out, path]))
    return {"seconds": min(r[1] for r in runs), "median": statistics.median(r[1] for r in runs), "mib": max(r[2] for r in runs),
            "triangles": len(car.triangle), "parts": int(number_in(r"(\d+) parts?,", said)), "open": int(number_in(r"(\d+) open edge", said)),
            "nodes": len(car.node), "deviation": 100 * (len(car.node) / NODES - 1), "volume": number_in(r"solid: ([\d.]+) m", said),
            "dihedral": car_sheet.smallest_dihedral(car.node, car.tet), "mean": 1000 * float(car.distance.mean()),
            "max": 1000 * float(car.distance.max()), "bodies": bodies(car.tet), "same": len(hashes) == 1,
            "flat": int(number_in(r"(\d+) triangles? dropped", said)), "sealed": 100 - number_in(r"closes off ([\d.]+) %", said + "closes off 100 %"),
            "mapped": mapped[1] == mapped[2], "map": f"{mapped[2]} of {mapped[1]}"}


def misses(car):
    for key, (title, unit, bar, least, most) in BARS.items():
        if not least <= car[key] <= most:
            yield f"{title}: {car[key]:.1f} {unit}, bar {bar}"
    if car["bodies"] != 1:
        yield f"the tets are {car['bodies']} bodies"
    if not car["same"]:
        yield "three bakes give different files"
    if not car["mapped"]:
        yield f"`crumple map` finds {car['map']} vertices on the car"


def draw(cars, path):
    """A contact sheet: of each car its surface from the side and from the front left, and the tets in a cut."""
    columns, wide, tall = 2, 3.4, 1.75  # inches, of one picture
    rows = -(-len(cars) // columns)
    figure = Figure((3 * columns * wide, rows * tall), dpi=80, facecolor="white")
    for i, (name, package, file) in enumerate(cars):
        car = car_sheet.read_baked(file)
        low, high = car.vertex.min(0), car.vertex.max(0)
        shades = np.tile(car_sheet.SURFACE, (len(car.triangle), 1))
        panels = [figure.add_axes(((3 * (i % columns) + k + 0.03) / 3 / columns, 1 - (i // columns + 0.98) / rows, 0.94 / 3 / columns, 0.85 / rows))
                  for k in range(3)]
        extent = (low[0], high[0], low[2], high[2])
        panels[0].imshow(car_sheet.look_along(car, (car.vertex, car.triangle), shades, 1), extent=extent)
        camera = framed(np.array([0.9, 0.8, 0.45]), car.vertex[:: max(1, len(car.vertex) // 5000)], 720, 360, 0.0)
        y, x = (each.ravel() + np.float32(0.5) for each in np.mgrid[: camera.height, : camera.width])
        rays = camera.rays(x, y)
        scene = Scene([Mesh(car.vertex, car.triangle, (0, 0, 0))])
        image, _, _ = car_sheet.shade(scene, np.broadcast_to(camera.eye, rays.shape), rays, shades)
        panels[1].imshow(car_sheet.halved(image, camera.width, camera.height))
        at = float(low[1] + car.size[1] / 2) + 1e-4 * float(car.size.max())
        polygons, owner = car_sheet.cut_tets(car.node, car.tet, 1, at)
        colors = np.where(car.held[owner], car_sheet.HELD, car_sheet.SOLID)
        panels[2].add_collection(PolyCollection(polygons, facecolors=colors, edgecolors="white", linewidths=0.3))
        panels[2].add_collection(LineCollection(list(car_sheet.cut_triangles(car.vertex, car.triangle, 1, at)), colors="black", linewidths=0.9))
        for axes in (panels[0], panels[2]):
            axes.set(xlim=(low[0] - 0.03 * car.size[0], high[0] + 0.03 * car.size[0]), ylim=(low[2] - 0.03, high[2] + 0.03), aspect="equal")
        for axes in panels:
            axes.axis("off")
        panels[0].set_title(f"{name}  ({package}), {car.size[0]:.1f} m", loc="left", fontsize=10, fontweight="bold", pad=3)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=80)
    Image.open(buffer).convert("RGB").quantize(128, dither=Image.Dither.NONE).save(path, optimize=True)


def page(cars, skipped, levels, picture):
    yield "# Cars\n"
    yield (f"`bench/cars` bakes {len(cars)} freely available cars at 5,000 nodes with the lattice, and writes this page. It bakes each car three\n"
           "times, the third time on one core. CPU seconds are those of all threads. The distance of the skin is that of a vertex from its\n"
           "tet, and 0 inside. Files do not state unit and axes reliably, so `bench/cars.py` gives them for each car.\n")
    rows = [(title, bar, "{:.1f} to {:.1f} {}".format(min(car[key] for car in cars), max(car[key] for car in cars), unit))
            for key, (title, unit, bar, _, _) in BARS.items()]
    kept = {"tets form one body": "bodies", "three bakes give the same bits": "same", "`crumple map` finds every vertex of the file on the car": "mapped"}
    rows += [(title, "every car", f"{sum(car[key] == 1 for car in cars)} of {len(cars)}") for title, key in kept.items()]
    found = [f"- {car['name']}: {each}" for car in cars for each in misses(car)]
    if levels:
        total = sum(seconds for _, seconds in levels)
        rows.append((f"{len(levels)} levels of {LEVELS_OF}, CPU together", f"<= {LEVELS_BAR} s", f"{total:.1f} s"))
        found += [f"- The levels of {LEVELS_OF} take {total:.1f} s of CPU, bar {LEVELS_BAR} s"] if total > LEVELS_BAR else []
    yield table(["", "goal", "measured"], rows)
    found += [f"- {name} ({package}) was not baked: {why}" for name, package, why in skipped]
    yield "\n## Misses\n\n" + ("\n".join(found) if found else "None.") + "\n"
    shares = [c["max"] / (1000 * (2 * c["volume"] / c["nodes"]) ** (1 / 3)) for c in cars]  # the lattice has two nodes in a cube
    yield ("The distance of the skin grows with the spacing of the lattice, and so with the vehicle: a bus of 134 m³ has nodes 380 mm apart "
           f"where a car has 130. Over all cars the largest distance is {min(shares):.2f} to {max(shares):.2f} of the spacing. With 5,000 nodes "
           "80 mm would be 0.21 for the bus. The racecar has 324 triangles, so its mean is one over some 160 vertices.\n") if cars else ""
    yield "## Pictures\n\nFrom left to right: the surface from the side, the surface from the front, and a lengthwise cut. Tets are blue, those that are held orange.\n"
    yield f"![Each car: its surface from the side and from the front, and a cut through its tets]({picture})\n\n## Every car\n"
    yield table(["car", "package", "licence", "triangles", "parts", "open edges", "CPU s (median)", "MiB", "nodes", "dihedral", "skin mean, max mm",
                 "solid m³", "sealed by the bake", "bodies", "map", "same bits"],
                [(c["name"], c["package"], c["licence"], f"{c['triangles']:,}", c["parts"], f"{c['open']:,}", f"{c['seconds']:.1f} ({c['median']:.1f})",
                  f"{c['mib']:.0f}", f"{c['nodes']:,} ({c['deviation']:+.1f} %)", f"{c['dihedral']:.1f}", f"{c['mean']:.1f}, {c['max']:.0f}",
                  f"{c['volume']:.2f}", f"{c['sealed']:.0f} %", c["bodies"], "all" if c["mapped"] else "no", "yes" if c["same"] else "no") for c in cars])
    flat = [f"{c['name']} ({c['flat']})" for c in cars if c["flat"]]
    yield "`map` says whether `crumple map` finds every vertex of the file on the car: then no part of the file is dropped."
    yield f"These lose triangles that have no area: {', '.join(flat)}." if flat else ""
    if levels:
        yield f"\n## Levels\n\nCPU seconds of the levels of {LEVELS_OF}.\n"
        yield table([f"{nodes:,} nodes" for nodes, _ in levels], [[f"{seconds:.1f} s" for _, seconds in levels]])
    yield "\n## Left out\n\n" + "\n".join(f"- {what}: {why}." for what, why in LEFT_OUT)


def main():
    options = argparse.ArgumentParser(prog="bench/cars", add_help=False)
    options.add_argument("--only", default="", metavar="WORD")
    only = options.parse_args().only
    cars, skipped, pictures, levels = [], [], [], []
    for registry, package, version, licence, all_of_it in SOURCES:
        chosen = [car for car in all_of_it if only in car[0] or only in package]
        try:
            paths = fetch(registry, package, version, all_of_it) if chosen else {}
        except RuntimeError as error:
            skipped += [(name, f"{package} {version}", str(error)) for name, _, _ in chosen]
            continue
        for name, _, flags in chosen:
            out = work / f"{name}.car"
            try:
                car = measure(paths[name], flags, out)
                cars.append({"name": name, "package": f"{package} {version}", "licence": LICENCES.get(name, licence), **car})
                pictures.append((name, package, out))
                print(f"{name}: {car['seconds']:.1f} s, {'; '.join(misses(car)) or 'every bar met'}", flush=True)
                for nodes in LEVELS if name == LEVELS_OF else ():
                    levels.append((nodes, bake(paths[name], flags, work / "level.car", nodes)[1]))
            except RuntimeError as error:
                skipped.append((name, f"{package} {version}", str(error)))
    if not cars:
        sys.exit("cars: no car could be baked: " + "; ".join(f"{name}: {why}" for name, _, why in skipped or [(only, "", "no such car")]))
    sheet, text = (work / "cars.png", work / "cars.md") if only else (here / "pictures/cars.png", here / "cars.md")
    (work / "cars.json").write_text(json.dumps([cars, skipped, levels]))
    draw(pictures, sheet)
    text.write_text("\n".join(page(cars, skipped, levels, os.path.relpath(sheet, text.parent))) + "\n")
    print(f"the page is {os.path.relpath(text)}")


main()
