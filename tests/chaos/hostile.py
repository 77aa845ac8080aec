"""TABLE lists all hostile messages. Each row runs in a separate process, which `run` kills after a few seconds.

    hostile.py ENDPOINT NETWORK CAR HOST:PORT HOST:PORT SEED NAME     sends the row NAME; the addresses: metrics and gateway
    hostile.py --list                                                 prints the name of every row

On an open server every program may do everything. On a server with TLS and users, a user with the rights of a player sends these
messages. No row commands a car of a host or uses a host's id, because a user with all rights may do that, and no server can tell
the difference.
"""

import dataclasses
import os
import random
import re
import signal
import socket
import sys
import time
from collections.abc import Callable

SCENE = "main"
ROOT = f"crumple/1/{SCENE}/"
MB = 1_000_000
HOLD = 2.0  # s for which a declaration or a socket stays open


@dataclasses.dataclass(frozen=True)
class Row:
    name: str
    send: Callable  # takes an Enemy
    usurps: bool = False  # declares itself the owner: on an open server everybody may, and hosts wait for its end
    tls: bool = False  # only for servers with TLS


class Enemy:
    def __init__(self, endpoint, network, car, metrics, gateway, seed):
        self.endpoint, self.network, self.car, self.metrics, self.gateway = endpoint, network, car, metrics, gateway
        self.random = random.Random(seed)
        self.held = []
        self._session = None

    @property
    def session(self):
        if self._session is None:
            import zenoh
            from roles import configured

            self._session = zenoh.open(configured(self.endpoint, self.network))
        return self._session

    def noise(self, size):
        return self.random.randbytes(int(size))

    def put(self, key, payload=b"x", times=1):
        for _ in range(times):
            self.session.put(key, payload)

    def get(self, key, payload=b"", times=1):
        for _ in range(times):
            self.held.append(self.session.get(key, payload=payload, timeout=HOLD))

    def token(self, *keys):
        self.held += [self.session.liveliness().declare_token(key) for key in keys]
        time.sleep(HOLD)

    def subscribe(self, key):
        self.held.append(self.session.declare_subscriber(key, lambda sample: None))

    def answer(self, key, payload):
        def reply(query):
            query.reply(query.key_expr, payload)

        self.held.append(self.session.declare_queryable(key, reply))

    def heard(self, seconds=0.7):
        """Real messages, by key."""
        taken = {}
        subscriber = self.session.declare_subscriber(ROOT + "**", lambda s: taken.setdefault(str(s.key_expr), bytes(s.payload)))
        time.sleep(seconds)
        subscriber.undeclare()
        return taken

    def connect(self, address, request=b""):
        """Opens a socket and keeps it open."""
        it = socket.create_connection(address, 2)
        it.settimeout(0.2)
        try:
            it.sendall(request)
        except OSError:
            pass  # already closed
        self.held.append(it)
        return it

    @property
    def port(self):
        host, port = re.search(r"/([^:/]+):(\d+)", self.endpoint).groups()
        return host, int(port)


def keyed(verb):
    """Uses one verb with every form of key that Zenoh accepts."""

    def send(enemy):
        for key in SHAPES:
            try:
                getattr(enemy, verb)(key, b"x") if verb in ("put", "get", "answer") else getattr(enemy, verb)(key)
            except Exception as error:
                print(f"{key[:60]!r}: {error}", flush=True)  # Zenoh refuses this key
        time.sleep(HOLD)

    return send


def tokens(enemy):
    for key in SHAPES:
        try:
            enemy.held.append(enemy.session.liveliness().declare_token(key))
        except Exception as error:
            print(f"{key[:60]!r}: {error}", flush=True)
    time.sleep(HOLD)


def declares(enemy):
    """Declares only keys, for which Zenoh checks no rights."""
    for key in SHAPES:
        try:
            enemy.held.append(enemy.session.declare_keyexpr(key))
        except Exception as error:
            print(f"{key[:60]!r}: {error}", flush=True)
    time.sleep(HOLD)


def many_keys(enemy):
    for number in range(20_000):
        enemy.held.append(enemy.session.declare_keyexpr(f"{ROOT}car/evil/{number}"))
    time.sleep(HOLD)


def deletes(enemy):
    for key in SHAPES:
        try:
            enemy.session.delete(key)
        except Exception as error:
            print(f"{key[:60]!r}: {error}", flush=True)
    time.sleep(0.5)


def packed(name, **fields):
    from importlib import import_module

    import flatbuffers

    thing = getattr(import_module(f"crumple.schema.{name}"), name + "T")()
    for field, value in fields.items():
        setattr(thing, field, value)
    builder = flatbuffers.Builder()
    builder.Finish(thing.Pack(builder))
    return bytes(builder.Output())


