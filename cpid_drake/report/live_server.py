"""A web server in threads of its own: files from memory, and a stream of events."""

import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from errno import EADDRINUSE
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from socketserver import ThreadingTCPServer
from threading import Condition, Thread
from typing import Any

from cpid_drake.files.errors import InputError

LOCAL = "127.0.0.1"
"""Address that only browsers on this computer reach."""

ALL = "0.0.0.0"
"""Address for all networks of this computer."""

PORTS = range(8100, 8200)
"""The first free one of these is taken."""

EVENTS = "/events"
"""Path of the stream of events."""

_SILENCE = 5.0  # [s] after which an empty line shows whether a browser still listens

_LAST = 2.0  # [s] in which browsers take the last event

File = tuple[str, bytes]
"""Content type and content."""

Events = Callable[[Any], tuple[Any, str]]
"""From a browser's place in the stream, None at first, to its next place and one line of text."""


class LiveServer:
    """Serves files and a stream of server-sent events until it is closed.

    Args:
        host: address on which it listens.
        files: content by path, such as "/".
        events: returns what is new since a place in the stream. It is called in other threads, one
            at a time, and must hold no lock while it waits.

    Attributes:
        address: of the page.

    Raises:
        InputError: no port is free, or the host is no address of this computer.

    """

    def __init__(self, host: str, files: Mapping[str, File], events: Events) -> None:
        self._files, self._events = files, events
        self._condition, self._version, self._streams = Condition(), 0, 0
        self._is_closed = False
        self._server = _bound(host, type("Handler", (_Handler,), {"live": self}))
        name = socket.gethostname() if host == ALL else host
        self.address = f"http://{name}:{self._server.server_address[1]}"
        Thread(target=self._server.serve_forever, args=(0.1,), daemon=True).start()

    def notify(self) -> None:
        """Send what is new to all browsers."""
        with self._condition:
            self._version += 1
            self._condition.notify_all()

    def close(self) -> None:
        """Send what is new, and end; browsers that do not listen are not waited for."""
        with self._condition:
            self._is_closed = True
            self._condition.notify_all()
            self._condition.wait_for(lambda: not self._streams, _LAST)
        self._server.shutdown()
        self._server.server_close()

    def file(self, path: str) -> File | None:
        """Return a file; None if there is none."""
        return self._files.get(path)

    def stream(self, write: Callable[[bytes], object]) -> None:
        """Write events until the server is closed, or the browser is gone."""
        version, place, is_last = -1, None, False
        with self._condition:
            self._streams += 1
        try:
            while not is_last:
                with self._condition:
                    is_new = self._condition.wait_for(partial(self._has_news, version), _SILENCE)
                    version, is_last = self._version, self._is_closed
                    if is_new:
                        place, text = self._events(place)
                write(f"data: {text}\n\n".encode() if is_new else b":\n\n")
        finally:
            with self._condition:
                self._streams -= 1
                self._condition.notify_all()

    def _has_news(self, version: int) -> bool:
        return self._is_closed or self._version != version


class _Handler(BaseHTTPRequestHandler):
    """Answers the requests of a browser."""

    live: LiveServer
    timeout = 10.0  # [s] for a browser that takes nothing

    def do_GET(self) -> None:
        """Answer with a file or with the stream."""
        with suppress(ConnectionError, TimeoutError):  # the browser is gone
            if self.path == EVENTS:
                self._begin("text/event-stream", {"Cache-Control": "no-store"})
                self.live.stream(self._write)
            elif (file := self.live.file(self.path)) is not None:
                kind, content = file
                self._begin(kind, {"Content-Length": str(len(content))})
                self._write(content)
            else:
                self.send_error(HTTPStatus.NOT_FOUND)

    def _begin(self, kind: str, others: Mapping[str, str]) -> None:
        self.send_response(HTTPStatus.OK)
        for name, value in {"Content-Type": kind, **others}.items():
            self.send_header(name, value)
        self.end_headers()

    def _write(self, content: bytes) -> None:
        self.wfile.write(content)
        self.wfile.flush()

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing for a request."""


class _Server(ThreadingTCPServer):
    """Serves in threads that do not keep the process, at a port that is free now."""

    daemon_threads = True
    allow_reuse_address = True


def _bound(host: str, handler: type[_Handler]) -> _Server:
    """Return a server on the first free port."""
    for port in PORTS:
        try:
            return _Server((host, port), handler)
        except OSError as error:
            if error.errno != EADDRINUSE:
                raise InputError(f"no page can be served on {host}: {error.strerror}") from error
    raise InputError(f"no port from {PORTS[0]} to {PORTS[-1]} is free on {host}")
