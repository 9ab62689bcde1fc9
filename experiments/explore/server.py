"""The page's server: plain HTTP from the standard library, which reads and never writes; on loopback unless told otherwise.

Addresses: ``/`` the page, ``/controls``, ``/answer?STATE``, ``/numbers?STATE`` (without the frame), ``/scenario.toml?STATE``.
"""

from __future__ import annotations

import errno
import json
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from types import TracebackType
from typing import Any, ClassVar
from urllib.parse import urlsplit

from experiments.explore.explorer import Explorer
from experiments.reporting.plain import plain

LOOPBACK = ("127.0.0.1", "localhost")
PAGES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/explore.js": ("explore.js", "text/javascript; charset=utf-8"),
    "/charts.js": ("charts.js", "text/javascript; charset=utf-8"),
    "/explore.css": ("explore.css", "text/css; charset=utf-8"),
}
#: Nothing from elsewhere, nothing inline, in no other page's frame.
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class Server:
    """Serves an explorer; a context manager that ends with it.

    Args:
        explorer: answers.
        host: address to listen on.
        port: 0 takes any that is free.

    Raises:
        OSError: when the port is taken, or the address is not this machine's; one line that says what to do.
    """

    def __init__(self, explorer: Explorer, host: str = "127.0.0.1", port: int = 0) -> None:
        try:
            self._http = _Http((host, port), _Handler)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise OSError(f"--port {port}: taken on {host}; choose another, or 0 for any that is free") from error
            if error.errno == errno.EACCES:
                raise OSError(f"--port {port}: not allowed to this user; choose one above 1023") from error
            raise OSError(f"--host {host}: cannot be listened on ({error.strerror or error})") from error
        self._http.explorer, self._http.guarded = explorer, host in LOOPBACK
        self._thread = threading.Thread(target=self._http.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)

    @property
    def url(self) -> str:
        """Address of the page."""
        host, port = self._http.server_address[:2]
        return f"http://{host!s}:{port}/"

    def wait(self) -> None:
        """Until the server ends, or an interrupt comes."""
        while self._thread.is_alive():
            self._thread.join(timeout=0.5)  # without a limit it would hold interrupts off on some systems

    def __enter__(self) -> Server:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._http.shutdown()
        self._http.server_close()
        self._thread.join(timeout=10)


class _Http(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = False  # or a second server would share the port on some systems
    explorer: Explorer
    guarded: bool


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: _Http

    def do_GET(self) -> None:
        """Answer a request; what is wrong with it is one line under `error`."""
        address = urlsplit(self.path)
        # A page from elsewhere could have its own name resolve to this machine and so read the answers.
        if self.server.guarded and _host_name(self.headers.get("Host", "")) not in LOOPBACK:
            self._send_json({"error": "this page answers to this machine's own address only"}, HTTPStatus.FORBIDDEN)
        elif address.path in PAGES:
            name, kind = PAGES[address.path]
            self._send((files("experiments") / "explore" / "page" / name).read_bytes(), kind)
        elif address.path in self._answers:
            try:
                self._answers[address.path](self, address.query)
            except ValueError as error:
                self._send_json({"error": " ".join(str(error).split())}, HTTPStatus.BAD_REQUEST)
        else:
            self._send_json({"error": f"{address.path}: there is nothing here"}, HTTPStatus.NOT_FOUND)

    def _controls(self, query: str) -> None:
        self._send_json(self.server.explorer.describe())

    def _answer(self, query: str) -> None:
        self._send_json(self.server.explorer.answer(query))

    def _numbers(self, query: str) -> None:
        self._send_json(self.server.explorer.answer(query, with_frame=False))

    def _toml(self, query: str) -> None:
        text = self.server.explorer.toml(query)
        self._send(text.encode(), "application/toml", {"Content-Disposition": 'attachment; filename="scenario.toml"'})

    _answers: ClassVar[dict[str, Callable[[_Handler, str], None]]] = {
        "/controls": _controls,
        "/answer": _answer,
        "/numbers": _numbers,
        "/scenario.toml": _toml,
    }

    def _send_json(self, data: Any, status: HTTPStatus = HTTPStatus.OK) -> None:
        self._send(json.dumps(plain(data), allow_nan=False).encode(), "application/json", status=status)

    def _send(
        self, body: bytes, kind: str, more: dict[str, str] | None = None, status: HTTPStatus = HTTPStatus.OK
    ) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": kind, "Content-Length": str(len(body)), **_HEADERS, **(more or {})}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *arguments: Any) -> None:
        """Nothing: the terminal is for what the user should read."""


def _host_name(header: str) -> str:
    """Host of a Host header, without its port."""
    return urlsplit(f"//{header}").hostname or ""
