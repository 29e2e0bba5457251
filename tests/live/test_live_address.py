"""Who may open the live page and its socket: the token, the Host and the origin of a request."""

import pytest
from live_team import TOKEN, Served, setup_of, until_update, why_closed
from starlette.datastructures import Headers

from hitl_jax.live import server
from hitl_jax.live.session import Session


@pytest.fixture(scope="module")
def one_for_all(tmp_path_factory):
    """A session that no page opens, for all tests."""
    folder = tmp_path_factory.mktemp("served")
    with Served(Session(setup_of()), folder / "journal.jsonl") as one:
        yield one


def test_only_those_who_know_the_address_come_in(served):
    assert served.page("/")[0] == 403
    assert served.page("/?token=wrong")[0] == 403
    status, text = served.page(f"/?token={TOKEN}")
    assert status == 200
    assert "<canvas" in text
    assert served.page(f"/?token={TOKEN}", Host="evil.example")[0] == 400
    assert served.page("/../server.py")[0] == 404
    with served.open(token="wrong") as page:
        assert why_closed(page) == (
            4403,
            "the address needs the token that `hitl-jax live` printed",
        )
    with served.open(origin="http://evil.example") as page:
        assert why_closed(page) == (4400, "another site's page may not speak to this session")
    with served.open(origin=None, token="wrong") as page:
        assert why_closed(page)[0] == 4403
    assert served.session.frame.number == 0  # Nobody came: nothing was played.


@pytest.mark.parametrize(
    "host", ["127.0.0.1:9000", "localhost:9000", "LOCALHOST:9000", "[::1]:9000", "127.0.0.2:80"]
)
def test_the_page_works_behind_a_tunnel_from_another_port(served, host):
    """As after `ssh -L 9000:127.0.0.1:8765`: the page and its socket are asked for at port 9000."""
    assert served.page(f"/?token={TOKEN}", Host=host)[0] == 200
    assert served.page("/live.js", Host=host)[0] == 200
    assert served.page("/", Host=host)[0] == 403
    with served.open(host=host) as page:
        assert until_update(page, "hello")["role"] == "controller"
    with served.open(host=host, token="wrong") as page:
        assert why_closed(page)[0] == 4403
    with served.open(host=host, origin="http://evil.example") as page:
        assert why_closed(page) == (4400, "another site's page may not speak to this session")


@pytest.mark.parametrize(
    ("host", "origin", "own"),
    [
        ("localhost:8765", "http://localhost:8765", True),
        ("localhost:8765", "http://LocalHost:8765", True),
        ("LOCALHOST:8765", "http://localhost:8765", True),
        ("[::1]:9000", "http://[::1]:9000", True),
        ("127.1.2.255:9000", "http://127.1.2.255:9000", True),
        # A port that is left out is the scheme's.
        ("localhost", "http://localhost", True),
        ("localhost:80", "http://localhost", True),
        ("localhost", "http://localhost:80", True),
        ("localhost", "https://localhost", True),
        ("localhost:443", "https://localhost", True),
        ("localhost:80", "https://localhost", False),
        ("localhost:443", "http://localhost", False),
        # A proxy that adds TLS.
        ("localhost:9000", "https://localhost:9000", True),
        # Another page of this machine.
        ("localhost:8765", "http://localhost:8766", False),
        ("localhost:8765", "http://localhost", False),
        ("localhost:8765", "http://127.0.0.1:8765", False),
        ("127.0.0.1:8765", "http://localhost:8765", False),
        ("127.0.0.1:8765", "http://127.0.0.2:8765", False),
        ("127.0.0.1:8765", "http://[::1]:8765", False),
        ("[::1]:8765", "http://::1:8765", False),
        # No page of ours.
        ("localhost:8765", "null", False),
        ("localhost:8765", "", False),
        ("localhost:8765", "http://", False),
        ("localhost:8765", "localhost:8765", False),
        ("localhost:8765", "ws://localhost:8765", False),
        ("localhost:8765", "file://localhost:8765", False),
        ("localhost:8765", "http://localhost:8765/", False),
        ("localhost:8765", "http://me@localhost:8765", False),
        ("localhost:8765", "http://localhost:8765.evil.example", False),
        ("localhost:8765", "http://evil.example:8765", False),
        ("localhost:8765", "http://localhost:8765 http://localhost:8765", False),
    ],
)
def test_only_a_page_of_the_host_that_is_asked_may_speak(host, origin, own):
    assert server.is_same_origin(Headers({"host": host, "origin": origin})) == own


def test_who_is_no_page_may_speak_and_who_says_two_things_may_not():
    host = (b"host", b"localhost:8765")
    origin = (b"origin", b"http://localhost:8765")
    assert server.is_same_origin(Headers(raw=[host]))
    assert server.is_same_origin(Headers(raw=[host, origin]))
    assert not server.is_same_origin(Headers(raw=[host, origin, origin]))


_UPGRADE = (
    "Connection: Upgrade",
    "Upgrade: websocket",
    "Sec-WebSocket-Version: 13",
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
)


@pytest.mark.parametrize("path", ["/", "/live.js", "/socket"])
@pytest.mark.parametrize(
    "hosts",
    [
        ["evil.example"],  # Such a name can lead here: DNS rebinding.
        ["evil.example:8765"],
        ["localhost.evil.example:8765"],
        ["127.0.0.1.evil.example"],
        ["127.0.0.256:8765"],
        ["0.0.0.0:8765"],
        ["10.0.0.1:8765"],
        ["localhost:port"],
        ["localhost:"],
        ["[::2]:8765"],
        ["::1"],
        ["me@localhost:8765"],
        ["local host"],
        ["löcalhost"],
        [""],
        ["localhost:8765", "evil.example"],
        ["localhost:8765", "localhost:8765"],
        [],
    ],
)
def test_requests_for_other_names_are_refused_in_one_line(one_for_all, hosts, path):
    lines = [f"GET {path}?token={TOKEN} HTTP/1.1", *(f"Host: {host}" for host in hosts)]
    if path == "/socket":
        origins = (f"Origin: http://{host}" for host in hosts[:1])
        lines += [*_UPGRADE, *origins]
    status, said = one_for_all.answer(*lines)
    assert status == 400
    assert "Host must be localhost" in said or "Invalid HTTP request" in said
    assert one_for_all.session.frame.number == 0
