"""The HTTP side, asked over a real socket: answers that teach, and no input that breaks it."""

from __future__ import annotations

import asyncio
import contextlib
import re
import socket
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from html.parser import HTMLParser

import httpx
import imagecodecs
import numpy as np
import pytest
from starlette.formparsers import MultiPartParser

from edge_service.errors import AddressError, ImageError
from edge_service.http.app import create_app
from edge_service.http.connections import MAX_CONNECTIONS
from edge_service.http.examples import CAMERA
from edge_service.http.server import HttpServer, bind, url_of
from rgbd_wire.camera import camera_from_json
from target_pose.candidate import Detections
from target_pose.target import Level
from tests.unit.edge_service.edge_fakes import (
    CAMERA_FROM_TARGET,
    CAMERA_JSON,
    COLOR,
    DEPTH,
    SECOND_NS,
    Bench,
    HeldDetector,
    KnownDetector,
)

PNG = bytes(imagecodecs.png_encode(COLOR))
JPEG = bytes(imagecodecs.jpeg8_encode(COLOR, level=95))
DEPTH_PNG = bytes(imagecodecs.png_encode(DEPTH))
FILES = {
    "color": ("c.jpg", JPEG),
    "depth": ("d.png", DEPTH_PNG),
    "camera": ("camera.json", CAMERA_JSON),
}


@contextmanager
def serving(bench):
    """A client of the bench's HTTP side on a free port of the loopback."""
    listener = bind("127.0.0.1", 0)
    server = HttpServer(create_app(bench.state))
    thread = threading.Thread(target=lambda: asyncio.run(server.serve([listener])))
    thread.start()
    port = listener.getsockname()[1]
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=20) as client:
            yield client
    finally:
        server.should_exit = True
        thread.join()


@pytest.fixture(scope="module")
def client():
    bench = Bench(http_upload_mb=1)
    bench.service.start()
    with serving(bench) as client:
        yield client
    bench.drain()


def test_connections_that_say_nothing_keep_nobody_out(client):
    """Not the cluster's probes, for which it would start the worker anew."""
    with contextlib.ExitStack() as stack:
        for _ in range(2 * MAX_CONNECTIONS):
            silent = socket.create_connection((client.base_url.host, client.base_url.port))
            stack.enter_context(silent)
        for _ in range(3):
            with httpx.Client(base_url=client.base_url, timeout=20) as probe:
                assert probe.get("/livez").status_code == 200
        assert client.post("/v1/localize", files=FILES).status_code == 200


def test_a_picture_in_a_pose_out(client):
    """Colour, depth and camera give the pose of the scene, in three forms that agree."""
    response = client.post("/v1/localize", files=FILES)
    assert response.status_code == 200
    body = response.json()
    assert (body["outcome"], body["reason"]) == ("target", "")
    pose = body["target"]["camera_from_target"]
    np.testing.assert_allclose(pose["translation_m"], CAMERA_FROM_TARGET.translation, atol=2e-3)
    matrix = np.array(pose["matrix"])
    np.testing.assert_allclose(matrix[:3, 3], pose["translation_m"])
    np.testing.assert_allclose(matrix[:3, 0], [0, 0, -1], atol=0.02)
    w, x, y, z = pose["q_wxyz"]
    np.testing.assert_allclose(w * w + x * x + y * y + z * z, 1)
    np.testing.assert_allclose(matrix[0, 1], 2 * (x * y - w * z), atol=1e-9)
    covariance = np.array(body["target"]["covariance"])
    assert covariance.shape == (6, 6)
    assert np.linalg.eigvalsh(covariance)[0] > 0
    assert {b["level"] for b in body["target"]["boxes"]} == set(Level)
    assert list(body["timings_ms"]) == ["detect", "nest", "localise"]


@pytest.mark.parametrize("color", [JPEG, PNG])
def test_depth_may_be_left_out_and_camera_may_be_a_field(client, color):
    """Without depth the circles alone give the pose; the camera may be typed in a form."""
    response = client.post(
        "/v1/localize", files={"color": ("c", color)}, data={"camera": CAMERA_JSON}
    )
    assert response.json()["target"]["method"] == "ellipse"


