"""Converts to and from the structs of crumple_client.h."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from crumple._library import ffi, lib, text
from crumple.types import CarPose, Obstacle, Parameters, Part, PartKind, Partner, Pose, Reaction, Vector


def part_of(part: Any) -> Part:
    pose = Pose(tuple(part.position), tuple(part.orientation))
    return Part(text(part.name), PartKind(part.kind), pose, part.radius, part.width)


def numbers(values: Vector, count: int, name: str) -> list[float]:
    if len(values) != count:
        raise ValueError(f"{name} has {len(values)} numbers, not {count}")
    return [float(value) for value in values]


def fill_pose(pose: Pose, to: Any) -> None:
    to.position = numbers(pose.position, 3, "position")
    to.orientation = numbers(pose.orientation, 4, "orientation")


def fill_car_pose(car: CarPose, name: Any, to: Any) -> None:
    to.car = name
    fill_pose(car.pose, to.pose)
    to.velocity = numbers(car.velocity, 3, "velocity")
    to.angular_velocity = numbers(car.angular_velocity, 3, "angular_velocity")
    to.seen = car.seen
    to.importance = car.importance


def fill_obstacle(obstacle: Obstacle, points: Any, to: Any) -> None:
    to.id, to.shape, to.friction = obstacle.id, int(obstacle.shape), obstacle.friction
    to.points, to.point_count = points, len(obstacle.points)
    to.size = numbers(obstacle.size, 3, "size")
    fill_pose(obstacle.pose, to.pose)
    to.velocity = numbers(obstacle.velocity, 3, "velocity")
    to.angular_velocity = numbers(obstacle.angular_velocity, 3, "angular_velocity")


def c_parameters(parameters: Parameters) -> Any:
    to = ffi.new("CrumpleParameters*", lib.crumple_keep())
    for name, value in vars(parameters).items():
        if value is not None:
            setattr(to, name.rstrip("_"), value)
    return to


# The memory layout of a CrumpleReaction. `car` is the address of its name.
_struct = ffi.typeof("CrumpleReaction")
_formats = {"car": np.dtype("u8"), "tick": np.dtype("u8"), "time": np.dtype("f8"), "contacts": np.dtype("u4"),
            "energy_absorbed": np.dtype("f8"), "energy_stored": np.dtype("f8"), "deepest": np.dtype("f4"),
            "partner_count": np.dtype("u4"), "partners": np.dtype("u8")}
_pose = np.dtype([("position", "f8", 3), ("orientation", "f4", 4)], align=True)
C_REACTION = np.dtype({
    "names": [name for name, _ in _struct.fields],
    "formats": [_pose if name == "pose" else _formats.get(name, np.dtype(("f4", 3))) for name, _ in _struct.fields],
    "offsets": [at.offset for _, at in _struct.fields],
    "itemsize": ffi.sizeof(_struct),
})
# Reactions as one array, with the fields of Reaction except partners: rows[["impulse", ...]], or columns(rows) for tables.
REACTION = np.dtype([("tick", "u8"), ("time", "f8"), ("car", "U32"), ("position", "f8", 3), ("orientation", "f4", 4)] + [
    (name, "f4", 3) for name in ("velocity", "angular_velocity", "impulse", "angular_impulse")
] + [("energy_absorbed", "f8"), ("energy_stored", "f8"), ("deepest", "f4"), ("contacts", "u4")])


def reaction_rows(taken: Any, count: int) -> NDArray[np.void]:
    """`taken`: CrumpleReaction[], of which the first `count` are filled."""
    raw = np.frombuffer(ffi.buffer(taken, count * ffi.sizeof(_struct)), C_REACTION)
    rows = np.zeros(count, REACTION)
    for name in REACTION.names or ():
        if name in ("position", "orientation"):
            rows[name] = raw["pose"][name]
        elif name != "car":
            rows[name] = raw[name]
    for place in np.unique(raw["car"]):
        rows["car"][raw["car"] == place] = text(ffi.cast("char*", int(place)))
    return rows


def partners_of(reaction: Any) -> tuple[Partner, ...]:
    """`reaction`: a CrumpleReaction that was taken last."""
    given = (reaction.partners[k] for k in range(reaction.partner_count))
    return tuple(Partner(text(each.car), text(each.host), tuple(each.impulse), each.contacts) for each in given)


def reaction_of(row: Any, partners: tuple[Partner, ...]) -> Reaction:
    def vector(name: str) -> tuple[float, ...]:
        return tuple(row[name].tolist())

    return Reaction(
        car=str(row["car"]), tick=int(row["tick"]), time=float(row["time"]), impulse=vector("impulse"),
        angular_impulse=vector("angular_impulse"), pose=Pose(vector("position"), vector("orientation")),
        velocity=vector("velocity"), angular_velocity=vector("angular_velocity"),
        energy_absorbed=float(row["energy_absorbed"]), energy_stored=float(row["energy_stored"]),
        deepest=float(row["deepest"]), contacts=int(row["contacts"]), partners=partners,
    )


def columns(rows: NDArray[np.void]) -> dict[str, NDArray[Any]]:
    """Gives one-dimensional columns (impulse_x and so on), which pandas.DataFrame takes."""
    table: dict[str, NDArray[Any]] = {}
    for name in rows.dtype.names or ():
        if rows[name].ndim == 1:
            table[name] = rows[name]
        else:
            table |= {f"{name}_{axis}": rows[name][:, i] for i, axis in enumerate("xyzw"[: rows[name].shape[1]])}
    return table
