# Reads tets made elsewhere (Gmsh .msh 2.2 and 4.1, Medit .mesh, TetGen .node/.ele) with meshio and writes them as plain arrays:
# nodes.f64 and tets.i32 in the folder given. Says why not in one line on stdout and exits 1.
import os
import sys

import meshio
import numpy as np

file, folder = sys.argv[1], sys.argv[2]
if not os.path.isfile(file):
    print("there is no such file")
    sys.exit(1)
try:
    mesh = meshio.read(file)
    tets = [block.data for block in mesh.cells if block.type in ("tetra", "tetra10")]
    other = sum(len(block.data) for block in mesh.cells if block.dim == 3) - sum(len(block) for block in tets)
    points = np.asarray(mesh.points, dtype=np.float64)
    corners = np.concatenate([block[:, :4] for block in tets]) if tets else np.zeros((0, 4))
except (Exception, SystemExit) as why:
    print(f"meshio cannot read it ({type(why).__name__}: {' '.join(str(why).split())[:200]})")
    sys.exit(1)
if other:
    print(f"it holds {other} volume elements that are not tets")
    sys.exit(1)
if points.ndim != 2 or points.shape[1] != 3 or len(corners) == 0:
    print("it holds no tets")
    sys.exit(1)
points.tofile(folder + "/nodes.f64")
np.ascontiguousarray(corners, dtype=np.int32).tofile(folder + "/tets.i32")
