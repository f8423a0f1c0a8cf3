"""The viewer's web page for this machine alone: nothing of it comes from, or goes to, the network.

rerun serves its page itself, but the page asks for fonts and news elsewhere. Here it is passed on
with a policy by which a browser fetches from this machine only.
"""

from __future__ import annotations

import contextlib
import http.client
import http.server
import threading
from collections.abc import Generator

_PASSED_ON = ("Content-Type", "Content-Encoding", "Cache-Control", "ETag")


@contextlib.contextmanager
def guarded_page(page_port: int, data_port: int) -> Generator[int]:
    """Passes on the page that rerun serves at `page_port` of 127.0.0.1; yields the port to open.

    Args:
        page_port: where the page is.
        data_port: where recordings come from, the only other place that the page may load from.
    """
    page = "'self' 'unsafe-inline' 'unsafe-eval' blob: data:"
    data = f"http://127.0.0.1:{data_port} ws://127.0.0.1:{data_port}"
    policy = f"default-src {page}; connect-src 'self' blob: data: {data}"

    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            source = http.client.HTTPConnection("127.0.0.1", page_port)
            with contextlib.closing(source):
                encodings = self.headers.get("Accept-Encoding", "identity")
                source.request("GET", self.path, headers={"Accept-Encoding": encodings})
                answer = source.getresponse()
                body = answer.read()
            self.send_response(answer.status)
            for name in _PASSED_ON:
                if (value := answer.getheader(name)) is not None:
                    self.send_header(name, value)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Content-Security-Policy", policy)
            self.end_headers()
            with contextlib.suppress(ConnectionError):  # the browser has gone away
                self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            del format, args

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
