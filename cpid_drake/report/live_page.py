"""The page of the live view: Meshcat in a frame, with numbers and a legend over it."""

import json
from collections.abc import Sequence
from functools import partial
from html import escape
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from string import Template
from threading import Thread
from urllib.parse import urlsplit

from cpid_drake.errors import InputError
from cpid_drake.report.scene_legend import LegendLayer

_TEMPLATE = Path(__file__).with_name("live_page.html")


class LivePage:
    """Serves the page from a thread of its own, until the process ends.

    The browser asks for the newest numbers five times a second.

    Args:
        meshcat_url: address of Meshcat's own page.
        title: heading.
        scale: length of the scene's scale [m].
        host: who may connect: "localhost" for this machine alone, "*" for all.

    Raises:
        InputError: no port is free.

    """

    def __init__(self, meshcat_url: str, title: str, scale: float, host: str = "localhost") -> None:
        self._state = b"{}"
        page = Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
            title=escape(title), scale=f"{scale:g} m", port=urlsplit(meshcat_url).port
        )
        handler = partial(_Handler, self, page.encode())
        try:
            server = ThreadingHTTPServer(("" if host == "*" else host, 0), handler)
        except OSError as error:
            raise InputError(f"the live page cannot be served: {error}") from error
        server.daemon_threads = True
        self.url = f"http://localhost:{server.server_address[1]}"
        Thread(target=server.serve_forever, daemon=True).start()

    def show(self, heading: str, text: str, layers: Sequence[LegendLayer]) -> None:
        """Replace what the page shows.

        Args:
            heading: one line, such as the time.
            text: the estimate.
            layers: the layers of the legend.

        """
        marks = [[mark.color, mark.meaning] for layer in layers for mark in layer.marks]
        state = {"heading": heading, "text": text, "legend": marks}
        self._state = json.dumps(state).encode()

    @property
    def state(self) -> bytes:
        """What the page shows, as JSON."""
        return self._state


class _Handler(BaseHTTPRequestHandler):
    """Answers a request for the page, or for its newest numbers."""

    def __init__(self, live: LivePage, page: bytes, *arguments: object) -> None:
        self._live, self._page = live, page
        super().__init__(*arguments)  # type: ignore[arg-type]  # answers the request

    def do_GET(self) -> None:
        answers = {
            "/": ("text/html; charset=utf-8", self._page),
            "/state": ("application/json", self._live.state),
        }
        kind, body = answers.get(self.path, ("", b""))
        self.send_response(200 if kind else 404)
        self.send_header("Content-Type", kind or "text/plain")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *arguments: object) -> None:
        """Write nothing to the terminal."""
