"""Bakes one car in several ways and runs crumple_meshers on them: bench/meshers explains it."""

import pathlib
import subprocess
import sys

import numpy as np

from crumple.car_sheet import boundary, read_baked

here = pathlib.Path(__file__).parent
build, work = here.parent / "build", here.parent / "build/meshers"
NODES = int(sys.argv[1])
TURN = np.radians(30)
FINE = 10_000  # nodes of the lattice whose boundary is the closed surface


def bake(surface, name, *options):
    out = work / f"{name}.car"
    subprocess.run([build / "crumple", "bake", surface, "-o", out, *map(str, options)], check=True, stdout=subprocess.DEVNULL)
    return out


def write_obj(path, vertex, triangle):
    path.write_text("".join("v {:.7f} {:.7f} {:.7f}\n".format(*v) for v in vertex) + "".join("f {} {} {}\n".format(*t) for t in triangle + 1))
    return path


def write_mesh(path, node, tet):
    """A Medit file."""
    lines = ["MeshVersionFormatted 2", "Dimension 3", "Vertices", str(len(node))] + ["{:.7f} {:.7f} {:.7f} 0".format(*n) for n in node]
    lines += ["Tetrahedra", str(len(tet))] + ["{} {} {} {} 0".format(*t) for t in tet + 1] + ["End"]
    path.write_text("\n".join(lines) + "\n")
    return path


def turned(points, angle):
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def compare(name, closed):
    """closed: a surface in the car's frame. All meshes get it as their surface, so their vertices are the same."""
    vertex, triangle = closed
    surface = write_obj(work / f"{name}.obj", vertex, triangle)
    meshes = [bake(surface, f"{name}, fTetWild", "--mesher", "ftetwild", "--nodes", NODES),
              bake(surface, f"{name}, lattice", "--mesher", "lattice", "--nodes", NODES)]
    askew = read_baked(bake(write_obj(work / "askew.obj", turned(vertex, TURN), triangle), "askew", "--mesher", "lattice", "--nodes", NODES))
    back = turned(askew.node, -TURN)  # about the middle of the turned box, which the bake put at the origin
    from_box = (turned(vertex, TURN).max(0) + turned(vertex, TURN).min(0)) / 2 * [1, 1, 0]
    back += turned(from_box[None], -TURN)[0] + [0, 0, vertex[:, 2].min()]
    meshes.append(bake(surface, f"{name}, lattice turned by 30 degrees", "--tets", write_mesh(work / "askew.mesh", back, askew.tet)))
    print(f"\n{name}:\n", flush=True)
    subprocess.run([build / "crumple_meshers" if (build / "crumple_meshers").exists() else build / "bench/crumple_meshers", *meshes], check=True)


def main():
    work.mkdir(parents=True, exist_ok=True)
    built_in = read_baked(bake("built-in", "built-in", "--nodes", 1000, "--mesher", "lattice"))
    body = np.isin(built_in.kind, (0, 1, 2, 3))
    used, triangle = np.unique(np.round(built_in.vertex, 6), axis=0, return_inverse=True)
    triangle = triangle.reshape(-1)[built_in.triangle[body]]
    keep, triangle = np.unique(triangle, return_inverse=True)
    compare("built-in", (used[keep], triangle.reshape(-1, 3)))
    m130 = build / "demo/m130.glb"
    if not m130.exists():
        print("m130: run server/demo first, which fetches it")
        return
    fine = read_baked(bake(m130, "m130", "--forward=-z", "--up=y", "--nodes", FINE))
    faces = boundary(fine.tet)[0]
    keep, faces = np.unique(faces, return_inverse=True)
    compare("m130", (fine.node[keep].astype(float), faces.reshape(-1, 3)))


if __name__ == "__main__":
    main()
