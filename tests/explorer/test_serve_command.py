"""`semloc landscape --serve`: starts, says where it is, ends at Ctrl-C; a port in use is one line."""

import signal
import subprocess
import sys
import urllib.request

import pytest

from semloc_jax.cli.main import FAILED, main


def test_a_port_in_use(explorer, simulated_road, capsys):
    words = ["--masks", "sem", "--serve", "--no-browser", "--port", str(explorer.server_port)]
    assert main(["landscape", str(simulated_road), *words]) == FAILED
    assert "in use by another program; give another --port" in capsys.readouterr().err.splitlines()[-1]


def _listens_to_ctrl_c() -> None:
    """What a shell does for a program in the foreground; tests may run in the background, where it is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.slow
def test_start_and_stop(simulated_road):
    words = [str(simulated_road), "--masks", "sem", "--serve", "--no-browser", "--port", "0"]
    command = [sys.executable, "-m", "semloc_jax.cli.main", "landscape", *words]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=_listens_to_ctrl_c
    ) as process:
        line = process.stdout.readline()
        assert line.startswith("explorer: http://127.0.0.1:") and line.endswith("(Ctrl-C ends it)\n")
        assert b'"error":null' in urllib.request.urlopen(line.split()[1] + "api/progress", timeout=30).read()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
    assert (process.returncode, out) == (0, "explorer: closed\n")
    assert "Traceback" not in err
