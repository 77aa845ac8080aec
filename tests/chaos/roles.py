"""The helper processes of the chaos run. `run` sends them lines on stdin and reads their stdout.

    roles.py host ENDPOINT NETWORK ID CARS LANE BIG SMALL     drives cars into walls; measures how long the server did not hear it
    roles.py truth ENDPOINT NETWORK CARS                      asks the server for the hash of each car, at each line on stdin
    roles.py links                                            bad links: "open NAME HOST:PORT [thin]",
                                                              "up|cut|freeze NAME", "slow NAME MS JITTER"
    roles.py machine                                          measures how long the machine lets ready processes wait: itself,
                                                              and those named on stdin, "watch NAME PID"

NETWORK: a file of Zenoh's configuration that overrides a client's, or "-". CARS of truth: car ids, comma separated.
"""

import asyncio
import json
import pathlib
import random
import socket
import sys
import threading
import time

SCENE = "main"
RATE = 60  # poses a second
WALL = 20.0  # m: the face of every wall, in x
LANE = 8.0  # m between cars
TELL = 0.1  # s: a host reports if the server does not hear it for longer
NAP, LOOK = 0.01, 0.1  # s: the machine is measured by sleeps of this length; the time between two looks at its processes
PERIOD = 2 * RATE  # ticks from one crash of all cars to the next
WAIT = RATE // 4  # ticks that a car stands at its start before it goes
UNIT = 1e-6  # m/s: the velocity in z encodes a pose's number modulo NUMBERS; contacts do not change it
NUMBERS = 10_000
MENDED = 4.0  # s between two repairs of a car


def say(**what):
    print(json.dumps(what), flush=True)


def lines(take):
    """Calls `take` with each line of stdin on a separate thread."""

    def read():
        for line in sys.stdin:
            take(line.strip())

    threading.Thread(target=read, daemon=True).start()


def text_of(network):
    return None if network == "-" else pathlib.Path(network).read_text()


# ---- host --------------------------------------------------------------------------------------------------------------------


class Car:
    """A probe taps its wall again and again, so that it gets a reaction in each tick. If the server does not hear it, it taps from
    the place of its last contact, because its dented nose may not reach the wall from its start. The other cars crash once a
    period, all in the same tick, and then tap their walls."""

    def __init__(self, crumple, id, probe, asset, nose, lane):
        self.crumple, self.id, self.probe, self.asset, self.lane = crumple, id, probe, asset, lane
        self.start = WALL - nose - (0.05 if probe else 10.0)  # m
        self.x, self.speed, self.seen, self.hit = self.start, 0.0, 0, None
        self.touched = self.start  # m
        self.wall = crumple.Obstacle(lane, crumple.Shape.box, (1.0, 3.0, 3.0), crumple.Pose((WALL + 1.0, LANE * lane, 0.0)))

    def take(self, reaction, now):
        self.seen = reaction.tick
        if reaction.contacts > 0:
            self.x = self.touched = reaction.pose.position[0]
            self.hit = now

    def repaired(self):
        if self.probe:
            self.touched, self.hit = self.start, None

    def intent(self, step, calm, sequence):
        """Returns the pose of this step. The velocity in z contains its number."""
        if self.probe:
            if self.hit is None or step - self.hit > RATE // 2:  # the server does not hear it, or its wall is gone
                self.hit, self.x = step, self.touched
            self.speed = -0.5 if step - self.hit < 6 else 0.5
        elif calm or step % PERIOD < WAIT:
            self.x, self.speed, self.hit = self.start, 0.0, None
        elif self.hit is None:
            self.speed = 14.0
        else:  # it taps its wall, so that viewers get a message in each tick
            self.speed = -1.0 if step - self.hit < 3 else 1.0
        self.x += self.speed / RATE
        pose = self.crumple.Pose((self.x, LANE * self.lane, 0.0))
        velocity = (self.speed, 0.0, sequence % NUMBERS * UNIT)
        return self.crumple.CarPose(self.id, pose, velocity, seen=0 if self.probe or self.hit is not None else self.seen)


