"""`semloc simulate` and `semloc config`: a drive that opens again, a configuration that reads back."""

import pytest
import yaml

from semloc_jax.cli.main import FAILED, OK, USAGE, main
from semloc_jax.datasets import open_drive

SMALL = ["--num-frames", "2", "--width-px", "160", "--height-px", "100"]


def test_a_drive_is_written_and_opens_again(tmp_path, capsys):
    out = tmp_path / "drive"
    assert main(["simulate", str(out), "--seed", "3", *SMALL]) == OK
    assert "2 frames, cameras front" in capsys.readouterr().out
    drive = open_drive(out)
    assert len(drive) == 2
    assert drive.frames[0].mask("sem_net", "front").shape == (100, 160)
    assert drive.truth is not None

    assert main(["simulate", str(out), *SMALL]) == FAILED
    assert "not an empty folder" in capsys.readouterr().err


def test_a_configuration_reads_back(tmp_path, capsys):
    assert main(["config", "simulate"]) == OK
    printed = capsys.readouterr().out
    content = yaml.safe_load(printed)
    assert content["sensors"]["gnss_bias_m"] == 1.0
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(content | {"num_frames": 7}))
    assert main(["config", "simulate", "--config", str(path)]) == OK
    assert yaml.safe_load(capsys.readouterr().out) == content | {"num_frames": 7}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--num-frame", "3"], "did you mean '--num-frames'?"),
        (["--kind", "sea"], "invalid choice"),
        (["--config", "nowhere.yaml"], "no such file"),
    ],
)
def test_wrong_usage_is_exit_code_2(tmp_path, capsys, words, message):
    assert main(["simulate", str(tmp_path / "drive"), *words]) == USAGE
    assert message in capsys.readouterr().err
    assert not (tmp_path / "drive").exists()


def test_wrong_values_are_exit_code_1(tmp_path, capsys):
    assert main(["simulate", str(tmp_path / "drive"), "--variants", "midnight"]) == FAILED
    assert "unknown variant 'midnight'" in capsys.readouterr().err


def test_the_next_command_fits_a_drive_without_satellites(tmp_path, capsys):
    words = ["--kind", "garage", "--laps", "1", "--num-frames", "1", "--masks-only", "--width-px", "64"]
    assert main(["simulate", str(tmp_path / "hall"), *words, "--height-px", "48"]) == OK
    assert capsys.readouterr().out.rstrip().endswith("--frames ::5 --prior truth")
