"""Reads recordings: MCAP files of `crumple serve --record`. The client library decodes their messages as it decodes live
ones."""

from __future__ import annotations

import contextlib
import os
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from types import TracebackType
from typing import Any, Self

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap.records import Chunk
from numpy.typing import NDArray

from crumple._convert import REACTION
from crumple._library import Error, check, ffi, lib
from crumple.schema.Answer import Answer
from crumple.schema.Asset import Asset
from crumple.schema.Command import Command
from crumple.schema.Obstacles import Obstacles, ObstaclesT
from crumple.schema.Order import Order
from crumple.schema.Pose import PoseT
from crumple.schema.Poses import Poses
from crumple.schema.Spawn import Spawn
from crumple.session import View
from crumple.types import Mesh, Obstacle, OwnMesh, Pose, Shape, Surface, Vertices

# The most bytes that a chunk may hold, in all and per compressed byte. The server's reader has the same limits.
CHUNK_MOST, RATIO_MOST = 64 << 20, 256  # bytes
FRAME = ("/key/0", "/delta/0", "/reactions", "health", "tick")  # ends of keys


@dataclass(frozen=True)
class Life:
    """A car from its spawn to its despawn. despawned is None: the car lived to the end."""

    car: str
    asset: str
    host: str
    spawned: int  # ticks
    despawned: int | None = None
    mass: float = 0.0  # kg; 0: the baked car's
    pose: Pose = Pose()  # at its spawn


class Frame(View):
    """The cars as they were after one tick."""

    def __init__(self, recording: Recording, tick: int) -> None:
        self._scene = ffi.new("char[]", recording.scene.encode())
        super().__init__(scene=self._scene)
        check(lib.crumple_follow(self._handle, ffi.NULL, 0))
        self.tick = tick
        self._recording = recording
        self._from = tick  # the tick at which a car is looked up when it is first asked for
        self._sought: set[str] = set()

    @property
    def time(self) -> float:
        """s, by the server's ticks."""
        return self.tick / self._recording.rate

    def cars(self) -> list[str]:
        return [car for car in self._recording.cars if self.surface(car)]

    def surface(self, car: str) -> Surface | None:
        return super().surface(car) if self._seek(car) else None

    def vertices(self, car: str, out: Vertices | None = None, time: float = 0.0, own: OwnMesh | None = None) -> Vertices | None:
        return super().vertices(car, out, time, own) if self._seek(car) else None

    def part_poses(self, car: str, time: float = 0.0) -> list[Pose] | None:
        return super().part_poses(car, time) if self._seek(car) else None

    def _mesh(self, asset: str) -> Mesh | None:
        if asset not in self._meshes and asset in self._recording.assets:
            self.add_asset(self._recording.assets[asset])
        elif asset not in self._meshes:
            for car in self._recording.given:
                with contextlib.suppress(Error):  # the server refused this car too
                    self.add_asset(car)
        return super()._mesh(asset)

    def _seek(self, car: str) -> bool:
        if car not in self._sought:
            self._sought.add(car)
            for key, data in self._recording._last_surface(car, self._from):
                self._feed(key, data)
        return car in super().cars() and self._recording._lives(car, self.tick)

    def _feed(self, key: str, data: bytes) -> None:
        check(lib.crumple_feed(self._handle, key.encode(), data, len(data)))


