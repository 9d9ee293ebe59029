"""A cache gives back what this user put there: planted, damaged and foreign entries are none."""

import logging
import os
import stat

import pytest

from semloc_jax.storage import others_can_write, private_folder, read_sealed, sealed, write_sealed

CONTENT = bytes(range(256)) * 40


@pytest.fixture
def entry(tmp_path, monkeypatch):
    monkeypatch.setattr(sealed, "home_folder", lambda: tmp_path / "home")
    sealed._key_in.cache_clear()
    path = tmp_path / "cache" / "program.bin"
    assert write_sealed(path, CONTENT)
    yield path
    sealed._key_in.cache_clear()


def test_an_entry_comes_back_and_nobody_else_can_enter_its_folder(entry, tmp_path):
    assert read_sealed(entry) == CONTENT
    key = tmp_path / "home" / "seal" / "key"
    assert stat.S_IMODE(entry.parent.stat().st_mode) == 0o700
    assert stat.S_IMODE(key.stat().st_mode) == 0o600
    assert len(key.read_bytes()) == 32


@pytest.mark.parametrize(
    "damage",
    [
        pytest.param(lambda content: CONTENT, id="planted"),
        pytest.param(lambda content: content[:-1], id="cut"),
        pytest.param(lambda content: content[:20], id="head only"),
        pytest.param(lambda content: b"", id="empty"),
        pytest.param(lambda content: content[:100] + bytes([content[100] ^ 1]) + content[101:], id="flipped bit"),
        pytest.param(lambda content: content + b"\0", id="longer"),
    ],
)
def test_what_was_changed_is_removed_with_one_line(entry, damage, caplog):
    entry.write_bytes(damage(entry.read_bytes()))
    with caplog.at_level(logging.WARNING):
        assert read_sealed(entry) is None
    assert [record.message.count("\n") for record in caplog.records] == [0]
    assert "made anew" in caplog.text and str(entry) in caplog.text
    assert not entry.exists()


def test_an_entry_under_another_name_is_another_entry(entry):
    other = entry.with_name("other.bin")
    other.write_bytes(entry.read_bytes())
    assert read_sealed(other) is None


def test_a_link_is_no_entry(entry, tmp_path):
    target = tmp_path / "target"
    target.write_bytes(entry.read_bytes())
    entry.unlink()
    entry.symlink_to(target)
    assert read_sealed(entry) is None
    assert target.exists()


def test_the_seal_of_another_user_is_none(entry, tmp_path, monkeypatch):
    monkeypatch.setattr(sealed, "home_folder", lambda: tmp_path / "another home")
    assert read_sealed(entry) is None


def test_an_entry_of_another_owner_is_refused(entry, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert read_sealed(entry) is None


def test_a_key_that_others_can_read_seals_nothing(entry, tmp_path, caplog):
    (tmp_path / "home" / "seal" / "key").chmod(0o644)
    sealed._key_in.cache_clear()
    assert read_sealed(entry) is None
    assert not write_sealed(entry, CONTENT)
    assert "others can read it" in caplog.text


def test_private_folders_and_those_that_are_not(tmp_path):
    folder = tmp_path / "open"
    folder.mkdir(mode=0o755)
    folder.chmod(0o777)
    assert others_can_write(folder)
    assert private_folder(folder)
    assert not others_can_write(folder)
    link = tmp_path / "link"
    link.symlink_to(folder)
    assert not private_folder(link)
    assert not others_can_write(tmp_path / "none yet")
