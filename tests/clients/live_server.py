"""Gives each test in Python its own server, and a crash. The test's command line: crumple, a baked car, the client library."""

import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

import crumple

ROOT = pathlib.Path(__file__).resolve().parents[2]
PATIENCE = 120.0  # s for messages that must arrive
PROGRAM, CAR, LIBRARY = (str(pathlib.Path(each).resolve()) for each in sys.argv[1:4])


class WithServer(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="crumple_test_")))
        self.recording = self.folder / "session.mcap"
        command = [PROGRAM, "serve", "--car", CAR, "--listen", "tcp/127.0.0.1:0", "--record", self.recording, "--threads", "1"]
        self.server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.addCleanup(self.stop)
        first = self.server.stdout.readline()
        self.assertTrue(first, "the server did not start; it says why above")
        self.endpoint = re.search(r"tcp/[0-9.:]+", first).group()

    def stop(self):
        if self.server.poll() is None:
            self.server.terminate()
            self.assertEqual(self.server.wait(PATIENCE), 0, "the server did not end cleanly")
        self.server.stdout.close()

    def crash(self, host):
        """Drives car1 at 15 m/s into a wall 0.7 m before its nose, until it has bounced off and gets no more reactions. Returns all
        reactions."""
        nose = float(host.mesh(self.asset).vertex[:, 0].max())
        self.wall = crumple.Obstacle(7, crumple.Shape.box, (1.0, 5.0, 5.0), crumple.Pose((nose + 1.7, 0.0, 0.0)), 0.25)
        host.publish_obstacles([self.wall])
        host.publish_poses(0.0, [crumple.CarPose("car1", crumple.Pose(), velocity=(15.0, 0.0, 0.0))])
        reactions = []

        def over():
            reactions.extend(host.reactions())
            touched = [each.tick for each in reactions if each.contacts]
            return touched and reactions[-1].tick >= touched[-1] + 15

        host.until(over, PATIENCE)
        return reactions
