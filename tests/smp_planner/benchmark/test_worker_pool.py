"""Workers end with the command that started them, whatever ends that."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]

SCRIPT = """
import os
import signal
import time

for name in ("SIGINT", "SIGTERM", "SIGHUP"):
    # What runs in the background of a shell may have been told to disregard it.
    signal.signal(getattr(signal, name), signal.SIG_DFL)

from smp_planner.benchmark.options import run_command
from smp_planner.benchmark.worker_pool import workers


def main():
    with workers(1) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        pool.submit(time.sleep, 600.0).result()


if __name__ == "__main__":
    run_command(main)
"""


def _exists(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.parametrize(
    ("sent", "status"),
    [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGKILL, -signal.SIGKILL)],
)
def test_a_command_that_is_ended_leaves_no_worker(
    tmp_path: Path, sent: signal.Signals, status: int
) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "script.py")],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    worker = int(process.stdout.readline())
    process.send_signal(sent)
    began = time.monotonic()
    # The pipe ends with the last process that holds it, and so does what reads it.
    assert process.stdout.read() == b""
    while _exists(worker):
        assert time.monotonic() < began + 5.0
        time.sleep(0.05)
    assert process.wait() == status
