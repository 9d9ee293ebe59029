"""A served map: pulled by differences, uploads with a token, and every wrong request is refused in a sentence."""

import http.client
import json
import threading

import numpy as np
import pytest

from semloc_jax.cli.main import FAILED, OK, USAGE, main
from semloc_jax.errors import SemlocError
from semloc_jax.maps import read_map
from semloc_jax.maps.io.packed_drive import packed_bytes, write_packed
from semloc_jax.maps.versions.difference import difference
from semloc_jax.maps.versions.history import history_of, write_version
from semloc_jax.maps.versions.state import MapState, read_state
from semloc_jax.service import server as served
from semloc_jax.service.server import MOST_UPLOAD_BYTES, MapServer
from tests.mapping.crowd_world import Road, drive
from tests.maps.versions.made_maps import road

TOKEN = "a token of enough letters"


@pytest.fixture
def server(tmp_path):
    path = tmp_path / "map.gpkg"
    first, second = MapState(road(60)), MapState(road(61, 4), 2)
    write_version(first, path)
    write_version(second, path, first, path, "second")
    with MapServer(path, TOKEN, port=0) as running:
        thread = threading.Thread(target=running.serve_forever, daemon=True)
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def asked(server, method, path, body=None, headers=None):
    connection = http.client.HTTPConnection(*server.server_address, timeout=10)
    try:
        connection.request(method, path, body, headers or {})
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def test_a_map_is_pulled_whole_and_then_by_differences(server, tmp_path, capsys):
    own = tmp_path / "car" / "map.gpkg"
    own.parent.mkdir()
    assert main(["pull", server.url, "--out", str(own)]) == OK
    assert own.read_bytes() == server.path.read_bytes()
    before, third = read_state(server.path), MapState(road(62, 5), 3)
    write_version(third, server.path, before, server.path, "third")
    capsys.readouterr()
    assert main(["pull", server.url, "--out", str(own), "--have", "2"]) == OK
    assert "version 2 -> version 3" in capsys.readouterr().out
    assert own.read_bytes() == server.path.read_bytes()
    assert main(["pull", server.url, "--out", str(own)]) == OK  # nothing new
    assert main(["pull", server.url, "--out", str(own), "--have", "1"]) == FAILED
    assert "holds version 3" in capsys.readouterr().err
    stranger = MapState(road(5), 9)
    write_version(stranger, own)
    assert main(["pull", server.url, "--out", str(own)]) == FAILED
    assert "is not in the history" in capsys.readouterr().err
    assert read_state(own).digest == stranger.digest


def test_a_difference_since_a_version_is_small(server):
    code, content = asked(server, "GET", "/diff?have=1")
    assert code == 200 and len(content) < 0.05 * server.path.stat().st_size
    assert asked(server, "GET", "/diff?have=2")[0] == 200


def test_a_tile_is_what_lies_in_its_box(server, tmp_path):
    code, content = asked(server, "GET", "/tile?bbox=0,-10,256,10&version=1")
    assert code == 200 and len(content) < 36_000 * 0.256
    (tmp_path / "tile.smap").write_bytes(content)
    found = read_map(tmp_path / "tile.smap").elements
    assert len(found) == 29 and np.concatenate([e.points for e in found])[:, 0].max() < 260.0
    summary = json.loads(asked(server, "GET", "/version")[1])
    assert summary["version"] == 2 and sorted(summary["tiles"]) == ["0,0", "1,0", "2,0"]


@pytest.mark.parametrize(
    ("path", "code"),
    [
        ("/", 404),
        ("/../../etc/passwd", 404),
        ("/map?x=1", 404),
        ("/tile?a=1&b=2&c=3&d=4&e=5", 400),
        ("/tile", 404),
        ("/tile?bbox=1,2,3", 400),
        ("/tile?bbox=0,0,nan,1", 400),
        ("/tile?bbox=0,0,-5,1", 400),
        ("/tile?bbox=0,0,1e9,1", 400),
        ("/tile?bbox=5000,5000,5001,5001", 404),
        ("/tile?bbox=0,0,9,9&version=77", 404),
        ("/diff?have=nothing", 404),
        ("/diff?have=" + "9" * 5000, 404),
    ],
)
def test_a_wrong_question_is_refused(server, path, code):
    found, said = asked(server, "GET", path)
    assert found == code and json.loads(said)["error"]


