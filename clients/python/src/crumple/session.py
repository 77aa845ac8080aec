"""Sessions hold cars and connect to a server. Only one thread at a time may use a session."""

from __future__ import annotations

import os
import pathlib
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from crumple import _convert
from crumple._library import Error, Refused, check, ffi, lib, text
from crumple.types import CarPose, Health, Mesh, Obstacle, OwnMesh, Parameters, Pose, Reaction, Statistics, Surface, Vector, Vertices

Value = TypeVar("Value")


def _array(place: Any, count: int, kind: type[Any]) -> NDArray[Any]:
    """Makes a copy, because the library's own memory stays valid only until the next poll."""
    rows = np.frombuffer(ffi.buffer(place, 3 * count * np.dtype(kind).itemsize), kind)
    return rows.reshape(count, 3).copy()


class View:
    """Cars as a viewer sees them: live (Session), or at one moment of a recording (Frame)."""

    def __init__(self, **options: Any) -> None:
        given = ffi.new("CrumpleOptions*", {"version": lib.CRUMPLE_CLIENT_VERSION, **options})
        out = ffi.new("Crumple**")
        check(lib.crumple_open(given, out))
        self._open: Any = ffi.gc(out[0], lib.crumple_close)
        self._meshes: dict[str, Mesh] = {}

    @property
    def _handle(self) -> Any:
        if self._open is None:
            raise Error("this session is closed")
        return self._open

    def close(self) -> None:
        if self._open is not None:
            ffi.release(self._open)
        self._open = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def cars(self) -> list[str]:
        """Gives the ids of the cars that the session holds or follows."""
        count = lib.crumple_cars(self._handle, ffi.NULL, 0)
        ids = ffi.new("const char*[]", count)
        lib.crumple_cars(self._handle, ids, count)
        return [text(each) for each in ids]

    def surface(self, car: str) -> Surface | None:
        """Gives the surface that the session holds. None: no whole surface has come yet, or none since half a second without
        poll()."""
        out = ffi.new("CrumpleSurface*")
        if check(lib.crumple_surface(self._handle, car.encode(), out)) == lib.CRUMPLE_PENDING:
            return None
        quanta = _array(out.quanta, out.node_count, np.int16)
        return Surface(out.tick, out.hash, out.quantum, text(out.asset), quanta, bool(out.dirty), bool(out.alive))

    def map(self, asset: str, position: NDArray[np.float32], normal: NDArray[np.float32] | None = None,
            tangent: NDArray[np.float32] | None = None, to_car: NDArray[np.float64] | None = None) -> OwnMesh:
        """Binds a mesh of your own to a baked car, so that vertices() moves its vertices, in your order, with your seams and hard
        edges. All arrays have n x 3 numbers. to_car: 3 x 4, from the coordinates of `position` to the car's frame; None: they are
        those of the file from which the car was baked. The session must hold the asset: mesh() waits for it."""
        self.mesh(asset)
        given = [None if each is None else np.ascontiguousarray(each, np.float32) for each in (position, normal, tangent)]
        for each in given:
            if each is not None and (each.ndim != 2 or each.shape != (len(position), 3)):
                raise ValueError(f"not an array of {len(position)} x 3")
        matrix = None if to_car is None else np.ascontiguousarray(to_car, np.float64)
        if matrix is not None and matrix.shape != (3, 4):
            raise ValueError("to_car is not an array of 3 x 4")
        places = [ffi.NULL if each is None else ffi.cast("float*", each.ctypes.data) for each in given]
        own = ffi.new("CrumpleOwnMesh*", [*places, 12, len(position), ffi.NULL if matrix is None
                                          else ffi.cast("double*", matrix.ctypes.data)])
        mapping = ffi.new("uint32_t*")
        check(lib.crumple_map(self._handle, asset.encode(), own, mapping))
        return OwnMesh(mapping[0], len(position), tangent is not None, own.on_vertices, own.farthest)

    def vertices(self, car: str, out: Vertices | None = None, time: float = 0.0, own: OwnMesh | None = None) -> Vertices | None:
        """Gives positions, displacements and normals. out: arrays to write into, those of an earlier call or the caller's own,
        which may be fields of one structured array. time: a moment of the last half second of Session.time; between two ticks
        the vertices are on the way from the one to the other; 0: the newest surface. own: the vertices of this mesh, in its
        coordinates. None: the surface or the mesh has not come yet; poll and call again."""
        surface = ffi.new("CrumpleSurface*")
        if check(lib.crumple_surface(self._handle, car.encode(), surface)) == lib.CRUMPLE_PENDING:
            return None
        mesh = self._mesh(text(surface.asset))
        if mesh is None:
            return None
        shape = (own.count if own else len(mesh.vertex), 3)
        tangents = own is not None and own.tangents
        if out is None:
            tangent = np.empty(shape, np.float32) if tangents else None
            out = Vertices(np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.float32), tangent=tangent)
        arrays = [out.position, out.displacement, out.normal]
        if tangents and out.tangent is not None:
            arrays.append(out.tangent)
        stride = out.position.strides[0]
        for array in arrays:
            if array.shape != shape or array.dtype != np.float32 or array.strides != (stride, 4):
                raise ValueError(f"an array of `out` is not {shape[0]} x 3 of float32, or its strides differ from those of the others")
            if not array.flags.writeable:
                raise ValueError("an array of `out` is read-only")
        places = [ffi.cast("float*", array.ctypes.data) for array in arrays]
        to = ffi.new("CrumpleVertices*", [*places[:3], stride, shape[0], time, 0, 0, own.mapping if own else 0,
                                          places[3] if len(places) > 3 else ffi.NULL])
        check(lib.crumple_copy(self._handle, car.encode(), to))
        return Vertices(out.position, out.displacement, out.normal, slice(to.first, to.first + to.count), out.tangent)

    def part_poses(self, car: str, time: float = 0.0) -> list[Pose] | None:
        """Gives where the frame of each part in Mesh.parts is now, in the car's frame. time, None: as in vertices()."""
        surface = ffi.new("CrumpleSurface*")
        if check(lib.crumple_surface(self._handle, car.encode(), surface)) == lib.CRUMPLE_PENDING:
            return None
        mesh = self._mesh(text(surface.asset))
        if mesh is None:
            return None
        out = ffi.new("CrumplePose*")
        poses = []
        for i in range(len(mesh.parts)):
            check(lib.crumple_part_pose(self._handle, car.encode(), i, time, out))
            poses.append(Pose(tuple(out.position), tuple(out.orientation)))
        return poses

    def _mesh(self, asset: str) -> Mesh | None:
        if asset in self._meshes:
            return self._meshes[asset]
        out = ffi.new("CrumpleMesh*")
        if check(lib.crumple_mesh(self._handle, asset.encode(), out)) == lib.CRUMPLE_PENDING:
            return None
        found = ffi.new("CrumpleParts*")
        check(lib.crumple_parts(self._handle, asset.encode(), found))
        parts = tuple(_convert.part_of(found.part[i]) for i in range(found.count))
        vertex_part = np.frombuffer(ffi.buffer(found.vertex_part, out.vertex_count), np.uint8).copy() if parts else None
        self._meshes[asset] = Mesh(
            _array(out.vertex, out.vertex_count, np.float32), _array(out.triangle, out.triangle_count, np.uint32),
            out.mass, tuple(out.center_of_mass), text(out.name), text(out.attribution), parts, vertex_part,
        )
        return self._meshes[asset]

    def mesh(self, asset: str) -> Mesh:
        mesh = self._mesh(asset)
        if mesh is None:
            raise Error(f"asset {asset} has not arrived yet")
        return mesh

    def add_asset(self, car: str | os.PathLike[str] | bytes) -> str:
        """Takes the bytes or the path of a baked car, so that the server need not send it. Gives its name for spawn()."""
        data = car if isinstance(car, bytes) else pathlib.Path(car).read_bytes()
        name = ffi.new("char[17]")
        check(lib.crumple_add_asset(self._handle, data, len(data), name))
        return text(name)

    def health(self) -> Health | None:
        """Gives the server's last message of health, which comes once a second. None: none has come yet."""
        out = ffi.new("CrumpleHealth*")
        if lib.crumple_health(self._handle, out) == lib.CRUMPLE_PENDING:
            return None
        return Health(out.tick, out.late, out.rate, out.tick_ms, out.worst_ms, out.refusals)

    def impair(self, delay: float = 0, jitter: float = 0, loss: float = 0, repeat: float = 0, seed: int = 0) -> None:
        """Simulates a bad link from now on, to test a game on it: the session delays (s) or loses (shares) the poses that it
        sends and everything that is published to it. Without arguments the line is good again."""
        line = ffi.new("CrumpleImpairment*", {"delay": delay, "jitter": jitter, "loss": loss, "repeat": repeat, "seed": seed})
        check(lib.crumple_impair(self._handle, line))

    def statistics(self) -> Statistics:
        out = ffi.new("CrumpleStatistics*")
        lib.crumple_statistics(self._handle, out)
        return Statistics(*(getattr(out, name) for name in Statistics.__dataclass_fields__))

    def reaction_rows(self) -> NDArray[np.void]:
        """Gives reactions() as a structured array, without their partners."""
        return _convert.reaction_rows(*self._take_reactions())

    def reactions(self) -> list[Reaction]:
        """Gives the reactions that came since the last call, oldest first."""
        taken, count = self._take_reactions()
        rows = _convert.reaction_rows(taken, count)
        return [_convert.reaction_of(row, _convert.partners_of(taken[k])) for k, row in enumerate(rows)]

    def _take_reactions(self) -> tuple[Any, int]:
        taken = ffi.new("CrumpleReaction[]", 4096)
        return taken, lib.crumple_take_reactions(self._handle, taken, 4096)