class Host:
    def __init__(self, endpoint, network, id, cars, lane, big, small):
        import crumple

        self.crumple, self.endpoint, self.network, self.id = crumple, endpoint, text_of(network), id
        self.session = self.open()
        assets = {file: self.session.add_asset(file) for file in (big, small)}
        noses = {file: float(self.session.mesh(asset).vertex[:, 0].max()) for file, asset in assets.items()}
        self.cars = {}
        for k in range(int(cars) + 1):
            file = small if k == 0 else big
            name = f"{id}{k}" if k else f"{id}-probe"
            self.cars[name] = Car(crumple, name, k == 0, assets[file], noses[file], int(lane) + k)
        self.probe = next(iter(self.cars))
        self.calm = True  # until a line on stdin ends the calm
        self.sent, self.confirmed, self.confirmed_at = 0, 0, time.monotonic()

    def open(self):
        while True:
            try:
                return self.crumple.Session(self.endpoint, SCENE, self.id, 2.0, self.network)
            except self.crumple.Error:
                time.sleep(0.2)

    @property
    def unheard(self):
        """s: the time of all poses sent after the last pose that the server confirmed."""
        return (self.sent - self.confirmed) / RATE

    def command(self):
        """Spawns missing cars and repairs the others, in a separate session, because a session that waits for an answer sends no poses."""
        session, mended, missing = self.open(), time.monotonic(), []
        while True:
            time.sleep(0.5)
            try:
                if self.unheard > 0.7:
                    missing = list(self.cars.values())
                if missing:
                    while missing:
                        try:
                            pose = self.crumple.Pose((missing[0].start, LANE * missing[0].lane, 0.0))
                            session.spawn(missing[0].id, missing[0].asset, pose)
                        except self.crumple.Refused:  # it is already there; dented too deeply, a probe touches its wall no more
                            if missing[0].probe:
                                session.repair(missing[0].id)
                                missing[0].repaired()
                        missing.pop(0)
                elif time.monotonic() > mended + MENDED and not self.calm:
                    mended = time.monotonic()
                    for car in self.cars.values():
                        session.repair(car.id)
                        car.repaired()
            except self.crumple.Error:
                pass  # no answer: try again

    def take_reactions(self, step):
        for reaction in self.session.reactions():
            car = self.cars.get(reaction.car)
            if car is None:
                continue
            car.take(reaction, step)
            number = round(float(reaction.velocity[2]) / UNIT)
            sequence = self.sent - (self.sent - number) % NUMBERS
            if sequence <= self.confirmed:
                continue
            now, gap, late = time.monotonic(), (sequence - self.confirmed) / RATE, (self.sent - sequence) / RATE
            if max(gap, late) > TELL:
                say(gap=gap, late=late, begin=self.confirmed_at, end=now)
            self.confirmed, self.confirmed_at = sequence, now

    def play(self):
        threading.Thread(target=self.command, daemon=True).start()
        step, due = 0, time.monotonic()
        while True:
            step += 1
            due = max(due + 1 / RATE, time.monotonic() - 1 / RATE)  # after a delay it sends no burst
            while (left := due - time.monotonic()) > 0:
                self.session.poll(left)
            self.session.poll()
            self.take_reactions(step)
            self.sent += 1
            poses = [car.intent(step, self.calm, self.sent) for car in self.cars.values()]
            try:
                self.session.publish_poses(step / RATE, poses)
                if step % RATE == 1:
                    self.session.publish_obstacles([car.wall for car in self.cars.values()])
            except self.crumple.Error:
                pass  # its own queue is full because the link is down
            if step % RATE == 0:
                say(unheard=self.unheard, since=self.confirmed_at, now=time.monotonic())


def host(*arguments):
    it = Host(*arguments)

    def order(line):
        it.calm = line == "calm"

    lines(order)
    it.play()


# ---- zenoh's own -------------------------------------------------------------------------------------------------------------


def configured(endpoint, network):
    """Returns a configuration for a client with PyPI's eclipse-zenoh."""
    import zenoh

    config = zenoh.Config() if network == "-" else zenoh.Config.from_json5(text_of(network))
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/timeout_ms", "3000")
    config.insert_json5("connect/retry", '{"period_init_ms": 100, "period_max_ms": 400, "period_increase_factor": 2}')
    return config


def truth(endpoint, network, cars):
    import zenoh
    from crumple.schema.Keyframe import Keyframe

    while True:
        try:
            session = zenoh.open(configured(endpoint, network))
            break
        except zenoh.ZError:
            time.sleep(0.2)
    say(truth=True)
    for _ in sys.stdin:
        held = {}
        for car in cars.split(","):
            for level in range(2):
                for reply in session.get(f"crumple/1/{SCENE}/car/{car}/key/{level}", timeout=2.0):
                    if reply.ok is not None:
                        held[f"{car}/{level}"] = f"{Keyframe.GetRootAs(bytes(reply.ok.payload)).Hash():016x}"
        say(held=held)


# ---- the machine -------------------------------------------------------------------------------------------------------------


def threads_of(pid):
    """Returns how long each thread of a process has run, and how long it was ready and waited for a core: s, by thread."""
    out = {}
    for file in pathlib.Path(f"/proc/{pid}/task").glob("*/schedstat"):
        try:
            ran, waited, _ = file.read_text().split()
        except (OSError, ValueError):
            continue  # the thread has just ended
        out[file.parent.name] = int(ran) * 1e-9, int(waited) * 1e-9
    return out