def test_an_answer_says_how_well_its_evidence_fits(client):
    """Residuals per circle, the two ranges, and sigmas that are those of the covariance."""
    target = client.post("/v1/localize", files=FILES).json()["target"]
    seen, sigmas = target["evidence"], target["sigmas"]
    assert [c["diameter_m"] for c in seen["circles"]][:2] == [0.3, 0.14]
    assert sum(c["used"] for c in seen["circles"]) == seen["ellipse_points"]
    assert sum(c["measured"] for c in seen["circles"]) == seen["ellipse_points_measured"]
    assert abs(seen["ranges_apart_sigmas"]) < 3
    assert seen["range_plane_sigma_m"] > 0
    assert target["covariance_frame"] == "camera"
    variances = np.diag(target["covariance"])
    np.testing.assert_allclose(sigmas["right_down_forward_mm"], 1000 * np.sqrt(variances[:3]))
    assert target["tilt_deg"] < 3


@pytest.mark.parametrize("files", [FILES, {k: FILES[k] for k in ("color", "camera")}])
def test_the_answer_may_be_a_picture(client, files):
    """With ?draw=1 a PNG comes back; what is wrong with a field is said as ever."""
    response = client.post("/v1/localize?draw=1", files=files)
    assert response.status_code == 200
    assert response.headers["content-type"] == "image/png"
    sheet = imagecodecs.png_decode(response.content)
    assert sheet.dtype == np.uint8
    assert sheet.shape[0] > 900
    response = client.post("/v1/localize?draw=1", files=files | {"color": ("c", b"junk")})
    assert response.status_code == 422
    assert client.post("/v1/localize?draw=maybe", files=files).status_code == 422


def test_a_browser_leaves_the_depth_out_as_an_empty_file(client):
    """A form's field without a file is an empty file without a name."""
    response = client.post("/v1/localize?draw=1", files=FILES | {"depth": ("", b"")})
    assert response.status_code == 200


def test_no_target_is_an_answer():
    """A picture without a target is a 200 with a reason, not an error."""
    bench = Bench(KnownDetector(Detections(dict.fromkeys(Level, ()))))
    with serving(bench) as client:
        body = client.post("/v1/localize", files=FILES).json()
    assert (body["outcome"], body["target"]) == ("nothing_found", None)
    assert body["reason"]


SMALL = bytes(imagecodecs.png_encode(np.ascontiguousarray(COLOR[:, :-1])))


@pytest.mark.parametrize(
    ("files", "field", "words"),
    [
        (FILES | {"color": ("c", b"")}, "color", "missing or empty"),
        ({"color": FILES["color"]}, "camera", "missing or empty"),
        (FILES | {"color": ("c", b"junk")}, "color", "not a JPEG or PNG"),
        (FILES | {"color": ("c", SMALL)}, "color", "319x240, the camera JSON says 320x240"),
        (FILES | {"depth": ("d", JPEG)}, "depth", "16-bit grey PNG"),
        (FILES | {"camera": ("c", b"{")}, "camera", "not JSON"),
        (FILES | {"camera": ("c", b"\xff\xfe{}")}, "camera", ""),
        (FILES | {"camera": ("c", b"[" * 60000)}, "camera", "not JSON"),
        (FILES | {"camera": ("c", b"{}")}, "camera", "lacks color"),
        (FILES | {"image": ("c", b"x")}, "form", ""),
        ([*FILES.items(), ("color", ("c", PNG))], "form", ""),
    ],
)
def test_a_field_that_cannot_be_used_is_named(client, files, field, words):
    """A 422 with the field and one sentence, whatever is wrong with it."""
    response = client.post("/v1/localize", files=files)
    assert response.status_code == 422
    body = response.json()
    assert body["field"] == field
    assert body["detail"].startswith(f"{field}: ")
    assert words in body["detail"]
    assert "\n" not in body["detail"]


