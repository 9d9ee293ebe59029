"""The server answers its own page on this machine, and nobody else; what is wrong is said in a sentence."""

import http.client
import json

import cv2
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.explorer import ExplorerServer

JSON = {"Content-Type": "application/json"}


def _ask(server, method, path, body=None, headers=None):
    """Code, content type and body of the answer."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=60)
    try:
        connection.request(method, f"/{server.token}{path}", body, headers or {})
        answer = connection.getresponse()
        return answer.status, answer.headers.get_content_type(), answer.read()
    finally:
        connection.close()


def _error(answer):
    assert answer[1] == "application/json"
    return answer[0], json.loads(answer[2])["error"]


@pytest.mark.parametrize(
    ("path", "kind"), [("/", "text/html"), ("/main.js", "text/javascript"), ("/style.css", "text/css")]
)
def test_the_page_and_its_parts(explorer, path, kind):
    code, found, body = _ask(explorer, "GET", path)
    assert (code, found) == (200, kind) and len(body) > 1000
    assert b"http://" not in body and b"https://" not in body  # nothing is fetched from elsewhere


def test_the_scene_holds_what_the_page_draws(explorer, session):
    scene = json.loads(_ask(explorer, "GET", "/api/scene")[2])
    assert [camera["name"] for camera in scene["cameras"]] == ["front"]
    assert scene["levels"] == [{"ramp_px": ramp} for ramp in (40.0, 14.0, 8.0, 3.0)]
    assert scene["places"]["truth"] == pytest.approx(vars(session.start()))
    assert {"face", "dot"} <= {shape["kind"] for shape in scene["shapes"]}
    for kind in ("image", "mask"):
        code, found, body = _ask(explorer, "GET", f"/api/picture/1/{kind}/front")
        assert (code, found) == (200, "image/jpeg")
        assert cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR).shape == (300, 480, 3)


def test_a_pose_is_answered_with_numbers_and_arrays(explorer, session):
    query = {"pose": vars(session.start()), "level": 1}
    code, found, body = _ask(explorer, "POST", "/api/evaluate", json.dumps(query), JSON)
    assert (code, found) == (200, "application/octet-stream")
    length = int.from_bytes(body[:4], "little")
    head = json.loads(body[4 : 4 + length])
    assert head["cost"] < 0.2 and head["path"]["status"] == "CONVERGED"
    place = head["arrays"]["slice_xy"]
    side = head["side"]
    values = np.frombuffer(body, place["dtype"], side * side, 4 + length + place["offset"]).reshape(side, side)
    assert values[side // 2, side // 2] == pytest.approx(head["cost"], abs=2e-3)
    assert len(body) < 100_000


def test_another_frame(explorer, session):
    scene = json.loads(_ask(explorer, "POST", "/api/frame", '{"index": 0}', JSON)[2])
    assert scene["frame"] == 0 and session.frame.index == 0


@pytest.mark.parametrize(
    ("headers", "words"),
    [
        ({"Host": "evil.example:80"}, "host 'evil.example:80'"),
        ({"Host": "127.0.0.1"}, "host '127.0.0.1'"),
        ({"Origin": "http://evil.example"}, "a page of http://evil.example may not ask"),
        ({"Origin": "null"}, "a page of null may not ask"),
    ],
)
def test_other_pages_and_rebound_names_are_refused(explorer, headers, words):
    for method, path, body in (("GET", "/api/scene", None), ("POST", "/api/frame", '{"index": 0}')):
        code, text = _error(_ask(explorer, method, path, body, JSON | headers))
        assert code == 403 and words in text


def test_the_server_listens_on_this_machine_only(explorer):
    assert explorer.server_address[0] == "127.0.0.1"
    own = {"Origin": f"http://127.0.0.1:{explorer.server_port}", "Host": f"localhost:{explorer.server_port}"}
    assert _ask(explorer, "GET", "/api/progress", None, own)[0] == 200


@pytest.mark.parametrize(
    ("method", "path", "body", "headers", "code", "words"),
    [
        ("POST", "/api/evaluate", "{", JSON, 400, "the request is not JSON"),
        ("POST", "/api/evaluate", "[" * 9000, JSON, 400, "the request is not JSON"),
        ("POST", "/api/evaluate", b"\xff\xfe{}", JSON, 400, "the request is not JSON"),
        ("POST", "/api/evaluate", "{}", {"Content-Type": "text/plain"}, 400, "expected application/json"),
        ("POST", "/api/evaluate", '{"pose": {"x_m": NaN}, "level": 1}', JSON, 400, "x_m nan; expected a number"),
        ("POST", "/api/evaluate", "{}", JSON, 400, "level None; expected 0 (coarse) to 3"),
        ("POST", "/api/evaluate", " " * 20000, JSON, 413, "expected at most 16384"),
        ("POST", "/api/frame", '{"index": 3}', JSON, 400, "expected an index from 0 to 2"),
        ("POST", "/api/poses", "{}", JSON, 404, "POST knows /api/evaluate"),
        ("GET", "/api/nothing", None, {}, 404, "GET knows /api/progress"),
        ("GET", "/api/picture/9/image/front", None, {}, 404, "frame 0 to 2"),
        ("GET", "/api/picture/1/depth/front", None, {}, 400, "cameras: front"),
        ("GET", "/api/picture/1/image/..%2Frear", None, {}, 404, "no such picture"),
        ("GET", "/../server.py", None, {}, 404, "no page"),
        ("GET", "/..%2f__init__.py", None, {}, 404, "no page"),
        ("GET", "/..%2fpage%2fmain.js", None, {}, 404, "no page"),
    ],
)
def test_bad_requests_get_a_sentence(explorer, method, path, body, headers, code, words):
    found, text = _error(_ask(explorer, method, path, body, headers))
    assert found == code and words in text and "\n" not in text


def test_a_length_that_is_none_is_refused(explorer):
    for length in ("-5", "many", "1e3", "9" * 30, "0" * 12 + "300000000", "0" * 30 + "9"):
        connection = http.client.HTTPConnection("127.0.0.1", explorer.server_port, timeout=10)
        connection.putrequest("POST", f"/{explorer.token}/api/frame")
        connection.putheader("Content-Type", "application/json")
        connection.putheader("Content-Length", length)
        connection.endheaders()
        assert connection.getresponse().status in (411, 413)
        connection.close()


@pytest.mark.parametrize("path", ["/", "/api/scene", "/x/api/scene", "//api/scene", "/main.js", "/%00/", "", "*"])
def test_without_the_token_nothing_is_shown(explorer, path):
    connection = http.client.HTTPConnection("127.0.0.1", explorer.server_port, timeout=10)
    connection.request("GET", path or "/?")
    answer = connection.getresponse()
    assert answer.status == 403 and b"lacks its token" in answer.read()
    connection.close()


def test_every_server_has_its_own_token(explorer):
    with ExplorerServer(explorer.session, 0) as other:
        assert other.token != explorer.token and len(other.token) >= 24 and other.token in other.url


def test_nothing_is_computed_before_everything_is_compiled(explorer):
    with ExplorerServer(explorer.session, 0) as other:
        other.session.warm_up(other.progress.report)
        assert other.progress.state["ready"]
        other.progress.report("again", 0, 2)
        assert _error(_ask(other, "POST", "/api/frame", '{"index": 0}', JSON)) == (
            503,
            "still compiling; ask /api/progress",
        )


def test_a_port_in_use_is_one_clear_line(explorer):
    with pytest.raises(SemlocError, match=r"in use by another program; give another --port, or 0 for any free one$"):
        ExplorerServer(explorer.session, explorer.server_port)
    with pytest.raises(SemlocError, match="port 70000: expected a number from 0"):
        ExplorerServer(explorer.session, 70000)
