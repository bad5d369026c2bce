"""The command line for tests: a process per call, forked from one that has imported dgeval already.

A call gets its own process, working folder, environment and standard streams, and no state of
another call; it doesn't wait some seconds for imports.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

SERVER = """\
import json, os, sys
import dgeval.worlds
import dgeval.cli
import dgeval.compare, dgeval.regress, dgeval.report.html, dgeval.rerun_view
import dgeval.runs.results, dgeval.runs.workers, dgeval.simulation.campaign

requests, answers = os.dup(0), os.dup(1)
with os.fdopen(requests) as lines:
    for line in lines:
        asked = json.loads(line)
        child = os.fork()
        if child == 0:
            for descriptor, path in enumerate(asked["streams"]):
                opened = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
                os.dup2(opened, descriptor)
            os.close(answers)
            os.chdir(asked["cwd"])
            os.environ.clear()
            os.environ.update(asked["environment"])
            sys.argv = ["dgeval", *asked["arguments"]]
            code = 0
            try:
                dgeval.cli.main()
            except SystemExit as end:
                code = end.code if isinstance(end.code, int) else int(end.code is not None)
            except BaseException:
                import traceback

                traceback.print_exc()
                code = 1
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
        _, status = os.waitpid(child, 0)
        os.write(answers, f"{os.waitstatus_to_exitcode(status)}\\n".encode())
"""


class Commands:
    """Runs `dgeval` as `subprocess.run` would run `python -m dgeval`."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._server: subprocess.Popen[str] | None = None

    def __call__(
        self, *arguments: str | Path, cwd: Path | None = None
    ) -> subprocess.CompletedProcess[str]:
        listed = [str(argument) for argument in arguments]
        with tempfile.TemporaryDirectory() as folder:
            streams = [Path(folder) / name for name in ("in", "out", "err")]
            asked = {
                "arguments": listed,
                "cwd": str(cwd or self._root),
                "environment": dict(os.environ),
                "streams": [str(path) for path in streams],
            }
            server = self._started()
            assert server.stdin is not None
            assert server.stdout is not None
            server.stdin.write(json.dumps(asked) + "\n")
            server.stdin.flush()
            code = int(server.stdout.readline())
            out, err = (path.read_text(encoding="utf-8") for path in streams[1:])
        return subprocess.CompletedProcess(["dgeval", *listed], code, out, err)

    def _started(self) -> subprocess.Popen[str]:
        if self._server is None:
            self._server = subprocess.Popen(
                [sys.executable, "-c", SERVER],
                cwd=self._root,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        return self._server

    def close(self) -> None:
        """End the process that calls are forked from."""
        if self._server is not None and self._server.stdin is not None:
            assert self._server.stdout is not None
            self._server.stdin.close()
            self._server.wait()
            self._server.stdout.close()