def spawn(asset, host="evil"):
    from crumple.schema.Order import Order
    from crumple.schema.Pose import PoseT
    from crumple.schema.Quat import QuatT
    from crumple.schema.Spawn import SpawnT
    from crumple.schema.Vec3d import Vec3dT

    at, turn, order = Vec3dT(), QuatT(), SpawnT()
    at.x, at.y, at.z, turn.w = -500.0, 0.0, 0.0, 1.0
    order.pose = PoseT()
    order.pose.position, order.pose.orientation, order.asset, order.host = at, turn, asset, host
    return packed("Command", orderType=Order.Spawn, order=order)


def despawn():
    from crumple.schema.Despawn import DespawnT
    from crumple.schema.Order import Order

    return packed("Command", orderType=Order.Despawn, order=DespawnT())


def asset_of(enemy):
    from crumple.schema.Keyframe import Keyframe

    for reply in enemy.session.get(ROOT + f"car/{enemy.car}/key/0", timeout=2.0):
        if reply.ok is not None:
            return Keyframe.GetRootAs(bytes(reply.ok.payload)).Asset().decode()
    raise SystemExit("no car to take the asset from")


def come_and_go(enemy):
    """Spawns and despawns cars with ids that occur only once."""
    come, go = spawn(asset_of(enemy)), despawn()
    end = time.monotonic() + 3
    number = 0
    while time.monotonic() < end:
        keys = [f"{ROOT}car/evil-{enemy.random.getrandbits(40):x}" for _ in range(200)]
        for order in (come, go):
            for replies in [enemy.session.get(key, payload=order, timeout=2.0) for key in keys]:
                number += sum(1 for _ in replies)
    print(f"{number} answers", flush=True)


def many_hosts(enemy):
    for number in range(3000):
        enemy.put(f"{ROOT}host/evil-{number}/obstacles", packed("Obstacles", sequence=1, obstacles=[]))
        enemy.put(f"{ROOT}host/evil-{number}/poses", packed("Poses", sequence=1, time=0.0, cars=[]))


def many_questions(enemy):
    for key in (f"car/{enemy.car}/key/0", "inputs", "replica/world", "car/evil", "asset"):
        enemy.get(ROOT + key, b"", 1500)
    time.sleep(1)


def every_queryable(enemy):
    for key in ("asset", "car/evil", f"car/{enemy.car}/key/0", "replica/world", "inputs"):
        enemy.get(ROOT + key, bytes(60 * MB))
        time.sleep(0.2)
    enemy.get("crumple/1/asset/0", bytes(60 * MB))
    time.sleep(1)


def own(key):
    """Returns the key for a forged copy of a message; its host or car does not exist."""
    key = re.sub(r"/host/[^/]+/", "/host/evil/", key)
    return re.sub(r"/car/[^/]+/", "/car/evil/", key)


def forged(enemy, real):
    data = bytearray(real)
    kind = enemy.random.randrange(4)
    if kind == 0:
        return bytes(data[: enemy.random.randrange(len(data))])
    if kind == 1:
        return bytes(data) + enemy.noise(100)
    for _ in range(enemy.random.choice((1, 8, 64))):
        data[enemy.random.randrange(len(data))] = enemy.random.choice((0, 1, 0x7F, 0x80, 0xFF, enemy.random.randrange(256)))
    return bytes(data)


def forge_samples(enemy):
    real = enemy.heard()
    end = time.monotonic() + 2
    while real and time.monotonic() < end:
        key = enemy.random.choice(sorted(real))
        enemy.put(own(key), forged(enemy, real[key]))
        time.sleep(0.001)


def forge_orders(enemy):
    come = spawn(asset_of(enemy))
    for _ in range(1000):
        enemy.get(f"{ROOT}car/evil-{enemy.random.randrange(9)}", forged(enemy, enemy.random.choice((come, despawn()))))
    for key in ("asset", "inputs", "replica/world", f"car/{enemy.car}/key/0"):
        enemy.get(ROOT + key, forged(enemy, come), 20)
    time.sleep(1)
    for number in range(9):
        enemy.get(f"{ROOT}car/evil-{number}", despawn())
    time.sleep(0.5)


def forge_cut(enemy):
    """Sends truncated real messages and noise under real keys: every receiver must refuse them."""
    for key, real in enemy.heard().items():
        if "/poses" in key or "/obstacles" in key:
            continue
        for _ in range(20):
            enemy.put(key, real[: enemy.random.randrange(len(real))])
            enemy.put(key, enemy.noise(enemy.random.choice((0, 1, 4, 100, 10_000))))
    time.sleep(0.3)


