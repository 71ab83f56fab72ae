"""A language model server on this machine that says what a test tells it to."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class Stub:
    """Answers requests from a script: (status, headers, text); afterwards by `answer(body)`.

    A text that begins with ``RAW`` is sent as it is, without the OpenAI envelope. Replies wait
    while `answering` is cleared.
    """

    def __init__(self, answer: Callable[[dict], str] = lambda body: " 0.85m"):
        self.script: list[tuple[int, dict[str, str], str]] = []
        self.requests: list[tuple[str, dict]] = []
        self.headers: list[dict[str, str]] = []
        self.answering = threading.Event()
        self.answering.set()
        self.answer = answer
        stub = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                length = int(self.headers["content-length"])
                body = json.loads(self.rfile.read(length))
                stub.requests.append((self.path, body))
                stub.headers.append(dict(self.headers))
                stub.answering.wait(60)
                if stub.script:
                    status, headers, text = stub.script.pop(0)
                else:
                    status, headers, text = 200, {}, stub.answer(body)
                if status == 200 and not text.startswith("RAW"):
                    choice = {"text": text, "message": {"content": text}, "finish_reason": "stop"}
                    text = json.dumps({"model": "/home/me/models/m.gguf", "choices": [choice]})
                data = text.removeprefix("RAW").encode()
                try:
                    self.send_response(status)
                    for name, value in headers.items():
                        self.send_header(name, value)
                    self.send_header("content-length", str(len(data)))
                    self.end_headers()
                    self.wfile.write(data)
                except (BrokenPipeError, ConnectionResetError):
                    pass  # the client has given up

            def log_message(self, format, *args):
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}/v1"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self.answering.set()
        self.server.shutdown()
        self.server.server_close()
