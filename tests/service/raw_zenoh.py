"""A hand-made Zenoh session without extensions, which can send messages that Zenoh's own sessions never send."""

import os
import random
import socket
import struct

CLIENT, ROUTER, PEER = 2, 0, 1
INIT, OPEN, CLOSE, KEEP_ALIVE, FRAME, FRAGMENT = 1, 2, 3, 4, 5, 6  # transport messages
RESPONSE_FINAL, RESPONSE, REQUEST, PUSH, DECLARE, INTEREST = 0x1A, 0x1B, 0x1C, 0x1D, 0x1E, 0x19  # messages inside a frame
RELIABLE, MORE = 0x20, 0x40
NAMED = 0x60  # with the key's text, after the number of a declared key
KEY, SUBSCRIBER, QUERYABLE, TOKEN = 0, 2, 4, 6  # declarations; the number plus one withdraws each
FINAL = 0x1A  # the end of the answers to an interest
PUT, QUERY, REPLY = 1, 3, 4
EVERYTHING, TOKENS = 0x0F, 0x08  # kinds of interest: keys, subscribers, queryables, tokens


def number(value):
    out = b""
    while value > 127:
        out += bytes([value & 127 | 128])
        value >>= 7
    return out + bytes([value])


def sized(data):
    return number(len(data)) + data


def wire(key, scope=0):
    return number(scope) + sized(key if isinstance(key, bytes) else key.encode())


def declare(kind, id, key, scope=0):
    return bytes([DECLARE, kind | (0x20 if kind == KEY else NAMED)]) + number(id) + wire(key, scope)


def interest(id, key, scope=0, mode=3, what=EVERYTHING):
    """mode: 1 for present declarations, 2 for future ones, 3 for both"""
    return bytes([INTEREST | mode << 5]) + number(id) + bytes([what | 0x70]) + wire(key, scope)


def push(key, data=b"x", scope=0):
    return bytes([PUSH | NAMED]) + wire(key, scope) + bytes([PUT]) + sized(data)


def request(id, key, scope=0):
    return bytes([REQUEST | NAMED]) + number(id) + wire(key, scope) + bytes([QUERY])


def response(id, key, scope=0):
    return bytes([RESPONSE | NAMED]) + number(id) + wire(key, scope) + bytes([REPLY, PUT]) + sized(b"x")


class Raw:
    def __init__(self, endpoint, opened=True, lease=100_000, kind=CLIENT, patience=60.0):
        host, port = endpoint.split("/")[1].rsplit(":", 1)
        self.socket = socket.create_connection((host, int(port)), timeout=patience)
        self.next = random.randrange(1 << 20)
        self.send(bytes([INIT, 9, 15 << 4 | kind]) + os.urandom(15) + b"\1")
        if opened:
            self.open(lease)

    def open(self, lease):
        """lease: seconds of silence that the session requests"""
        told = self.receive()
        at = 3 + (told[2] >> 4) + (3 if told[0] & 0x40 else 0)
        size = shift = 0
        while True:
            size, shift, at = size | (told[at] & 127) << shift, shift + 7, at + 1
            if told[at - 1] < 128:
                break
        self.send(bytes([OPEN | 0x40]) + number(lease) + number(self.next) + sized(told[at : at + size]))
        if self.receive()[0] & 0x1F != OPEN:
            raise ConnectionError("not let in")

    def send(self, *messages):
        self.socket.sendall(b"".join(struct.pack("<H", len(each)) + each for each in messages))

    def receive(self):
        size = struct.unpack("<H", self.exactly(2))[0]
        return self.exactly(size)

    def exactly(self, size):
        out = b""
        while len(out) < size:
            if not (more := self.socket.recv(size - len(out))):
                raise ConnectionError("the other end is gone")
            out += more
        return out

    def number(self):
        self.next = self.next + 1 & 0xFFFFFFF
        return number(self.next - 1 & 0xFFFFFFF)

    def frames(self, *bodies):
        self.send(*(bytes([FRAME | RELIABLE]) + self.number() + each for each in bodies))

    def fragments(self, *pieces):
        """Sends the first part of a message that never ends."""
        self.send(*(bytes([FRAGMENT | RELIABLE | MORE]) + self.number() + each for each in pieces))

    def wait_for(self, bytes_of_it):
        """Waits for a message that contains these bytes."""
        while bytes_of_it not in (told := self.receive()):
            pass
        return told

    def wait_for_end(self, id):
        """Waits for the end of the answers to a query. It carries the priority that the server gives to queries, or none."""
        ends = [bytes([RESPONSE_FINAL | flag]) + number(id) for flag in (0, 0x80)]
        while not any(end in told for told in [self.receive()] for end in ends):
            pass

    def close(self):
        self.socket.close()
