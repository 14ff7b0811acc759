"""A real S3 server on loopback (moto), and a line to it that can be cut."""

import os
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from urllib.parse import urlsplit

__all__ = ["BUCKET", "CutLine", "environment", "object_store", "set_environment"]

BUCKET = "dough"
STARTS_WITHIN = 60.0  # [s]


@contextmanager
def object_store() -> Iterator[str]:
    """Start a server in a process of its own, with one bucket; yields its endpoint."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    endpoint = f"http://127.0.0.1:{port}"
    try:
        _make_bucket(endpoint)
        yield endpoint
    finally:
        process.kill()
        process.wait()


def environment(endpoint: str) -> dict[str, str]:
    """What a user's shell would hold to reach the server."""
    return {
        "AWS_ENDPOINT_URL": endpoint,
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_EC2_METADATA_DISABLED": "true",
    }


@contextmanager
def set_environment(**values: str) -> Iterator[None]:
    """Set environment variables of this process for a while."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _make_bucket(endpoint: str) -> None:
    """Wait until the server answers, and make the bucket."""
    until = time.monotonic() + STARTS_WITHIN
    while True:
        try:
            request = urllib.request.Request(f"{endpoint}/{BUCKET}", method="PUT")
            urllib.request.urlopen(request, timeout=5).close()
            return
        except (urllib.error.URLError, OSError):
            if time.monotonic() > until:
                raise
            time.sleep(0.05)


class CutLine:
    """A TCP relay to the server that forgets requests or answers when it is told to.

    `cut` is asked with the first bytes of every request; True closes the connection: before the
    request reaches the server, or (`after=True`) when the server has acted but before it answers.
    """

    def __init__(self, endpoint: str, cut: Callable[[bytes], bool], *, after: bool = False) -> None:
        self._target = (urlsplit(endpoint).hostname, urlsplit(endpoint).port)
        self._cut, self._after = cut, after
        self._server = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"http://127.0.0.1:{self._server.getsockname()[1]}"

    def __enter__(self) -> "CutLine":
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(
        self, kind: type | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._server.accept()
            except OSError:
                return
            threading.Thread(target=self._relay, args=(client,), daemon=True).start()

    def _relay(self, client: socket.socket) -> None:
        """One connection, request after request."""
        with client, socket.create_connection(self._target) as server:
            try:
                while request := _message(client):
                    doomed = self._cut(request)
                    if doomed and not self._after:
                        return
                    server.sendall(request)
                    head = request.startswith(b"HEAD")
                    answer = _message(server, bodiless=head)
                    if doomed:
                        return
                    client.sendall(answer)
            except OSError:
                return


def _message(source: socket.socket, *, bodiless: bool = False) -> bytes:
    """One whole HTTP message, with `Expect: 100-continue` answered at once."""
    data = b""
    while b"\r\n\r\n" not in data:
        more = source.recv(65536)
        if not more:
            return data
        data += more
    head, _, body = data.partition(b"\r\n\r\n")
    fields = dict(line.lower().split(b": ", 1) for line in head.split(b"\r\n")[1:] if b": " in line)
    if fields.get(b"expect") == b"100-continue":
        source.sendall(b"HTTP/1.1 100 Continue\r\n\r\n")
        head = b"\r\n".join(p for p in head.split(b"\r\n") if not p.lower().startswith(b"expect"))
    left = 0 if bodiless else int(fields.get(b"content-length", b"0")) - len(body)
    while left > 0:
        more = source.recv(min(left, 1 << 20))
        if not more:
            break
        body += more
        left -= len(more)
    return head + b"\r\n\r\n" + body