def machine():
    """Sleeps again and again for a moment. Tells at each look: the time since the last one, by how much a sleep was too long, and
    for each process the longest time that one of its threads was ready and got no core, and the time that all of them ran."""
    pids, before = {}, {}

    def order(line):
        _, name, pid = line.split()
        pids[name] = int(pid)

    lines(order)
    while True:
        since, overslept = time.monotonic(), 0.0
        while (slept := time.monotonic()) < since + LOOK:
            time.sleep(NAP)
            overslept += time.monotonic() - slept - NAP
        waited, ran = {"sleeper": overslept}, {}
        for name, pid in list(pids.items()):
            now, last = threads_of(pid), before.get(pid, {})
            more = [[after - then for after, then in zip(now[id], last[id])] for id in now if id in last]
            ran[name], waited[name] = sum(each[0] for each in more), max((each[1] for each in more), default=0.0)
            before[pid] = now
        say(at=time.monotonic(), since=since, waited=waited, ran=ran)


def share_of_machine(told, begin, end):
    """Of the time from begin to end, the seconds in which the sleeper or a watched process was ready and got no core. told: the
    lines of `machine`. A wait that is told at a look ended there at the latest."""
    stood, covered = 0.0, end  # from `covered` on, all waits are counted
    for each in reversed(told):
        until = min(each["at"], covered)
        since = max(each["at"] - max(each["waited"].values()), begin)
        if until > since:
            stood, covered = stood + until - since, since
    return stood


def time_of(name, told, begin, end):
    """The seconds of a core that a process used at the looks from begin to end."""
    return sum(each["ran"].get(name, 0.0) for each in told if begin < each["at"] <= end + LOOK)


# ---- bad lines ---------------------------------------------------------------------------------------------------------------

QUEUE = 8  # pieces that may wait in a link, in each direction
PIECE = 256 << 10  # bytes
BUFFER = 32 << 10  # bytes in the sockets of a thin link, so that data soon waits at the sender


def make_socket(thin):
    it = socket.socket()
    it.setblocking(False)
    if thin:
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            it.setsockopt(socket.SOL_SOCKET, option, BUFFER)
    return it


class Link:
    def __init__(self, to, thin):
        host, port = to.rsplit(":", 1)
        self.to, self.thin, self.state, self.delay, self.jitter = (host, int(port)), thin, "up", 0.0, 0.0
        self.moves = asyncio.Event()
        self.moves.set()
        self.writers = set()

    async def accept(self, reader, writer):
        if self.state == "cut":
            return writer.transport.abort()
        await self.moves.wait()
        try:
            far = make_socket(self.thin)
            await asyncio.get_running_loop().sock_connect(far, self.to)
            far_reader, far_writer = await asyncio.open_connection(sock=far)
        except OSError:
            return writer.transport.abort()
        self.writers |= {writer, far_writer}
        tasks = [asyncio.create_task(way) for way in (self.carry(reader, far_writer), self.carry(far_reader, writer))]
        await asyncio.wait(tasks)
        self.writers -= {writer, far_writer}

    async def carry(self, reader, writer):
        queue = asyncio.Queue(QUEUE)

        async def take():
            while True:
                try:
                    data = await reader.read(PIECE)
                except OSError:
                    data = b""  # a killed process resets the connection, and the other end must see this
                await self.moves.wait()
                await queue.put((time.monotonic() + max(0, random.gauss(self.delay, self.jitter)), data))
                if not data:
                    return

        taking = asyncio.create_task(take())
        try:
            while True:
                due, data = await queue.get()
                if (left := due - time.monotonic()) > 0:
                    await asyncio.sleep(left)
                await self.moves.wait()
                if not data:
                    break
                writer.write(data)
                await writer.drain()
        except OSError:
            pass
        finally:
            taking.cancel()
            writer.close()

    def set(self, state, delay=0.0, jitter=0.0):
        self.state, self.delay, self.jitter = state, float(delay) / 1e3, float(jitter) / 1e3
        if state == "cut":
            for writer in list(self.writers):
                writer.transport.abort()
        self.moves.clear() if state == "freeze" else self.moves.set()


async def serve_links():
    reader = asyncio.StreamReader(limit=1 << 16)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    links, servers = {}, []
    while line := (await reader.readline()).decode().split():
        verb, name, *rest = line
        if verb == "open":
            links[name] = Link(rest[0], "thin" in rest)
            listener = make_socket(links[name].thin)
            listener.bind(("127.0.0.1", 0))
            servers.append(await asyncio.start_server(links[name].accept, sock=listener))
            say(link=name, port=servers[-1].sockets[0].getsockname()[1])
        else:
            links[name].set(verb, *rest)


if __name__ == "__main__":
    verb, *arguments = sys.argv[1:]
    if verb == "links":
        asyncio.run(serve_links())
    else:
        {"host": host, "machine": machine, "truth": truth}[verb](*arguments)
