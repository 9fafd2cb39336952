"""Viewers of the live page for measurements: python -m experiments._lib.page_clients URL COUNT; ends with the stream.

It runs in a separate process, so that viewers cost the page nothing, and prints their counts as JSON.
"""

from __future__ import annotations

import json
import socket
import sys
import threading
import time
from urllib.parse import urlsplit


def follow(host: str, port: int, seen: dict[str, int], lock: threading.Lock) -> None:
    """Follow the frames; a viewer that finds no free place requests the page once a second until it is closed."""
    own = {"frames": 0, "bytes": 0, "no place": 0, "pages": 0, "ends": 0}
    try:
        while not own["ends"]:
            with socket.create_connection((host, port), timeout=30) as client:
                client.sendall(f"GET /frames HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
                while block := client.recv(2**16):
                    own["bytes"] += len(block)
                    own["frames"] += block.count(b"event: frame")
                    own["ends"] += block.count(b"event: end")
                    own["no place"] += block.startswith(b"HTTP/1.0 503")
            if not own["ends"]:
                with socket.create_connection((host, port), timeout=30) as client:
                    client.sendall(f"GET / HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
                    own["pages"] += client.recv(12).endswith(b"200")
                time.sleep(1)
    except OSError:
        pass  # the page is closed
    with lock:
        for key, value in own.items():
            seen[key] = seen.get(key, 0) + value
        seen["followed to the end"] = seen.get("followed to the end", 0) + bool(own["ends"])


def main() -> None:
    url, seen, lock = urlsplit(sys.argv[1]), dict[str, int](), threading.Lock()
    viewers = [
        threading.Thread(target=follow, args=(url.hostname, url.port, seen, lock)) for _ in range(int(sys.argv[2]))
    ]
    for viewer in viewers:
        viewer.start()
    for viewer in viewers:
        viewer.join()
    print(json.dumps(seen))


if __name__ == "__main__":
    main()
