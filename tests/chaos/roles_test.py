"""Tests that the host of the chaos run distinguishes a server that does not hear it from a car that no longer touches its wall.

    python tests/chaos/roles_test.py
"""

import pathlib
import sys
from types import SimpleNamespace

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
sys.dont_write_bytecode = True
from roles import RATE, Car  # noqa: E402

SILENCE = 2 * RATE  # steps
DEEPEST = 60  # cm


def make_probe():
    crumple = SimpleNamespace(Shape=SimpleNamespace(box=0), Obstacle=lambda *_: None, Pose=lambda position: position,
                              CarPose=lambda id, pose, velocity, seen: pose[0])
    return Car(crumple, "probe", True, "asset", 2.0, 0)


def touch(car, face, step):
    """A reaction of a car whose dented nose reaches the wall at x = face."""
    car.take(SimpleNamespace(tick=step, contacts=1, pose=SimpleNamespace(position=(face, 0, 0))), step)


def touches_within(car, face, begun, steps):
    return any(car.intent(step, False, step) >= face for step in range(begun, begun + steps))


def a_dented_probe_touches_its_wall_after_a_silence():
    for dent in range(5, DEEPEST):
        car = make_probe()
        face = car.start + 0.01 * dent
        touch(car, face, 0)
        touches_within(car, face, 1, SILENCE)  # the car gets no reactions
        if not touches_within(car, face, SILENCE, RATE):
            return f"dented by {dent} cm and unheard for {SILENCE / RATE:g} s, the probe never touches its wall again"
    return ""


def a_repaired_probe_does_not_dent_its_new_nose():
    car = make_probe()
    touch(car, car.start + 0.01 * DEEPEST, 0)
    car.repaired()
    deepest = max(car.intent(step, False, step) for step in range(1, RATE // 2)) - car.start
    if not 0.05 < deepest < 0.2:
        return f"repaired, the probe goes {deepest:.2f} m beyond its start: its wall is at 0.05 m"
    return ""


failed = [why for why in (a_dented_probe_touches_its_wall_after_a_silence(), a_repaired_probe_does_not_dent_its_new_nose()) if why]
sys.exit("\n".join(failed) or 0)