@pytest.mark.parametrize(
    ("content", "kind", "words"),
    [
        (b"", "", "multipart/form-data"),
        (b"{}", "application/json", "multipart/form-data"),
        (b"a=b", "application/x-www-form-urlencoded", "multipart/form-data"),
        (b"--x", "multipart/form-data", "boundary"),
        (b"junk", "multipart/form-data; boundary=x", "Invalid multipart"),
        (b"--x\r\n\r\nhi\r\n--x--\r\n", "multipart/form-data; boundary=x", "name"),
        (b"--x\r\nContent-Disp", "multipart/form-data; boundary=x", "color: missing"),
        (b"", "multipart/form-data; boundary=" + "x" * 5000, ""),
    ],
)
def test_a_body_that_is_no_form_is_said_so(client, content, kind, words):
    """Other bodies and broken forms are a 422 in one sentence, never a 500."""
    response = client.post("/v1/localize", content=content, headers={"Content-Type": kind})
    assert response.status_code == 422
    assert words in response.json()["detail"]


@pytest.mark.parametrize(
    ("charset", "name", "text"),
    [
        ("unicode_escape", b"camera", b"\\ud800"),  # a lone surrogate, which no bytes are made of
        ("undefined", b"camera", b"{}"),
        ("punycode", b"camera!", b"{}"),
    ],
)
def test_a_charset_that_makes_no_text_is_said_so(charset, name, text):
    """Python knows codecs that fail in ways of their own: a 422 like any other, and counted."""
    bench = Bench()
    part = b'--x\r\nContent-Disposition: form-data; name="%b"\r\n\r\n%b\r\n--x--\r\n'
    kind = f"multipart/form-data; charset={charset}; boundary=x"
    with serving(bench) as client:
        response = client.post(
            "/v1/localize", content=part % (name, text), headers={"Content-Type": kind}
        )
    assert response.status_code == 422
    assert response.json()["field"] == "form"
    assert "charset" in response.json()["detail"]
    assert bench.count("edge_http_localize_total", status="422") == 1


@pytest.mark.parametrize("query", ["", "?draw=1"])
def test_a_fault_of_its_own_is_counted_and_tells_nothing(caplog, query):
    """A 500 with the usual body; what happened is for the log, with its traceback."""
    bench = Bench(KnownDetector(error=RuntimeError("secret of the house")))
    with serving(bench) as client:
        response = client.post(f"/v1/localize{query}", files=FILES)
    assert response.status_code == 500
    assert response.json() == {
        "field": None,
        "detail": "a fault of the service's own; its log says more",
    }
    assert bench.count("edge_http_localize_total", status="500") == 1
    (record,) = caplog.records
    assert record.name == "edge_service.http.localize"
    assert record.exc_info[1].args == ("secret of the house",)


def test_one_field_twice_is_refused(client):
    """Which of two pictures was meant cannot be known."""
    files = [("color", FILES["color"]), ("color", FILES["color"]), ("camera", FILES["camera"])]
    response = client.post("/v1/localize", files=files)
    assert response.status_code == 422
    assert response.json() == {"field": "color", "detail": "color: given more than once"}