class Session(View):
    """A session with a scene of a server. host: the id under which it moves cars; None: a viewer only. timeout: s, for the
    connection and for each command. network: JSON5 in zenoh's own form (TLS, user, password), as for `crumple watch
    --network`."""

    def __init__(
        self, connect: str, scene: str = "main", host: str | None = None, timeout: float = 2.0, network: str | None = None,
    ) -> None:
        keep = {name: ffi.new("char[]", value.encode())
                for name, value in (("connect", connect), ("scene", scene), ("host", host), ("network", network))
                if value is not None}
        super().__init__(timeout_ms=max(1, round(1000 * timeout)), **keep)
        self._timeout = timeout

    def poll(self, timeout: float = 0.0) -> int:
        """Takes in the messages that have arrived; if there are none, it waits for one for at most `timeout` seconds. Gives
        their number."""
        return check(lib.crumple_poll(self._handle, round(1e6 * max(0.0, timeout))))

    def until(self, condition: Callable[[], Value | None], timeout: float = 10.0) -> Value:
        """Polls until the condition gives something that is true, and gives that. It raises TimeoutError after `timeout`
        seconds."""
        deadline = time.monotonic() + timeout
        while not (value := condition()):
            if time.monotonic() > deadline:
                raise TimeoutError(f"the condition did not become true within {timeout:g} s")
            self.poll(0.1)
        return value

    # ---- commands: each gives the tick in which the server did it, or raises Refused with the server's sentence

    def _order(self, send: Callable[..., int], car: str, *arguments: Any) -> Any:
        ticket = ffi.new("uint64_t*")
        check(send(self._handle, car.encode(), *arguments, ticket))
        answer = ffi.new("CrumpleAnswer*")
        check(lib.crumple_wait(self._handle, ticket[0], answer))
        if not answer.ok:
            raise Refused(text(answer.sentence))
        return answer

    def spawn(
        self, car: str, asset: str, pose: Pose = Pose(), *, planar: bool = True, mass: float = 0.0,
        inertia: Vector = (0.0, 0.0, 0.0), center_of_mass: Vector = (0.0, 0.0, 0.0),
    ) -> int:
        """planar: the car is on its wheels. Where a number is 0, that of the baked car counts."""
        to = ffi.new("CrumpleSpawn*")
        _convert.fill_pose(pose, to.pose)
        to.mass, to.planar = mass, int(planar)
        to.inertia = _convert.numbers(inertia, 3, "inertia")
        to.center_of_mass = _convert.numbers(center_of_mass, 3, "center_of_mass")
        return int(self._order(lib.crumple_spawn, car, asset.encode(), to).tick)

    def despawn(self, car: str) -> int:
        return int(self._order(lib.crumple_despawn, car).tick)

    def repair(self, car: str, amount: float = 1.0) -> int:
        """amount: the share of the damage that the server takes away, 0 to 1."""
        return int(self._order(lib.crumple_repair, car, amount).tick)

    def set_parameters(self, car: str, parameters: Parameters) -> int:
        return int(self._order(lib.crumple_set_parameters, car, _convert.c_parameters(parameters)).tick)

    def save(self, car: str) -> bytes:
        """Gives the car's deformation, for load()."""
        answer = self._order(lib.crumple_save, car)
        return bytes(ffi.buffer(answer.state, answer.state_size))

    def load(self, car: str, state: bytes) -> int:
        return int(self._order(lib.crumple_load, car, state, len(state)).tick)

    # ---- host

    def publish_poses(self, time: float, cars: Sequence[CarPose]) -> None:
        """Sends all cars of this host. time: the host's clock, s."""
        names = [ffi.new("char[]", car.car.encode()) for car in cars]
        list_ = ffi.new("CrumpleCarPose[]", len(cars))
        for car, name, to in zip(cars, names, list_):
            _convert.fill_car_pose(car, name, to)
        check(lib.crumple_publish_poses(self._handle, time, list_, len(cars)))

    def publish_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """Sends the whole list of this host, which replaces the list before."""
        hulls = [ffi.new("float[]", [x for point in each.points for x in _convert.numbers(point, 3, "a point")])
                 for each in obstacles]
        list_ = ffi.new("CrumpleObstacle[]", len(obstacles))
        for each, points, to in zip(obstacles, hulls, list_):
            _convert.fill_obstacle(each, points, to)
        check(lib.crumple_publish_obstacles(self._handle, list_, len(obstacles)))

    # ---- viewer

    @property
    def time(self) -> float:
        """The server's time now, s, as in Reaction.time; 0: no message has come yet."""
        return float(lib.crumple_time(self._handle))

    def follow(self, car: str | None = None, level: int = 0) -> None:
        """From now on the session holds the surface of this car; None: of every car. level 0: in every tick; 1: less often and
        more coarsely, from afar."""
        check(lib.crumple_follow(self._handle, car.encode() if car else ffi.NULL, level))

    def mesh(self, asset: str) -> Mesh:
        """Fetches the mesh from the server, once, and waits until it has come."""
        return self.until(lambda: self._mesh(asset), max(10.0, self._timeout))