class Recording:
    """A recording, which is a context manager. Times are seconds by the server's ticks, as in Reaction.time."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._file = open(path, "rb")
        summary = head = None
        with contextlib.suppress(McapError, OSError):  # the latter for a file of a few bytes
            self._reader: McapReader = make_reader(self._file)
            summary = self._reader.get_summary()
            head = {each.name: each.metadata for each in self._reader.iter_metadata()}.get("crumple")
        if summary is None or head is None:
            self.close()
            raise Error(f"{os.fspath(path)}: this is not a whole recording of crumple; if it was cut off, run crumple recover FILE -o WHOLE")
        self.scene, self.rate, self.program = head["scene"], float(head["rate"]), head["program"]
        self._root = f"crumple/1/{self.scene}/"
        self._topics = {channel.topic.removeprefix(self._root) for channel in summary.channels.values()}
        self.cars = sorted({key.split("/")[1] for key in self._topics if key.startswith("car/") and key.endswith("/key/0")})

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    @cached_property
    def assets(self) -> dict[str, bytes]:
        """The baked cars that the server began with, by hash."""
        return {each.name: each.data for each in self._reader.iter_attachments() if each.media_type.endswith(".car")}

    @cached_property
    def given(self) -> list[bytes]:
        """The baked cars that came later, in messages."""
        return [Asset.GetRootAs(data).CarAsNumpy().tobytes() for _, _, _, data in self._messages("asset".__eq__)]

    @cached_property
    def _ticks(self) -> NDArray[np.uint64]:
        """A row for each tick: its number, and the log time of its end, ns."""
        rows = [(tick, at) for tick, at, _, _ in self._messages(lambda key: key == "tick")]
        if not rows:
            raise Error(f"{self._file.name}: it has no whole tick")
        return np.array(rows, np.uint64)

    @property
    def start(self) -> float:
        return float(self._ticks[0, 0]) / self.rate

    @property
    def end(self) -> float:
        return float(self._ticks[-1, 0]) / self.rate

    def messages(self, key: str | None = None) -> Iterator[tuple[int, str, bytes]]:
        """Gives tick, key below crumple/1/{scene}/ and bytes of all messages, or of those with this key. crumple.schema reads
        the bytes."""
        for tick, _, below, data in self._messages(lambda topic: key in (None, topic)):
            yield tick, below, data

    def _messages(self, wanted: Callable[[str], bool], **bounds: Any) -> Iterator[tuple[int, int, str, bytes]]:
        topics = [self._root + key for key in self._topics if wanted(key)]
        if not topics or not self._chunks_checked:
            return
        for _, channel, message in self._reader.iter_messages(topics, **bounds):
            yield message.sequence, message.log_time, channel.topic.removeprefix(self._root), message.data

    @cached_property
    def _chunks_checked(self) -> bool:
        """Checks the sizes that a chunk and its compressed data claim, because mcap allocates as much memory."""
        summary = self._reader.get_summary()
        if summary is None or not summary.chunk_indexes:  # mcap would then read it without the index
            raise Error(f"{self._file.name}: it has no index of its chunks; crumple recover FILE -o WHOLE makes one")
        for index in summary.chunk_indexes:
            self._file.seek(index.chunk_start_offset + 9)  # opcode, length
            chunk = Chunk.read(ReadDataStream(self._file))
            taken, holds = len(chunk.data), chunk.uncompressed_size
            if chunk.compression == "zstd":
                holds = max(holds, zstandard.frame_content_size(chunk.data))
            elif chunk.compression == "lz4" and 255 * taken > CHUNK_MOST:  # less cannot expand beyond it
                holds = max(holds, len(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=CHUNK_MOST + 1)))
            if holds > CHUNK_MOST or holds > RATIO_MOST * taken:
                raise Error(f"{self._file.name}: a chunk claims to hold {holds} bytes in {taken}; record it anew")
        return True

    def _tick_at(self, time: float) -> int:
        """The last tick that had ended at this time."""
        ticks = self._ticks[:, 0]
        return int(ticks[max(0, int(np.searchsorted(ticks, time * self.rate + 1e-6, side="right")) - 1)])

    def _log_time(self, tick: int) -> int:
        return int(self._ticks[np.searchsorted(self._ticks[:, 0], tick), 1])

    def _last_surface(self, car: str, tick: int) -> list[tuple[str, bytes]]:
        """Gives the messages of the surface after a tick: the last keyframe, and the last delta against it."""
        found: list[tuple[str, bytes]] = []
        key_tick = 0
        for kind in ("key", "delta"):
            parts: list[tuple[str, bytes]] = []
            last = None
            backwards = self._messages(f"car/{car}/{kind}/0".__eq__, ending_at=self._log_time(tick), reverse=True)
            for at, _, key, data in backwards:
                if last not in (None, at) or at < key_tick:
                    break
                last = at
                parts.insert(0, (self._root + key, data))
            key_tick = last or 0
            found += parts
        return found

    def at(self, time: float) -> Frame:
        """Gives the cars after the last tick that had ended at this time, or after the first tick. It searches the file for a car
        only when the caller first asks for the car."""
        return Frame(self, self._tick_at(time))

    def frames(self, start: float = 0.0, end: float = float("inf")) -> Iterator[Frame]:
        """Gives one Frame again after every tick, with its reactions() and health()."""
        frame = self.at(max(start, self.start))
        frame.cars()
        yield frame
        begun = self._log_time(frame.tick)
        for tick, _, key, data in self._messages(lambda key: key.endswith(FRAME), starting_after=begun):
            if tick / self.rate > end:
                break
            if key == "tick":
                frame.tick = tick
                yield frame
            else:
                frame._feed(self._root + key, data)

    def reactions(self, start: float = 0.0, end: float = float("inf")) -> NDArray[np.void]:
        """Gives all reactions of a time as one structured array: rows["impulse"] is n x 3. columns(rows) gives what
        pandas.DataFrame takes."""
        found = [np.zeros(0, REACTION)]
        with Frame(self, 0) as frame:
            for tick, _, key, data in self._messages(lambda key: key.endswith("/reactions")):
                if start <= tick / self.rate <= end:
                    frame._feed(self._root + key, data)
                    found.append(frame.reaction_rows())
        return np.concatenate(found)

    def obstacles(self, time: float = float("inf")) -> dict[str, list[Obstacle]]:
        """Gives the list of each host at a time."""
        lists: dict[str, list[Obstacle]] = {}
        last = self._tick_at(time)
        for tick, _, key, data in self._messages(lambda key: key.endswith("/obstacles")):
            if tick <= last:
                read = ObstaclesT.InitFromObj(Obstacles.GetRootAs(data))
                lists[key.split("/")[1]] = [_obstacle_of(each) for each in read.obstacles]
        return lists

    def poses(self, start: float = 0.0, end: float = float("inf")) -> dict[str, dict[int, Pose]]:
        """Gives poses by car and tick, as far as the recording has them: of the spawn, of the host, and where there is a
        reaction, of that."""
        known: dict[str, dict[int, Pose]] = {}
        for life in self.lives:
            known.setdefault(life.car, {})[life.spawned] = life.pose
        hosts = {life.car: life.host for life in self.lives}
        for tick, _, key, data in self._messages(lambda key: key.endswith("/poses")):
            if not start <= tick / self.rate <= end:
                continue
            message = Poses.GetRootAs(data)
            for i in range(message.CarsLength()):
                each = message.Cars(i)
                car = each.Car().decode()
                if hosts.get(car, host := key.split("/")[1]) == host:
                    known.setdefault(car, {})[tick] = _pose_of(PoseT.InitFromObj(each.Pose()))
        for row in self.reactions(start, end):
            pose = Pose(tuple(row["position"].tolist()), tuple(row["orientation"].tolist()))
            known.setdefault(str(row["car"]), {})[int(row["tick"])] = pose
        return known

    @cached_property
    def lives(self) -> list[Life]:
        """Which cars lived, and when."""
        lives: list[Life] = []
        asked: dict[str, deque[bytes]] = {}  # in the order of their answers; not parsed, because a refused command may be any bytes
        commands = self._messages(lambda key: key.startswith("car/") and (key.count("/") == 1 or key.endswith("/answer")))
        for tick, _, key, data in commands:
            car = key.split("/")[1]
            if not key.endswith("/answer"):
                asked.setdefault(car, deque()).append(data)
                continue
            order = asked[car].popleft() if asked.get(car) else None
            if order is None or not Answer.GetRootAs(data).Ok():
                continue
            command = Command.GetRootAs(order)
            if command.OrderType() == Order.Spawn:
                spawn = Spawn()
                spawn.Init(command.Order().Bytes, command.Order().Pos)
                pose = PoseT.InitFromObj(spawn.Pose())
                lives.append(Life(car, spawn.Asset().decode(), spawn.Host().decode(), tick, None, spawn.Mass(), _pose_of(pose)))
            elif command.OrderType() == Order.Despawn:
                lives = [replace(life, despawned=tick) if life.car == car and life.despawned is None else life for life in lives]
        return lives

    def _lives(self, car: str, tick: int) -> bool:
        """Whether the car was not despawned, or was spawned again. A recording may begin with cars that live."""
        last = [life for life in self.lives if life.car == car and life.spawned <= tick]
        return not last or last[-1].despawned is None or tick < last[-1].despawned


def _vector(of: Any) -> tuple[float, ...]:
    return (of.x, of.y, of.z) if of else (0.0, 0.0, 0.0)


def _pose_of(read: Any) -> Pose:
    turn = read.orientation
    return Pose(_vector(read.position), (turn.x, turn.y, turn.z, turn.w))


def _obstacle_of(read: Any) -> Obstacle:
    return Obstacle(
        read.id, Shape(read.shape), _vector(read.size), _pose_of(read.pose), read.friction, _vector(read.velocity),
        _vector(read.angularVelocity), tuple(map(_vector, read.points or ())),
    )
