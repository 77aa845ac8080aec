"""Strangers attack a server with everything that Zenoh alone allows: keys of every kind at samples, questions, tokens and
subscriptions, questions that bring megabytes, tokens of owners that are none. And with frames made by hand (raw_zenoh.py). The
server goes on, counts it, stays small and is deaf to nobody.

    python tests/service/door_test.py build/crumple CAR        DOOR_SEED=7: other keys
"""

import contextlib
import importlib
import json
import os
import pathlib
import queue
import random
import re
import resource
import subprocess
import sys
import tempfile
import threading
import time
import unittest

import raw_zenoh as raw
import zenoh

PATIENCE = 60.0  # s for messages that must arrive
PROGRAM, CAR = (str(pathlib.Path(each).resolve()) for each in sys.argv[1:3])
DEAF = 15.0  # s: no answer may take longer on any machine; it once took more than 20 s
SANITIZED = b"__asan_init" in pathlib.Path(sys.argv[1]).read_bytes()  # the sanitizer needs more memory
SEED = int(os.environ.get("DOOR_SEED", "1"))
ROOT = "crumple/1/main/"


def put(session, key, payload):
    """Puts a message and waits, because otherwise Zenoh drops messages that are faster than the link."""
    session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)


def health_of(sample):
    return importlib.import_module("crumple.schema.Health").Health.GetRootAs(bytes(sample.payload))