def chunked(n_bytes):
    """A form that goes on and on without saying how long it is."""
    yield b'--x\r\nContent-Disposition: form-data; name="color"; filename="c"\r\n\r\n'
    for _ in range(n_bytes // 50_000):
        yield bytes(50_000)


@pytest.mark.parametrize("declared", [True, False])
def test_too_large_an_upload_is_cut_off(client, declared):
    """A 413 whether the size was declared or only turned out."""
    if declared:
        response = client.post("/v1/localize", files=FILES | {"depth": ("d", bytes(1_000_001))})
    else:
        response = client.post(
            "/v1/localize",
            content=chunked(1_500_000),
            headers={"Content-Type": "multipart/form-data; boundary=x"},
        )
    assert response.status_code == 413
    assert response.json()["detail"] == "the upload is over 1 MB"
    assert response.headers["connection"] == "close"


def test_a_declared_size_is_refused_before_it_is_sent(client):
    """A client that says how much will come is told at once, not after it was sent."""
    with socket.create_connection((client.base_url.host, client.base_url.port), 20) as upload:
        upload.sendall(
            b"POST /v1/localize HTTP/1.1\r\nHost: x\r\nContent-Length: 1000001\r\n"
            b"Content-Type: multipart/form-data; boundary=x\r\n\r\n"
        )
        assert upload.recv(12) == b"HTTP/1.1 413"


def test_an_upload_never_touches_the_disk(client, monkeypatch):
    """The root file system is read-only in a cluster: even the largest upload stays in memory."""
    monkeypatch.setattr(tempfile, "tempdir", "/nowhere")
    response = client.post("/v1/localize", files=FILES | {"color": ("c", bytes(990_000))})
    assert response.status_code == 422
    monkeypatch.setattr(MultiPartParser, "spool_max_size", 1000)
    assert client.post("/v1/localize", files=FILES).status_code == 200


def test_a_client_that_goes_away_leaves_no_trace(caplog):
    """Half an upload and a closed connection: counted, not logged, and its place is free again."""
    bench = Bench(http_waiting=2)
    with serving(bench) as client:
        for _ in range(3):  # as many as have a place
            with socket.create_connection((client.base_url.host, client.base_url.port)) as half:
                half.sendall(
                    b"POST /v1/localize HTTP/1.1\r\nHost: x\r\nContent-Length: 9000\r\n"
                    b"Content-Type: multipart/form-data; boundary=x\r\n\r\n--x\r\n"
                )
        asked = 0
        while bench.count("edge_http_localize_total", status="400") < 3:
            client.get("/livez")
            asked += 1
            assert asked < 5000
        assert client.post("/v1/localize", files=FILES).status_code == 200
    assert caplog.text == ""


def test_pictures_wait_in_a_bounded_line():
    """One in work, as many waiting as the setting says, the others get a 503 at once."""
    detector = HeldDetector()
    bench = Bench(detector, http_waiting=1)
    with serving(bench) as client, ThreadPoolExecutor() as pool:
        jobs = [pool.submit(client.post, "/v1/localize", files=FILES) for _ in range(4)]
        done = as_completed(jobs)
        turned_away = [next(done).result() for _ in range(2)]
        assert client.get("/livez").status_code == 200  # the event loop is not blocked
        detector.go.release(2)
        served = [job.result() for job in done]
    for response in turned_away:
        assert response.status_code == 503
        assert response.headers["retry-after"] == "1"
        assert response.json()["detail"] == "too many pictures wait already"
    assert [r.status_code for r in served] == [200, 200]


def test_a_picture_that_the_detector_does_not_take_is_a_422():
    """Too small a picture is the sender's fault, not the service's."""
    bench = Bench(KnownDetector(error=ImageError("too small")))
    with serving(bench) as client:
        response = client.post("/v1/localize", files=FILES)
    assert response.status_code == 422
    assert response.json() == {"field": "color", "detail": "color: too small"}


def test_health_follows_the_state():
    """Alive while the loop goes round; ready only while everything stands, and it says what not."""
    bench = Bench(heartbeat_s=1)
    pipeline, bench.state.pipeline = bench.state.pipeline, None
    transport, bench.state.transport = bench.state.transport, None
    with serving(bench) as client:
        assert client.get("/livez").json() == {"alive": True, "silent_s": None}
        response = client.get("/readyz")
        assert response.status_code == 503
        assert response.json() == {
            "ready": False,
            "model_warm": False,
            "link_open": False,
            "not_draining": True,
        }
        for path in ("/v1/model", "/v1/localize"):
            method = "GET" if path.endswith("model") else "POST"
            response = client.request(method, path)
            assert (response.status_code, response.headers["retry-after"]) == (503, "1")
        bench.state.pipeline, bench.state.transport = pipeline, transport
        bench.service.start()
        assert client.get("/readyz").json()["ready"]
        bench.drain()
        assert client.get("/readyz").json()["not_draining"] is False
        bench.clock.advance(2 * SECOND_NS)
        assert client.get("/livez").status_code == 503


def test_metrics_are_in_prometheus_format(client):
    """Every series has its help and type, and requests are counted by their status."""
    client.post("/v1/localize")
    text = client.get("/metrics").text
    for name in ("edge_frames_total", "edge_rejected_total", "edge_ready", "edge_build_info"):
        assert re.search(rf"^# HELP {name} .+\.$", text, re.MULTILINE)
    assert re.search(r'^edge_http_localize_total\{status="422"\} [1-9]', text, re.MULTILINE)
    assert 'edge_rejected_total{reason="checksum"} 0.0' in text
    assert "_created" not in text


def test_the_model_says_what_it_looks_for(client):
    """The target's geometry and the detector's own description."""
    body = client.get("/v1/model").json()
    assert body["target"]["name"] == "bullseye-400"
    assert body["target"]["level_m"]["T_best"] == 0.14
    assert body["detector"]["name"] == "known"
    assert body["worker"] == "w1"


class Links(HTMLParser):
    """Collects what a page would load, and whether its tags are balanced."""

    def __init__(self):
        super().__init__()
        self.loaded, self.open = [], []

    def handle_starttag(self, tag, attrs):
        self.loaded += [v for k, v in attrs if k in ("src", "href")]
        if tag not in ("meta", "link", "br", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.mark.parametrize("path", ["/", "/docs"])
def test_the_page_needs_nothing_from_elsewhere(client, path):
    """The page that people see first works without a network and names every endpoint."""
    response = client.get(path)
    page = Links()
    page.feed(response.text)
    assert page.loaded == ["/openapi.json"]
    assert page.open == []
    for endpoint in ("POST /v1/localize", "GET /v1/model", "GET /livez", "GET /readyz"):
        assert endpoint in response.text
    assert "curl -F color=@color.jpg" in response.text


def test_the_examples_are_true(client):
    """What the OpenAPI description shows is what the service takes and answers."""
    description = client.get("/openapi.json").json()
    camera_from_json(CAMERA)
    operation = description["paths"]["/v1/localize"]["post"]
    assert set(operation["responses"]) == {"200", "408", "413", "422", "500", "503"}
    content = operation["responses"]["200"]["content"]["application/json"]
    assert content["schema"] == {"$ref": "#/components/schemas/LocalizeBody"}
    found, nothing = (e["value"] for e in content["examples"].values())
    body = client.post("/v1/localize", files=FILES).json()
    assert body.keys() == found.keys() == nothing.keys()
    assert body["target"].keys() == found["target"].keys()
    assert body["target"]["evidence"].keys() == found["target"]["evidence"].keys()
    assert body["timings_ms"].keys() == found["timings_ms"].keys()
    assert nothing["target"] is None


def test_where_a_socket_is_reached():
    """A URL that can be pasted, of the port that was given."""
    with bind("127.0.0.1", 0) as listener:
        assert url_of(listener) == f"http://127.0.0.1:{listener.getsockname()[1]}"


@pytest.mark.parametrize(
    ("host", "words"), [("192.0.2.1", "Cannot assign"), ("no.invalid", ""), ("a..b", "not a host")]
)
def test_an_address_that_is_not_ours_is_one_line(host, words):
    """Which address, what is wrong with it, which flag gives another one."""
    with pytest.raises(AddressError) as error:
        bind(host, 1)
    line = str(error.value)
    assert line.startswith(f"HTTP on {host}:1: ")
    assert words in line
    assert "--http or EDGE_HTTP" in line


def test_a_path_that_is_none_is_a_404(client):
    """Nothing else is served."""
    assert client.get("/v1/nothing").status_code == 404
    assert client.get("/v1/localize").status_code == 405