def test_an_upload_needs_a_token_and_is_looked_at(server):
    content = packed_bytes(drive(Road.of(70.0), 0))
    shown = {"Authorization": f"Bearer {TOKEN}"}
    inbox = history_of(server.path) / "inbox"
    assert asked(server, "POST", "/drives", content)[0] == 401
    assert asked(server, "POST", "/drives", content, {"Authorization": "Bearer x"})[0] == 401
    assert asked(server, "POST", "/elsewhere", content, shown)[0] == 404
    assert asked(server, "POST", "/drives", b"junk", shown)[0] == 400
    assert asked(server, "POST", "/drives", content[:-1], shown)[0] == 400
    length = {**shown, "Content-Length": str(MOST_UPLOAD_BYTES + 1)}
    assert asked(server, "POST", "/drives", None, length)[0] == 413
    assert asked(server, "POST", "/drives", None, {**shown, "Content-Length": "many"})[0] == 411
    assert not inbox.exists()
    for _ in range(2):
        code, said = asked(server, "POST", "/drives", content, shown)
        assert code == 202
    kept = list(inbox.iterdir())
    assert [path.stem for path in kept] == [json.loads(said)["drive"]]
    assert kept[0].read_bytes() == content


def test_too_many_questions_are_refused(server, monkeypatch):
    monkeypatch.setattr(served, "_RATE_PER_S", 0.001)
    codes = [asked(server, "GET", "/version")[0] for _ in range(70)]
    assert codes[:60] == [200] * 60 and codes[-1] == 429


def test_more_connections_than_there_is_room_for_are_closed_at_once(server, monkeypatch):
    monkeypatch.setattr(server, "_connections", threading.Semaphore(2))
    idle = [http.client.HTTPConnection(*server.server_address, timeout=10) for _ in range(2)]
    for connection in idle:
        connection.request("GET", "/version")
        assert connection.getresponse().read()  # and stays open
    with pytest.raises((ConnectionError, http.client.HTTPException)):
        asked(server, "GET", "/version")
    for connection in idle:
        connection.close()
    codes = []
    for _ in range(100):
        try:
            codes.append(asked(server, "GET", "/version")[0])
            break
        except (ConnectionError, http.client.HTTPException):
            continue
    assert codes == [200]


def test_the_same_step_is_worked_out_once(server, monkeypatch):
    made = []
    monkeypatch.setattr(served, "difference", lambda *words: made.append(words) or difference(*words))
    first, again = (asked(server, "GET", "/diff?have=1")[1] for _ in range(2))
    assert first == again and len(made) == 1
    before, third = read_state(server.path), MapState(road(62, 5), 3)
    write_version(third, server.path, before, server.path, "third")
    assert asked(server, "GET", "/diff?have=1")[1] != first and len(made) == 2


def test_uploads_that_wait_are_merged_by_one_word_and_then_go(tmp_path, capsys):
    path = tmp_path / "map.gpkg"
    inbox = history_of(path) / "inbox"
    inbox.mkdir(parents=True)
    for k in range(2):
        write_packed(drive(Road.of(70.0), k), inbox / f"d{k}.slocal")
    write_version(MapState(Road.of(70.0).map), path)
    assert main(["merge", str(path), "--inbox", "--out", str(path)]) == OK
    assert "2 new of 2 drives" in capsys.readouterr().out
    assert not list(inbox.iterdir()) and read_state(path).version == 3
    assert main(["merge", str(path), "--inbox", "--out", str(path)]) == OK
    assert "no drive waits" in capsys.readouterr().out
    assert main(["merge", str(inbox / "d.slocal"), "--inbox", "--out", str(path)]) == USAGE


def test_nothing_listens_to_other_machines_unasked(server, tmp_path):
    assert server.server_address[0] == "127.0.0.1"
    with pytest.raises(SemlocError, match="in use"):
        MapServer(server.path, TOKEN, port=server.server_address[1])
    with pytest.raises(SemlocError, match="16 or more"):
        MapServer(server.path, "short", port=0)
    assert main(["serve", str(tmp_path / "none.gpkg")]) == FAILED


def test_a_server_that_is_not_there_is_said(tmp_path, capsys):
    assert main(["pull", "http://127.0.0.1:9", "--out", str(tmp_path / "m.gpkg")]) == FAILED
    assert main(["pull", "file:///etc/passwd", "--out", str(tmp_path / "m.gpkg")]) == FAILED
    said = capsys.readouterr().err
    assert "cannot be reached" in said and "expected an address" in said
    assert not (tmp_path / "m.gpkg").exists()