class WithServer(unittest.TestCase):
    def start(self, *command):
        """Returns the process, and the endpoint that it prints."""
        environment = {**os.environ, "ASAN_OPTIONS": "quarantine_size_mb=16"}  # freed memory must not count as kept
        process = subprocess.Popen([PROGRAM, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
        self.addCleanup(process.kill)
        return process, re.search(r"tcp/[0-9.:]+", process.stdout.readline()).group()

    def start_server(self, *ends):
        self.server, self.endpoint = self.start("serve", "--car", CAR, "--threads", "1", *ends)
        self.attacked = self.server

    def setUp(self):
        self.start_server("--listen", "tcp/127.0.0.1:0")
        self.begin()

    def begin(self):
        self.healths = queue.Queue()
        self.watcher = self.open()
        # values from strangers are shorter
        self.watcher.declare_subscriber(ROOT + "health", lambda it: len(it.payload) > 99 and self.healths.put(health_of(it)))
        self.health()

    def open(self, **more):
        config = zenoh.Config()
        for key, value in {
            "mode": "client",
            "connect/endpoints": [self.endpoint],
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            **more,
        }.items():
            config.insert_json5(key, json.dumps(value))
        session = zenoh.open(config)
        self.addCleanup(session.close)
        return session

    def health(self):
        """Returns the next health that the server sends: its counts by name."""
        while not self.healths.empty():
            self.healths.get()
        try:
            told = self.healths.get(timeout=PATIENCE)
        except queue.Empty:
            self.fail("the server fell silent; it said: " + self.end(kill=True))
        return {told.Counts(i).Name().decode(): told.Counts(i).Value() for i in range(told.CountsLength())}

    def memory(self):
        status = pathlib.Path(f"/proc/{self.attacked.pid}/status").read_text()
        return int(re.search(r"VmRSS:\s+(\d+) kB", status).group(1)) / 1024  # MiB

    def end(self, kill=False):
        self.server.kill() if kill else self.server.terminate()
        return self.server.communicate(timeout=PATIENCE)[1]

    def tearDown(self):
        said = self.end()
        self.assertEqual(self.server.returncode, 0, said)

    def ask(self, session, key, payload=b"x"):
        """Sends a query. Returns a list of the sentences of refusals, and the number of answers."""
        refused, answered = [], 0
        for reply in session.get(key, payload=payload, timeout=PATIENCE):
            if reply.ok is None:
                refused.append(bytes(reply.err.payload).decode(errors="replace"))
            else:
                answered += 1
        return refused, answered


class Door(WithServer):
    def keys(self, draw):
        """Returns key expressions that Zenoh accepts: those of an earlier attack, and random combinations of parts."""
        x = "x" * 60_000
        all_keys = ["**", "*", "crumple/**", "crumple/*/main/**", "crumple/1/**", "crumple/1/*/owner/**", "@/**", "@a/b"]
        for below in """** * car/** car/* car/$* car/a$*b/key/0 car/*/key/0 car/x/key/* car/x/key/9 car/x/delta/0 car/x/answer car/@x
                host/*/poses host/**/obstacles host/$*/poses host/x/reactions host/x host/@x/poses host/x/y/poses owner/* owner/2-x
                owner/18446744073709551615-x owner/18446744073709551616-x owner/-1-x owner/ owner/2- standby/* standby/0-0 standby/9-x
                server server/x health tick budget asset asset/* inputs inputs/* replica/* replica/** replica/world replica/inputs
                @x/car/y replica/inputs/x""".split():
            all_keys.append(ROOT + below)
        all_keys += [ROOT + "car/" + x, ROOT + "host/" + x + "/poses", ROOT + "owner/1-" + x, ROOT + "car/a\0b", ROOT + "host/a\0/poses",
                     ROOT + "car/x/key/0\0", ROOT + "car/é", ROOT + "car/" + "/".join("a" * 500), "crumple/1/asset/*", "crumple/1/asset/**",
                     "crumple/1/asset/" + x, "crumple/1/asset/0123456789ABCDEF"]
        parts = ["crumple", "1", "main", "car", "host", "key", "0", "poses", "obstacles", "*", "**", "$*", "a$*", "@v", "é", "x", "owner", "2-x",
                 "asset", "replica", "inputs", "world", "\0", "?", "#", "x" * 300]
        for _ in range(150):
            middle = "/".join(draw.choice(parts) for _ in range(draw.randint(1, 5)))
            all_keys.append(draw.choice(["", ROOT, ROOT, ROOT + "car/", ROOT + "host/"]) + middle)
        for key in all_keys:
            try:
                yield zenoh.KeyExpr.autocanonize(key)
            except zenoh.ZError:
                continue

    def test_no_key_that_zenoh_allows_ends_the_server(self):
        print(f"DOOR_SEED={SEED}")
        stranger, tokens, tried = self.open(), [], 0
        before = self.health()
        for key in self.keys(random.Random(SEED)):
            tried += 1
            put(stranger, key, b"x")
            stranger.delete(key)
            subscriber = stranger.declare_subscriber(key, lambda sample: None)
            tokens.append(stranger.liveliness().declare_token(key))
            refused, _ = self.ask(stranger, key)
            self.assertNotIn("Timeout", " ".join(refused), f"nobody answers {key!s:.100}")
            if len(tokens) > 20:
                tokens.pop(0).undeclare()
            subscriber.undeclare()
        self.assertGreater(tried, 150)
        after = self.health()
        self.assertGreater(after["keys_refused"], 50)
        self.assertGreater(after["received_dropped"], 0, "keys that are too long or hold a zero")
        self.assertEqual((after["cars"], after["hosts"], after["obstacles"]), (0, 0, 0))
        self.assertEqual(before["cars"], 0)

    def test_a_server_without_descriptors_for_its_first_session_lives_on(self):
        """Zenoh begins its sending threads with the first session, which takes descriptors; without them it panicked."""
        server, endpoint = self.start("serve", "--car", CAR, "--threads", "1", "--listen", "tcp/127.0.0.1:0")
        _, most = resource.prlimit(server.pid, resource.RLIMIT_NOFILE)
        resource.prlimit(server.pid, resource.RLIMIT_NOFILE, (len(os.listdir(f"/proc/{server.pid}/fd")) + 1, most))
        with contextlib.suppress(zenoh.ZError):
            self.open(**{"connect/endpoints": [endpoint], "connect/timeout_ms": 2_000})
        resource.prlimit(server.pid, resource.RLIMIT_NOFILE, (min(1024, most), most))
        server.terminate()
        self.assertEqual(server.wait(PATIENCE), 0)

    def test_questions_that_bring_megabytes_are_refused_and_not_kept(self):
        stranger = self.open()
        before = self.memory()
        megabytes = bytes(50 << 20)
        for key in ["crumple/1/*/car/x/key/0", ROOT + "car/x/key/0", ROOT + "inputs", ROOT + "replica/world", ROOT + "asset",
                    ROOT + "car/x", "crumple/1/asset/0123456789abcdef", "crumple/1/asset/*"]:
            refused, answered = self.ask(stranger, key, megabytes)
            self.assertEqual(answered, 0)
            self.assertIn("52428800 bytes", " ".join(refused), key)
        while (refused := self.health()["oversized"]) < 8:  # a health that was under way does not know the last one yet
            pass
        self.assertEqual(refused, 8)
        self.assertLess(self.memory(), before + 300, "MiB: of 400 that came")

    def test_samples_that_are_too_long_are_counted_and_not_looked_at(self):
        stranger = self.open()
        for what in ["poses", "obstacles"]:
            put(stranger, ROOT + "host/x/" + what, bytes((1 << 20) + 1))
        while self.health()["oversized"] < 2:
            pass
        self.assertEqual(self.health()["hosts"], 0)

    def test_a_key_of_many_parts_is_forgotten_again(self):
        """Makes long keys: Zenoh keeps an object for each part of a key, and destroys them recursively."""
        deep = ROOT + "/".join("x" * 12_000)
        session = self.open()
        session.declare_subscriber(deep, lambda sample: None)
        session.liveliness().declare_token(deep)
        self.assertTrue(self.ask(session, ROOT + "inputs", b"")[1], "it was heard")
        session.close()
        self.health()
        self.health()

    def test_invented_hosts_take_a_part_of_a_second_at_most(self):
        stranger = self.open()
        before = self.health()
        for number in range(4_000):
            put(stranger, ROOT + f"host/h{number}/poses", b"x")
        while (after := self.health())["received"] < before["received"] + 4_000 - after["received_dropped"]:
            pass
        taken = after["messages"] - before["messages"]
        self.assertGreater(after["keys_refused"], 0)
        self.assertLessEqual(taken + after["keys_refused"] + after["received_dropped"], 4_000)
        self.assertEqual(after["hosts"], 0)

    def test_no_stranger_chooses_who_waits_for_it(self):
        """A receiving thread would wait to pass on a sample that must not be dropped."""
        stranger, other, seen = self.open(), self.open(), queue.Queue()
        other.declare_subscriber("x/y", seen.put)
        self.ask(other, ROOT + "inputs", b"")
        put(stranger, "x/y", b"z")
        self.assertEqual(seen.get(timeout=PATIENCE).congestion_control, zenoh.CongestionControl.DROP)

    def test_a_server_that_listens_alone_heeds_no_owner(self):
        stranger = self.open()
        tokens = [stranger.liveliness().declare_token(ROOT + token)
                  for token in ["owner/2-x", "owner/18446744073709551615-x", "owner/1000000000-x", "owner/x", "**"]]
        self.health()
        self.assertTrue(self.ask(stranger, ROOT + "inputs", b"")[1], "it answers")
        self.health()
        for token in tokens:
            token.undeclare()


class Asker(threading.Thread):
    """Sends the server one query after the other in its own session, and measures the longest time without an answer."""

    def __init__(self, endpoint):
        super().__init__(daemon=True)
        self.session, self.longest, self.answered, self.going = raw.Raw(endpoint), 0.0, 0, True
        self.start()

    def run(self):
        while self.going:
            asked = time.monotonic()
            number = self.answered % 100
            self.session.frames(raw.request(number, ROOT + "inputs"))
            self.session.wait_for_end(number)
            self.longest = max(self.longest, time.monotonic() - asked)
            self.answered += 1
            time.sleep(0.01)

    def end(self):
        self.going = False
        self.join(PATIENCE)
        return self.longest


class Frames(WithServer):
    """Sends hand-made frames that Zenoh's own sessions never send."""

    def setUp(self):
        super().setUp()
        self.asker = Asker(self.endpoint)

    def stranger(self, **options):
        session = raw.Raw(self.endpoint, **options)
        self.addCleanup(session.close)
        return session

    def refused_since(self, before, least):
        while (refused := self.health()["frames_refused"] - before) < least:
            pass
        return refused

    def nobody_was_deaf(self):
        self.health()
        count = self.asker.answered
        deadline = time.monotonic() + PATIENCE
        while self.asker.answered < count + 10:
            self.assertLess(time.monotonic(), deadline, "the server answers nothing any more")
            time.sleep(0.01)
        self.assertLess(self.asker.end(), DEAF, "s without an answer")

    def test_no_key_made_by_hand_ends_the_server(self):
        bad = [b"*x", b"crumple/1/main/*x", b"a//b", b"crumple/1/main/car/x#y", b"", b"/", b"a/", b"**/**/$*$*", b"$*$*", b"a?b",
               b"x" * 300, b"x" * 40_000, b"a" + b"/a" * 40, b"a/" * 15_000 + b"a", b"**/" * 20 + b"a"]
        self.stranger().frames(raw.push(b"\xff\xfe"))  # this is no text: the session ends
        sent = 0
        for key in bad:
            for scope in (0, 7, 99):  # key 7 is declared, key 99 is not
                stranger = self.stranger()
                stranger.frames(raw.declare(raw.KEY, 7, "crumple/1/main/car"))
                stranger.frames(raw.push(key, scope=scope), raw.response(3, key, scope=scope))
                for id, kind in enumerate((raw.KEY, raw.SUBSCRIBER, raw.QUERYABLE, raw.TOKEN)):
                    stranger.frames(raw.declare(kind, 20 + id, key, scope=scope))
                for mode in (1, 2, 3):
                    stranger.frames(raw.interest(30 + mode, key, scope=scope, mode=mode))
                stranger.frames(raw.request(5, key, scope=scope))
                stranger.wait_for_end(5)  # the asker gets the end of the answers
                sent += 8 if key else 0  # a declared key without a suffix
        self.nobody_was_deaf()
        self.refused_since(0, sent)

    def test_a_session_that_declared_much_and_leaves_is_noticed_by_nobody(self):
        before = self.memory()
        car = "crumple/1/main/car/"
        for several in (["crumple/1/main/**/$*a{}/**"], [car + "a{}/key/0", car + "$*{}/**"], ["{}/x" + "/y" * 13]):
            for kind in (raw.SUBSCRIBER, raw.QUERYABLE, raw.TOKEN, raw.KEY):
                stranger = self.stranger()
                for id in range(4_000):
                    stranger.frames(*(raw.declare(kind, 10_000 * n + id + 1, key.format(id)) for n, key in enumerate(several)))
                stranger.frames(raw.request(5, ROOT + "inputs"))
                stranger.wait_for_end(5)  # everything has arrived
                stranger.close()
        self.nobody_was_deaf()
        self.assertLess(self.memory(), before + 200, "MiB")
        self.refused_since(0, 1_000)  # wildcards beyond 256

    def test_what_nobody_holds_any_more_is_forgotten(self):
        """Declares interest in many keys, because Zenoh once kept each of them."""
        for turn in range(3):
            stranger = self.stranger()
            for id in range(2_500):  # 105,000 parts of keys in all
                stranger.frames(raw.interest(id + 1, f"a{turn}/{id}" + "/x" * 12, mode=1 + id % 3, what=raw.TOKENS))
            stranger.frames(raw.request(5, ROOT + "inputs"))
            stranger.wait_for_end(5)
            stranger.close()
        stranger = self.stranger()
        stranger.frames(raw.declare(raw.QUERYABLE, 1, "new/key"))
        asker = self.open()
        stranger.frames(raw.request(6, ROOT + "inputs"))
        stranger.wait_for_end(6)
        asked = asker.get("new/key", timeout=PATIENCE)
        stranger.wait_for(b"new/key")  # the server accepted the declaration, so it sends the query
        stranger.close()
        list(asked)
        self.nobody_was_deaf()

    def test_unfinished_messages_of_many_sessions_take_a_bounded_memory(self):
        before, strangers = self.memory(), []
        for size, count in ((40_000, 600), (1, 40_000)):
            for _ in range(12):
                strangers.append(self.stranger())
                piece = bytes(size)
                for _ in range(count // 100):
                    strangers[-1].fragments(*[piece] * 100)
                strangers[-1].frames(raw.request(5, ROOT + "inputs"))
                strangers[-1].wait_for_end(5)  # everything has arrived
                for each in strangers:
                    each.send(bytes([raw.KEEP_ALIVE]))
        most = before + (800 if SANITIZED else 400)
        self.assertLess(self.memory(), most, "MiB: of 256 that may wait, and what else is there")
        oversized = self.health()["oversized"]
        put(self.watcher, ROOT + "host/x/poses", bytes((1 << 20) + 1))  # also in pieces
        while self.health()["oversized"] == oversized:
            pass
        self.nobody_was_deaf()

    def test_what_one_stranger_asks_another_who_never_answers_is_bounded(self):
        """Zenoh keeps each query until its timeout, which is 10 s or what the asker sets."""
        silent, asker = self.stranger(), self.stranger()
        silent.frames(raw.declare(raw.QUERYABLE, 1, "crumple/silent"), raw.request(5, ROOT + "inputs"))
        silent.wait_for_end(5)
        asked = time.monotonic()
        asker.frames(*(raw.request(id, "crumple/silent") for id in range(1, 5_001)))
        asker.wait_for_end(5_000)
        self.assertLess(time.monotonic() - asked, 8.0, "s until a question that has no room ends")
        silent.wait_for(b"crumple/silent")
        self.nobody_was_deaf()

    def test_half_handshakes_keep_nobody_out(self):
        for _ in range(400):
            with contextlib.suppress(OSError):  # the server may refuse it
                self.stranger(opened=False)
        opened = time.monotonic()
        self.stranger()
        self.assertLess(time.monotonic() - opened, DEAF, "s until a newcomer is in")
        self.nobody_was_deaf()

    def test_a_session_that_falls_silent_goes_whatever_lease_it_asked_for(self):
        stranger, began = self.stranger(lease=1_000_000), time.monotonic()
        with self.assertRaises((ConnectionError, TimeoutError)):
            while True:
                stranger.receive()
        self.assertLess(time.monotonic() - began, 30.0, "s")

    def test_frames_of_every_shape_change_nothing(self):
        draw, before, began = random.Random(SEED), self.memory(), time.monotonic()
        print(f"DOOR_SEED={SEED}")
        good = [raw.push(ROOT + "car/x"), raw.push(ROOT + "host/q/poses", b"abc"), raw.request(5, ROOT + "inputs"),
                raw.response(5, ROOT + "inputs"), raw.interest(9, ROOT + "**"), raw.interest(9, "**", mode=1),
                bytes([raw.INTEREST, 9]), bytes([raw.RESPONSE_FINAL, 5]), b"\x1f\x01", bytes([raw.DECLARE, raw.FINAL]),
                bytes([raw.DECLARE | 0x20, 0, raw.FINAL])]
        for kind in (raw.KEY, raw.SUBSCRIBER, raw.QUERYABLE, raw.TOKEN):
            good += [raw.declare(kind, 1, ROOT + "car/*/key/0"), raw.declare(kind, 2, "a/b"),
                     raw.declare(kind, 3, "/b", scope=2), bytes([raw.DECLARE, kind | 1, 1])]
        sessions = sent = 0
        while time.monotonic() < began + 8.0:
            try:
                stranger = raw.Raw(self.endpoint, kind=draw.choice([raw.CLIENT, raw.CLIENT, raw.PEER, raw.ROUTER]))
                for _ in range(draw.randint(1, 12)):
                    body = bytearray(b"".join(draw.choice(good) for _ in range(draw.randint(1, 4))))
                    for _ in range(draw.randint(0, 3)):
                        at = draw.randrange(len(body))
                        body[at] = draw.choice([draw.randrange(256), 255, 0, 127, body[at] ^ 1 << draw.randrange(8)])
                    sent += 1
                    if (shape := draw.random()) < 0.8:
                        stranger.frames(bytes(body))
                    elif shape < 0.9:
                        stranger.send(bytes([raw.FRAGMENT | draw.randrange(8) << 5]) + stranger.number() + bytes(body))
                    else:
                        stranger.send(draw.randbytes(draw.randint(1, 40)))
                stranger.close()
            except OSError:
                pass  # the server has closed it
            sessions += 1
        self.nobody_was_deaf()
        self.assertGreater(sessions, 50)
        most = before + (400 if SANITIZED else 100)
        self.assertLess(self.memory(), most, f"MiB after {sent} frames of {sessions} sessions")


class Users(WithServer):
    """One user must not take what all have together."""

    def setUp(self):
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        (folder / "users").write_text("game:a\nplayer:b\n")
        (folder / "network.json5").write_text(f"{{transport: {{auth: {{usrpwd: {{dictionary_file: '{folder}/users'}}}}}}}}")
        self.start_server("--listen", "tcp/127.0.0.1:0", "--network", folder / "network.json5")
        self.begin()

    def open(self, user="game", password="a"):
        return super().open(**{"transport/auth/usrpwd/user": user, "transport/auth/usrpwd/password": password})

    def test_a_user_who_declares_keys_without_end_leaves_keys_to_others(self):
        """Zenoh keeps 65,536 parts of keys."""
        player = self.open("player", "b")
        keys = [player.declare_subscriber(f"a{number}/" + "x/" * 13 + "y", lambda sample: None) for number in range(4_700)]
        self.assertTrue(self.ask(player, ROOT + "inputs", b"")[1], "it was heard")
        arrived = queue.Queue()
        newcomer, other = self.open(), self.open()
        newcomer.declare_subscriber("a/key/that/nobody/knows", lambda sample: arrived.put(bytes(sample.payload)))
        self.ask(newcomer, ROOT + "inputs", b"")
        put(other, "a/key/that/nobody/knows", b"hello")
        self.assertEqual(arrived.get(timeout=PATIENCE), b"hello")
        self.assertGreater(self.health()["frames_refused"], 1_000)
        self.assertEqual(len(keys), 4_700)
        player.close()
        self.health()
        player, refused = self.open("player", "b"), self.health()["frames_refused"]
        again = [player.declare_subscriber(f"b{number}/" + "x/" * 13 + "y", lambda sample: None) for number in range(300)]
        self.assertTrue(self.ask(player, ROOT + "inputs", b"")[1], "it was heard")
        self.health()
        self.assertEqual(self.health()["frames_refused"], refused, "what a user's session held is free when it has left")
        self.assertEqual(len(again), 300)


class Router(WithServer):
    """Sends some of these frames to `crumple router`, which has the limits of a server."""

    stranger, nobody_was_deaf = Frames.stranger, Frames.nobody_was_deaf
    test_no_key_made_by_hand_ends_it = Frames.test_no_key_made_by_hand_ends_the_server
    test_a_session_that_declared_much_and_leaves_is_noticed_by_nobody = Frames.test_a_session_that_declared_much_and_leaves_is_noticed_by_nobody
    test_what_one_stranger_asks_another_who_never_answers_is_bounded = Frames.test_what_one_stranger_asks_another_who_never_answers_is_bounded

    def setUp(self):
        router, endpoint = self.start("router", "--listen", "tcp/127.0.0.1:0")
        self.start_server("--connect", endpoint)
        self.attacked = router
        self.begin()
        self.asker = Asker(self.endpoint)

    def refused_since(self, before, least):
        """The router tells nobody what it refused."""

    def tearDown(self):
        super().tearDown()
        self.attacked.terminate()
        said = self.attacked.communicate(timeout=PATIENCE)[1]
        self.assertEqual(self.attacked.returncode, 0, said)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
