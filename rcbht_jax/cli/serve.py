"""``rcbht serve``."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

from rcbht_jax.cli.stream import Source
from rcbht_jax.introspection.session import paced
from rcbht_jax.report.live_page import Frames, PageServer


@dataclass(frozen=True)
class Serve(Source):
    """A live page: the wrench, the label bands and the beliefs, moving.

    SOURCE is what "rcbht stream" takes. The page needs no network, takes no input, and can be seen from this
    machine only unless --host says otherwise. Ctrl-C ends it.

    Example: rcbht serve hiro.zarr --trial 20121127-HIROSA-S-13 --model states.model
    """

    host: str = "127.0.0.1"
    """Address to serve at; 0.0.0.0 lets every machine look that can reach this one."""
    port: int = 8080
    """Port; 0 = any free one."""
    speed: float = 1.0
    """Pace of a recording: 1 = as recorded, 0 = as fast as possible."""
    stay: bool = True
    """Go on showing the end when the source has ended."""

    def run(self) -> dict[str, Any]:
        session, messages = self.opened()
        with PageServer(session, self.host, self.port) as server:
            print(f"Open {server.url} in a browser; Ctrl-C ends.", file=sys.stderr, flush=True)
            frames = Frames(session, server.broadcast)
            for message in paced(messages, self.speed):
                frames.feed(message)
            frames.flush()
            while self.stay:
                time.sleep(0.5)
        return {"source": self.source, "messages": dict(session.counts)}

    def text(self, result: dict[str, Any]) -> str:
        words = ", ".join(f"{count} {name}" for name, count in result["messages"].items())
        return f"{result['source']}: {words or 'nothing'}"
