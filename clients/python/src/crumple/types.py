"""What a session sends to the server and receives from it. Units are SI. In the world z is up; a car has x forward, y left and
z up; orientations are unit quaternions (x, y, z, w)."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Vector = Sequence[float]  # numpy's arrays too
ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Pose:
    """Position and orientation of a frame in the world."""

    position: Vector = ZERO
    orientation: Vector = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class CarPose:
    """What a host intends for one car now. seen: the tick of the last reaction that pose and velocity contain; 0: the car
    follows a script."""

    car: str
    pose: Pose
    velocity: Vector = ZERO  # of the centre of mass, world
    angular_velocity: Vector = ZERO  # rad/s, world
    seen: int = 0
    importance: float = 1.0  # in (0, 1]


class Shape(enum.IntEnum):
    box = 0  # size: half extents
    sphere = 1  # size: radius
    capsule = 2  # size: radius, half the length of its axis (local z)
    half_space = 3  # solid where local z <= 0
    hull = 4  # of points


@dataclass(frozen=True)
class Obstacle:
    """A rigid convex body. If it has velocities, it moves on by itself."""

    id: int
    shape: Shape
    size: Vector = ZERO
    pose: Pose = field(default_factory=Pose)
    friction: float = 0.3
    velocity: Vector = ZERO
    angular_velocity: Vector = ZERO
    points: tuple[Vector, ...] = ()  # of a hull, in its own frame


class Solver(enum.IntEnum):
    nodal = 0
    classic = 1


@dataclass(frozen=True)
class Parameters:
    """None: the parameter stays as it is. server/sim/material.h has the ranges."""

    solver: Solver | None = None
    iterations: int | None = None
    substeps: int | None = None
    tolerance: float | None = None
    region: int = -1  # the one that the fields below are for; -1: all
    young_modulus: float | None = None
    poisson_ratio: float | None = None
    yield_strain: float | None = None
    hardening: float | None = None
    hardening_strain: float | None = None
    densification: float | None = None
    densification_strain: float | None = None
    plastic_limit: float | None = None
    drag: float | None = None
    friction: float | None = None  # on other cars
    distance_stiffness: float | None = None  # of the solver `classic`, like the next two
    volume_stiffness: float | None = None
    plasticity: float | None = None


@dataclass(frozen=True)
class Partner:
    """Another car that touched the car of a reaction in the same tick, or at the end of the tick before."""

    car: str
    host: str  # of that car
    impulse: Vector  # what it gave the car of the reaction, N s, world; that car got the opposite
    contacts: int  # between the two at the end of the tick


@dataclass(frozen=True)
class Reaction:
    """What one tick did to one car."""

    car: str
    tick: int
    time: float  # s, by the server's ticks
    impulse: Vector  # N s, world
    angular_impulse: Vector  # N m s about the centre of mass, world
    pose: Pose  # at the end of the tick
    velocity: Vector
    angular_velocity: Vector
    energy_absorbed: float  # J since spawn
    energy_stored: float
    deepest: float  # m
    contacts: int
    partners: tuple[Partner, ...] = ()  # sorted by car; what they and obstacles gave adds up to `impulse`


@dataclass(frozen=True)
class Surface:
    """The surface of a car as the session holds it, with the same bits as the server's. quanta: displacements from rest of the
    nodes that the skin uses."""

    tick: int
    hash: int  # XXH64 of quanta
    quantum: float  # m
    asset: str
    quanta: NDArray[np.int16]  # nodes x 3
    dirty: bool  # changed since the last call of vertices()
    alive: bool


@dataclass(frozen=True)
class Vertices:
    """Arrays of n x 3 floats. changed: only these vertices may differ from the last call."""

    position: NDArray[np.float32]  # m, car's frame
    displacement: NDArray[np.float32]  # m, from rest
    normal: NDArray[np.float32]
    changed: slice = field(default_factory=lambda: slice(0))
    tangent: NDArray[np.float32] | None = None  # only of an OwnMesh that has tangents


@dataclass(frozen=True)
class OwnMesh:
    """A mesh that you draw yourself, bound to a baked car by Session.map()."""

    mapping: int
    count: int  # vertices
    tangents: bool
    on_vertices: int  # vertices that lie on a vertex of the baked car
    farthest: float  # m, from a vertex to the surface of the baked car


class PartKind(enum.IntEnum):
    body = 0  # these four deform
    panel = 1
    glass = 2
    light = 3
    wheel = 4  # rigid
    interior = 5  # moves with the body around it
    point = 6  # a place without vertices


@dataclass(frozen=True)
class Part:
    """A part of a car. pose: the frame of the part at rest, in the car's frame. A wheel has its hub there and turns about y of the
    frame; other parts have the middle of their vertices there."""

    name: str
    kind: PartKind
    pose: Pose
    radius: float  # of a wheel, m
    width: float


@dataclass(frozen=True)
class Mesh:
    """The undamaged car."""

    vertex: NDArray[np.float32]  # n x 3, m
    triangle: NDArray[np.uint32]  # m x 3
    mass: float  # kg
    center_of_mass: tuple[float, ...]  # m
    name: str
    attribution: str  # must be shown where the car is shown
    parts: tuple[Part, ...] = ()  # part 0 is the body; empty: there is only a body
    vertex_part: NDArray[np.uint8] | None = None  # the part of each vertex


@dataclass(frozen=True)
class Health:
    tick: int
    late: int  # number of ticks that began late
    rate: float  # ticks a second
    tick_ms: float  # duration of the ticks of the last second: mean
    worst_ms: float  # and the longest
    refusals: int


@dataclass(frozen=True)
class Statistics:
    """Messages and bytes that came, and the keyframes and deltas among them. older: the session held newer ones. refused:
    malformed. asked: queries for a keyframe."""

    received: int
    received_bytes: int
    surface: int
    surface_bytes: int
    older: int
    refused: int
    asked: int
