"""For hosts, viewers and recordings of crumple, the server that owns the dents of cars. README.md begins with a whole
program."""

from crumple._convert import columns
from crumple._library import Error, Refused
from crumple.recording import Frame, Life, Recording
from crumple.scene import Hit, Scene, SceneCar
from crumple.session import Session, View
from crumple.types import (
    CarPose, Health, Mesh, Obstacle, OwnMesh, Parameters, Part, PartKind, Partner, Pose, Reaction, Shape, Solver, Statistics, Surface,
    Vertices,
)

__all__ = [
    "CarPose", "Error", "Frame", "Health", "Hit", "Life", "Mesh", "Obstacle", "OwnMesh", "Parameters", "Part", "PartKind",
    "Partner", "Pose", "Reaction", "Recording", "Refused", "Scene", "SceneCar", "Session", "Shape", "Solver", "Statistics", "Surface",
    "Vertices", "View", "columns",
]