def forge_inputs(enemy):
    for tick in (0, 1, 2**32, 2**63, 2**64 - 1):
        enemy.put(ROOT + "replica/inputs", packed("Inputs", tick=tick, inputs=[], hash=1))
    time.sleep(0.5)


def noise(enemy):
    for key in ("host/evil/poses", "host/evil/obstacles", "host/evil/reactions", "health", "replica/inputs", "car/evil/key/0"):
        for size in (0, 1, 3, 4, 8, 64, 5000):
            enemy.put(ROOT + key, enemy.noise(size), 5)
    for key in ("car/evil", "car/evil/key/0", "car/evil/key/9", "asset", "inputs", "replica/world", "../asset/0"):
        for size in (0, 1, 8, 300, 70_000):
            enemy.get((ROOT + key).replace(f"{SCENE}/../", ""), enemy.noise(size), 5)
    time.sleep(0.5)


def answers(enemy):
    """Pretends to be a server: it answers the queries of viewers with noise or not at all."""
    for key, size in (("car/*/key/*", 300), ("../asset/*", 300_000), ("inputs", 100), ("replica/world", 5 * MB)):
        enemy.answer((ROOT + key).replace(f"{SCENE}/../", ""), enemy.noise(size))
    enemy.held.append(enemy.session.declare_queryable(ROOT + "car/*", lambda query: enemy.held.append(query)))
    time.sleep(HOLD)


def never_reads(key, asks=0):
    """Never reads. With `asks` it also requests answers, until more data waits than the system buffers for a socket."""

    def send(enemy):
        asset = asset_of(enemy) if asks else ""
        for _ in range(3):
            enemy.subscribe(key)
        time.sleep(0.3)
        enemy.get(f"crumple/1/asset/{asset}", bytes(8), asks)
        time.sleep(0.05)  # until they have left
        os.kill(os.getpid(), signal.SIGSTOP)

    return send


def half_open(enemy):
    """Opens sockets at Zenoh's port that send nothing, half a greeting, or noise."""
    for number in range(150):
        enemy.connect(enemy.port, (b"", b"\x00\x40", enemy.noise(50), b"\xff\xff" + enemy.noise(50))[number % 4])
    time.sleep(HOLD)


def wrong_password(enemy):
    import zenoh
    from roles import configured

    for _ in range(20):
        config = configured(enemy.endpoint, enemy.network)
        config.insert_json5("connect/timeout_ms", "200")
        try:
            zenoh.open(config).close()
            print("let in", flush=True)
        except zenoh.ZError:
            pass


def web(where, request, sockets=1, more=b"", times=0):
    """Opens sockets with this request and never reads the answers; then sends the request again as often as the server accepts it."""

    def send(enemy):
        for _ in range(sockets):
            it = enemy.connect(getattr(enemy, where), request)
            for _ in range(times):
                try:
                    it.sendall(more)
                except OSError:
                    break  # the server accepts no more
        time.sleep(HOLD)

    return send


