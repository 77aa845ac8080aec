"""The one scene that every peer plays: a mesh of tets with anchored nodes, and with a front that is pushed in.

The mesh is the mesh that crumple solves (a baked car), or a grid with five tets per cell. All nodes within 0.15 m of the nose move
0.20 m backwards at constant speed in 12 steps of 1/60 s. Nothing else acts. The material is elastic, because most peers have no
plasticity. Peers with physical constants use those of crumple there (bench/peer.cpp): E 15 MPa, nu 0.
"""

import dataclasses
import pathlib
import sys

import numpy as np

young_modulus = 15e6  # Pa
steps, dt, depth, band = 12, 1 / 60, 0.20, 0.15
speed = depth / (steps * dt)  # m/s


@dataclasses.dataclass
class Scene:
    name: str
    node: np.ndarray  # n x 3, m
    tet: np.ndarray  # t x 4, positive volume
    mass: np.ndarray  # n, kg
    anchored: np.ndarray  # n, bool

    def __post_init__(self):
        pairs = np.sort(self.tet[:, [0, 1, 0, 2, 0, 3, 1, 2, 1, 3, 2, 3]].reshape(-1, 2), axis=1)
        self.edge = np.unique(pairs, axis=0)
        self.pushed = (self.node[:, 0] > self.node[:, 0].max() - band) & ~self.anchored
        corner = self.node[self.tet]
        self.volume = np.linalg.det(corner[:, 1:] - corner[:, :1]) / 6
        keys = self.edge[:, 0] * len(self.node) + self.edge[:, 1]
        shared = np.bincount(np.searchsorted(keys, pairs[:, 0] * len(self.node) + pairs[:, 1]), np.repeat(self.volume, 6))
        length2 = ((self.node[self.edge[:, 0]] - self.node[self.edge[:, 1]]) ** 2).sum(axis=1)
        # Springs in all directions form a Cauchy solid of modulus E if the stiffness of each is E times the volume around it,
        # divided by length^2.
        self.edge_stiffness = young_modulus * shared / length2  # N/m
        self.volume_stiffness = young_modulus / 3 / self.volume  # Pa/m^3, of (V - V0)^2 / 2: the bulk modulus at nu = 0

    def fixed(self):
        return self.anchored | self.pushed

    def targets(self, step):
        """Returns the places of the pushed nodes at the end of a step. Steps count from 0."""
        return self.node[self.pushed] - [speed * dt * (step + 1), 0, 0]


def surface(tet):
    """Returns the faces that belong to only one tet, facing outward."""
    faces = tet[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def grid_tets(cells, size):
    """Returns nodes and tets of a box of cells with five tets each. Neighbouring cells are mirrored, so that faces match."""
    nx, ny, nz = cells
    axes = [np.linspace(0, size[k], cells[k] + 1) for k in range(3)]
    node = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    i, j, k = (a.ravel() for a in np.meshgrid(range(nx), range(ny), range(nz), indexing="ij"))

    def at(a, b, c):
        return ((i + a) * (ny + 1) + j + b) * (nz + 1) + k + c

    even = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [(1, 1, 0), (0, 1, 0), (1, 0, 0), (1, 1, 1)], \
        [(1, 0, 1), (0, 0, 1), (1, 1, 1), (1, 0, 0)], [(0, 1, 1), (1, 1, 1), (0, 0, 1), (0, 1, 0)], \
        [(1, 0, 0), (1, 1, 1), (0, 1, 0), (0, 0, 1)]
    odd = (i + j + k) % 2 == 1
    tet = np.concatenate([
        np.stack([np.where(odd, at(1 - a, b, c), at(a, b, c)) for a, b, c in corners], axis=1) for corners in even])
    return node, positive(node, tet)


def positive(node, tet):
    corner = node[tet]
    flipped = np.linalg.det(corner[:, 1:] - corner[:, :1]) < 0
    tet[flipped] = tet[flipped][:, [0, 1, 3, 2]]
    return tet


def grid(cells):
    node, tet = grid_tets(cells, (4.5, 1.7, 1.3))
    corner = node[tet]
    volume = np.linalg.det(corner[:, 1:] - corner[:, :1]) / 6
    mass = np.bincount(tet.ravel(), np.repeat(volume, 4))
    return Scene(f"grid-{len(node)}", node, tet, mass * 1100 / mass.sum(), node[:, 0] < 0.01)


def car(path):
    """Reads a baked car (schema/car.fbs)."""
    sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "build/schema/python"))  # the code from flatc
    from crumple.schema.Car import Car

    read = Car.GetRootAs(pathlib.Path(path).read_bytes())
    def records(table, columns, kind):
        start = read._tab.Vector(read._tab.Offset(table))
        return np.frombuffer(read._tab.Bytes, kind, columns * read._tab.VectorLen(read._tab.Offset(table)), start)

    # FlatBuffers' Python has no arrays of structs: 4 + 2 * position of the field in the table.
    node = records(10, 3, "<f4").reshape(-1, 3).astype(float)
    tet = records(18, 4, "<u4").reshape(-1, 4).astype(np.int64)
    return Scene(pathlib.Path(path).stem, node, tet, read.NodeMassAsNumpy().astype(float), read.NodeAnchoredAsNumpy() != 0)
