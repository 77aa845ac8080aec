"""Reads, changes and writes scenes: the JSON files that `crumple drive` plays (schema/scene.fbs)."""

from __future__ import annotations

import dataclasses
import json
import os
import pathlib
from dataclasses import dataclass, field
from typing import Any

from crumple.types import ZERO, Obstacle, Parameters, Pose, Shape, Solver, Vector


@dataclass(frozen=True)
class Hit:
    """One run-up of a car. It begins at `position` and goes at this speed along `direction` (of length 1) until it hits
    something."""

    position: Vector
    direction: Vector
    speed_kmh: float = 0.0
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    repair: float = 0.0  # share of the earlier damage that the server takes away before
    seconds: float = 3.0


@dataclass(frozen=True)
class SceneCar:
    """One of several cars of a scene. What it leaves out, it has from the scene."""

    id: str
    hits: tuple[Hit, ...]
    host: str = ""
    car: str = ""  # path or hash of the baked car
    mass: float = 0.0  # kg
    planar: bool | None = None
    parameters: tuple[Parameters, ...] = ()


@dataclass(frozen=True)
class Scene:
    """What `crumple drive` plays: one car, whose hits are `hits`, or several `cars`."""

    about: str
    obstacles: tuple[Obstacle, ...]
    hits: tuple[Hit, ...] = ()
    car: str = ""  # path or hash of the baked car
    mass: float = 0.0  # kg; 0: the baked car's
    planar: bool = True
    rate: float = 60.0  # poses a second
    parameters: tuple[Parameters, ...] = ()
    cars: tuple[SceneCar, ...] = ()

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Scene:
        given = json.loads(pathlib.Path(path).read_text())
        try:
            obstacles = tuple(_obstacle(each) for each in given.pop("obstacles"))
            cars = tuple(SceneCar(**_of_car(each)) for each in given.pop("cars", []))
            return cls(obstacles=obstacles, cars=cars, **_of_car(given))
        except (KeyError, TypeError) as error:
            raise ValueError(f"{os.fspath(path)}: {error} (the form of a scene: schema/scene.fbs)") from error

    def write(self, path: str | os.PathLike[str]) -> None:
        pathlib.Path(path).write_text(json.dumps(_json(self), indent=2) + "\n")


def _vectors(given: dict[str, Any]) -> dict[str, Any]:
    def value(of: Any) -> Any:
        return tuple(float(of.get(axis, 0.0)) for axis in "xyzw" if axis in of or axis != "w") if isinstance(of, dict) else of

    return {name: value(each) for name, each in given.items()}


def _of_car(given: dict[str, Any]) -> dict[str, Any]:
    hits = tuple(Hit(**_vectors(each)) for each in given.get("hits", []))
    parameters = tuple(_parameters(each) for each in given.get("parameters", []))
    return {**given, "hits": hits, "parameters": parameters}


def _obstacle(given: dict[str, Any]) -> Obstacle:
    rest = {name: each for name, each in given.items() if name not in ("pose", "shape", "points")}
    points = tuple(_vectors({"": point})[""] for point in given.get("points", []))
    return Obstacle(shape=Shape[given["shape"]], pose=Pose(**_vectors(given["pose"])), points=points, **_vectors(rest))


def _parameters(given: dict[str, Any]) -> Parameters:
    if "solver" in given:
        given = {**given, "solver": Solver[given["solver"]]}
    return Parameters(**given)


def _json(value: Any) -> Any:
    if isinstance(value, (Shape, Solver)):
        return value.name
    if dataclasses.is_dataclass(value):  # what is absent has its default there as here; but a Pose is a struct, always whole
        given = [(each, getattr(value, each.name)) for each in dataclasses.fields(value)]
        return {each.name: _json(of) for each, of in given if isinstance(value, Pose) or of != each.default}
    if isinstance(value, (list, tuple)) and value and isinstance(value[0], (int, float)):
        return dict(zip("xyzw", map(float, value)))
    return [_json(each) for each in value] if isinstance(value, (list, tuple)) else value
