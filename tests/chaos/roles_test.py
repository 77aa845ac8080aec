"""Tests the instruments of the chaos run: its host distinguishes a server that does not hear it from a car that no longer touches
its wall; its look at the machine distinguishes a process that stands still by itself from one that gets no core.

    python tests/chaos/roles_test.py
"""

import json
import os
import pathlib
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
sys.dont_write_bytecode = True
from roles import RATE, Car, share_of_machine, time_of  # noqa: E402

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


BUSY = "while True: pass"
HOGS = 2  # with more, the watched process waits so long for its next turn that no look sees it end
WINDOW = 1.5  # s


class Machine:
    """The role "machine", which watches a process that computes without end, and `hogs` others on the same core."""

    def __init__(self, hogs):
        core = min(os.sched_getaffinity(0))
        role = [sys.executable, str(pathlib.Path(__file__).with_name("roles.py")), "machine"]
        self.role = subprocess.Popen(role, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        busy = ["taskset", "-c", str(core), sys.executable, "-c", BUSY]
        self.watched = subprocess.Popen(["nice", "-n", "19" if hogs else "0", *busy])
        self.all = [self.role, self.watched, *(subprocess.Popen(busy) for _ in range(hogs))]
        self.role.stdin.write(f"watch server1 {self.watched.pid}\n")
        self.role.stdin.flush()
        time.sleep(0.5)  # until all have begun

    def told(self, stall=False):
        """Returns the lines of a window in which the watched process is stopped or not, and the window."""
        begin = time.monotonic()
        if stall:
            self.watched.send_signal(signal.SIGSTOP)
        time.sleep(WINDOW)
        if stall:
            self.watched.send_signal(signal.SIGCONT)
        end = time.monotonic()
        time.sleep(1.0)  # until the watched process has had a turn and the last look has seen it
        for each in self.all:
            each.kill()
        return [json.loads(line) for line in self.role.communicate()[0].splitlines() if line.endswith("}")], begin, end


def a_server_that_stands_still_by_itself_is_not_the_machine():
    told, begin, end = Machine(hogs=0).told(stall=True)
    stood, used = share_of_machine(told, begin, end), time_of("server1", told, begin, end)
    if len(told) < 5 or stood > 0.5 * WINDOW or used > 0.5 * WINDOW:
        return f"a server stopped for {WINDOW} s: the machine is said to have stood {stood:.2f} s, the server to have used {used:.2f} s"
    return ""


def a_server_that_gets_no_core_is_the_machine():
    stood = share_of_machine(*Machine(HOGS).told())
    return "" if stood > 0.7 * WINDOW else f"a server without a core for {WINDOW} s: the machine is said to have stood {stood:.2f} s"


tests = [a_dented_probe_touches_its_wall_after_a_silence, a_repaired_probe_does_not_dent_its_new_nose,
         a_server_that_stands_still_by_itself_is_not_the_machine, a_server_that_gets_no_core_is_the_machine]
failed = [why for why in (test() for test in tests) if why]
sys.exit("\n".join(failed) or 0)
