# One run of fTetWild. In the folder given: vertices.f64 and triangles.i32 in; nodes.f64 and tets.i32 out. Its own log goes to
# stdout, from which the parent tells the progress.
import os
import sys

import numpy as np
import wildmeshing

folder, edge_length, epsilon = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
os.chdir(folder)  # fTetWild leaves two files of its own in the working folder
vertices = np.fromfile(folder + "/vertices.f64", dtype=np.float64).reshape(-1, 3)
triangles = np.fromfile(folder + "/triangles.i32", dtype=np.int32).reshape(-1, 3)
# fTetWild gives slightly other tets in every run, whatever the threads; a second one cost a third more time than one.
mesher = wildmeshing.Tetrahedralizer(edge_length_r=edge_length, epsilon=epsilon, max_threads=1)
mesher.set_log_level(2)
mesher.set_mesh(vertices, triangles)
mesher.tetrahedralize()
nodes, tets = mesher.get_tet_mesh()[:2]
np.ascontiguousarray(nodes, dtype=np.float64).tofile(folder + "/nodes.f64")
np.ascontiguousarray(tets, dtype=np.int32).tofile(folder + "/tets.i32")
