"""Strangers at a server's door, with zenoh alone and all that it allows: keys of every kind at samples, questions, tokens and
subscriptions, questions that bring megabytes, tokens of owners that are none. The server goes on, counts it and stays small.

    python tests/door_test.py build/crumple CAR        DOOR_SEED=7: other keys
"""

import importlib
import json
import os
import pathlib
import queue
import random
import re
import subprocess
import sys
import unittest

import zenoh

PATIENCE = 60.0  # s for what must come
PROGRAM, CAR = (str(pathlib.Path(each).resolve()) for each in sys.argv[1:3])
SEED = int(os.environ.get("DOOR_SEED", "1"))
ROOT = "crumple/1/main/"


def health_of(sample):
    return importlib.import_module("crumple.schema.Health").Health.GetRootAs(bytes(sample.payload))


class Door(unittest.TestCase):
    def setUp(self):
        command = [PROGRAM, "serve", "--car", CAR, "--listen", "tcp/127.0.0.1:0", "--threads", "1"]
        environment = {**os.environ, "ASAN_OPTIONS": "quarantine_size_mb=16"}  # what is freed is not to count as kept
        self.server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
        self.addCleanup(self.server.kill)
        self.endpoint = re.search(r"tcp/[0-9.:]+", self.server.stdout.readline()).group()
        self.healths = queue.Queue()
        self.watcher = self.open()
        # what strangers put there is shorter
        self.watcher.declare_subscriber(ROOT + "health", lambda it: len(it.payload) > 99 and self.healths.put(health_of(it)))
        self.health()

    def open(self):
        config = zenoh.Config()
        for key, value in {
            "mode": "client",
            "connect/endpoints": [self.endpoint],
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
        }.items():
            config.insert_json5(key, json.dumps(value))
        session = zenoh.open(config)
        self.addCleanup(session.close)
        return session

    def health(self):
        """One that the server tells from now on: as its counts, by name."""
        while not self.healths.empty():
            self.healths.get()
        try:
            told = self.healths.get(timeout=PATIENCE)
        except queue.Empty:
            self.fail("the server fell silent; it said: " + self.end(kill=True))
        return {told.Counts(i).Name().decode(): told.Counts(i).Value() for i in range(told.CountsLength())}

    def memory(self):
        status = pathlib.Path(f"/proc/{self.server.pid}/status").read_text()
        return int(re.search(r"VmRSS:\s+(\d+) kB", status).group(1)) / 1024  # MiB

    def end(self, kill=False):
        self.server.kill() if kill else self.server.terminate()
        return self.server.communicate(timeout=PATIENCE)[1]

    def tearDown(self):
        said = self.end()
        self.assertEqual(self.server.returncode, 0, said)

    def ask(self, session, key, payload=b"x"):
        """What a question comes to: a list of sentences of refusals, and the number of answers."""
        refused, answered = [], 0
        for reply in session.get(key, payload=payload, timeout=PATIENCE):
            if reply.ok is None:
                refused.append(bytes(reply.err.payload).decode(errors="replace"))
            else:
                answered += 1
        return refused, answered

    def keys(self, draw):
        """Key expressions that zenoh takes: what an attack used, and others put together of parts at random."""
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
            stranger.put(key, b"x")
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

    def test_questions_that_bring_megabytes_are_refused_and_not_kept(self):
        stranger = self.open()
        before = self.memory()
        megabytes = bytes(50 << 20)
        for key in ["crumple/1/*/car/x/key/0", ROOT + "car/x/key/0", ROOT + "inputs", ROOT + "replica/world", ROOT + "asset",
                    ROOT + "car/x", "crumple/1/asset/0123456789abcdef", "crumple/1/asset/*"]:
            refused, answered = self.ask(stranger, key, megabytes)
            self.assertEqual(answered, 0)
            self.assertIn("52428800 bytes", " ".join(refused), key)
        self.assertEqual(self.health()["oversized"], 8)
        self.assertLess(self.memory(), before + 300, "MiB: of 400 that came")

    def test_samples_that_are_too_long_are_counted_and_not_looked_at(self):
        stranger = self.open()
        for what in ["poses", "obstacles"]:
            stranger.put(ROOT + "host/x/" + what, bytes((1 << 20) + 1))
        while self.health()["oversized"] < 2:
            pass
        self.assertEqual(self.health()["hosts"], 0)

    def test_a_key_of_many_parts_is_forgotten_again(self):
        """zenoh knows each part of a key by one of its own, and drops them one within the other."""
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
            stranger.put(ROOT + f"host/h{number}/poses", b"x")
        while (after := self.health())["received"] < before["received"] + 4_000 - after["received_dropped"]:
            pass
        taken = after["messages"] - before["messages"]
        self.assertGreater(after["keys_refused"], 0)
        self.assertLessEqual(taken + after["keys_refused"] + after["received_dropped"], 4_000)
        self.assertEqual(after["hosts"], 0)

    def test_a_server_that_listens_alone_heeds_no_owner(self):
        stranger = self.open()
        tokens = [stranger.liveliness().declare_token(ROOT + token)
                  for token in ["owner/2-x", "owner/18446744073709551615-x", "owner/1000000000-x", "owner/x", "**"]]
        self.health()
        self.assertTrue(self.ask(stranger, ROOT + "inputs", b"")[1], "it answers")
        self.health()
        for token in tokens:
            token.undeclare()


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