SHAPES = [
    "**", "*", "crumple", "crumple/**", "crumple/*/*/**", "crumple/1/**", "crumple/1/*/**", ROOT + "**", ROOT + "*",
    ROOT[:-1], ROOT + "car/*", ROOT + "car/*/key/*", ROOT + "car/**/0", ROOT + "host/*/reactions", ROOT + "ho$*",
    ROOT + "$*e$*", ROOT + "@x", ROOT + "car/@v/key/0", "@/**", "@x/**", "crumple/1/@main/**", ROOT + "car/a b\n\t",
    ROOT + "car/\u0000/key/0", ROOT + "car/evil\u0000/delta/0", ROOT + "car/\U0001f697/key/0", ROOT + "car/" + "x" * 300,
    ROOT + "car/" + "x" * 60_000, ROOT + "car/evil/key/99999999999999999999",
    ROOT + "car/evil/key/-1", ROOT + "delta", ROOT + "key/0", ROOT + "host", ROOT + "replica/**", ROOT + "owner/**",
    "crumple/1/asset/*", "crumple/1/asset/" + "f" * 16, "crumple/1/asset/" + "f" * 5000, "crumple/2/**",
]
DEEP = ROOT + "/".join("x" * 30_000)  # the longest key that Zenoh accepts
HELLO = (b"GET /live HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
         b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n")
POST = b"POST /x HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 60000000\r\n\r\n"
METRICS = b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n"

TABLE = [
    Row("put on every key of the scene", lambda e: e.put(ROOT + "**", times=50)),
    Row("put on every key shape", keyed("put")),
    Row("delete on every key shape", deletes),
    Row("question on every key shape", keyed("get")),
    Row("subscription to every key shape", keyed("subscribe")),
    Row("queryable on every key shape", keyed("answer")),
    Row("put on a key 30,000 deep", lambda e: e.put(DEEP)),
    Row("question for a key 30,000 deep", lambda e: e.get(DEEP)),
    Row("subscription to a key 30,000 deep", lambda e: (e.subscribe(DEEP), time.sleep(HOLD))),
    Row("token on a key 30,000 deep", lambda e: e.token(DEEP)),
    Row("declaration of a key 30,000 deep", lambda e: (e.held.append(e.session.declare_keyexpr(DEEP)), time.sleep(HOLD))),
    Row("declaration of every key shape", declares),
    Row("declaration of 20,000 keys", many_keys),
    Row("token on every key shape", tokens, usurps=True),
    Row("token on everything", lambda e: e.token("**")),
    Row("token of a later owner", lambda e: e.token(ROOT + "owner/2-x"), usurps=True),
    Row("token of the last epoch", lambda e: e.token(ROOT + f"owner/{2**64 - 1}-x"), usurps=True),
    Row("tokens of no owner", lambda e: e.token(*(ROOT + "owner/" + x for x in ("-", "2", "x-2", "2-", "9" * 30 + "-x")))),
    Row("tokens of standbys", lambda e: e.token(*(ROOT + "standby/" + x for x in ("0-0", "x", "9-9")))),
    Row("tokens of thousands of cars", lambda e: e.token(*(f"{ROOT}car/evil{i}" for i in range(4000)))),
    Row("50 MB with a question for a keyframe", lambda e: (e.get(ROOT + "car/x/key/0", bytes(50 * MB), 3), time.sleep(1))),
    Row("50 MB for all keyframes", lambda e: (e.get("crumple/1/*/car/*/key/0", bytes(50 * MB), 2), time.sleep(1))),
    Row("60 MB with every question", every_queryable),
    Row("1,500 questions of each kind", many_questions),
    Row("3,000 questions for keyframes", lambda e: (e.get(ROOT + f"car/{e.car}/key/0", b"", 3000), time.sleep(1))),
    Row("cars that come and go", come_and_go),
    Row("3,000 hosts", many_hosts),
    Row("poses of 1.1 MB", lambda e: e.put(ROOT + "host/evil/poses", bytes(11 * MB // 10), 40)),
    Row("60 MB samples", lambda e: e.put(ROOT + "host/evil/obstacles", bytes(60 * MB), 3)),
    Row("forged inputs for standbys", forge_inputs),
    Row("noise under every key", noise),
    Row("forged samples", forge_samples),
    Row("forged orders", forge_orders),
    Row("messages cut off", forge_cut),
    Row("answers of a server that is none", answers),
    Row("a subscriber that never reads", never_reads(ROOT + "**")),
    Row("who asks for much and never reads", never_reads(ROOT + "car/*/delta/*", 300)),
    Row("a player that never reads", never_reads(ROOT + "car/*/delta/*")),
    Row("sockets that say nothing to zenoh", half_open),
    Row("wrong passwords", wrong_password, tls=True),
    Row("metrics: 300 half requests", web("metrics", b"GET /met", 300)),
    Row("metrics: a header of 8 MB", web("metrics", b"GET /metrics HTTP/1.1\r\nX: ", 1, b"x" * MB, 8)),
    Row("metrics: who asks and never reads", web("metrics", METRICS, 8, METRICS * 1000, 50)),
    Row("gateway: 300 half requests", web("gateway", b"GET / HT", 300)),
    Row("gateway: a header of 8 MB", web("gateway", b"GET / HTTP/1.1\r\nX: ", 1, b"x" * MB, 8)),
    Row("gateway: who asks and never reads", web("gateway", b"", 8, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 100, 50)),
    Row("gateway: 300 sockets", web("gateway", HELLO, 300)),
    Row("gateway: unfinished frames", web("gateway", HELLO + b"\x82\xff" + b"\x3f" + b"\xff" * 7 + b"mask", 30, b"x" * MB, 2)),
    Row("gateway: noise for frames", web("gateway", HELLO, 10, bytes(range(256)) * 400, 20)),
    Row("gateway: a POST of 60 MB", web("gateway", POST, 4, b"x" * MB, 60)),
]


def main(endpoint, network, car, metrics, gateway, seed, name):
    def address(text):
        host, port = text.rsplit(":", 1)
        return host, int(port)

    enemy = Enemy(endpoint, network, car, address(metrics), address(gateway), int(seed))
    next(row for row in TABLE if row.name == name).send(enemy)
    time.sleep(0.3)
    os._exit(0)  # Zenoh would wait until somebody reads the messages


if __name__ == "__main__":
    if sys.argv[1:] == ["--list"]:
        for row in TABLE:
            print(row.name)
    else:
        main(*sys.argv[1:])
